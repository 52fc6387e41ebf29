//! A commissioning on a plant, advanced in pieces, with what only the plant knows: the largest current and how far the
//! shaft has turned. Wiring faults are made between plant and control.

use crate::plant::{Plant, PlantParams};
use crate::shunt::Shunt;
use stillflux::commission::si::{Shaft, SiCommissioning};
use stillflux::commission::{Nameplate, Stage, Status};
use stillflux::params::{Inverter, ParamError, check};
use stillflux::si::{Arithmetic, MeasurementSi};

/// What is wrong with the wiring between plant and control.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wiring {
    /// Leg whose current each channel reads.
    pub channels: Option<[usize; 3]>,
    /// Factor of each channel: negative for an inverted one, zero for a dead one.
    pub gain: Option<[f64; 3]>,
}

impl Wiring {
    fn read(&self, m: MeasurementSi) -> MeasurementSi {
        let [a, b, c] = self.channels.unwrap_or([0, 1, 2]);
        let i = [a, b, c].map(|k| m.i_abc[k % 3]);
        let g = self.gain.unwrap_or([1.0; 3]);
        MeasurementSi { i_abc: [g[0] * i[0], g[1] * i[1], g[2] * i[2]], ..m }
    }
}

/// A commissioning coupled to a plant.
#[derive(Clone, Debug)]
pub struct CommissioningRun {
    commissioning: SiCommissioning,
    plant: Plant,
    wiring: Wiring,
    measured: MeasurementSi,
    rated_peak: f64,
    pole_pairs: f64,
    current: f64,
    turned: f64,
}

impl CommissioningRun {
    /// Before the first period. `shaft` is what the commissioning is told; the plant's own is that of `plant.mechanics`, whose
    /// `speed` is `Some(0.0)` where it is locked.
    ///
    /// # Errors
    /// The first value outside its admissible range, and what a commissioning cannot do with a plant: a single shunt, calls
    /// that are missed or doubled, another control period.
    pub fn new(
        plate: &Nameplate,
        inverter: &Inverter,
        shaft: Shaft,
        arithmetic: Arithmetic,
        plant: PlantParams,
        wiring: Wiring,
    ) -> Result<Self, ParamError> {
        let commissioning = SiCommissioning::new(plate, inverter, shaft, arithmetic)?;
        plant.check_period(inverter)?;
        for (field, chance) in [("missed_calls", plant.calls.missed), ("doubled_calls", plant.calls.doubled)] {
            check(field, chance, 0.0, 0.0, "").map_err(|e| e.with_note("a commissioning is called once a period"))?;
        }
        if let Some(Shunt { settling }) = plant.shunt {
            let note = "a commissioning reads the phase currents";
            return Err(ParamError { field: "shunt", value: settling, min: 1.0, max: 0.0, unit: "s", note });
        }
        let mut plant = Plant::new(plant)?;
        let measured = wiring.read(plant.sample());
        let rated_peak = std::f64::consts::SQRT_2 * plate.I_N;
        let pole_pairs = f64::from(plate.n_p());
        Ok(Self { commissioning, plant, wiring, measured, rated_peak, pole_pairs, current: 0.0, turned: 0.0 })
    }

    /// Number of current sensors, 2 or 3, before the first period.
    ///
    /// # Errors
    /// Another number.
    pub fn current_sensors(self, number: u32) -> Result<Self, ParamError> {
        Ok(Self { commissioning: self.commissioning.current_sensors(number)?, ..self })
    }

    /// One procedure alone, before the first period.
    #[must_use]
    pub fn only(self, stage: Stage) -> Self {
        Self { commissioning: self.commissioning.only(stage), ..self }
    }

    /// Advances by a number of control periods; `false` when the commissioning is over.
    pub fn advance(&mut self, periods: u32) -> bool {
        for _ in 0..periods {
            if self.commissioning.status() != Status::Running {
                return false;
            }
            let standstill = self.commissioning.stage() != "inertia";
            let (duty, gates_on) = self.commissioning.step(&self.measured);
            self.measured = self.wiring.read(self.plant.step(duty, gates_on, 0.0));
            let largest = self.plant.phase_currents().iter().fold(0.0f64, |x, i| x.max(i.abs()));
            self.current = self.current.max(largest / self.rated_peak);
            if standstill {
                self.turned = self.turned.max(self.pole_pairs * self.plant.truth().theta_m.abs());
            }
        }
        self.commissioning.status() == Status::Running
    }

    /// The commissioning.
    #[must_use]
    pub fn commissioning(&self) -> &SiCommissioning {
        &self.commissioning
    }

    /// Blocks the gates for good.
    pub fn abort(&mut self) {
        self.commissioning.abort();
    }

    /// Time, s.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.plant.truth().t
    }

    /// Largest phase current so far, relative to the rated peak, and the largest angle by which the shaft has turned in
    /// the procedures at standstill, electrical rad.
    #[must_use]
    pub fn extremes(&self) -> (f64, f64) {
        (self.current, self.turned)
    }
}
