//! The plant: machine, bridge, sensors and shaft, one control period at a time ([`period`]), exact at every event
//! ([`events`]).
#![allow(non_snake_case)]

mod events;
mod period;
mod tolerance;

use self::tolerance::Tolerance;
use crate::adc::{Adc, ChannelFault, Converter};
use crate::branches::{DeepBar, IronLoss};
use crate::bridge::{Bridge, Feed, GateDelays};
use crate::coupling::ElasticLoad;
use crate::dclink::{DcLink, Link};
use crate::encoder::{Counter, Encoder, EncoderFault};
use crate::link_energy::LinkEnergy;
use crate::machine::{BRANCHED, Circuit, Energy, Extras, FULL, Field, LINEAR, SATURATING, State, V2, dot, phases};
use crate::mechanics::{Mechanics, Shaft};
use crate::nodes::Nodes;
use crate::rectifier::Grid;
use crate::shunt::{Amplifier, Shunt};
use crate::slots::{LeakageSaturation, SlotRipple};
use crate::thermal::Thermal;
use stillflux::control::shunt::Pulses;
use stillflux::params::{Inverter, Machine, ParamError, check};
use stillflux::si::MeasurementSi;

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
    /// A single shunt in place of the current channels: the readings are then those of the instants that
    /// [`Plant::step_pulses`] is given, in their order, and at the end of the period. `None`: three phase currents.
    pub shunt: Option<Shunt>,
    /// Encoder on the shaft.
    pub encoder: Option<Encoder>,
    /// Eddy currents in the iron.
    pub iron_loss: Option<IronLoss>,
    /// Skin effect in the rotor's bars.
    pub deep_bar: Option<DeepBar>,
    /// Saturation of the leakage.
    pub leakage_saturation: Option<LeakageSaturation>,
    /// Ripple by the rotor's slots.
    pub slot_ripple: Option<SlotRipple>,
    /// Whether the control is called once a period, as it should be.
    pub calls: Calls,
    /// Temperature of winding and rotor; `None`: cold throughout.
    pub thermal: Option<Thermal>,
    /// Capacitor, supply and chopper of the dc link; `None`: the link has the voltage that is set.
    pub dc_link: Option<DcLink>,
    /// Grid that feeds the link's rectifier; `None`: the rectified voltage is smooth.
    pub grid: Option<Grid>,
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
            shunt: None,
            encoder: None,
            iron_loss: None,
            deep_bar: None,
            leakage_saturation: None,
            slot_ripple: None,
            calls: Calls::default(),
            thermal: None,
            dc_link: None,
            grid: None,
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
        self.gate_delays.with(&self.inverter).validate(&self.inverter)?;
        self.mechanics.validate(&self.machine)?;
        if let Some(coupling) = self.mechanics.coupling {
            coupling.validate(&self.machine, self.mechanics.J_load, 1.0 / self.inverter.f_s)?;
        }
        self.adc.validate()?;
        for skew in self.adc.skew {
            check("adc_skew", skew, 0.0, 0.5 / self.inverter.f_s.max(self.inverter.f_c()), "s")?;
        }
        if let Some(shunt) = self.shunt {
            shunt.validate()?;
            let skew = self.adc.skew.iter().fold(0.0, |most: f64, s| most.max(*s));
            check("adc_skew", skew, 0.0, 0.0, "s").map_err(|e| e.with_note("a shunt has no channels of their own"))?;
            let halves = if self.mode == Mode::Switching { self.inverter.half_periods } else { 0 };
            check("half_periods", f64::from(halves), 2.0, 16.0, "")
                .map_err(|e| e.with_note("a shunt sees the edges of whole carrier periods, in the switching model"))?;
        }
        self.encoder.map_or(Ok(()), |e| e.validate())?;
        self.iron_loss.map_or(Ok(()), |l| l.validate(&self.machine))?;
        self.deep_bar.map_or(Ok(()), |b| b.validate())?;
        self.leakage_saturation.map_or(Ok(()), |l| l.validate(&self.machine))?;
        self.slot_ripple.map_or(Ok(()), |s| s.validate())?;
        check("missed_calls", self.calls.missed, 0.0, 0.9, "")?;
        check("doubled_calls", self.calls.doubled, 0.0, 1.0 - self.calls.missed, "")?;
        self.dc_link.map_or(Ok(()), |l| l.validate())?;
        if let Some(grid) = self.grid {
            grid.validate()?;
            if self.dc_link.is_none() {
                return check("grid frequency", grid.frequency, 0.0, 0.0, "Hz")
                    .map_err(|e| e.with_note("a grid feeds the capacitor of dc_link, and that is not given"));
            }
        }
        self.thermal.map_or(Ok(()), |t| t.validate())
    }
}

impl PlantParams {
    /// Checks that the control of an inverter is called in the plant's period.
    pub(crate) fn check_period(&self, inverter: &Inverter) -> Result<(), ParamError> {
        check("plant inverter.f_s", self.inverter.f_s, inverter.f_s, inverter.f_s, "Hz")?;
        let half_periods = f64::from(inverter.half_periods);
        check("plant inverter.half_periods", f64::from(self.inverter.half_periods), half_periods, half_periods, "")
    }
}

fn stray_rate(m: &Machine, inv: &Inverter) -> f64 {
    (m.R_s + inv.r_d + m.R_R) / m.L_sigma
}

/// Fastest rate of the machine's equations at a constant voltage, 1/s.
fn fastest_rate(p: &PlantParams, circuit: &Circuit) -> f64 {
    // Saturated leakage raises the stray rate, by its tangent at the current that it is given for. A branch carries a small
    // part of the current: its time constant may be met by fewer steps.
    let stray = stray_rate(&p.machine, &p.inverter) * (1.0 + 3.0 * p.leakage_saturation.map_or(0.0, |l| l.excess()));
    let imposed = 0.5 * f64::from(p.machine.n_p) * p.mechanics.speed.unwrap_or(0.0).abs();
    stray + 0.15 * circuit.branch_rate() + imposed.max(1.5 * p.machine.omega_sR())
}

/// Longest step of the equations, s.
fn longest_step(p: &PlantParams, rate: f64) -> f64 {
    // The ripple of the slots has to be followed.
    let slots = p.slot_ripple.map_or(0.0, |s| f64::from(s.slots)) * p.machine.omega_sR() / f64::from(p.machine.n_p);
    (0.05 / rate).min(60e-6).min(0.2 / slots)
}

/// The legs' nodes, if they have capacitance, and up to which length a segment then takes a Taylor step, s.
fn node_model(m: &Machine, inv: &Inverter, rate: f64) -> (Option<Nodes>, f64) {
    if inv.c_out > 0.0 {
        (Some(Nodes::new(inv.c_out, inv.u_dc, zero_current(m))), of_taylor(rate))
    } else {
        (None, 0.0)
    }
}

fn of_taylor(rate: f64) -> f64 {
    5e-3 / rate
}

/// Current that counts as zero, A.
fn zero_current(m: &Machine) -> f64 {
    1e-11 * std::f64::consts::SQRT_2 * m.I_N
}

/// Band of the average model, A ([`BAND`]).
fn average_band(m: &Machine, inv: &Inverter) -> f64 {
    let full = (2.0 / 3.0) * (inv.u_dc * inv.dead_time + inv.u_th / inv.f_s) / m.L_sigma;
    (BAND * full).max(100.0 * zero_current(m))
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
    /// Mechanical speed of the machine's shaft, rad/s.
    pub omega_m: f64,
    /// Shaft angle, not wrapped, mechanical rad.
    pub theta_m: f64,
    /// Air-gap torque, N·m.
    pub torque: f64,
    /// Load torque during the last period, N·m.
    pub load_torque: f64,
    /// Mechanical speed of the load, rad/s: that of the shaft but for an elastic coupling.
    pub omega_load: f64,
    /// Resistance of the winding as it is now, without the bridge's `r_d`, Ω.
    pub R_s: f64,
    /// Dc-link voltage, V.
    pub u_dc: f64,
    /// Electrical speed of `psi_s`, mean of the last period, rad/s.
    pub omega_s: f64,
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
    /// What an elastic coupling drives.
    elastic: Option<ElasticLoad>,
    adc: Converter,
    x: State,
    f: Field,
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
    /// Pulses for the coming period.
    preload: Pulses<f64>,
    shunt: Option<Amplifier>,
    counter: Option<Counter>,
    /// Instants within the period at which channels are sampled ahead of its end, else infinite, and what they saw.
    instants: [f64; 3],
    seen: [f64; 3],
    /// Whether there are such channels.
    skewed: bool,
    /// `∫ i_s dt` since the period began.
    int_i: V2,
    /// `∫ |i_s|² dt` since then, with a thermal model.
    int_i2: f64,
    /// Band of the average model, A.
    band: f64,
    /// Leg signs are out of date because the last step went past the bridge model.
    stale: bool,
    kelvin: f64,
    energy: Option<Energy>,
    /// Whether the account holds more than what a link with a capacitor lives by.
    booked: bool,
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
        let mut adc = params.adc;
        if params.shunt.is_some() {
            // One amplifier, and no channel with an instant of its own.
            (adc.offset, adc.gain) = ([adc.offset[0]; 3], [adc.gain[0]; 3]);
            (adc.offset_drift, adc.skew) = ([adc.offset_drift[0]; 3], [0.0; 3]);
        }
        let PlantParams { machine: m, inverter: inv, .. } = params;
        let period = 1.0 / inv.f_s.max(inv.f_c());
        let circuit = Circuit::new(
            &m,
            inv.r_d,
            params.saturation,
            &Extras {
                iron: params.iron_loss,
                bar: params.deep_bar,
                leakage: params.leakage_saturation,
                slots: params.slot_ripple,
            },
        );
        let i_n = std::f64::consts::SQRT_2 * m.I_N;
        let rate = fastest_rate(&params, &circuit);
        let (nodes, h_taylor) = node_model(&m, &inv, rate);
        let mut plant = Self {
            params,
            circuit,
            bridge: Bridge::new(&inv, &params.gate_delays),
            nodes,
            shaft: Shaft::new(params.mechanics, &m),
            elastic: params.mechanics.elastic_load(params.mechanics.speed.unwrap_or(0.0)),
            adc: Converter::new(adc, params.seed),
            x: State { omega: params.mechanics.speed.unwrap_or(0.0), ..State::default() },
            f: Field::default(),
            t: 0.0,
            period,
            stretches: (inv.half_periods / 2).max(1),
            rising: (inv.half_periods == 1).then_some(true),
            h_max: longest_step(&params, rate),
            h_taylor,
            tol: Tolerance {
                current: zero_current(&m),
                voltage: 1e-10 * inv.u_dc,
                speed: 1e-13 * m.omega_sR(),
                torque: 1e-12 * m.T_N,
                time: 1e-13 / inv.f_s,
                near: 2e-3 * i_n,
            },
            preload: centred([0.5; 3]),
            shunt: params.shunt.map(Amplifier::new),
            counter: params.encoder.map(Counter::new),
            instants: adc.skew.map(|s| if s > 0.0 { period - s } else { f64::INFINITY }),
            seen: [0.0; 3],
            skewed: adc.skew.iter().any(|s| *s > 0.0),
            int_i: [0.0; 2],
            int_i2: 0.0,
            band: average_band(&m, &inv),
            stale: false,
            kelvin: 0.0,
            energy: params.dc_link.map(|_| Energy::default()),
            booked: params.mode == Mode::Averaged,
            link: params.dc_link.map(|l| Link::new(l, params.grid, inv.u_dc)),
            truth: Truth::default(),
        };
        if let Some(link) = &plant.link {
            plant.bridge.u_dc = link.no_load();
        }
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
        self.step_pulses(&centred(duty), gates_on, load_torque)
    }

    /// [`Plant::step`] with pulses that need not be centred, and the instants at which a single shunt is sampled. With a
    /// double update the half widths before the middle count in one control period, those after it in the next.
    pub fn step_pulses(&mut self, pulses: &Pulses<f64>, gates_on: bool, load_torque: f64) -> MeasurementSi {
        let within = |d: f64| if d > 0.0 { d.min(1.0) } else { 0.0 };
        let Pulses { rising, falling, sample } = pulses;
        let pulses = Pulses { rising: rising.map(within), falling: falling.map(within), sample: sample.map(within) };
        let active = std::mem::replace(&mut self.preload, pulses);
        if let Some(shunt) = &mut self.shunt {
            let middle = 0.5 * self.period;
            shunt.instants = active.sample.map(|s| middle + self.bridge.half_width(s));
        }
        let length = f64::from(self.stretches) * self.period;
        let begin = self.begin(load_torque, length);
        let taken = self.taken();
        let averaged = self.params.mode == Mode::Averaged && gates_on;
        for _ in 0..self.stretches {
            match (averaged, self.circuit.kind()) {
                (false, LINEAR) => self.switched::<LINEAR>(&active, gates_on),
                (false, SATURATING) => self.switched::<SATURATING>(&active, gates_on),
                (false, BRANCHED) => self.switched::<BRANCHED>(&active, gates_on),
                (false, _) => self.switched::<FULL>(&active, gates_on),
                (true, LINEAR) => self.averaged::<LINEAR>(active.duty()),
                (true, SATURATING) => self.averaged::<SATURATING>(active.duty()),
                (true, BRANCHED) => self.averaged::<BRANCHED>(active.duty()),
                (true, _) => self.averaged::<FULL>(active.duty()),
            }
        }
        self.rising = self.rising.map(|rising| !rising);
        let drawn = self.taken() - taken;
        if let Some(link) = &mut self.link {
            self.bridge.u_dc = link.advance(self.bridge.u_dc, drawn, length);
        }
        self.finish(begin, length);
        if let Some(Amplifier { seen: [first, second], y, .. }) = self.shunt {
            return self.adc.read([first, second, y], self.bridge.u_dc);
        }
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
        // A coupling has one torque in a control period.
        let parts = if self.elastic.is_some() { (dt * self.params.inverter.f_s).ceil().max(1.0) } else { 1.0 };
        let h = dt / parts;
        let r_d = std::mem::replace(&mut self.circuit.r_d, 0.0);
        self.circuit.set_R_s(self.circuit.R_s);
        let mut done = 0.0;
        while done < parts {
            done += 1.0;
            let begin = self.begin(load_torque, h);
            match self.circuit.kind() {
                LINEAR => self.smooth::<LINEAR>(Feed::Voltage(u_s), h),
                SATURATING => self.smooth::<SATURATING>(Feed::Voltage(u_s), h),
                BRANCHED => self.smooth::<BRANCHED>(Feed::Voltage(u_s), h),
                _ => self.smooth::<FULL>(Feed::Voltage(u_s), h),
            }
            self.finish(begin, h);
        }
        self.circuit.r_d = r_d;
        self.circuit.set_R_s(self.circuit.R_s);
    }

    /// A reading at the present instant. Every call draws fresh noise.
    pub fn sample(&mut self) -> MeasurementSi {
        let i = self.shunt.map_or_else(|| self.phase_currents(), |shunt| [shunt.y; 3]);
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
        self.warm();
        self.refresh();
    }

    /// Sets the present offset of the current channels, A, of a single shunt that of the first; the drift goes on from there.
    pub fn set_offset(&mut self, offset: [f64; 3]) {
        self.adc.offset = if self.shunt.is_some() { [offset[0]; 3] } else { offset };
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

    /// Position of the encoder at the instant of the latest reading, counts; `None` without one, or if it is not read.
    #[must_use]
    pub fn encoder(&self) -> Option<i64> {
        self.counter.and_then(|counter| counter.content())
    }

    /// Lets the encoder fail, or heals it.
    pub fn set_encoder(&mut self, fault: Option<EncoderFault>) {
        if let Some(counter) = &mut self.counter {
            counter.fault = fault;
        }
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

    /// Sets the dead time of the bridge, s; a switch already waiting for its turn-on keeps the earlier one.
    pub fn set_dead_time(&mut self, dead_time: f64) {
        self.params.inverter.dead_time = dead_time;
        self.bridge.dead_time = dead_time;
        self.band = average_band(&self.params.machine, &self.params.inverter);
    }

    /// Sets the capacitance of the legs' nodes, F; their potentials become those of the present gates.
    pub fn set_node_capacitance(&mut self, c_out: f64) {
        self.params.inverter.c_out = c_out;
        self.bridge.c_out = c_out;
        if self.bridge.open == [false; 3] {
            let PlantParams { machine, inverter, .. } = &self.params;
            (self.nodes, self.h_taylor) = node_model(machine, inverter, fastest_rate(&self.params, &self.circuit));
            self.stale = true;
        }
    }

    /// Imposes a shaft speed (mechanical rad/s) from now on, or with `None` lets the shaft go.
    pub fn set_speed(&mut self, speed: Option<f64>) {
        self.params.mechanics.speed = speed;
        let rate = fastest_rate(&self.params, &self.circuit);
        self.h_max = longest_step(&self.params, rate);
        if self.nodes.is_some() {
            self.h_taylor = of_taylor(rate);
        }
        self.x.omega = speed.unwrap_or(self.x.omega);
        self.shaft.impose(speed, self.x.omega);
        self.refresh();
    }

    /// Puts the machine into a state: stator flux and inverse-Γ rotor flux in V·s, mechanical rad/s.
    ///
    /// # Errors
    /// Another speed than the one that is imposed, or a state that the longest step cannot follow: a shaft that turns
    /// by a radian in it, or iron so saturated that currents rise and decay within it.
    pub fn set_state(&mut self, psi_s: [f64; 2], psi_r: [f64; 2], omega_m: f64) -> Result<(), ParamError> {
        if let Some(w) = self.params.mechanics.speed {
            check("omega_m", omega_m, w, w, "rad/s").map_err(|e| e.with_note("the speed is imposed"))?;
        }
        let most = 1.0 / (self.circuit.n_p * self.h_max);
        check("omega_m", omega_m, -most, most, "rad/s")?;
        let x = self.circuit.state_of(psi_s, psi_r, omega_m, self.x.theta);
        check("rate of currents at psi_s and psi_r", self.circuit.rate(&x), 0.0, 1.0 / self.h_max, "1/s")
            .map_err(|e| e.with_note("so much flux saturates the iron"))?;
        self.x = x;
        self.shaft.restart(omega_m);
        self.elastic = self.params.mechanics.elastic_load(omega_m);
        self.stale = true;
        self.refresh();
        Ok(())
    }

    /// Starts (from zero) or stops the account of energies.
    pub fn track_energy(&mut self, on: bool) {
        // A link with a capacitor lives by what the bridge takes from it.
        self.energy = (on || self.link.is_some()).then(Energy::default);
        self.booked = on || self.params.mode == Mode::Averaged;
    }

    /// Energies since tracking began, if it did.
    #[must_use]
    pub fn energy(&self) -> Option<&Energy> {
        self.energy.as_ref().filter(|_| self.booked)
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

    fn begin(&mut self, load_torque: f64, dt: f64) -> V2 {
        self.truth.load_torque = load_torque;
        let omega = self.x.omega;
        self.shaft.load = self.elastic.as_mut().map_or(load_torque, |elastic| elastic.begin(omega, dt));
        (self.int_i, self.int_i2) = ([0.0; 2], 0.0);
        // Steps turn it on: no rounding may pile up.
        self.x.slot = self.circuit.slot(self.x.theta);
        if self.shaft.stuck {
            self.shaft.at_rest(self.f.torque);
        }
        self.x.psi_s
    }

    /// The books of a period of length `dt` that began with flux `psi`.
    fn finish(&mut self, psi: V2, dt: f64) {
        self.t += dt;
        self.adc.drift(dt);
        if let Some(counter) = &mut self.counter {
            counter.advance(self.x.theta);
        }
        let (now, w) = (self.x.psi_s, 1.0 / dt);
        // psi_s' = u_s - R_s i_s, integrated.
        let mean_i = [w * self.int_i[0], w * self.int_i[1]];
        let R_s = self.circuit.R_s;
        self.truth.u_s = [w * (now[0] - psi[0]) + R_s * mean_i[0], w * (now[1] - psi[1]) + R_s * mean_i[1]];
        self.truth.omega_s = w * angle(psi, now);
        if let Some(elastic) = &mut self.elastic {
            elastic.finish(self.x.omega, self.truth.load_torque, dt);
        }
        if let Some(thermal) = &self.params.thermal {
            let m = &self.params.machine;
            let load = R_s / m.R_s * w * self.int_i2 / (2.0 * m.I_N * m.I_N);
            self.kelvin = thermal.advance(self.kelvin, load, dt);
            self.warm();
        }
        self.publish();
    }

    fn warm(&mut self) {
        let (alpha, alpha_R) = self.params.thermal.map_or((0.0, 0.0), |t| (t.alpha, t.alpha_R));
        let m = &self.params.machine;
        self.circuit.set_R_s(m.R_s * (1.0 + alpha * self.kelvin));
        if alpha_R > 0.0 {
            self.circuit.set_R_R(&Machine { R_R: m.R_R * (1.0 + alpha_R * self.kelvin), ..*m });
        }
        self.truth.R_s = self.circuit.R_s;
    }

    /// Recomputes what follows from the state after it was changed from outside.
    fn refresh(&mut self) {
        self.x.slot = self.circuit.slot(self.x.theta);
        self.f = self.circuit.any_field(&self.x);
        self.publish();
    }

    fn publish(&mut self) {
        let t = &mut self.truth;
        (t.t, t.psi_s, t.psi_r, t.i_s) = (self.t, self.x.psi_s, self.circuit.psi_R(&self.x), self.f.i);
        (t.omega_m, t.theta_m, t.torque) = (self.x.omega, self.x.theta, self.f.torque);
        t.omega_load = self.elastic.map_or(self.x.omega, |elastic| elastic.omega);
        (t.R_s, t.u_dc) = (self.circuit.R_s, self.bridge.u_dc);
    }
}

/// Centred pulses.
fn centred(duty: [f64; 3]) -> Pulses<f64> {
    Pulses { rising: duty, falling: duty, sample: [0.5; 2] }
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
        libm::atan2(sin, cos)
    }
}
