//! Nameplates and self-commissioning.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use stillflux::commission::{Deviation, Nameplate as Plate};

use crate::convert::value_error;
use crate::parameters::machine_dict;

/// What is read from a Python `Nameplate`.
#[derive(FromPyObject)]
pub struct Nameplate {
    P_N: f64,
    U_N: f64,
    I_N: f64,
    f_N: f64,
    n_N: f64,
    cos_phi: f64,
    T_max: Option<f64>,
    J: Option<f64>,
}

impl Nameplate {
    /// As the core has it.
    pub fn plate(&self) -> Plate {
        let Self { P_N, U_N, I_N, f_N, n_N, cos_phi, T_max, J } = *self;
        Plate { P_N, U_N, I_N, f_N, n_N, cos_phi, T_max, J }
    }
}

/// Relative deviations as dict.
pub fn deviation_dict<'py>(py: Python<'py>, d: &Deviation) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (name, value) in [("R_s", d.R_s), ("R_R", d.R_R), ("L_sigma", d.L_sigma), ("L_M", d.L_M), ("J", d.J)] {
        dict.set_item(name, value)?;
    }
    Ok(dict)
}

type Fields<'py> = Bound<'py, PyDict>;

/// Fields of the motor that a nameplate describes, and the relative standard deviation of each parameter.
///
/// Raises ValueError for the first value that no induction machine can have.
#[pyfunction]
pub fn nameplate_motor<'py>(py: Python<'py>, plate: Nameplate) -> PyResult<(Fields<'py>, Fields<'py>)> {
    let (machine, deviation) = plate.plate().machine().map_err(value_error)?;
    Ok((machine_dict(py, &machine)?, deviation_dict(py, &deviation)?))
}
