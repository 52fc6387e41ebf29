//! One period: its segments from one change of the gates or event to the next.
//!
//! Between events the stator voltage is constant and the equations are smooth, so one Runge-Kutta step
//! carries a whole segment. A segment ends at a gate change that some current notices, or where within it a
//! phase current reaches zero, a floating leg reaches one of its diodes or switches, the shaft comes to rest
//! or breaks away ([`super::events`]). With capacitance at the legs' nodes ([`crate::nodes`]) the legs' events are
//! others, the method is the same: a current reaches zero, a node reaches a rail.
#![allow(non_snake_case)]

use super::events::Event;
use super::{H_MAX, Plant};
use crate::bridge::Feed;
use crate::machine::{Field, State, Step, V2, dot, phases};
use crate::nodes::Nodes;
use crate::shunt::Amplifier;
use stillflux::control::shunt::Pulses;

/// Segments of a period with capacitive edges after which it goes on without looking for events. A period has some
/// twenty of them, with ringing nodes some hundreds, with nodes of a tenth of a picofarad some ten thousand.
const MOST_SEGMENTS: u32 = 1_000_000;

impl Plant {
    /// The next instant after `t` at which a channel is sampled ahead of the period's end.
    #[inline(always)]
    pub(super) fn next_instant(&self, t: f64) -> f64 {
        if !self.skewed && self.shunt.is_none() {
            return f64::INFINITY;
        }
        let of_shunt = self.shunt.map_or([f64::INFINITY; 2], |shunt| shunt.instants);
        self.instants.into_iter().chain(of_shunt).filter(|s| *s > t).fold(f64::INFINITY, f64::min)
    }

    /// Samples the channels whose instant is `t`.
    #[inline(always)]
    pub(super) fn look(&mut self, t: f64) {
        if self.skewed && self.instants.contains(&t) {
            let i = self.phase_currents();
            for k in 0..3 {
                if self.instants[k] == t {
                    self.seen[k] = i[k];
                }
            }
        }
        if let Some(shunt) = &mut self.shunt {
            for (seen, instant) in shunt.seen.iter_mut().zip(shunt.instants) {
                if instant == t {
                    *seen = shunt.y;
                }
            }
        }
    }

    /// What the shunt's amplifier sees of a segment that is to follow.
    #[inline(always)]
    fn watched(&self) -> Option<([f64; 3], [f64; 3])> {
        self.shunt.is_some().then(|| (Amplifier::parts(&self.bridge), phases(self.f.i)))
    }

    /// The segment, of length `h`, is over.
    #[inline(always)]
    fn watch(&mut self, watched: Option<([f64; 3], [f64; 3])>, h: f64) {
        if let (Some(shunt), Some((parts, from))) = (&mut self.shunt, watched) {
            shunt.advance(&parts, from, phases(self.f.i), h);
        }
    }

    /// A period of the average model.
    pub(super) fn averaged<const KIND: u8>(&mut self, duty: [f64; 3]) {
        let feed = self.bridge.average(duty, self.band);
        let mut t = 0.0;
        while t < self.period {
            let end = self.next_instant(t).min(self.period);
            self.smooth::<KIND>(feed, end - t);
            t = end;
            self.look(t);
        }
    }

    /// A period of the bridge.
    pub(super) fn switched<const KIND: u8>(&mut self, pulses: &Pulses<f64>, gates_on: bool) {
        let stale = std::mem::replace(&mut self.stale, false);
        if stale {
            self.bridge.set_signs(self.f.i, self.tol.current);
        }
        self.bridge.load([pulses.rising, pulses.falling], gates_on, self.rising);
        if let Some(nodes) = self.nodes {
            return self.capacitive::<KIND>(nodes, stale);
        }
        let (mut t, mut lift, mut stall) = (0.0, false, 0);
        while t < self.period {
            self.look(t);
            self.bridge.apply(t);
            let feed = self.bridge.feed::<KIND>(&self.circuit, &self.x, &self.f, lift);
            let end = self.bridge.next_change().min(self.period).min(self.next_instant(t)).min(t + self.h_max);
            let watched = self.watched();
            match self.segment::<KIND, true>(&feed, end - t, stall > 8) {
                None => {
                    self.watch(watched, end - t);
                    (t, lift, stall) = (end, false, 0);
                }
                Some((tau, event)) => {
                    self.watch(watched, tau);
                    // Conditions that contradict each other by rounding alone could repeat at one instant;
                    // after a few turns the segment is integrated as it stands.
                    stall = if tau <= self.tol.time { stall + 1 } else { 0 };
                    t += tau;
                    lift = matches!(event, Event::LiftAny);
                }
            }
        }
        self.look(self.period);
        // Changes since the last segment began that no current noticed.
        self.bridge.apply(self.period);
    }

    /// The rest of [`Self::switched`] with capacitance at the legs' nodes.
    pub(super) fn capacitive<const KIND: u8>(&mut self, mut nodes: Nodes, stale: bool) {
        if stale {
            nodes.place(&self.bridge);
        }
        let (mut t, mut stall, mut segments) = (0.0, 0, 0);
        while t < self.period {
            segments += 1;
            self.look(t);
            self.bridge.apply(t);
            nodes.settle(&mut self.bridge, self.f.i, &mut self.energy);
            let feed = nodes.feed(&self.bridge);
            let end = self.bridge.next_change().min(self.period).min(self.next_instant(t)).min(t + self.h_max);
            self.nodes = Some(nodes);
            // As in `switched`; and a node that comes to its rail and leaves it again and again, a little later each
            // time, must not keep the period from ending.
            let blind = stall > 8 || segments > MOST_SEGMENTS;
            let watched = self.watched();
            let (h, hit) = match feed {
                Feed::Nodes(u, K) => self.ramp::<KIND>(u, &K, &nodes, end - t, blind),
                _ => (end - t, self.segment::<KIND, true>(&feed, end - t, blind)),
            };
            nodes = self.nodes.unwrap_or(nodes);
            self.watch(watched, hit.map_or(h, |(tau, _)| tau));
            match hit {
                None => (t, stall) = (if h == end - t { end } else { t + h }, 0),
                Some((tau, _)) => {
                    stall = if tau <= self.tol.time { stall + 1 } else { 0 };
                    t += tau;
                }
            }
        }
        self.look(self.period);
        self.bridge.apply(self.period);
        nodes.settle(&mut self.bridge, self.f.i, &mut self.energy);
        self.nodes = Some(nodes);
    }

    /// A stretch without a bridge: only the shaft has events.
    pub(super) fn smooth<const KIND: u8>(&mut self, feed: Feed, dt: f64) {
        self.stale = true;
        let least = if matches!(feed, Feed::Average(_)) { 2.0 } else { 1.0 };
        let n = (dt / self.h_max.min(H_MAX) - 1e-9).ceil().max(least);
        for _ in 0..n as u64 {
            let (mut left, mut stall) = (dt / n, 0);
            while left > 0.0 {
                match self.segment::<KIND, false>(&feed, left, stall > 8) {
                    None => break,
                    Some((tau, _)) => {
                        stall = if tau <= self.tol.time { stall + 1 } else { 0 };
                        left -= tau;
                    }
                }
            }
        }
    }

    /// Integrates over `h`, or to the first event within and what it was.
    #[inline(always)]
    pub(super) fn segment<const KIND: u8, const BRIDGE: bool>(
        &mut self,
        feed: &Feed,
        h: f64,
        blind: bool,
    ) -> Option<(f64, Event)> {
        let step = self.trial::<KIND>(feed, &self.x, &self.f, h);
        let f = self.circuit.field::<KIND>(&step.x);
        let near = BRIDGE && {
            let (s, i) = (&self.bridge.sign, phases(f.i));
            // A floating leg has sign 0 and is near.
            (s[0] * i[0]).min(s[1] * i[1]).min(s[2] * i[2]) < self.tol.near
        };
        if near || self.shaft.restless(f.torque, step.x.omega) {
            return self.eventful::<KIND, BRIDGE>(feed, h, step, f, blind);
        }
        self.commit::<KIND>(feed, h, step, f);
        None
    }

    /// A segment of at most `h` in which some node floats: how long it was meant to be, and its event.
    #[inline(always)]
    pub(super) fn ramp<const KIND: u8>(
        &mut self,
        u: V2,
        K: &[f64; 3],
        nodes: &Nodes,
        h: f64,
        blind: bool,
    ) -> (f64, Option<(f64, Event)>) {
        let c = &self.circuit;
        let longest = nodes.longest_step::<KIND>(c, &self.x, &self.f);
        if h > 5.0 * longest && nodes.still::<KIND>(&self.bridge, c, &self.x, &self.f) {
            let hit = self.segment::<KIND, true>(&Feed::Open, h, blind);
            let e = self.circuit.open::<KIND>(&self.x, &self.f);
            if let Some(nodes) = &mut self.nodes {
                nodes.follow(e, &mut self.energy);
            }
            return (h, hit);
        }
        let series = c.series::<KIND, true>(&self.shaft, &self.x, &self.f, u, K);
        let mut h = h.min(longest).min(self.h_taylor);
        let ramp = if blind { None } else { nodes.ramp(&self.bridge, &self.f, &series, h) };
        if let Some((_, t)) = ramp {
            h = t;
        }
        let feed = Feed::Nodes(u, *K);
        let step = c.taylor::<KIND, true>(&self.shaft, &self.x, &series, h);
        let f = c.field::<KIND>(&step.x);
        // The usual course: one node has come to its diode, no current is near zero or has turned.
        let (i0, i1, mut plain) =
            (phases(self.f.i), phases(f.i), !blind && !self.shaft.restless(f.torque, step.x.omega));
        for k in 0..3 {
            let b = &self.bridge;
            plain &= if b.sign[k] == 0.0 {
                let v = nodes.potential(k, step.int_i);
                let rail = if i1[k] > 0.0 { v - b.lo(k) } else { b.hi(k) - v };
                i0[k] * i1[k] > 0.0
                    && if ramp.is_some_and(|r| r.0 == k) { rail.abs() <= nodes.tol } else { rail > nodes.tol }
            } else {
                b.sign[k] * i1[k] > self.tol.near
            };
        }
        if !plain {
            return (h, self.eventful::<KIND, true>(&feed, h, step, f, blind));
        }
        self.commit::<KIND>(&feed, h, step, f);
        let hit = ramp.map(|(k, t)| {
            let sign = i1[k].signum();
            self.take_over(k, sign);
            (t, Event::Rail(k, sign))
        });
        (h, hit)
    }

    /// The device at the rail begins to conduct.
    #[inline(always)]
    pub(super) fn take_over(&mut self, k: usize, sign: f64) {
        let b = &mut self.bridge;
        b.sign[k] = sign;
        if let Some(nodes) = &mut self.nodes {
            nodes.v[k] = if sign > 0.0 { b.lo(k) } else { b.hi(k) };
        }
    }

    #[inline(always)]
    pub(super) fn commit<const KIND: u8>(&mut self, feed: &Feed, h: f64, step: Step, f: Field) {
        if self.energy.is_some() {
            if self.booked {
                self.account::<KIND>(feed, h, &step, &f);
            }
            self.draw(&step);
        }
        if let (Feed::Nodes(..), Some(nodes)) = (feed, &mut self.nodes) {
            nodes.discharge(&self.bridge, step.int_i);
        }
        if self.params.thermal.is_some() {
            // The current of a segment is a straight line but for its curvature, some 1e-4 of it.
            self.int_i2 += h / 3.0 * (dot(self.f.i, self.f.i) + dot(self.f.i, f.i) + dot(f.i, f.i));
        }
        (self.x, self.f) = (step.x, f);
        self.int_i[0] += step.int_i[0];
        self.int_i[1] += step.int_i[1];
    }

    #[inline(always)]
    pub(super) fn trial<const KIND: u8>(&self, feed: &Feed, x: &State, f: &Field, h: f64) -> Step {
        let (c, s) = (&self.circuit, &self.shaft);
        if let Feed::Voltage(u) = *feed {
            if h <= self.h_taylor {
                return c.taylor::<KIND, false>(s, x, &c.series::<KIND, false>(s, x, f, u, &[0.0; 3]), h);
            }
            return c.rk4::<KIND>(s, x, f, h, |x, f| c.stator::<KIND>(x, f, u));
        }
        if let Feed::Nodes(u, k) = *feed {
            return c.taylor::<KIND, true>(s, x, &c.series::<KIND, true>(s, x, f, u, &k), h);
        }
        if let Feed::Average(a) = feed {
            return c.rk4::<KIND>(s, x, f, h, |x, f| c.stator::<KIND>(x, f, a.voltage(f.i)));
        }
        self.trial_at_zero::<KIND>(feed, x, f, h)
    }

    #[inline(never)]
    pub(super) fn trial_at_zero<const KIND: u8>(&self, feed: &Feed, x: &State, f: &Field, h: f64) -> Step {
        let c = &self.circuit;
        c.rk4::<KIND>(&self.shaft, x, f, h, |x, f| feed.dpsi_s::<KIND>(c, x, f, [0.0; 2]))
    }

    /// Simpson's rule over the segment: the order of the integrator.
    #[inline(never)]
    pub(super) fn account<const KIND: u8>(&mut self, feed: &Feed, h: f64, step: &Step, f: &Field) {
        let c = &self.circuit;
        let mid = self.trial::<KIND>(feed, &self.x, &self.f, 0.5 * h);
        let power = |s: &Step, f: &Field| c.power(&s.x, f, feed.dpsi_s::<KIND>(c, &s.x, f, s.int_i));
        let p = [power(&self.here(), &self.f), power(&mid, &c.field::<KIND>(&mid.x)), power(step, f)];
        if let Some(e) = &mut self.energy {
            for (p, k) in p.iter().zip([1.0, 4.0, 1.0]) {
                e.add(k * h / 6.0, p);
            }
        }
    }

    /// What the legs take from the link in a segment, and what their thresholds do.
    fn draw(&mut self, step: &Step) {
        let (b, q) = (&self.bridge, phases(step.int_i));
        if let Some(e) = &mut self.energy {
            for k in 0..3 {
                if b.sign[k] != 0.0 && !self.stale {
                    let v = if b.sign[k] > 0.0 { b.lo(k) } else { b.hi(k) };
                    e.link += if v > 0.5 * b.u_dc { b.u_dc * q[k] } else { 0.0 };
                    e.conduction += b.sign[k] * q[k] * b.u_th;
                }
            }
        }
    }

    /// A step of no length.
    #[inline(always)]
    pub(super) fn here(&self) -> Step {
        Step { x: self.x, int_i: [0.0; 2] }
    }
}
