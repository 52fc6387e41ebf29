//! `RecordEstimator`: the estimators of both schemes over recorded signals, for `stillflux.replay`.

use numpy::{Complex64, PyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use stillflux::params::check;
use stillflux_sim::replay::{Estimates, Replay, Row, Start};

use crate::convert::{Given, complex, finite, finite_parts, interrupt, pair, record, value_error};
use crate::parameters::{drive_params, inverter_of, machine_of};

/// Estimators of a scheme over records whose rows are one control period of the inverter apart.
///
/// Takes motor, inverter and settings as `Drive` does.
#[pyclass(module = "stillflux._core")]
pub struct RecordEstimator {
    replay: Replay,
}

macro_rules! columns {
    ($py:expr, $rows:expr; complex: $($z:ident),* ; real: $($x:ident),*) => {{
        let dict = PyDict::new($py);
        $(dict.set_item(
            stringify!($z),
            PyArray1::from_vec($py, $rows.iter().map(|e| complex(e.$z)).collect::<Vec<_>>()),
        )?;)*
        $(dict.set_item(stringify!($x), PyArray1::from_vec($py, $rows.iter().map(|e| e.$x).collect::<Vec<_>>()))?;)*
        dict
    }};
}

#[pymethods]
impl RecordEstimator {
    #[new]
    #[pyo3(
        signature = (motor, inverter, scheme=Given::NOTHING, **settings),
        text_signature = "(motor, inverter, scheme='enhanced', **settings)"
    )]
    fn new(
        motor: &Bound<'_, PyAny>,
        inverter: &Bound<'_, PyAny>,
        scheme: Given<'_>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (machine, inverter) = (machine_of("motor", motor)?, inverter_of("inverter", inverter)?);
        let scheme = scheme.or("scheme", "enhanced".to_owned())?;
        let params = drive_params(&machine, &inverter, &scheme, settings)?;
        Ok(Self { replay: Replay::new(&machine, &inverter, &params).map_err(value_error)? })
    }

    /// Begins at the first row and runs over all; what was identified before stays.
    ///
    /// Parameters
    /// ----------
    /// u_s, i_s
    ///     Voltage in V (mean over the interval that ends at the row) and current in A, complex, shape (n,).
    /// i_sum, u_dc, psi_ref
    ///     Sum of the phase currents in A, dc-link voltage in V, flux reference in V·s, shape (n,).
    /// psi_s0
    ///     Stator flux at the first row, V·s.
    /// deviation
    ///     Standard deviation of each of its components, V·s; 0: a machine without flux.
    /// settled
    ///     The flux is that of a direct current along the a-axis in a machine at rest.
    /// omega_m
    ///     Speed at the first row, mechanical rad/s.
    /// R_s
    ///     Resistance for the scheme "paper", Ω; None: that of the parameters.
    ///
    /// Returns the estimates after each row by name. Raises ValueError for lengths that differ and values that are not
    /// finite, KeyboardInterrupt within some tenths of a second of Ctrl-C: start again then.
    #[pyo3(signature = (u_s, i_s, i_sum, u_dc, psi_ref, psi_s0, deviation, omega_m, settled=false, R_s=None))]
    #[allow(clippy::too_many_arguments)]
    fn run<'py>(
        &mut self,
        py: Python<'py>,
        u_s: &Bound<'_, PyAny>,
        i_s: &Bound<'_, PyAny>,
        i_sum: &Bound<'_, PyAny>,
        u_dc: &Bound<'_, PyAny>,
        psi_ref: &Bound<'_, PyAny>,
        psi_s0: Complex64,
        deviation: f64,
        omega_m: f64,
        settled: bool,
        R_s: Option<f64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (u_s, i_s) = (record::<Complex64>("u_s", u_s)?, record::<Complex64>("i_s", i_s)?);
        let real = |name, x| record::<f64>(name, x);
        let (i_sum, u_dc, psi_ref) = (real("i_sum", i_sum)?, real("u_dc", u_dc)?, real("psi_ref", psi_ref)?);
        let (u, i, sum) = (u_s.as_array(), i_s.as_array(), i_sum.as_array());
        let (u_dc, psi_ref) = (u_dc.as_array(), psi_ref.as_array());
        let n = u.len();
        for (name, len) in [("i_s", i.len()), ("i_sum", sum.len()), ("u_dc", u_dc.len()), ("psi_ref", psi_ref.len())] {
            if len != n {
                return Err(PyValueError::new_err(format!("{name} has {len} rows, u_s has {n}")));
            }
        }
        let rows: Vec<Row> = (0..n)
            .map(|k| Row { u_s: pair(u[k]), i_s: pair(i[k]), i_sum: sum[k], u_dc: u_dc[k], psi_ref: psi_ref[k] })
            .collect();
        let is_finite = |r: &Row| {
            let [a, b] = r.u_s;
            let [c, d] = r.i_s;
            [a, b, c, d, r.i_sum, r.u_dc, r.psi_ref].iter().all(|x| x.is_finite())
        };
        if let Some(k) = rows.iter().position(|r| !is_finite(r)) {
            return Err(PyValueError::new_err(format!("row {k} is not finite: {:?}", rows[k])));
        }
        check("deviation", deviation, 0.0, 1e9, "V s").map_err(value_error)?;
        check("R_s", R_s.unwrap_or(1.0), 1e-9, 1e9, "ohm").map_err(value_error)?;
        let start = Start {
            psi_s: finite_parts("psi_s0", psi_s0)?,
            deviation,
            settled,
            omega_m: finite("omega_m", omega_m)?,
            R_s,
        };
        let replay = &mut self.replay;
        let found = py.detach(|| -> PyResult<Vec<Estimates>> {
            let mut found = Vec::with_capacity(n);
            for (k, row) in rows.iter().enumerate() {
                interrupt(k)?;
                if k == 0 {
                    replay.start(&start, row);
                } else {
                    replay.step(row);
                }
                found.push(replay.estimates());
            }
            Ok(found)
        })?;
        Ok(columns!(
            py, found;
            complex: psi_s, psi_r, i_s, u_s, u_off;
            real: omega_m, omega_s, torque, R_s, confidence, angle_deviation, nis
        ))
    }
}
