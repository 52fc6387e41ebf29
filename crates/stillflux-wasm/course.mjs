// A session of the WebAssembly module under node: what `examples/course.rs` does on the host, from the same arguments.
//     node course.mjs stillflux.wasm FILE start:0,1,1,7,1 set:0,3.5 run:20000 …
// The columns of every `run` go to FILE. Prints periods run and the time this took.
import fs from "node:fs";

const [module, file, ...steps] = process.argv.slice(2);
const { instance } = await WebAssembly.instantiate(fs.readFileSync(module), {});
const core = instance.exports;
const decoder = new TextDecoder();
const text = (length) => decoder.decode(new Uint8Array(core.memory.buffer, core.playground_text(), length));

const values = JSON.parse(text(core.playground_describe())).signals.reduce((n, s) => n + (s.complex ? 2 : 1), 1);
const out = fs.openSync(file, "w");
let [periods, busy] = [0, 0];
for (const step of steps) {
    const [what, list] = step.split(":");
    const x = list.split(",").map(Number);
    if (what === "run") {
        const begin = performance.now();
        const rows = core.playground_run(x[0]);
        busy += performance.now() - begin;
        periods += x[0];
        fs.writeSync(out, new Uint8Array(core.memory.buffer, core.playground_columns(), 8 * rows * values));
    } else {
        const said = { start: core.playground_start, set: core.playground_set }[what](...x);
        if (said) throw new Error(`${step}: ${text(said)}`);
    }
}
fs.closeSync(out);
console.log(JSON.stringify({ periods, seconds: busy / 1000 }));
