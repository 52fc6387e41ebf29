//! A session on the host, for comparison with that of the WebAssembly module: what `course.mjs` does, from the same
//! arguments: `course FILE start:0,1,1,7,1 set:0,3.5 run:20000 …`. The columns of every `run` go to FILE.

use std::io::Write;

use stillflux_wasm::exports;

fn main() -> std::io::Result<()> {
    let mut args = std::env::args().skip(1);
    let mut out = std::fs::File::create(args.next().expect("a file to write"))?;
    for step in args {
        let (what, values) = step.split_once(':').expect("what:values");
        let x: Vec<f64> = values.split(',').map(|x| x.parse().expect("a number")).collect();
        let n = |k: usize| x[k] as u32;
        let said = match what {
            "start" => exports::playground_start(n(0), n(1), n(2), n(3), n(4)),
            "set" => exports::playground_set(n(0), x[1]),
            "run" => {
                exports::playground_run(n(0));
                let bytes: Vec<u8> = exports::columns().iter().flat_map(|x| x.to_le_bytes()).collect();
                out.write_all(&bytes)?;
                0
            }
            _ => panic!("{what} is none of start, set, run"),
        };
        assert_eq!(said, 0, "{step}: {}", exports::text());
    }
    Ok(())
}
