// The WebAssembly module: a drive on its plant, as numbers.
"use strict";

/** The module; SI units. A call that is refused throws an Error with the module's text. */
class Core {
    /** From the module's bytes in base 64: a page that is opened as a file must not fetch. */
    static async load(base64) {
        const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
        return new Core((await WebAssembly.instantiate(bytes, {})).instance.exports);
    }

    constructor(exports) {
        this.exports = exports;
        /** Installations with the ranges of their settings, and signals: `description.rs`. */
        this.description = JSON.parse(this.#text(exports.playground_describe()));
    }

    /** Starts anew, at rest. */
    start({ installation, scheme, offsetEstimator, seed, recordEvery }) {
        this.#accepted(this.exports.playground_start(installation, scheme, offsetEstimator ? 1 : 0, seed, recordEvery));
    }

    /** Sets one thing by its position in the description. */
    set(setting, value) {
        this.#accepted(this.exports.playground_set(setting, value));
    }

    /** Runs control periods; the rows as {count, t, name: Float64Array …}, complex signals with two values a row. The
     *  arrays are valid until the next call. */
    run(periods) {
        const count = this.exports.playground_run(periods);
        let address = this.exports.playground_columns();
        const take = (n) => {
            const column = new Float64Array(this.exports.memory.buffer, address, n);
            address += 8 * n;
            return column;
        };
        const rows = { count, t: take(count) };
        for (const signal of this.description.signals) {
            rows[signal.name] = take(signal.complex ? 2 * count : count);
        }
        return rows;
    }

    /** Why the drive has stopped; empty: it has not. */
    fault() {
        return this.#text(this.exports.playground_fault());
    }

    #accepted(length) {
        if (length) throw new Error(this.#text(length));
    }

    #text(length) {
        return new TextDecoder().decode(new Uint8Array(this.exports.memory.buffer, this.exports.playground_text(), length));
    }
}

/** The last rows, in rings of `capacity`: `at(name, k)` for k from `begin` to `end` - 1. */
class History {
    constructor(signals, capacity) {
        this.capacity = capacity;
        this.signals = signals;
        this.columns = { t: new Float64Array(capacity) };
        for (const s of signals) {
            for (const name of s.complex ? [`${s.name}.re`, `${s.name}.im`] : [s.name]) {
                this.columns[name] = new Float64Array(capacity);
            }
        }
        this.clear();
    }

    clear() {
        this.end = 0;
    }

    get begin() {
        return Math.max(0, this.end - this.capacity);
    }

    at(name, k) {
        return this.columns[name][k % this.capacity];
    }

    /** The first row that is not before `t`. */
    first(t) {
        let [low, high] = [this.begin, this.end];
        while (low < high) {
            const middle = (low + high) >> 1;
            if (this.at("t", middle) < t) low = middle + 1;
            else high = middle;
        }
        return low;
    }

    last(name) {
        return this.end ? this.at(name, this.end - 1) : NaN;
    }

    append(rows) {
        for (let k = 0; k < rows.count; k++) {
            const to = (this.end + k) % this.capacity;
            this.columns.t[to] = rows.t[k];
            for (const { name, complex } of this.signals) {
                if (complex) {
                    this.columns[`${name}.re`][to] = rows[name][2 * k];
                    this.columns[`${name}.im`][to] = rows[name][2 * k + 1];
                } else {
                    this.columns[name][to] = rows[name][k];
                }
            }
        }
        this.end += rows.count;
    }
}

/** Codes of the signal `status`. */
const STATUS = { READING_OFFSET: 1, MAGNETISING: 2, RUNNING: 3, FAULTED: 4 };

/** Whether the drive is held, off or lost, by the true angle error; row by row. */
class Verdict {
    /** Angle errors in rad from which on a drive is off, and lost. */
    static OFF = (15 / 180) * Math.PI;
    static LOST = (90 / 180) * Math.PI;
    /** An error below OFF for so long, s, ends an excursion. */
    static CALM = 0.5;

    constructor() {
        this.state = "starting";
        /** {t, confidence, last} when the error came to exceed OFF, and when it last did; null: it is below. */
        this.excursion = null;
        /** Of the loss {t, why, confidence, excursion}: the confidence when the error came to exceed OFF, if it did
         *  (excursion), else when the drive was lost; null: not lost. */
        this.lost = null;
        this.ran = false;
        /** Confidence of the row before: a drive that has stopped has none. */
        this.before = 0;
    }

    /** Takes rows; `fault` says why a drive has stopped. */
    judge(rows, fault) {
        for (let k = 0; k < rows.count && !this.lost; k++) {
            const running = rows.status[k] === STATUS.RUNNING;
            const error = running ? Math.abs(rows.angle_error[k]) : 0;
            const confidence = running ? rows["estimate.confidence"][k] : this.before;
            const now = { t: rows.t[k], confidence };
            this.ran ||= running;
            if (error >= Verdict.OFF) this.excursion = { ...(this.excursion ?? now), last: now.t };
            else if (this.excursion && now.t - this.excursion.last > Verdict.CALM) this.excursion = null;
            if (rows.status[k] === STATUS.FAULTED) this.#lose(now, `stopped: ${fault()}`);
            else if (error >= Verdict.LOST) this.#lose(now, "true angle error beyond 90°");
            this.before = confidence;
        }
        if (!this.lost && rows.count && fault()) {
            this.#lose({ t: rows.t[rows.count - 1], confidence: this.before }, fault());
        }
        this.state = this.lost ? "lost" : !this.ran ? "starting" : this.excursion ? "off" : "held";
    }

    #lose({ t, confidence }, why) {
        const excursion = Boolean(this.excursion);
        this.lost = { t, why, confidence: excursion ? this.excursion.confidence : confidence, excursion };
    }
}
