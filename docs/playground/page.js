// The page: controls, loop, readings.
"use strict";

const SPAN = 10; // s of signals that are shown
const FLUX_SPAN = 1.5; // s of trajectory
const RECORD_EVERY = 20; // control periods from row to row
const BUDGET = 20; // ms of computation in one frame, at most
const REDRAW = 40; // ms from one drawing to the next
const AFTER = 2; // s for which a lost run goes on: what happened stays in view

const DEGREES = 180 / Math.PI;
const R_MIN = 60 / (2 * Math.PI);

/** How settings are shown: unit of the display, its factor to SI, step in units of the display, what it relates to. */
const DISPLAY = {
    speed: { label: "Speed", unit: "r/min", factor: R_MIN, step: () => 1, of: (i) => [i.rated_speed, "of synchronous"] },
    load: { label: "Load torque", unit: "N·m", factor: 1, step: (i) => nice(0.006 * i.T_N), of: (i) => [i.T_N, "of rated"] },
    offset: {
        label: "Offset of current sensor a", unit: "mA", factor: 1e3,
        step: (i) => nice(0.8 * i.I_N), of: (i) => [Math.SQRT2 * i.I_N, "of rated peak"],
    },
    R_s: {
        label: "Stator resistance", unit: "Ω", factor: 1,
        step: (i, s) => nice(0.006 * s.default), of: (i, s) => [s.default, "of data sheet"],
    },
    dead_time: { label: "Dead time", unit: "µs", factor: 1e6, step: () => 0.1 },
    c_out: { label: "Capacitance of a leg", unit: "nF", factor: 1e9, step: () => 0.1 },
};
const SET_POINTS = ["speed", "load"];

const byId = (id) => document.getElementById(id);
const minus = (text) => text.replace("-", "−");

/** A slider in whole steps from its default, so that the default is met exactly. */
class Slider {
    constructor(installation, setting, index, changed) {
        const display = DISPLAY[setting.name];
        Object.assign(this, { installation, setting, index, display });
        this.step = display.step(installation, setting) / display.factor;
        const steps = (x) => Math.trunc((x - setting.default) / this.step + Math.sign(x - setting.default) * 1e-6);
        const [first, last] = [steps(setting.min), steps(setting.max)];

        const root = document.createElement("div");
        root.className = "slider";
        root.innerHTML = `<label for="set-${setting.name}">${display.label} <output for="set-${setting.name}"></output></label>
            <div><input type="range" id="set-${setting.name}" min="${first}" max="${last}" step="1" value="0"></div>`;
        this.root = root;
        this.input = root.querySelector("input");
        this.output = root.querySelector("output");
        if (!SET_POINTS.includes(setting.name)) {
            this.input.parentElement.className = "track";
            this.input.parentElement.style.setProperty("--mark", -first / (last - first));
        }
        this.input.addEventListener("input", () => {
            this.show();
            changed(this);
        });
        this.show();
    }

    /** Value in SI. */
    get value() {
        return this.setting.default + Number(this.input.value) * this.step;
    }

    set value(x) {
        this.input.value = Math.round((x - this.setting.default) / this.step);
        this.show();
    }

    show() {
        const { unit, factor, of } = this.display;
        const text = `${onGrid(this.value * factor, this.step * factor)} ${unit}`;
        let relative = "";
        if (of) {
            const [base, name] = of(this.installation, this.setting);
            relative = ` ${minus(((100 * this.value) / base).toFixed(0))} % ${name}`;
        }
        this.output.innerHTML = `${text}<small>${relative}</small>`;
        this.input.setAttribute("aria-valuetext", text + relative);
    }
}

const rpm = (x) => () => x / R_MIN;
const rated = (x) => (i) => x * i.T_N;
const warm = (x) => (i) => x * i.settings.find((s) => s.name === "R_s").default;

/** What happens by itself: steps [t, setting, value(installation)], t in s from the start. */
const EXPERIMENTS = [
    {
        name: "A load is lowered, the resistance rises",
        text: "Rated load at −15 r/min: the machine brakes. At 7 s its resistance rises by 20 % at once.",
        steps: [[0, "speed", rpm(-15)], [4, "load", rated(1)], [7, "R_s", warm(1.2)]],
    },
    {
        name: "A sensor’s offset appears",
        text: "Half the rated load at −10 r/min. At 6 s the sensor of phase a gets an offset of 2 %.",
        steps: [[0, "speed", rpm(-10)], [4, "load", rated(0.5)], [6, "offset", (i) => 0.02 * Math.SQRT2 * i.I_N]],
    },
    {
        name: "A slow reversal under load",
        text: "From 60 to −120 r/min in 30 s under rated load: slowly through zero stator frequency.",
        steps: [
            [0, "speed", rpm(60)], [3, "load", rated(1)],
            ...Array.from({ length: 61 }, (_, k) => [5 + k / 2, "speed", rpm(60 - 3 * k)]),
        ],
    },
    {
        name: "Standstill, then rated load",
        text: "Twenty seconds at zero stator frequency without load. At 22 s the rated load comes at once.",
        steps: [[22, "load", rated(1)]],
    },
];

class Page {
    constructor(core) {
        this.core = core;
        this.history = new History(core.description.signals, Math.ceil((SPAN + 1) * 1e4 / RECORD_EVERY));
        this.paused = false;
        this.experiment = null;
        this.seed = 1;
        this.reached = { wall: performance.now(), simulated: 0 };

        const running = (h, k) => h.at("status", k) === STATUS.RUNNING;
        const estimate = (name, factor) => {
            const column = `estimate.${name}`;
            return (h, k) => (running(h, k) ? factor * h.at(column, k) : NaN);
        };
        const truth = (name, factor) => (h, k) => factor * h.at(name, k);
        this.flux = new FluxPlot(document.querySelector("#flux canvas"), {
            truth: "psi_s", estimate: "estimate.psi_s", shown: running,
        });
        const R_s = estimate("R_s", 1);
        const dashed = { colour: "reference", dash: [6, 4] };
        const chart = (title, unit, keys, options) => this.#chart(title, unit, keys, options);
        this.charts = [
            chart("Speed", "r/min", { true: "true", estimate: "estimated", reference: "set point" }, {
                least: [-10, 10],
                lines: [
                    { of: truth("reference", R_MIN), ...dashed },
                    { of: truth("omega_m", R_MIN), colour: "true" },
                    { of: estimate("omega_m", R_MIN), colour: "estimate" },
                ],
            }),
            chart("Field angle error", "degrees", { true: "true", band: "drive expects (2 σ)" }, {
                least: [-5, 5],
                room: 30,
                band: (h, k) => (running(h, k) ? Math.min(180, 2 * DEGREES * h.at("estimate.angle_deviation", k)) : NaN),
                lines: [{ of: (h, k) => (running(h, k) ? DEGREES * h.at("angle_error", k) : NaN), colour: "true" }],
            }),
            chart("Drive’s confidence in its angle", "0 to 1", {}, {
                fixed: [0, 1],
                marks: [0.5],
                lines: [{ of: estimate("confidence", 1), colour: "estimate" }],
            }),
            chart("Torque", "N·m", { true: "true", estimate: "estimated", reference: "load" }, {
                least: [-1, 1],
                lines: [
                    { of: truth("load_torque", 1), ...dashed },
                    { of: truth("torque", 1), colour: "true" },
                    { of: estimate("torque", 1), colour: "estimate" },
                ],
            }),
            chart("Stator resistance", "Ω", { true: "true", estimate: "estimated" }, {
                least: null,
                lines: [
                    { of: truth("R_s", 1), colour: "true" },
                    { of: (h, k) => R_s(h, k) - this.installation.r_d, colour: "estimate" },
                ],
            }),
        ];

        const { installations } = core.description;
        byId("installation").innerHTML = installations.map((i, k) => `<option value="${k}">${i.name}</option>`).join("");
        byId("installation").addEventListener("change", () => this.install());
        for (const input of document.querySelectorAll("[name=scheme], #offset-estimator")) {
            input.addEventListener("change", () => this.start());
        }
        byId("restart").addEventListener("click", () => {
            this.seed += 1;
            this.start();
        });
        byId("pause").addEventListener("click", () => this.pause(!this.paused));
        byId("as-data-sheet").addEventListener("click", () => {
            for (const slider of this.sliders.filter((s) => !SET_POINTS.includes(s.setting.name))) {
                this.#move(slider, slider.setting.default);
            }
        });
        EXPERIMENTS.forEach((experiment) => {
            const button = document.createElement("button");
            button.type = "button";
            button.textContent = experiment.name;
            button.setAttribute("aria-pressed", "false");
            button.addEventListener("click", () => this.try(experiment));
            byId("experiments").append(button);
        });
        this.install();
        requestAnimationFrame((t) => this.#frame(t));
    }

    /** Takes the chosen machine: its sliders, everything as in its data sheet. */
    install() {
        const k = Number(byId("installation").value);
        this.installation = this.core.description.installations[k];
        this.rated = Math.sqrt(2 / 3) * this.installation.U_N / (2 * Math.PI * this.installation.f_N);
        this.sliders = this.installation.settings.map(
            (setting, index) => new Slider(this.installation, setting, index, (slider) => this.#manual(slider)));
        const placed = (name) => SET_POINTS.includes(name);
        byId("set-points").replaceChildren(...this.sliders.filter((s) => placed(s.setting.name)).map((s) => s.root));
        byId("installation-settings").replaceChildren(
            ...this.sliders.filter((s) => !placed(s.setting.name)).map((s) => s.root));
        this.slider("speed").value = 30 / R_MIN;
        this.slider("load").value = 0.5 * this.installation.T_N;
        const R_s = this.slider("R_s").setting.default;
        this.charts.at(-1).least = [0.8 * R_s, 1.2 * R_s];
        this.start();
    }

    slider(name) {
        return this.sliders.find((s) => s.setting.name === name);
    }

    /** Starts anew with what the controls say; an experiment begins again. */
    start() {
        this.core.start({
            installation: Number(byId("installation").value),
            scheme: Number(document.querySelector("[name=scheme]:checked").value),
            offsetEstimator: byId("offset-estimator").checked,
            seed: this.seed,
            recordEvery: RECORD_EVERY,
        });
        this.history.clear();
        this.verdict = new Verdict();
        this.owed = 0;
        this.done = 0;
        this.over = false;
        if (this.experiment) {
            for (const slider of this.sliders) slider.value = slider.setting.default;
            this.steps = [...this.experiment.steps];
        } else {
            this.steps = [];
        }
        for (const slider of this.sliders) this.core.set(slider.index, slider.value);
        this.#tell();
    }

    /** Runs an experiment, or with null leaves it. */
    try(experiment) {
        this.experiment = experiment;
        [...byId("experiments").children].forEach((button, k) =>
            button.setAttribute("aria-pressed", String(EXPERIMENTS[k] === experiment)));
        byId("experiment-text").textContent = experiment?.text ?? "";
        if (experiment) {
            this.pause(false);
            this.start();
        }
    }

    pause(paused) {
        this.paused = paused;
        byId("pause").setAttribute("aria-pressed", String(paused));
        byId("pause").textContent = paused ? "Go on" : "Pause";
    }

    #chart(title, unit, keys, options) {
        const figure = document.createElement("figure");
        const key = Object.entries(keys).map(([kind, text]) => `<span class="key ${kind}">${text}</span>`).join(" ");
        figure.innerHTML = `<figcaption><span><b>${title}</b>, ${unit}</span> ${key}</figcaption>
            <canvas role="img" aria-label="${title} in ${unit} over the last ${SPAN} seconds"></canvas>`;
        byId("charts").append(figure);
        return new StripChart(figure.querySelector("canvas"), options);
    }

    #move(slider, value) {
        slider.value = value;
        this.core.set(slider.index, slider.value);
    }

    /** A slider moved by hand ends an experiment: its further steps would move it back. */
    #manual(slider) {
        this.steps = [];
        this.try(null);
        this.core.set(slider.index, slider.value);
    }

    /** Runs so many periods, with the steps of an experiment at their times. */
    #run(periods) {
        const f_s = this.installation.f_s;
        while (this.steps.length && this.steps[0][0] * f_s <= this.done) {
            const [, name, value] = this.steps.shift();
            this.#move(this.slider(name), value(this.installation));
        }
        const rows = this.core.run(periods);
        this.done += rows.count * RECORD_EVERY;
        this.history.append(rows);
        this.verdict.judge(rows, () => this.core.fault());
        const { lost } = this.verdict;
        this.over = !rows.count || (lost !== null && this.done > (lost.t + AFTER) * f_s);
    }

    #frame(now) {
        requestAnimationFrame((t) => this.#frame(t));
        const elapsed = Math.min(0.1, (now - (this.before ?? now)) / 1000);
        this.before = now;
        if (!this.paused) {
            // In pieces of 10 ms, as many as are owed and fit into the frame; what does not fit is not owed.
            const piece = Math.round(0.01 * this.installation.f_s);
            this.owed += elapsed * Number(byId("rate").value) * this.installation.f_s;
            const until = performance.now() + BUDGET;
            let from = this.done;
            while (this.owed >= piece && performance.now() < until && !this.over) {
                this.#run(piece);
                this.owed -= piece;
            }
            this.owed = Math.min(this.owed, piece);
            this.reached.simulated += (this.done - from) / this.installation.f_s;
        }
        if (now - (this.drawn ?? 0) >= REDRAW) {
            this.drawn = now;
            for (const chart of this.charts) chart.draw(this.history, SPAN);
            this.flux.draw(this.history, FLUX_SPAN, this.rated);
        }
        if (now - this.reached.wall > 500) this.#tell(now);
    }

    /** Verdict and readings in words: twice a second, that they can be read. */
    #tell(now = performance.now()) {
        const { history: h, verdict: v } = this;
        const seconds = (now - this.reached.wall) / 1000;
        if (seconds > 0.4) {
            const rate = this.reached.simulated / seconds;
            byId("rate-reached").textContent = this.over
                ? "The run has ended: Restart, or change one of them."
                : this.paused ? "" : `Running at ${rate.toFixed(1)} × real time.`;
            this.reached = { wall: now, simulated: 0 };
        }
        const running = h.last("status") === STATUS.RUNNING;
        const deviation = 2 * DEGREES * h.last("estimate.angle_deviation");
        const shown = (x, digits, unit) => (Number.isFinite(x) ? `${onGrid(x, 10 ** -digits)} ${unit}` : "–");
        const angle = DEGREES * h.last("angle_error");
        const only = (text) => (running ? text : "–");
        byId("reading-angle").textContent = only(`${onGrid(angle, 0.1)}°`);
        byId("reading-deviation").textContent = only(`±${Math.min(180, deviation).toFixed(1)}°`);
        byId("reading-confidence").textContent = only(h.last("estimate.confidence").toFixed(2));
        byId("reading-frequency").textContent = shown(h.last("omega_s") / (2 * Math.PI), 2, "Hz");
        byId("reading-current").textContent = shown(Math.hypot(h.last("i_s.re"), h.last("i_s.im")), 1, "A");
        byId("reading-time").textContent = shown(h.last("t"), 1, "s");

        const noticed = (confidence, when) =>
            `${when} the drive’s confidence was ${confidence.toFixed(2)}: it ${confidence < 0.5 ? "knew" : "did not know"}`;
        const passed = "when this passed 15°";
        const words = {
            starting: ["Starting", "reads its sensors’ offsets, then magnetises the machine; the brake holds the shaft"],
            held: ["Held", "the true field angle is within 15° of the estimate"],
            off: ["Off", v.excursion && `true angle error beyond 15°; ${noticed(v.excursion.confidence, passed)}`],
            lost: ["Lost", v.lost && `after ${v.lost.t.toFixed(1)} s: ${v.lost.why}; `
                + noticed(v.lost.confidence, v.lost.excursion ? "when the angle error passed 15°" : "until then")],
        }[v.state];
        if (byId("verdict-word").textContent !== words[0]) byId("verdict-word").textContent = words[0];
        if (byId("verdict-text").textContent !== words[1]) byId("verdict-text").textContent = words[1];
        byId("verdict").dataset.state = v.state;
    }
}

Drawing.readStyle();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => Drawing.readStyle());
Core.load(MODULE).then(
    (core) => (window.playground = new Page(core)),
    (error) => {
        byId("verdict-word").textContent = "Not started";
        byId("verdict-text").textContent = String(error);
    },
);
