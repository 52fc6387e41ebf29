//! Three bridge legs: gate timing with dead time, thresholds, and what a leg without current does.
//!
//! A leg has an interval of potentials `[v_lo, v_hi]` (against the negative rail) in which none of its
//! four devices conducts:
//!
//! | gates | `v_lo` | `v_hi` |
//! |---|---|---|
//! | upper on | `u_dc - u_th` | `u_dc + u_th` |
//! | lower on | `-u_th` | `u_th` |
//! | both off | `-u_th` | `u_dc + u_th` |
//!
//! `i > 0` (towards the motor) holds the leg at `v_lo - r_d i`, `i < 0` at `v_hi - r_d i`; at `i = 0` it
//! floats at the induced potential while that stays inside. One rule covers switch, diode, dead time,
//! zero-current clamping and the blocked bridge. `r_d` is folded into the stator resistance. With capacitance
//! at the node the potential floats inside the interval as [`crate::nodes`] says.
//!
//! A switch turns on and off later than it is told ([`GateDelays`]). A pulse lasts by its turn-off delay longer and
//! by its turn-on delay shorter; one that nothing is left of does not appear. Per period a switching leg with `i > 0`,
//! which only its upper switch moves, gains `u_dc (off_u - on_u)`, one with `i < 0` `u_dc (on_l - off_l)`.

use crate::adc::nearest;
use crate::machine::{AXIS, Circuit, Field, State, V2, phases, space_vector};
use stillflux::params::{Inverter, ParamError, check};

/// Which switch of a leg is on. Bit 0: `v_lo` at the positive rail; bit 1: `v_hi` there.
pub(crate) type Gate = u8;
pub(crate) const LOW: Gate = 0b00;
pub(crate) const OFF: Gate = 0b10;
pub(crate) const HIGH: Gate = 0b11;

/// Delays of the six switches, s: for each leg its upper and its lower switch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GateDelays {
    /// From the command to turn on, dead time included, until the switch conducts.
    pub on: [[f64; 2]; 3],
    /// From the command to turn off until it no longer does.
    pub off: [[f64; 2]; 3],
}

impl GateDelays {
    /// These and what the inverter's `leg_delay` says: a longer pulse turns off later, a shorter one on.
    #[must_use]
    pub fn with(mut self, inverter: &Inverter) -> Self {
        for (leg, [plus, minus]) in inverter.leg_delay.into_iter().enumerate() {
            self.off[leg][0] += plus.max(0.0);
            self.on[leg][0] -= plus.min(0.0);
            self.on[leg][1] += minus.max(0.0);
            self.off[leg][1] -= minus.min(0.0);
        }
        self
    }

    /// Checks that no leg's switches are on together.
    ///
    /// # Errors
    /// The first delay outside its range: 0 to a twentieth of the period, a turn-off delay also at most the dead time
    /// and the turn-on delay of the leg's other switch.
    pub fn validate(&self, inverter: &Inverter) -> Result<(), ParamError> {
        for leg in 0..3 {
            for switch in 0..2 {
                let on = self.on[leg][1 - switch];
                check("turn_on_delay", on, 0.0, 0.05 / inverter.f_s, "s")?;
                let most = (inverter.dead_time + on).min(0.05 / inverter.f_s);
                check("turn_off_delay", self.off[leg][switch], 0.0, most, "s")?;
            }
        }
        Ok(())
    }
}

/// One leg's gate and the changes ahead of it in this period.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Leg {
    pub gate: Gate,
    /// Commanded level.
    level: bool,
    /// Time within the period at which the commanded switch turns on, infinite if it already has.
    turn_on: f64,
    /// Delays of (upper, lower) switch.
    on_delay: [f64; 2],
    off_delay: [f64; 2],
    /// Next entry of the list.
    next: usize,
    n: usize,
    /// At most: carried turn-off and turn-on, and Off + on for each of three edges.
    t: [f64; LIST],
    to: [Gate; LIST],
}

/// Bound of the potential of a disconnected phase, V: never reached.
const ISOLATED: f64 = 1e9;

const LIST: usize = 16;

impl Leg {
    const BLOCKED: Self = Self {
        gate: OFF,
        level: false,
        turn_on: f64::INFINITY,
        on_delay: [0.0; 2],
        off_delay: [0.0; 2],
        next: 0,
        n: 0,
        t: [f64::INFINITY; LIST],
        to: [OFF; LIST],
    };

    /// A leg with this gate and nothing ahead of it.
    fn at_rest(&self, gate: Gate) -> Self {
        Self { gate, on_delay: self.on_delay, off_delay: self.off_delay, ..Self::BLOCKED }
    }

    #[inline(always)]
    fn push(&mut self, t: f64, to: Gate) {
        self.t[self.n] = t;
        self.to[self.n] = to;
        self.n += 1;
    }

    /// A command edge: what is on goes off now, the other switch comes on a dead time later. A turn-on still
    /// pending is cancelled: a pulse shorter than the dead time never turns its switch on.
    #[inline(always)]
    fn edge(&mut self, t: f64, level: bool, dead_time: f64) {
        let (old, new) = (usize::from(!self.level), usize::from(!level));
        let off = t + self.off_delay[old];
        // Told to turn on in time, and on before it is off again.
        if self.turn_on - self.on_delay[old] < t && self.turn_on < off {
            self.push(self.turn_on, if self.level { HIGH } else { LOW });
        }
        self.push(off, OFF);
        self.level = level;
        self.turn_on = t + dead_time + self.on_delay[new];
    }

    /// Lists the changes of one period `T` for a pulse from `rising` before its centre to `falling` after it.
    #[inline(always)]
    fn load(&mut self, rising: f64, falling: f64, period: f64, dead_time: f64) {
        let carried = self.next..self.n;
        (self.n, self.next) = (0, 0);
        for k in carried {
            self.push(self.t[k] - period, self.to[k]);
        }
        let centre = 0.5 * period;
        let from_begin = rising >= centre;
        if self.level != from_begin {
            self.edge(0.0, from_begin, dead_time);
        }
        if rising + falling > 0.0 {
            if !from_begin {
                self.edge(centre - rising, true, dead_time);
            }
            if falling < centre {
                self.edge(centre + falling, false, dead_time);
            }
        }
        self.take_turn_on(period);
    }

    /// The pending turn-on, if it is within this stretch of length `length`.
    #[inline(always)]
    fn take_turn_on(&mut self, length: f64) {
        if self.turn_on < length {
            self.push(self.turn_on, if self.level { HIGH } else { LOW });
            self.turn_on = f64::INFINITY;
        } else {
            self.turn_on -= length;
        }
        self.t[self.n] = f64::INFINITY;
    }

    /// The same for half a period of length `length`: with a rising edge `half` before its end, or a falling one `half`
    /// after its beginning.
    fn load_half(&mut self, half: f64, length: f64, dead_time: f64, rising: bool) {
        let carried = self.next..self.n;
        (self.n, self.next) = (0, 0);
        for k in carried {
            self.push(self.t[k] - length, self.to[k]);
        }
        let (none, full) = (half <= 0.0, half >= length);
        let at_first = if rising { full } else { !none };
        if self.level != at_first {
            self.edge(0.0, at_first, dead_time);
        }
        if !none && !full {
            self.edge(if rising { length - half } else { half }, rising, dead_time);
        }
        self.take_turn_on(length);
    }

    /// Time of the next change that matters to a leg with current of this sign: a positive current sees only
    /// `v_lo`, a negative one only `v_hi`.
    #[inline(always)]
    fn next_change(&self, sign: f64) -> f64 {
        let see: Gate = if sign > 0.0 { 0b01 } else { 0b10 };
        let mut k = self.next;
        if sign != 0.0 {
            while k < self.n && (self.to[k & (LIST - 1)] ^ self.gate) & see == 0 {
                k += 1;
            }
        }
        self.t[k & (LIST - 1)]
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Bridge {
    pub u_dc: f64,
    pub u_th: f64,
    pub dead_time: f64,
    pub c_out: f64,
    period: f64,
    /// Timer ticks per half period and length of a tick; zero: no quantisation.
    ticks: f64,
    tick: f64,
    pub on: bool,
    pub legs: [Leg; 3],
    /// Sign of each leg's current; 0: the leg floats.
    pub sign: [f64; 3],
    /// Phases that are disconnected from the machine: a current flows on to its next zero, then never again.
    pub open: [bool; 3],
}

/// How the bridge presently feeds the stator.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Feed {
    /// All legs conduct: a constant voltage.
    Voltage(V2),
    /// Leg `k` floats; the voltage is that with its potential zero.
    Float(usize, V2),
    /// No leg conducts.
    Open,
    /// Some legs' nodes float with their capacitance: the voltage less a matrix (αα, αβ, ββ) times `∫ i_s dt`.
    Nodes(V2, [f64; 3]),
    /// Average model.
    Average(Average),
}

/// Mean potentials of one period, and what each leg loses of them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Average {
    v: [f64; 3],
    /// Drop of each leg at full current.
    drop: [f64; 3],
    /// Its dead-time part.
    dead: [f64; 3],
    /// 1/band of the drop's transition.
    inv_band: f64,
    /// `I_k = C u_dc/T_d`: the current that charges the node within the dead time. Zero: no capacitance.
    knee: f64,
}

impl Bridge {
    pub fn new(inv: &Inverter, delays: &GateDelays) -> Self {
        let delays = delays.with(inv);
        let (ticks, tick) = if inv.f_clk > 0.0 { (inv.f_clk / (2.0 * inv.f_s), 1.0 / inv.f_clk) } else { (0.0, 0.0) };
        Self {
            u_dc: inv.u_dc,
            u_th: inv.u_th,
            dead_time: inv.dead_time,
            c_out: inv.c_out,
            period: 1.0 / inv.f_s,
            ticks,
            tick,
            on: false,
            legs: [0, 1, 2].map(|k| Leg { on_delay: delays.on[k], off_delay: delays.off[k], ..Leg::BLOCKED }),
            sign: [0.0; 3],
            open: [false; 3],
        }
    }

    /// Half width of the pulse the timer makes of a duty: symmetric up/down counter, one compare value.
    #[inline(always)]
    pub fn half_width(&self, duty: f64) -> f64 {
        let centre = 0.5 * self.period;
        let half = if self.ticks > 0.0 { nearest(duty * self.ticks) * self.tick } else { duty * centre };
        // Full on is exact: a rounding error must not become a gap.
        if half < centre * (1.0 - 1e-9) { half } else { centre }
    }

    /// Prepares one period of pulses with these half widths before and after their middle, in parts of half of it, or the
    /// half of it with the rising or the falling edges. Blocking acts at once, unblocking turns the lower switches on at
    /// once.
    pub fn load(&mut self, [before, after]: [[f64; 3]; 2], on: bool, rising: Option<bool>) {
        if !on {
            self.legs = self.legs.map(|leg| leg.at_rest(OFF));
        } else {
            if !self.on {
                self.legs = self.legs.map(|leg| leg.at_rest(LOW));
            }
            for k in 0..3 {
                let (before, after) = (self.half_width(before[k]), self.half_width(after[k]));
                match rising {
                    None => self.legs[k].load(before, after, self.period, self.dead_time),
                    Some(rising) => self.legs[k].load_half(
                        if rising { before } else { after },
                        0.5 * self.period,
                        self.dead_time,
                        rising,
                    ),
                }
            }
        }
        self.on = on;
    }

    /// Takes the current signs from a current vector.
    pub fn set_signs(&mut self, i: V2, zero: f64) {
        self.sign = phases(i).map(|i| if i.abs() <= zero { 0.0 } else { i.signum() });
        if self.sign.iter().filter(|s| **s == 0.0).count() > 1 {
            self.sign = [0.0; 3];
        }
    }

    /// Carries out the gate changes due at `t`.
    #[inline(always)]
    pub fn apply(&mut self, t: f64) {
        for leg in &mut self.legs {
            while leg.t[leg.next & (LIST - 1)] <= t {
                leg.gate = leg.to[leg.next & (LIST - 1)];
                leg.next += 1;
            }
        }
    }

    /// Time of the next gate change that any current notices.
    #[inline(always)]
    pub fn next_change(&self) -> f64 {
        let t = |k: usize| self.legs[k].next_change(self.sign[k]);
        t(0).min(t(1)).min(t(2))
    }

    #[inline(always)]
    pub fn lo(&self, k: usize) -> f64 {
        if self.open[k] && self.sign[k] == 0.0 {
            return -ISOLATED;
        }
        (if self.legs[k].gate & 0b01 != 0 { self.u_dc } else { 0.0 }) - self.u_th
    }

    #[inline(always)]
    pub fn hi(&self, k: usize) -> f64 {
        if self.open[k] && self.sign[k] == 0.0 {
            return ISOLATED;
        }
        (if self.legs[k].gate & 0b10 != 0 { self.u_dc } else { 0.0 }) + self.u_th
    }

    /// Potential of a conducting leg; 0 for a floating one.
    #[inline(always)]
    fn potential(&self, k: usize) -> f64 {
        match self.sign[k] {
            s if s > 0.0 => self.lo(k),
            s if s < 0.0 => self.hi(k),
            _ => 0.0,
        }
    }

    #[inline(always)]
    fn voltage(&self) -> V2 {
        space_vector([self.potential(0), self.potential(1), self.potential(2)])
    }

    /// Room left for an isolated star point when no leg conducts: it exists where some common potential puts
    /// every induced voltage inside its leg's interval. Also the legs that bound it, (lower, upper).
    pub fn room(&self, emf: V2) -> (f64, usize, usize) {
        let e = phases(emf);
        let (mut p, mut q) = (0, 0);
        for k in 1..3 {
            if self.lo(k) - e[k] > self.lo(p) - e[p] {
                p = k;
            }
            if self.hi(k) - e[k] < self.hi(q) - e[q] {
                q = k;
            }
        }
        (self.hi(q) - e[q] - self.lo(p) + e[p], p, q)
    }

    /// Decides for each leg at zero current whether it floats or which way it conducts, and returns the feed.
    /// `lift`: the star point has just run out of room, do not ask again.
    #[inline(always)]
    pub fn feed<const KIND: u8>(&mut self, c: &Circuit, x: &State, f: &Field, lift: bool) -> Feed {
        if self.sign[0] != 0.0 && self.sign[1] != 0.0 && self.sign[2] != 0.0 {
            return Feed::Voltage(self.voltage());
        }
        self.feed_at_zero::<KIND>(c, x, f, lift)
    }

    #[inline(never)]
    fn feed_at_zero<const KIND: u8>(&mut self, c: &Circuit, x: &State, f: &Field, lift: bool) -> Feed {
        if self.sign == [0.0; 3] {
            let (room, p, q) = self.room(c.open::<KIND>(x, f));
            if p == q || (room >= 0.0 && !lift) {
                return Feed::Open;
            }
            (self.sign[p], self.sign[q]) = (1.0, -1.0);
        }
        let k = self.sign.iter().position(|s| *s == 0.0).unwrap_or(0);
        let u = self.voltage();
        let v = c.float::<KIND>(x, f, k, u).1;
        if v < self.lo(k) {
            self.sign[k] = 1.0;
        } else if v > self.hi(k) {
            self.sign[k] = -1.0;
        } else {
            return Feed::Float(k, u);
        }
        Feed::Voltage(self.voltage())
    }

    /// The average model of one period.
    ///
    /// A leg loses `sat(i/band) (u_th + T_d u_dc/T_s)`; legs that do not switch lose the threshold only. With
    /// capacitance the dead time's part follows, where it is less, the ramp of the node in a constant current:
    ///
    /// ```text
    /// |i| >= I_k:  1 - I_k/(2|i|)      |i| < I_k:  |i|/(2 I_k)      of u_dc T_d/T_s,  I_k = C u_dc/T_d
    /// ```
    ///
    /// The falling edge of a positive current (the rising one of a negative) falls with `i/C`: over `C u_dc/i`
    /// if that is shorter than `T_d`, which gives back `C u_dc²/(2i)`; else the leg has come to `i T_d/C` when
    /// the switch turns on, which leaves `i T_d²/(2C)`. With this law `L(i)` and current ripple,
    /// `i_rise` and `i_fall` at the leg's two edges, it is `max(L(i_fall), 0) + min(L(i_rise), 0)`: within the
    /// ripple twice as steep. The average model knows no ripple.
    pub fn average(&self, duty: [f64; 3], band: f64) -> Feed {
        let (mut v, mut drop, mut dead, mut delay) = ([0.0; 3], [self.u_th; 3], [0.0; 3], [[0.0; 2]; 3]);
        for k in 0..3 {
            let d = 2.0 * self.half_width(duty[k]) / self.period;
            v[k] = d * self.u_dc;
            if d > 0.0 && d < 1.0 {
                dead[k] = self.dead_time / self.period * self.u_dc;
                drop[k] += dead[k];
                let (on, off) = (self.legs[k].on_delay, self.legs[k].off_delay);
                let half = 0.5 * self.u_dc / self.period;
                let (positive, negative) = (half * (off[0] - on[0]), half * (on[1] - off[1]));
                delay[k] = [positive + negative, positive - negative];
            }
        }
        let knee = if self.dead_time > 0.0 { self.c_out * self.u_dc / self.dead_time } else { 0.0 };
        for k in 0..3 {
            v[k] += delay[k][0];
            drop[k] -= delay[k][1];
        }
        Feed::Average(Average { v, drop, dead, inv_band: 1.0 / band, knee })
    }
}

impl Average {
    #[inline(always)]
    pub fn voltage(&self, i: V2) -> V2 {
        let p = phases(i);
        let part = p.map(|i| (i * self.inv_band).clamp(-1.0, 1.0));
        if self.knee > 0.0 {
            return space_vector([0, 1, 2].map(|k| {
                let i = p[k].abs();
                let law = if i < self.knee { 0.5 * i / self.knee } else { 1.0 - 0.5 * self.knee / i };
                self.v[k] - self.drop[k] * part[k] + self.dead[k] * (part[k] - part[k].max(-law).min(law))
            }));
        }
        space_vector([0, 1, 2].map(|k| self.v[k] - self.drop[k] * part[k]))
    }
}

impl Feed {
    /// Right-hand side of the stator equation; `q` is `∫ i_s dt` since the start of the segment.
    pub fn dpsi_s<const KIND: u8>(&self, c: &Circuit, x: &State, f: &Field, q: V2) -> V2 {
        let minus_ri = |u: V2| [u[0] - c.R * f.i[0], u[1] - c.R * f.i[1]];
        match self {
            Feed::Voltage(u) => minus_ri(*u),
            Feed::Float(k, u) => c.float::<KIND>(x, f, *k, *u).0,
            Feed::Open => c.open::<KIND>(x, f),
            Feed::Nodes(u, k) => minus_ri(Self::discharged(*u, k, q)),
            Feed::Average(a) => minus_ri(a.voltage(f.i)),
        }
    }

    /// Voltage of [`Feed::Nodes`] after the charge `q`.
    #[inline(always)]
    pub fn discharged(u: V2, k: &[f64; 3], q: V2) -> V2 {
        [u[0] - k[0] * q[0] - k[1] * q[1], u[1] - k[1] * q[0] - k[2] * q[1]]
    }
}

/// Current of one phase.
#[inline(always)]
pub(crate) fn phase(i: V2, k: usize) -> f64 {
    AXIS[k][0] * i[0] + AXIS[k][1] * i[1]
}

#[cfg(test)]
mod tests {
    use super::*;

    const T: f64 = 100e-6;

    fn gates(leg: &mut Leg, half: f64, dead: f64) -> Vec<(f64, Gate)> {
        leg.load(half, half, T, dead);
        let list: Vec<_> = (0..leg.n).map(|k| ((leg.t[k] * 1e7).round() / 10.0, leg.to[k])).collect();
        while leg.t[leg.next] <= T {
            leg.gate = leg.to[leg.next];
            leg.next += 1;
        }
        list
    }

    #[test]
    fn pulse_is_centred_and_turn_on_is_delayed() {
        let mut leg = Leg { gate: LOW, ..Leg::BLOCKED };
        assert_eq!(gates(&mut leg, 20e-6, 2e-6), [(30.0, OFF), (32.0, HIGH), (70.0, OFF), (72.0, LOW)]);
    }

    #[test]
    fn the_halves_of_a_period_are_the_period() {
        for half in [0.0, 0.5e-6, 20e-6, 49.5e-6, 50e-6] {
            let mut whole = Leg { gate: LOW, ..Leg::BLOCKED };
            let mut halves = whole;
            let edges = |leg: &mut Leg, begin: f64, length: f64| {
                let list: Vec<_> = (0..leg.n).map(|k| (begin + leg.t[k], leg.to[k])).collect();
                while leg.t[leg.next] <= length {
                    leg.gate = leg.to[leg.next];
                    leg.next += 1;
                }
                list.into_iter().filter(|(t, _)| *t < begin + length).collect::<Vec<_>>()
            };
            for _ in 0..3 {
                whole.load(half, half, T, 2e-6);
                let want = edges(&mut whole, 0.0, T);
                halves.load_half(half, 0.5 * T, 2e-6, true);
                let mut got = edges(&mut halves, 0.0, 0.5 * T);
                halves.load_half(half, 0.5 * T, 2e-6, false);
                got.extend(edges(&mut halves, 0.5 * T, 0.5 * T));
                assert_eq!(want.len(), got.len(), "{half}: {want:?} {got:?}");
                for (w, g) in want.iter().zip(&got) {
                    assert!(w.1 == g.1 && (w.0 - g.0).abs() < 1e-15, "{half}: {want:?} {got:?}");
                }
            }
        }
    }

    #[test]
    fn short_pulses_and_gaps_never_turn_on() {
        let mut leg = Leg { gate: LOW, ..Leg::BLOCKED };
        assert_eq!(gates(&mut leg, 0.5e-6, 2e-6), [(49.5, OFF), (50.5, OFF), (52.5, LOW)], "upper switch stays off");
        assert_eq!(
            gates(&mut leg, 49.5e-6, 2e-6),
            [(0.5, OFF), (2.5, HIGH), (99.5, OFF)],
            "turn-on falls past the end"
        );
        assert_eq!(gates(&mut leg, 49.5e-6, 2e-6), [(0.5, OFF), (2.5, HIGH), (99.5, OFF)], "and is cancelled there");
        assert_eq!(gates(&mut leg, 20e-6, 2e-6)[0], (1.5, LOW), "carried over");
    }

    #[test]
    fn zero_and_full_duty_do_not_switch() {
        let mut leg = Leg { gate: LOW, ..Leg::BLOCKED };
        assert_eq!(gates(&mut leg, 0.0, 2e-6), []);
        assert_eq!(gates(&mut leg, 50e-6, 2e-6), [(0.0, OFF), (2.0, HIGH)]);
        assert_eq!(gates(&mut leg, 50e-6, 2e-6), []);
        assert_eq!(gates(&mut leg, 0.0, 2e-6), [(0.0, OFF), (2.0, LOW)]);
    }

    #[test]
    fn switches_act_late_and_pulses_end_with_the_turn_off_delay() {
        let mut leg = Leg { gate: LOW, on_delay: [0.3e-6, 0.1e-6], off_delay: [0.7e-6, 0.2e-6], ..Leg::BLOCKED };
        assert_eq!(gates(&mut leg, 20e-6, 2e-6), [(30.2, OFF), (32.3, HIGH), (70.7, OFF), (72.1, LOW)]);
        assert_eq!(gates(&mut leg, 1.2e-6, 2e-6), [(49.0, OFF), (51.1, HIGH), (51.9, OFF), (53.3, LOW)]);
        assert_eq!(gates(&mut leg, 49.8e-6, 2e-6), [(0.4, OFF), (2.5, HIGH), (100.5, OFF)], "past the end");
        assert_eq!(
            gates(&mut leg, 10e-6, 2e-6),
            [(0.5, OFF), (1.9, LOW), (40.2, OFF), (42.3, HIGH), (60.7, OFF), (62.1, LOW)]
        );
        let slow = Leg { gate: LOW, on_delay: [1.5e-6, 0.0], ..Leg::BLOCKED };
        assert_eq!(gates(&mut { slow }, 1.2e-6, 2e-6), [(48.8, OFF), (51.2, OFF), (53.2, LOW)], "nothing left of it");
    }

    #[test]
    fn edges_are_multiples_of_the_timer_clock() {
        let b = Bridge::new(&Inverter { f_clk: 10e6, ..Inverter::preset_2k2() }, &GateDelays::default());
        assert!((b.half_width(0.3333) - 16.7e-6).abs() < 1e-18, "0.3333 · 500 = 166.65 → 167 ticks");
        assert_eq!(b.half_width(1.0), 0.5 * b.period);
    }
}
