//! What ends a segment before its time, and when: found on the integrator's own solution by bracketed secant steps.
#![allow(non_snake_case)]

use super::Plant;
use crate::bridge::{Feed, phase};
use crate::machine::{Field, Step};

/// What can end a segment before its time.
#[derive(Clone, Copy, Debug)]
pub(super) enum Event {
    /// The current of leg `k` reaches zero.
    Current(usize),
    /// The floating leg `k` begins to conduct with this sign.
    Lift(usize, f64),
    /// The node of floating leg `k` reaches the rail at which it conducts with this sign.
    Rail(usize, f64),
    /// The isolated star point can no longer avoid some diode or switch.
    LiftAny,
    /// The sliding shaft comes to rest.
    Rest,
    /// The sticking shaft breaks away.
    Breakaway,
}

impl Plant {
    /// The end of a segment that may hold an event.
    #[inline(never)]
    pub(super) fn eventful<const KIND: u8, const BRIDGE: bool>(
        &mut self,
        feed: &Feed,
        h: f64,
        step: Step,
        f: Field,
        blind: bool,
    ) -> Option<(f64, Event)> {
        let mut hit = None;
        let (mut h, mut step, mut f) = (h, step, f);
        if !blind {
            let sliding = [Event::Rest];
            let sticking = [Event::Breakaway];
            let shaft: &[Event] = if self.shaft.stuck {
                &sticking
            } else if self.shaft.dir != 0.0 {
                &sliding
            } else {
                &[]
            };
            let currents = [0, 1, 2].map(Event::Current);
            let (float, open);
            let rails = [0, 1, 2, 3, 4, 5].map(|k| Event::Rail(k >> 1, if k & 1 == 0 { 1.0 } else { -1.0 }));
            let legs: &[Event] = match *feed {
                Feed::Float(k, _) => {
                    float = [Event::Lift(k, 1.0), Event::Lift(k, -1.0)];
                    &float
                }
                Feed::Open => {
                    open = [Event::LiftAny];
                    &open
                }
                Feed::Nodes(..) => &rails,
                _ => &[],
            };
            let bridge = if BRIDGE { currents.iter().chain(legs) } else { [].iter().chain(&[]) };
            for event in shaft.iter().chain(bridge) {
                let tol = self.tolerance(*event);
                let mut end = (h, step, f);
                let margin = self.margin::<KIND>(*event, feed, &step, &f);
                if margin >= -tol {
                    match self.dip::<KIND>(*event, feed, h, &step, &f) {
                        None if margin <= tol && self.drives(*event, &f) => {
                            hit = Some((h, *event));
                            continue;
                        }
                        Some(dip) => end = dip,
                        None => continue,
                    }
                }
                (h, step, f) = self.locate::<KIND>(*event, feed, end);
                hit = Some((h, *event));
            }
        }
        self.commit::<KIND>(feed, h, step, f);
        match *feed {
            Feed::Float(k, _) => self.circuit.clear_leg::<KIND>(&mut self.x, &mut self.f, k),
            Feed::Open => self.circuit.clear_all::<KIND>(&mut self.x, &mut self.f),
            _ => {}
        }
        match hit.map(|(_, e)| e) {
            Some(Event::Current(k)) if self.nodes.is_some() => {
                let b = &mut self.bridge;
                let room = self.nodes.is_some_and(|n| b.hi(k) - b.lo(k) > n.tol);
                b.sign[k] = if room { 0.0 } else { -b.sign[k] };
            }
            Some(Event::Rail(k, sign)) => self.take_over(k, sign),
            Some(Event::Current(k)) => {
                self.bridge.sign[k] = 0.0;
                self.circuit.clear_leg::<KIND>(&mut self.x, &mut self.f, k);
                if self.bridge.sign.iter().filter(|s| **s == 0.0).count() > 1 {
                    self.bridge.sign = [0.0; 3];
                    self.circuit.clear_all::<KIND>(&mut self.x, &mut self.f);
                }
            }
            Some(Event::Lift(k, sign)) => self.bridge.sign[k] = sign,
            Some(Event::Rest) => {
                self.x.omega = 0.0;
                self.f = self.circuit.field::<KIND>(&self.x);
                self.shaft.at_rest(self.f.torque);
            }
            Some(Event::Breakaway) => self.shaft.release(self.f.torque),
            Some(Event::LiftAny) | None => {}
        }
        if blind && BRIDGE && self.nodes.is_none() {
            self.bridge.set_signs(self.f.i, self.tol.current);
        }
        hit
    }

    /// Whether a node at a rail is driven into it.
    pub(super) fn drives(&self, event: Event, f: &Field) -> bool {
        matches!(event, Event::Rail(k, sign) if self.bridge.sign[k] == 0.0 && sign * phase(f.i, k) > self.tol.current)
    }

    /// A current with the right sign at both ends of a segment may still have crossed zero between, a node its
    /// rail: the course is nearly a parabola, so the state at the vertex decides.
    pub(super) fn dip<const KIND: u8>(
        &self,
        event: Event,
        feed: &Feed,
        h: f64,
        end: &Step,
        f: &Field,
    ) -> Option<(f64, Step, Field)> {
        let c = &self.circuit;
        let (d0, d1) = match event {
            Event::Current(k) => {
                let s = self.bridge.sign[k];
                if s == 0.0 || s * phase(f.i, k) > self.tol.near || s * phase(self.f.i, k) > self.tol.near {
                    return None;
                }
                let slope =
                    |x: &Step, f: &Field| s * phase(c.di::<KIND>(&x.x, f, feed.dpsi_s::<KIND>(c, &x.x, f, x.int_i)), k);
                (slope(&self.here(), &self.f), slope(end, f))
            }
            Event::Rail(k, sign) if self.bridge.sign[k] == 0.0 => (-sign * phase(self.f.i, k), -sign * phase(f.i, k)),
            _ => return None,
        };
        if d0 >= 0.0 || d1 <= 0.0 {
            return None;
        }
        let tau = h * d0 / (d0 - d1);
        let step = self.trial::<KIND>(feed, &self.x, &self.f, tau);
        let low = (tau, step, c.field::<KIND>(&step.x));
        (self.margin::<KIND>(event, feed, &low.1, &low.2) < -self.tolerance(event)).then_some(low)
    }

    pub(super) fn tolerance(&self, event: Event) -> f64 {
        match event {
            Event::Current(_) => self.tol.current,
            Event::Lift(..) | Event::LiftAny => self.tol.voltage,
            Event::Rail(..) => self.nodes.map_or(0.0, |n| n.tol),
            Event::Rest => self.tol.speed,
            Event::Breakaway => self.tol.torque,
        }
    }

    /// Distance from an event; negative once it has happened.
    pub(super) fn margin<const KIND: u8>(&self, event: Event, feed: &Feed, step: &Step, f: &Field) -> f64 {
        let (c, x) = (&self.circuit, &step.x);
        match (event, feed) {
            (Event::Current(k), _) => self.bridge.sign[k] * phase(f.i, k),
            (Event::Lift(k, sign), Feed::Float(_, u)) => {
                let v = c.float::<KIND>(x, f, k, *u).1;
                if sign > 0.0 { v - self.bridge.lo(k) } else { self.bridge.hi(k) - v }
            }
            (Event::Rail(k, sign), _) => match &self.nodes {
                Some(nodes) if self.bridge.sign[k] == 0.0 => {
                    let v = nodes.potential(k, step.int_i);
                    if sign > 0.0 { v - self.bridge.lo(k) } else { self.bridge.hi(k) - v }
                }
                _ => f64::INFINITY,
            },
            (Event::LiftAny, _) => self.bridge.room(c.open::<KIND>(x, f)).0,
            (Event::Rest, _) => self.shaft.dir * x.omega,
            (Event::Breakaway, _) => self.shaft.breakaway() - (f.torque - self.shaft.load).abs(),
            (Event::Lift(..), _) => f64::INFINITY,
        }
    }

    /// Finds the event's instant in (0, end], where its condition is violated at `end`: bracketed secant
    /// (Illinois) on the integrator's own solution from the segment's start.
    pub(super) fn locate<const KIND: u8>(
        &self,
        event: Event,
        feed: &Feed,
        end: (f64, Step, Field),
    ) -> (f64, Step, Field) {
        let at = |tau: f64| {
            let step = self.trial::<KIND>(feed, &self.x, &self.f, tau);
            let f = self.circuit.field::<KIND>(&step.x);
            ((tau, step, f), self.margin::<KIND>(event, feed, &step, &f))
        };
        let (mut a, mut fa) = (0.0, self.margin::<KIND>(event, feed, &self.here(), &self.f));
        let (mut b, mut fb) = (end.0, self.margin::<KIND>(event, feed, &end.1, &end.2));
        let mut best = end;
        // Starting on the boundary: an excursion to the admissible side, however short, precedes the event.
        for _ in 0..12 {
            if fa > 0.0 {
                break;
            }
            let (p, fp) = at(0.25 * b);
            if fp > 0.0 {
                (a, fa) = (p.0, fp);
            } else {
                (b, fb, best) = (p.0, fp, p);
            }
        }
        if fa <= 0.0 {
            return at(0.0).0;
        }
        let mut last = 0;
        for _ in 0..60 {
            if b - a <= self.tol.time || fb == 0.0 {
                break;
            }
            let tau = b - fb * (b - a) / (fb - fa);
            let moved = (tau - best.0).abs();
            let (p, fp) = at(tau);
            if fp > 0.0 {
                (a, fa) = (tau, fp);
                if last > 0 {
                    fb *= 0.5;
                }
                last = 1;
            } else {
                (b, fb) = (tau, fp);
                if last < 0 {
                    fa *= 0.5;
                }
                last = -1;
            }
            best = p;
            if moved <= self.tol.time || fp.abs() <= 1e-3 * self.tolerance(event) {
                break;
            }
        }
        best
    }
}
