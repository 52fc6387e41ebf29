//! Shaft: inertia, friction with stiction, or a dynamometer that imposes the speed.
//!
//! `J omega' = T - T_load - b omega - sign(omega) (T_c + T_st exp(-(omega/omega_st)²))`; at standstill the
//! shaft sticks while `|T - T_load| <= T_c + T_st`. With a [`Coupling`] `J` is the machine's own inertia, and the torque of the
//! coupling takes the place of `T_load`.
#![allow(non_snake_case)]

use crate::coupling::{Coupling, ElasticLoad};
use stillflux::params::{Machine, ParamError, check};

/// Friction and inertia beyond the machine's own `J`, or an imposed speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mechanics {
    /// Inertia of the load, kg·m², added to the machine's.
    pub J_load: f64,
    /// Between the machine and `J_load`; `None`: it is rigid. Friction is the machine's then, the load torque acts on the load.
    pub coupling: Option<Coupling>,
    /// Viscous friction, N·m·s.
    pub viscous: f64,
    /// Coulomb friction, N·m.
    pub coulomb: f64,
    /// Breakaway torque in excess of the Coulomb friction, N·m.
    pub stribeck: f64,
    /// Speed at which the excess has fallen to 1/e, mechanical rad/s.
    pub stribeck_speed: f64,
    /// `Some(w)`: a dynamometer drives the shaft at `w` mechanical rad/s.
    pub speed: Option<f64>,
}

impl Default for Mechanics {
    fn default() -> Self {
        Self {
            J_load: 0.0,
            coupling: None,
            viscous: 0.0,
            coulomb: 0.0,
            stribeck: 0.0,
            stribeck_speed: 1.0,
            speed: None,
        }
    }
}

impl Mechanics {
    /// What the coupling drives, if there is one, turning with a shaft at `omega`.
    pub(crate) fn elastic_load(&self, omega: f64) -> Option<ElasticLoad> {
        self.coupling.map(|coupling| ElasticLoad::new(coupling, self.J_load, omega))
    }

    /// Inertia that turns with the machine's shaft, kg·m².
    fn inertia(&self, machine: &Machine) -> f64 {
        machine.J + if self.coupling.is_some() { 0.0 } else { self.J_load }
    }

    /// Checks every field but the coupling's against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range. Viscous friction leaves the shaft a time constant of at least 100 µs: it is
    /// integrated with the machine.
    pub fn validate(&self, machine: &Machine) -> Result<(), ParamError> {
        check("J_load", self.J_load, 0.0, 1e6, "kg m^2")?;
        check("viscous", self.viscous, 0.0, 1e4 * self.inertia(machine), "N m s")?;
        check("coulomb", self.coulomb, 0.0, 1e6, "N m")?;
        check("stribeck", self.stribeck, 0.0, 1e6, "N m")?;
        check("stribeck_speed", self.stribeck_speed, 1e-4, 1e4, "rad/s")?;
        check("speed", self.speed.unwrap_or(0.0), -1e5, 1e5, "rad/s")
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Shaft {
    mechanics: Mechanics,
    /// 1/J; zero while the speed is imposed or the shaft sticks.
    inv_J: f64,
    J: f64,
    pub load: f64,
    /// Direction the friction opposes: ±1, 0 without dry friction.
    pub dir: f64,
    pub stuck: bool,
}

impl Shaft {
    pub fn new(mechanics: Mechanics, machine: &Machine) -> Self {
        let J = mechanics.inertia(machine);
        let mut s = Self { mechanics, inv_J: 1.0 / J, J, load: 0.0, dir: 0.0, stuck: false };
        s.restart(mechanics.speed.unwrap_or(0.0));
        s
    }

    /// Chooses between imposed speed, sliding and sticking for a shaft found at speed `omega`.
    pub fn restart(&mut self, omega: f64) {
        let free_running = self.mechanics.speed.is_none();
        let dry = free_running && self.breakaway() > 0.0;
        self.stuck = dry && omega == 0.0;
        self.dir = if dry && !self.stuck { omega.signum() } else { 0.0 };
        self.inv_J = if free_running && !self.stuck { 1.0 / self.J } else { 0.0 };
    }

    pub fn impose(&mut self, speed: Option<f64>, omega: f64) {
        self.mechanics.speed = speed;
        self.restart(speed.unwrap_or(omega));
    }

    /// Torque that must be exceeded to leave standstill.
    pub fn breakaway(&self) -> f64 {
        self.mechanics.coulomb + self.mechanics.stribeck
    }

    /// At standstill: stick, or slide off in the direction of the net torque.
    pub fn at_rest(&mut self, torque: f64) {
        let net = torque - self.load;
        self.stuck = net.abs() <= self.breakaway();
        (self.inv_J, self.dir) = if self.stuck { (0.0, 0.0) } else { (1.0 / self.J, net.signum()) };
    }

    /// Breaks away in the direction of the net torque, whose excess over the breakaway torque is rounding.
    pub fn release(&mut self, torque: f64) {
        (self.stuck, self.inv_J, self.dir) = (false, 1.0 / self.J, (torque - self.load).signum());
    }

    /// Whether a segment that ends at this torque and speed may hold an event of the shaft.
    #[inline(always)]
    pub fn restless(&self, torque: f64, omega: f64) -> bool {
        if self.stuck { (torque - self.load).abs() >= self.breakaway() } else { self.dir * omega < 0.0 }
    }

    #[inline(always)]
    pub fn accel(&self, torque: f64, omega: f64) -> f64 {
        let m = &self.mechanics;
        let mut dry = m.coulomb;
        if m.stribeck > 0.0 && self.dir != 0.0 {
            let r = omega / m.stribeck_speed;
            // Beyond, the exponential is 3e-20.
            if r * r < 45.0 {
                dry += m.stribeck * libm::exp(-r * r);
            }
        }
        self.inv_J * torque - self.inv_J * (self.load + m.viscous * omega + self.dir * dry)
    }
}
