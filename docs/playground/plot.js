// Drawings on canvases, in the colours of the style sheet.
"use strict";

/** Canvas in CSS pixels, redrawn in its present size and colours. */
class Drawing {
    constructor(canvas) {
        this.canvas = canvas;
        this.context = canvas.getContext("2d");
    }

    /** Clears; width and height in CSS pixels. */
    begin() {
        const { clientWidth: width, clientHeight: height } = this.canvas;
        const ratio = window.devicePixelRatio || 1;
        const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
        if (this.canvas.width !== w || this.canvas.height !== h) [this.canvas.width, this.canvas.height] = [w, h];
        this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
        this.context.clearRect(0, 0, width, height);
        this.context.font = `12px ${Drawing.font}`;
        this.context.lineJoin = "round";
        return { width, height };
    }

    line(points, colour, { width = 1.75, dash = [] } = {}) {
        const c = this.context;
        c.strokeStyle = colour;
        c.lineWidth = width;
        c.setLineDash(dash);
        c.beginPath();
        let pen = false;
        for (let k = 0; k < points.length; k += 2) {
            if (Number.isNaN(points[k + 1])) pen = false;
            else if (pen) c.lineTo(points[k], points[k + 1]);
            else {
                c.moveTo(points[k], points[k + 1]);
                pen = true;
            }
        }
        c.stroke();
        c.setLineDash([]);
    }

    text(text, x, y, align, baseline = "middle") {
        const c = this.context;
        c.fillStyle = Drawing.colours.quiet;
        c.textAlign = align;
        c.textBaseline = baseline;
        c.fillText(text, x, y);
    }

    static font = "sans-serif";
    static colours = {};

    /** Takes the colours of the style sheet; again when the mode changes. */
    static readStyle() {
        const style = getComputedStyle(document.documentElement);
        for (const name of ["text", "quiet", "line", "grid", "true", "estimate", "band", "reference", "warn"]) {
            Drawing.colours[name] = style.getPropertyValue(`--${name}`).trim();
        }
        Drawing.font = getComputedStyle(document.body).fontFamily;
    }
}

/** 1, 2 or 5 times a power of ten, at least `x`. */
function nice(x) {
    const power = 10 ** Math.floor(Math.log10(x));
    return [1, 2, 5, 10].find((m) => m * power >= x * (1 - 1e-9)) * power;
}

/** Number with the digits that a grid of this step needs. */
function onGrid(x, step) {
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return (Math.abs(x) < step / 2 ? 0 : x).toFixed(digits).replace("-", "−");
}

/** Signals over the last `span` seconds. */
class StripChart extends Drawing {
    static MARGIN = { left: 46, right: 8, top: 8, bottom: 20 };

    /** lines: [{of(history, k), colour, dash, width}], NaN leaves a gap; band: a half width about zero, likewise,
     *  for which the range grows up to `room`; least: smallest range that is shown; fixed: the range; marks: levels drawn dashed. */
    constructor(canvas, { lines, band = null, room = 0, least, fixed = null, marks = [] }) {
        super(canvas);
        Object.assign(this, { lines, band, room, least, fixed, marks });
    }

    draw(history, span) {
        const { width, height } = this.begin();
        const m = StripChart.MARGIN;
        const [w, h] = [width - m.left - m.right, height - m.top - m.bottom];
        const now = history.end ? history.last("t") : 0;
        const x = (t) => m.left + w * (1 + (t - now) / span);

        // Columns of pixels: the smallest and the largest value of each, in the order in which they come.
        const traces = this.lines.map(() => []);
        const bands = [];
        let [low, high] = this.fixed ?? this.least;
        const first = history.first(now - span);
        const rows = Math.max(1, Math.floor((history.end - first) / Math.max(1, w)));
        this.lines.forEach((line, n) => {
            for (let k = first; k < history.end; k += rows) {
                let [bottom, top, bottomAt, topAt] = [NaN, NaN, k, k];
                for (let j = k; j < Math.min(k + rows, history.end); j++) {
                    const value = line.of(history, j);
                    if (Number.isNaN(value)) continue;
                    if (!(value >= bottom)) [bottom, bottomAt] = [value, j];
                    if (!(value <= top)) [top, topAt] = [value, j];
                }
                const [from, to] = [x(history.at("t", Math.min(bottomAt, topAt))), x(history.at("t", Math.max(bottomAt, topAt)))];
                traces[n].push(from, bottomAt < topAt ? bottom : top, to, bottomAt < topAt ? top : bottom);
                if (!this.fixed && bottom < low) low = bottom;
                if (!this.fixed && top > high) high = top;
            }
        });
        if (this.band) {
            for (let k = first; k < history.end; k += rows) {
                const half = this.band(history, k);
                bands.push(x(history.at("t", k)), half);
                const room = Math.min(half, this.room);
                if (room > high) high = room;
                if (-room < low) low = -room;
            }
        }

        const step = nice((high - low) / 4);
        if (!this.fixed) [low, high] = [Math.floor(low / step - 1e-9) * step, Math.ceil(high / step + 1e-9) * step];
        const y = (value) => m.top + h * (1 - (Math.min(high, Math.max(low, value)) - low) / (high - low));
        this.#grid(low, high, step, y, x, now, span, { ...m, w, h });

        const scaled = (trace) => trace.map((value, k) => (k % 2 ? (Number.isNaN(value) ? NaN : y(value)) : value));
        if (bands.length) this.#fill(bands, y);
        for (const level of this.marks) {
            this.line([m.left, y(level), m.left + w, y(level)], Drawing.colours.warn, { width: 1, dash: [4, 4] });
        }
        this.lines.forEach((line, n) => this.line(scaled(traces[n]), Drawing.colours[line.colour], line));
    }

    #grid(low, high, step, y, x, now, span, { left, top, w, h }) {
        const c = Drawing.colours;
        for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + step * 1e-6; value += step) {
            this.line([left, y(value), left + w, y(value)], Math.abs(value) < step / 2 ? c.line : c.grid, { width: 1 });
            this.text(onGrid(value, step), left - 6, y(value), "right");
        }
        for (let back = 0; back <= span; back += span / 5) {
            const at = x(now - back);
            this.line([at, top, at, top + h], c.grid, { width: 1 });
            const label = back === 0 ? "now" : `−${back} s`;
            this.text(label, at, top + h + 4, back === 0 ? "right" : back === span ? "left" : "center", "top");
        }
    }

    #fill(bands, y) {
        const c = this.context;
        c.fillStyle = Drawing.colours.band;
        for (let k = 0; k + 3 < bands.length; k += 2) {
            const half = bands[k + 1];
            if (Number.isNaN(half)) continue;
            c.fillRect(bands[k], y(half), bands[k + 2] - bands[k] + 0.5, y(-half) - y(half));
        }
    }
}

/** Trajectories of the true and the estimated flux over the last `span` seconds. */
class FluxPlot extends Drawing {
    /** truth, estimate: names of complex signals; shown(history, k): whether there is an estimate. */
    constructor(canvas, { truth, estimate, shown }) {
        super(canvas);
        Object.assign(this, { truth, estimate, shown });
    }

    draw(history, span, rated) {
        const { width, height } = this.begin();
        const side = Math.min(width, height);
        const centre = [width / 2, height / 2];
        const scale = (side / 2 - 4) / (1.35 * rated);
        const c = Drawing.colours;
        const at = (re, im) => [centre[0] + scale * re, centre[1] - scale * im];

        for (const axis of [[-1, 0, 1, 0], [0, -1, 0, 1]]) {
            const [a, b] = [at(1.35 * rated * axis[0], 1.35 * rated * axis[1]), at(1.35 * rated * axis[2], 1.35 * rated * axis[3])];
            this.line([...a, ...b], c.grid, { width: 1 });
        }
        this.text("α", centre[0] + side / 2 - 6, centre[1] - 10, "right");
        this.text("β", centre[0] + 8, centre[1] - side / 2 + 12, "left");
        this.text(`circle: rated, ${rated.toFixed(2)}`, 0, height - 8, "left");
        this.#circle(centre, scale * rated, c.reference);

        const now = history.end ? history.last("t") : 0;
        const first = history.first(now - span);
        for (const [name, colour, always] of [[this.truth, c.true, true], [this.estimate, c.estimate, false]]) {
            const points = [];
            for (let k = first; k < history.end; k++) {
                const [px, py] = at(history.at(`${name}.re`, k), history.at(`${name}.im`, k));
                points.push(px, always || this.shown(history, k) ? py : NaN);
            }
            if (!points.length) continue;
            this.context.globalAlpha = 0.55;
            this.line(points, colour, { width: 1.5 });
            this.context.globalAlpha = 1;
            if (!Number.isNaN(points.at(-1))) this.#arrow(centre, points.slice(-2), colour, always ? 6 : 2.5);
        }
    }

    #circle([x, y], radius, colour) {
        const c = this.context;
        c.strokeStyle = colour;
        c.lineWidth = 1;
        c.setLineDash([5, 5]);
        c.beginPath();
        c.arc(x, y, radius, 0, 2 * Math.PI);
        c.stroke();
        c.setLineDash([]);
    }

    #arrow(from, to, colour, width) {
        this.line([...from, ...to], colour, { width });
        const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
        const c = this.context;
        c.fillStyle = colour;
        c.beginPath();
        for (const [r, turn] of [[5, 0], [10, 2.5], [10, -2.5]]) {
            c.lineTo(to[0] + r * Math.cos(angle + turn), to[1] + r * Math.sin(angle + turn));
        }
        c.fill();
    }
}
