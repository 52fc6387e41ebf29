//! The plant: one control period at a time, exact at every event.
//!
//! Between events the stator voltage is constant and the equations are smooth, so one Runge-Kutta step
//! carries a whole segment. A segment ends at a gate change that some current notices, or where within it a
//! phase current reaches zero, a floating leg reaches one of its diodes or switches, the shaft comes to rest
//! or breaks away: these are found on the integrator's own solution by bracketed secant steps. With capacitance
//! at the legs' nodes ([`crate::nodes`]) the legs' events are others, the method is the same: a current reaches
//! zero, a node reaches a rail.
#![allow(non_snake_case)]

use crate::adc::{Adc, ChannelFault, Converter};
use crate::branches::{DeepBar, IronLoss};
use crate::bridge::{Bridge, Feed, GateDelays, phase};
use crate::dclink::{DcLink, Link, LinkEnergy};
use crate::machine::{BRANCHED, Circuit, Energy, Field, LINEAR, SATURATING, State, Step, V2, dot, phases};
use crate::mechanics::{Mechanics, Shaft};
use crate::nodes::Nodes;
use crate::thermal::Thermal;
use stillflux::params::{Inverter, Machine, ParamError, check};
use stillflux::si::MeasurementSi;

/// Segments of a period with capacitive edges after which it goes on without looking for events. A period has some
/// twenty of them, with ringing nodes some hundreds, with nodes of a tenth of a picofarad some ten thousand.
const MOST_SEGMENTS: u32 = 1_000_000;

/// How the bridge is modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Every edge, dead time and diode event resolved.
    Switching,
    /// Mean leg voltages; the dead time as a saturating function of the phase current.
    Averaged,
}

/// Interrupts that do not come or come twice, by chance: what a closed loop ([`crate::simulate`]) does of it. A plant
/// alone is stepped by its caller.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Calls {
    /// Probability that the control is not called in a period: the preload register keeps its duties.
    pub missed: f64,
    /// Probability that it is called twice with the same sample; the second duties count.
    pub doubled: f64,
}

/// Everything the plant is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantParams {
    /// The machine; `R_s` is that of the cold winding.
    pub machine: Machine,
    /// The bridge.
    pub inverter: Inverter,
    /// Delays of the switches.
    pub gate_delays: GateDelays,
    /// Load inertia and friction, or an imposed speed.
    pub mechanics: Mechanics,
    /// Measurement.
    pub adc: Adc,
    /// Eddy currents in the iron.
    pub iron_loss: Option<IronLoss>,
    /// Skin effect in the rotor's bars.
    pub deep_bar: Option<DeepBar>,
    /// Whether the control is called once a period, as it should be.
    pub calls: Calls,
    /// Winding temperature; `None`: cold throughout.
    pub thermal: Option<Thermal>,
    /// Capacitor, supply and chopper of the dc link; `None`: the link has the voltage that is set.
    pub dc_link: Option<DcLink>,
    /// Model of the bridge.
    pub mode: Mode,
    /// Whether to use the machine's saturation curve, if it has one.
    pub saturation: bool,
    /// Seed of the measurement noise.
    pub seed: u64,
}

impl PlantParams {
    /// Switching model, saturation if the machine has a curve, no friction, 12-bit converters without error.
    #[must_use]
    pub fn new(machine: Machine, inverter: Inverter) -> Self {
        Self {
            machine,
            inverter,
            gate_delays: GateDelays::default(),
            mechanics: Mechanics::default(),
            adc: Adc::new(&machine, &inverter),
            iron_loss: None,
            deep_bar: None,
            calls: Calls::default(),
            thermal: None,
            dc_link: None,
            mode: Mode::Switching,
            saturation: true,
            seed: 0,
        }
    }

    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range.
    pub fn validate(&self) -> Result<(), ParamError> {
        self.machine.validate()?;
        self.inverter.validate()?;
        // Below 10 µs of stray time constant the sub-steps would no longer be few.
        check("(R_s + r_d + R_R)/L_sigma", stray_rate(&self.machine, &self.inverter), 0.0, 1e5, "1/s")?;
        self.gate_delays.validate(&self.inverter)?;
        self.mechanics.validate()?;
        self.adc.validate()?;
        for skew in self.adc.skew {
            check("adc_skew", skew, 0.0, 0.5 / self.inverter.f_s.max(self.inverter.f_c()), "s")?;
        }
        self.iron_loss.map_or(Ok(()), |l| l.validate(&self.machine))?;
        self.deep_bar.map_or(Ok(()), |b| b.validate())?;
        check("missed_calls", self.calls.missed, 0.0, 0.9, "")?;
        check("doubled_calls", self.calls.doubled, 0.0, 1.0 - self.calls.missed, "")?;
        self.dc_link.map_or(Ok(()), |l| l.validate())?;
        self.thermal.map_or(Ok(()), |t| t.validate())
    }
}

fn stray_rate(m: &Machine, inv: &Inverter) -> f64 {
    (m.R_s + inv.r_d + m.R_R) / m.L_sigma
}

/// What only a simulation knows. Space vectors in stator coordinates, amplitude-invariant, SI.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Time, s.
    pub t: f64,
    /// Stator flux, V·s.
    pub psi_s: [f64; 2],
    /// Rotor flux of the inverse-Γ circuit, `psi_s - L_sigma i_s` with the operating point's `L_sigma`, V·s.
    pub psi_r: [f64; 2],
    /// Stator current, A.
    pub i_s: [f64; 2],
    /// Voltage at the machine's terminals, mean of the last period, V.
    pub u_s: [f64; 2],
    /// Mechanical speed, rad/s.
    pub omega_m: f64,
    /// Shaft angle, not wrapped, mechanical rad.
    pub theta_m: f64,
    /// Air-gap torque, N·m.
    pub torque: f64,
    /// Load torque during the last period, N·m.
    pub load_torque: f64,
    /// Resistance of the winding as it is now, without the bridge's `r_d`, Ω.
    pub R_s: f64,
    /// Dc-link voltage, V.
    pub u_dc: f64,
    /// Electrical speed of `psi_s`, mean of the last period, rad/s.
    pub omega_s: f64,
}

/// What can end a segment before its time.
#[derive(Clone, Copy, Debug)]
enum Event {
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

/// Tolerances below which a violated condition is rounding, not an event.
#[derive(Clone, Copy, Debug)]
struct Tolerance {
    current: f64,
    voltage: f64,
    speed: f64,
    torque: f64,
    time: f64,
    /// A current below this is looked at for a zero inside the segment that its end does not show.
    near: f64,
}

/// Induction machine, bridge, sensors and shaft.
#[derive(Clone, Debug)]
pub struct Plant {
    params: PlantParams,
    circuit: Circuit,
    bridge: Bridge,
    /// Potentials of the legs' nodes, if these have capacitance.
    nodes: Option<Nodes>,
    shaft: Shaft,
    adc: Converter,
    x: State,
    f: Field,
    theta: f64,
    t: f64,
    /// Length of the stretch whose edges are listed together: a carrier period, or half of one with a double update.
    period: f64,
    /// Such stretches in a control period.
    stretches: u32,
    /// With a double update: whether the next half period has the rising edges.
    rising: Option<bool>,
    h_max: f64,
    /// Up to this length a segment takes a Taylor step. Zero without node capacitance.
    h_taylor: f64,
    tol: Tolerance,
    /// Duties for the coming period.
    preload: [f64; 3],
    /// Instants within the period at which channels are sampled ahead of its end, else infinite, and what they saw.
    instants: [f64; 3],
    seen: [f64; 3],
    /// `∫ i_s dt` since the period began.
    int_i: V2,
    /// Band of the average model, A.
    band: f64,
    /// Leg signs are out of date because the last step went past the bridge model.
    stale: bool,
    kelvin: f64,
    energy: Option<Energy>,
    link: Option<Link>,
    truth: Truth,
}

/// Longest step of the average model and of [`Plant::step_voltage`], s.
const H_MAX: f64 = 50e-6;

/// Half width of the current band over which the average model's drop changes sign, in units of
/// `(2/3) (u_dc T_d + u_th T_s)/L_sigma`, what a full drop changes a phase current by in one period.
///
/// The switching model, sampled at the carrier peak at standstill, crosses from 0 to 97 % of the drop within
/// 0.2 to 0.5 of that unit (7 to 17 mA at 2.2 kW), at higher speed the current ripple shifts and widens it.
/// 0.5 keeps the two Runge-Kutta steps a period well inside their stability limit, `h lambda = 1.5 < 2.78`.
const BAND: f64 = 0.5;

impl Plant {
    /// A plant at rest: no flux, bridge blocked, 50 % duty in the preload register.
    ///
    /// # Errors
    /// The first parameter found outside its range.
    pub fn new(params: PlantParams) -> Result<Self, ParamError> {
        params.validate()?;
        let PlantParams { machine: m, inverter: inv, .. } = params;
        let period = 1.0 / inv.f_s.max(inv.f_c());
        let circuit = Circuit::new(&m, inv.r_d, params.saturation, params.iron_loss, params.deep_bar);
        let i_n = std::f64::consts::SQRT_2 * m.I_N;
        // A branch carries a small part of the current: its time constant may be met by fewer steps.
        let rate = stray_rate(&m, &inv) + 0.15 * circuit.branch_rate() + 1.5 * m.omega_sR();
        let mut plant = Self {
            params,
            circuit,
            bridge: Bridge::new(&inv, &params.gate_delays),
            nodes: (inv.c_out > 0.0).then(|| Nodes::new(inv.c_out, inv.u_dc, 1e-11 * i_n)),
            shaft: Shaft::new(params.mechanics, m.J),
            adc: Converter::new(params.adc, params.seed),
            x: State { omega: params.mechanics.speed.unwrap_or(0.0), ..State::default() },
            f: Field::default(),
            theta: 0.0,
            t: 0.0,
            period,
            stretches: (inv.half_periods / 2).max(1),
            rising: (inv.half_periods == 1).then_some(true),
            h_max: (0.05 / rate).min(60e-6),
            h_taylor: if inv.c_out > 0.0 { 5e-3 / rate } else { 0.0 },
            tol: Tolerance {
                current: 1e-11 * i_n,
                voltage: 1e-10 * inv.u_dc,
                speed: 1e-13 * m.omega_sR(),
                torque: 1e-12 * m.T_N,
                time: 1e-13 / inv.f_s,
                near: 2e-3 * i_n,
            },
            preload: [0.5; 3],
            instants: params.adc.skew.map(|s| if s > 0.0 { period - s } else { f64::INFINITY }),
            seen: [0.0; 3],
            int_i: [0.0; 2],
            band: (BAND * (2.0 / 3.0) * (inv.u_dc * inv.dead_time + inv.u_th / inv.f_s) / m.L_sigma).max(1e-9 * i_n),
            stale: false,
            kelvin: 0.0,
            energy: params.dc_link.map(|_| Energy::default()),
            link: params.dc_link.map(|l| Link::new(l, inv.u_dc)),
            truth: Truth::default(),
        };
        plant.refresh();
        Ok(plant)
    }

    /// Runs one control period and returns the reading at its end: the carrier peak, in the middle of the lower zero
    /// vector, and with a double update in turn the middle of the upper one, which comes first.
    ///
    /// `duty` (high share of each leg, clamped to 0…1, NaN as 0) goes to the modulator's preload register and
    /// acts in the *next* period; this one runs with the duties given the period before. `gates_on` acts at
    /// once. `load_torque` in N·m opposes positive rotation and is active, as a crane's.
    pub fn step(&mut self, duty: [f64; 3], gates_on: bool, load_torque: f64) -> MeasurementSi {
        let active = std::mem::replace(&mut self.preload, duty.map(|d| if d > 0.0 { d.min(1.0) } else { 0.0 }));
        let begin = self.begin(load_torque);
        let taken = self.taken();
        let averaged = self.params.mode == Mode::Averaged && gates_on;
        for _ in 0..self.stretches {
            match (averaged, self.circuit.kind()) {
                (false, LINEAR) => self.switched::<LINEAR>(active, gates_on),
                (false, SATURATING) => self.switched::<SATURATING>(active, gates_on),
                (false, _) => self.switched::<BRANCHED>(active, gates_on),
                (true, LINEAR) => self.averaged::<LINEAR>(active),
                (true, SATURATING) => self.averaged::<SATURATING>(active),
                (true, _) => self.averaged::<BRANCHED>(active),
            }
        }
        self.rising = self.rising.map(|rising| !rising);
        let length = f64::from(self.stretches) * self.period;
        let drawn = self.taken() - taken;
        if let Some(link) = &mut self.link {
            self.bridge.u_dc = link.advance(self.bridge.u_dc, drawn, length);
        }
        self.finish(begin, length);
        let mut i = self.phase_currents();
        for k in 0..3 {
            if self.instants[k].is_finite() {
                i[k] = self.seen[k];
            }
        }
        self.adc.read(i, self.bridge.u_dc)
    }

    /// Applies a constant voltage vector to the terminals for `dt` seconds, past the bridge (and its `r_d`).
    pub fn step_voltage(&mut self, u_s: [f64; 2], dt: f64, load_torque: f64) {
        let begin = self.begin(load_torque);
        let r_d = std::mem::replace(&mut self.circuit.r_d, 0.0);
        self.circuit.set_R_s(self.circuit.R_s);
        match self.circuit.kind() {
            LINEAR => self.smooth::<LINEAR>(Feed::Voltage(u_s), dt),
            SATURATING => self.smooth::<SATURATING>(Feed::Voltage(u_s), dt),
            _ => self.smooth::<BRANCHED>(Feed::Voltage(u_s), dt),
        }
        self.circuit.r_d = r_d;
        self.circuit.set_R_s(self.circuit.R_s);
        self.finish(begin, dt);
    }

    /// A reading at the present instant. Every call draws fresh noise.
    pub fn sample(&mut self) -> MeasurementSi {
        let i = self.phase_currents();
        self.adc.read(i, self.bridge.u_dc)
    }

    /// The true state at the end of the last period.
    #[must_use]
    pub fn truth(&self) -> &Truth {
        &self.truth
    }

    /// The parameters the plant was made with.
    #[must_use]
    pub fn params(&self) -> &PlantParams {
        &self.params
    }

    /// True phase currents, A; exactly zero where a leg does not conduct.
    #[must_use]
    pub fn phase_currents(&self) -> [f64; 3] {
        let mut i = phases(self.f.i);
        if !self.stale && self.nodes.is_none() {
            for k in 0..3 {
                if self.bridge.sign[k] == 0.0 {
                    i[k] = 0.0;
                }
            }
        }
        i
    }

    /// Sets the winding's cold resistance, Ω.
    pub fn set_R_s(&mut self, R_s: f64) {
        self.params.machine.R_s = R_s;
        self.warm();
    }

    /// Sets the rotor resistance of the inverse-Γ circuit, Ω.
    pub fn set_R_R(&mut self, R_R: f64) {
        self.params.machine.R_R = R_R;
        self.circuit.set_R_R(&self.params.machine);
        self.refresh();
    }

    /// Sets the present offset of the current channels, A; the drift goes on from there.
    pub fn set_offset(&mut self, offset: [f64; 3]) {
        self.adc.offset = offset;
    }

    /// Energy that the bridge has taken from the link, as far as it is accounted.
    fn taken(&self) -> f64 {
        self.energy.as_ref().map_or(0.0, |e| of_mode(self.params.mode, e))
    }

    /// Duty of the brake chopper from now on, 0 to 1.
    pub fn set_chopper(&mut self, duty: f64) {
        if let Some(link) = &mut self.link {
            link.chopper = if duty > 0.0 { duty.min(1.0) } else { 0.0 };
        }
    }

    /// Energies of the dc link since the plant was made, if it has a capacitor.
    #[must_use]
    pub fn link_energy(&self) -> Option<&LinkEnergy> {
        self.link.as_ref().map(|link| &link.energy)
    }

    /// Disconnects phase `phase` (0 to 2) from its leg, or connects it again: its current flows on to its next zero. Of
    /// the switching model; capacitances of the nodes are neglected from then on.
    pub fn set_open_phase(&mut self, phase: usize, open: bool) {
        if let Some(state) = self.bridge.open.get_mut(phase) {
            *state = open;
            self.nodes = None;
            self.h_taylor = 0.0;
            self.stale = true;
        }
    }

    /// Lets a current channel (0 to 2) fail, or heals it.
    pub fn set_channel(&mut self, channel: usize, fault: Option<ChannelFault>) {
        self.adc.set_fault(channel, fault);
    }

    /// Sets the dc-link voltage, V; of a link with a capacitor the no-load voltage of its supply.
    pub fn set_u_dc(&mut self, u_dc: f64) {
        if let Some(link) = &mut self.link {
            link.supply = u_dc;
            return;
        }
        self.bridge.u_dc = u_dc;
        self.truth.u_dc = u_dc;
    }

    /// Imposes a shaft speed (mechanical rad/s) from now on, or with `None` lets the shaft go.
    pub fn set_speed(&mut self, speed: Option<f64>) {
        self.x.omega = speed.unwrap_or(self.x.omega);
        self.shaft.impose(speed, self.x.omega);
        self.refresh();
    }

    /// Puts the machine into a state: stator flux and inverse-Γ rotor flux in V·s, mechanical rad/s.
    pub fn set_state(&mut self, psi_s: [f64; 2], psi_r: [f64; 2], omega_m: f64) {
        self.x = self.circuit.state_of(psi_s, psi_r, omega_m);
        self.shaft.restart(omega_m);
        self.stale = true;
        self.refresh();
    }

    /// Starts (from zero) or stops the account of energies.
    pub fn track_energy(&mut self, on: bool) {
        // A link with a capacitor lives by the account.
        self.energy = (on || self.link.is_some()).then(Energy::default);
    }

    /// Energies since tracking began, if it did.
    #[must_use]
    pub fn energy(&self) -> Option<&Energy> {
        self.energy.as_ref()
    }

    /// Energy now stored in the machine's magnetic field, J.
    #[must_use]
    pub fn magnetic_energy(&self) -> f64 {
        self.circuit.magnetic_energy(&self.x)
    }

    /// Energy now stored in the capacitances of the legs' nodes, J.
    #[must_use]
    pub fn node_energy(&self) -> f64 {
        self.nodes.map_or(0.0, |n| n.energy())
    }

    /// Potentials of the legs' nodes against the negative rail, V, if they have capacitance: before the drop
    /// at `r_d`.
    #[must_use]
    pub fn node_potentials(&self) -> Option<[f64; 3]> {
        self.nodes.map(|n| n.v)
    }

    fn begin(&mut self, load_torque: f64) -> V2 {
        self.shaft.load = load_torque;
        self.int_i = [0.0; 2];
        if self.shaft.stuck {
            self.shaft.at_rest(self.f.torque);
        }
        self.x.psi_s
    }

    /// The books of a period of length `dt` that began with flux `psi`.
    fn finish(&mut self, psi: V2, dt: f64) {
        self.t += dt;
        self.adc.drift(dt);
        let (now, w) = (self.x.psi_s, 1.0 / dt);
        // psi_s' = u_s - R_s i_s, integrated.
        let mean_i = [w * self.int_i[0], w * self.int_i[1]];
        let R_s = self.circuit.R_s;
        self.truth.u_s = [w * (now[0] - psi[0]) + R_s * mean_i[0], w * (now[1] - psi[1]) + R_s * mean_i[1]];
        self.truth.omega_s = w * angle(psi, now);
        self.truth.load_torque = self.shaft.load;
        if let Some(thermal) = &self.params.thermal {
            let m = &self.params.machine;
            let load = R_s / m.R_s * dot(mean_i, mean_i) / (2.0 * m.I_N * m.I_N);
            self.kelvin = thermal.advance(self.kelvin, load, dt);
            self.warm();
        }
        self.publish();
    }

    fn warm(&mut self) {
        let alpha = self.params.thermal.map_or(0.0, |t| t.alpha);
        self.circuit.set_R_s(self.params.machine.R_s * (1.0 + alpha * self.kelvin));
        self.truth.R_s = self.circuit.R_s;
    }

    /// Recomputes what follows from the state after it was changed from outside.
    fn refresh(&mut self) {
        self.f = self.circuit.field::<BRANCHED>(&self.x);
        self.publish();
    }

    fn publish(&mut self) {
        let t = &mut self.truth;
        (t.t, t.psi_s, t.psi_r, t.i_s) = (self.t, self.x.psi_s, self.circuit.psi_R(&self.x), self.f.i);
        (t.omega_m, t.theta_m, t.torque) = (self.x.omega, self.theta, self.f.torque);
        (t.R_s, t.u_dc) = (self.circuit.R_s, self.bridge.u_dc);
    }

    /// The next instant after `t` at which a channel is sampled ahead of the period's end.
    #[inline(always)]
    fn next_instant(&self, t: f64) -> f64 {
        self.instants.into_iter().filter(|s| *s > t).fold(f64::INFINITY, f64::min)
    }

    /// Samples the channels whose instant is `t`.
    #[inline(always)]
    fn look(&mut self, t: f64) {
        if self.instants.contains(&t) {
            let i = self.phase_currents();
            for k in 0..3 {
                if self.instants[k] == t {
                    self.seen[k] = i[k];
                }
            }
        }
    }

    /// A period of the average model.
    fn averaged<const KIND: u8>(&mut self, duty: [f64; 3]) {
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
    fn switched<const KIND: u8>(&mut self, duty: [f64; 3], gates_on: bool) {
        let stale = std::mem::replace(&mut self.stale, false);
        if stale {
            self.bridge.set_signs(self.f.i, self.tol.current);
        }
        self.bridge.load(duty, gates_on, self.rising);
        if let Some(nodes) = self.nodes {
            return self.capacitive::<KIND>(nodes, stale);
        }
        let (mut t, mut lift, mut stall) = (0.0, false, 0);
        while t < self.period {
            self.look(t);
            self.bridge.apply(t);
            let feed = self.bridge.feed::<KIND>(&self.circuit, &self.x, &self.f, lift);
            let end = self.bridge.next_change().min(self.period).min(self.next_instant(t)).min(t + self.h_max);
            match self.segment::<KIND, true>(&feed, end - t, stall > 8) {
                None => (t, lift, stall) = (end, false, 0),
                Some((tau, event)) => {
                    // Conditions that contradict each other by rounding alone could repeat at one instant;
                    // after a few turns the segment is integrated as it stands.
                    stall = if tau <= self.tol.time { stall + 1 } else { 0 };
                    t += tau;
                    lift = matches!(event, Event::LiftAny);
                }
            }
        }
        // Changes since the last segment began that no current noticed.
        self.bridge.apply(self.period);
    }

    /// The rest of [`Self::switched`] with capacitance at the legs' nodes.
    fn capacitive<const KIND: u8>(&mut self, mut nodes: Nodes, stale: bool) {
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
            let (h, hit) = match feed {
                Feed::Nodes(u, K) => self.ramp::<KIND>(u, &K, &nodes, end - t, blind),
                _ => (end - t, self.segment::<KIND, true>(&feed, end - t, blind)),
            };
            nodes = self.nodes.unwrap_or(nodes);
            match hit {
                None => (t, stall) = (if h == end - t { end } else { t + h }, 0),
                Some((tau, _)) => {
                    stall = if tau <= self.tol.time { stall + 1 } else { 0 };
                    t += tau;
                }
            }
        }
        self.bridge.apply(self.period);
        nodes.settle(&mut self.bridge, self.f.i, &mut self.energy);
        self.nodes = Some(nodes);
    }

    /// A stretch without a bridge: only the shaft has events.
    fn smooth<const KIND: u8>(&mut self, feed: Feed, dt: f64) {
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
    fn segment<const KIND: u8, const BRIDGE: bool>(
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
        if near || self.shaft.stuck || self.shaft.dir * step.x.omega < 0.0 {
            return self.eventful::<KIND, BRIDGE>(feed, h, step, f, blind);
        }
        self.commit::<KIND>(feed, h, step, f);
        None
    }

    /// A segment of at most `h` in which some node floats: how long it was meant to be, and its event.
    #[inline(always)]
    fn ramp<const KIND: u8>(
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
            (phases(self.f.i), phases(f.i), !blind && !self.shaft.stuck && self.shaft.dir * step.x.omega >= 0.0);
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
    fn take_over(&mut self, k: usize, sign: f64) {
        let b = &mut self.bridge;
        b.sign[k] = sign;
        if let Some(nodes) = &mut self.nodes {
            nodes.v[k] = if sign > 0.0 { b.lo(k) } else { b.hi(k) };
        }
    }

    #[inline(always)]
    fn commit<const KIND: u8>(&mut self, feed: &Feed, h: f64, step: Step, f: Field) {
        if self.energy.is_some() {
            self.account::<KIND>(feed, h, &step, &f);
        }
        if let (Feed::Nodes(..), Some(nodes)) = (feed, &mut self.nodes) {
            nodes.discharge(&self.bridge, step.int_i);
        }
        (self.x, self.f) = (step.x, f);
        self.int_i[0] += step.int_i[0];
        self.int_i[1] += step.int_i[1];
        self.theta += step.dtheta;
    }

    #[inline(always)]
    fn trial<const KIND: u8>(&self, feed: &Feed, x: &State, f: &Field, h: f64) -> Step {
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
    fn trial_at_zero<const KIND: u8>(&self, feed: &Feed, x: &State, f: &Field, h: f64) -> Step {
        let c = &self.circuit;
        c.rk4::<KIND>(&self.shaft, x, f, h, |x, f| feed.dpsi_s::<KIND>(c, x, f, [0.0; 2]))
    }

    /// Simpson's rule over the segment: the order of the integrator.
    #[inline(never)]
    fn account<const KIND: u8>(&mut self, feed: &Feed, h: f64, step: &Step, f: &Field) {
        let c = &self.circuit;
        let mid = self.trial::<KIND>(feed, &self.x, &self.f, 0.5 * h);
        let power = |s: &Step, f: &Field| c.power(&s.x, f, feed.dpsi_s::<KIND>(c, &s.x, f, s.int_i));
        let p = [power(&self.here(), &self.f), power(&mid, &c.field::<KIND>(&mid.x)), power(step, f)];
        let (b, q) = (&self.bridge, phases(step.int_i));
        if let Some(e) = &mut self.energy {
            for (p, k) in p.iter().zip([1.0, 4.0, 1.0]) {
                e.add(k * h / 6.0, p);
            }
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
    fn here(&self) -> Step {
        Step { x: self.x, int_i: [0.0; 2], dtheta: 0.0 }
    }

    /// The end of a segment that may hold an event.
    #[inline(never)]
    fn eventful<const KIND: u8, const BRIDGE: bool>(
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
    fn drives(&self, event: Event, f: &Field) -> bool {
        matches!(event, Event::Rail(k, sign) if self.bridge.sign[k] == 0.0 && sign * phase(f.i, k) > self.tol.current)
    }

    /// A current with the right sign at both ends of a segment may still have crossed zero between, a node its
    /// rail: the course is nearly a parabola, so the state at the vertex decides.
    fn dip<const KIND: u8>(
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

    fn tolerance(&self, event: Event) -> f64 {
        match event {
            Event::Current(_) => self.tol.current,
            Event::Lift(..) | Event::LiftAny => self.tol.voltage,
            Event::Rail(..) => self.nodes.map_or(0.0, |n| n.tol),
            Event::Rest => self.tol.speed,
            Event::Breakaway => self.tol.torque,
        }
    }

    /// Distance from an event; negative once it has happened.
    fn margin<const KIND: u8>(&self, event: Event, feed: &Feed, step: &Step, f: &Field) -> f64 {
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
    fn locate<const KIND: u8>(&self, event: Event, feed: &Feed, end: (f64, Step, Field)) -> (f64, Step, Field) {
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

/// What the bridge takes from the link; the average model has no losses of its own.
fn of_mode(mode: Mode, e: &Energy) -> f64 {
    match mode {
        Mode::Switching => e.link,
        Mode::Averaged => e.input,
    }
}

/// Angle from `a` to `b`, rad.
fn angle(a: V2, b: V2) -> f64 {
    let (sin, cos) = (a[0] * b[1] - a[1] * b[0], dot(a, b));
    if cos > 0.0 && sin.abs() < 0.05 * cos {
        // The turn of one period is small: the arctangent's series, exact to 1e-12 here.
        let r = sin / cos;
        let r2 = r * r;
        r * (1.0 - r2 * (1.0 / 3.0 - r2 * (0.2 - r2 * (1.0 / 7.0 - r2 / 9.0))))
    } else {
        sin.atan2(cos)
    }
}
