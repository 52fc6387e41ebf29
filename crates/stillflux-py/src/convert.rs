//! Conversions shared by the classes.

use std::any::type_name;

use numpy::{Complex64, Element, PyArrayDescrMethods, PyReadonlyArray1};
use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyComplex, PyDict, PyList, PyTuple};
use stillflux::params::{ParamError, check};
use stillflux::space::{AlphaBeta, Space};

/// A parameter error as `ValueError`; its text names field, value and range.
pub fn value_error(e: ParamError) -> PyErr {
    PyValueError::new_err(e.to_string())
}

/// Ctrl-C, looked for in every 2^16th row of a loop that has released the GIL.
pub fn interrupt(row: usize) -> PyResult<()> {
    if row.is_multiple_of(1 << 16) { Python::attach(|py| py.check_signals()) } else { Ok(()) }
}

/// Admits a finite number.
pub fn finite(field: &'static str, value: f64) -> PyResult<f64> {
    check(field, value, -1e9, 1e9, "").map_err(value_error)?;
    Ok(value)
}

/// Admits a complex number whose parts are finite.
pub fn finite_parts(field: &'static str, z: Complex64) -> PyResult<[f64; 2]> {
    Ok([finite(field, z.re)?, finite(field, z.im)?])
}

/// Puts the name of what was being converted in front of an error.
pub fn named(py: Python<'_>, name: &str, e: &PyErr) -> PyErr {
    PyErr::from_type(e.get_type(py), format!("{name}: {}", e.value(py)))
}

/// A list or an array as tuple, for what is one; anything else as it is.
fn tuple<'py>(value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let several = value.is_instance_of::<PyList>() || value.hasattr("__array__")?;
    match value.try_iter() {
        Ok(items) if several => Ok(PyTuple::new(value.py(), items.collect::<PyResult<Vec<_>>>()?)?.into_any()),
        _ => Ok(value.clone()),
    }
}

/// Range of the whole number that a type is or has as option.
fn range_of<T>() -> Option<(i128, i128)> {
    let name = type_name::<T>();
    let holds = |kind: &str| name == kind || name.ends_with(&format!("<{kind}>"));
    let unsigned =
        [("u16", u16::MAX.into()), ("u32", u32::MAX.into()), ("u64", u64::MAX.into()), ("usize", usize::MAX as i128)];
    if holds("i64") {
        return Some((i64::MIN.into(), i64::MAX.into()));
    }
    unsigned.into_iter().find(|(kind, _)| holds(kind)).map(|(_, most)| (0, most))
}

/// Extracts a value, a tuple from a list or an array as well; an error names it, and the range of a whole number that does
/// not fit.
pub fn extract<'py, T>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<T>
where
    T: for<'a> FromPyObject<'a, 'py>,
{
    let error = |e: <T as FromPyObject<'_, 'py>>::Error| {
        let e: PyErr = e.into();
        match range_of::<T>() {
            Some((least, most)) if e.is_instance_of::<PyOverflowError>(value.py()) => {
                PyValueError::new_err(format!("{name} = {value} is outside the admissible range {least} to {most}"))
            }
            _ => named(value.py(), name, &e),
        }
    };
    // Python's truth values are whole numbers; one where a number is meant is a mistake.
    if value.is_instance_of::<PyBool>() && is_number::<T>() {
        return Err(PyTypeError::new_err(format!("{name} = {value} is not a number")));
    }
    value.extract().or_else(|_| tuple(value)?.extract().map_err(error))
}

/// Whether a type is a number or has one as option.
fn is_number<T>() -> bool {
    range_of::<T>().is_some() || type_name::<T>().trim_end_matches('>').ends_with("f64")
}

/// Extracts an optional tuple; an error says what its parts are.
pub fn parts<'py, T>(name: &str, value: &Bound<'py, PyAny>, meaning: &str) -> PyResult<Option<T>>
where
    T: for<'a> FromPyObject<'a, 'py>,
{
    let wrong = |_| PyTypeError::new_err(format!("{name} = {value} is not ({meaning}), nor None"));
    tuple(value)?.extract::<Option<T>>().map_err(|e: <Option<T> as FromPyObject<'_, 'py>>::Error| wrong(e.into()))
}

/// Refuses complex numbers where real ones are meant: numpy would drop their imaginary parts.
fn real(name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    let kind = value.getattr("dtype").and_then(|d| d.getattr("kind")).and_then(|k| k.extract::<String>());
    if value.is_instance_of::<PyComplex>() || kind.is_ok_and(|kind| kind == "c") {
        return Err(PyTypeError::new_err(format!("{name} is complex, real numbers are needed")));
    }
    Ok(())
}

/// A record of one number a sample, from an array or a sequence of numbers.
pub fn record<'py, T>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<PyReadonlyArray1<'py, T>>
where
    T: Element,
{
    let py = value.py();
    let dtype = T::get_dtype(py);
    if dtype.kind() == b'f' {
        real(name, value)?;
    }
    let array = py.import("numpy")?.call_method1("asarray", (value, dtype)).map_err(|e| named(py, name, &e))?;
    let wrong = || PyTypeError::new_err(format!("{name} is not an array of one dimension"));
    array.extract().map_err(|_| wrong())
}

/// What of `known` is spelt nearly so, as the end of a message.
fn nearly(py: Python<'_>, name: &str, known: &[&str]) -> PyResult<String> {
    let close: Vec<String> =
        py.import("difflib")?.call_method1("get_close_matches", (name, known.to_vec(), 1))?.extract()?;
    Ok(close.first().map_or_else(String::new, |found| format!("; '{found}'?")))
}

/// Calls `set` for every keyword; a name for which it returns `false` is a `TypeError` that says so, and what of `known` it
/// may be.
pub fn each_keyword<'py>(
    keywords: Option<&Bound<'py, PyDict>>,
    owner: &str,
    known: &[&str],
    mut set: impl FnMut(&str, &Bound<'py, PyAny>) -> PyResult<bool>,
) -> PyResult<()> {
    for (key, value) in keywords.into_iter().flatten() {
        let name: String = key.extract()?;
        if !set(&name, &value)? {
            let hint = nearly(key.py(), &name, known)?;
            return Err(PyTypeError::new_err(format!("{owner} has no setting '{name}'{hint}")));
        }
    }
    Ok(())
}

/// Three phase values from a numpy array or any iterable of numbers.
pub fn three(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    let wrong = |n: usize| PyValueError::new_err(format!("{name} has {n} values, three are needed"));
    real(name, value)?;
    if let Ok(array) = value.extract::<PyReadonlyArray1<'_, f64>>() {
        let array = array.as_array();
        return array.iter().copied().collect::<Vec<_>>().try_into().map_err(|v: Vec<f64>| wrong(v.len()));
    }
    let items = value.try_iter().map_err(|_| PyTypeError::new_err(format!("{name} = {value} is not three numbers")))?;
    let number = |x: PyResult<Bound<'_, PyAny>>| {
        let x = x?;
        real(name, &x)?;
        extract(name, &x)
    };
    let items: Vec<f64> = items.map(number).collect::<PyResult<_>>()?;
    items.try_into().map_err(|v: Vec<f64>| wrong(v.len()))
}

/// Offsets of three channels, given as such or as complex space vector.
pub fn offsets(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    match value.extract::<Complex64>() {
        Ok(o) => Ok(AlphaBeta::new(o.re, o.im).to_phases()),
        Err(_) => three(name, value),
    }
}

/// A space vector as complex number.
pub fn complex(v: [f64; 2]) -> Complex64 {
    Complex64::new(v[0], v[1])
}

/// A complex number as space vector.
pub fn pair(z: Complex64) -> [f64; 2] {
    [z.re, z.im]
}

/// A space vector of the core as complex number, times its base.
pub fn scaled<F>(v: &Space<f64, F>, base: f64) -> Complex64 {
    Complex64::new(v.re() * base, v.im() * base)
}
