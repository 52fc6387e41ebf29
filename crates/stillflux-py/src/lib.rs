//! `stillflux._core`: the Rust core and plant behind Python objects.
//!
//! Thin: converts, validates, releases the GIL. Documentation of what a user calls stands in the stub
//! `_core.pyi` and in the docstrings here; everything is SI, space vectors are complex and
//! amplitude-invariant.
#![forbid(unsafe_code)]
#![allow(non_snake_case)]

mod commission;
mod convert;
mod drive;
mod flux;
mod parameters;
mod plant;
mod replay;
mod run;

use pyo3::prelude::*;

/// The compiled part of stillflux.
#[pymodule(name = "_core")]
mod core_module {
    #[pymodule_export]
    use crate::commission::{CommissioningCore, CommissioningRun, nameplate_motor, nameplate_of, priors};
    #[pymodule_export]
    use crate::drive::{Drive, Estimate, Status, StatusWarning};
    #[pymodule_export]
    use crate::flux::{FluxEstimator, Trace};
    #[pymodule_export]
    use crate::parameters::{
        base, from_gamma, from_t_model, inverter_preset, motor_preset, to_gamma, to_t_model, validate_inverter,
        validate_motor,
    };
    #[pymodule_export]
    use crate::plant::{Plant, PlantState, at_slip_frequency};
    #[pymodule_export]
    use crate::replay::RecordEstimator;
    #[pymodule_export]
    use crate::run::{Run, signals};

    /// Current at which a commissioning blocks the gates, of the rated peak.
    #[pymodule_export]
    const COMMISSIONING_TRIP: f64 = stillflux::commission::TRIP;
}
