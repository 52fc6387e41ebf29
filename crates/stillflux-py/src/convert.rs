//! Conversions shared by the classes.

use std::any::type_name;
use std::error::Error;

use numpy::{Complex64, Element, PyArrayDescrMethods, PyReadonlyArray1, PyUntypedArray};
use pyo3::exceptions::{PyAttributeError, PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyComplex, PyDict, PyFloat, PyFrozenSet, PyList, PySet, PyString, PyTuple};
use stillflux::params::{ParamError, check};
use stillflux::space::{AlphaBeta, Space};

/// An error of core or plant as `ValueError`; that of a parameter names field, value and range.
pub fn value_error(e: impl Error) -> PyErr {
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

/// What a type is, or has as option, to Python.
enum Kind {
    Number,
    /// With its range, where that is not only the type's.
    Whole(Option<(i128, i128)>),
    Truth,
    Text,
    /// Two numbers for each of three legs.
    Legs,
    Other,
}

fn kind_of<T>() -> Kind {
    let name = type_name::<T>();
    let inner = name.strip_prefix("core::option::Option<").and_then(|rest| rest.strip_suffix('>'));
    match inner.unwrap_or(name) {
        "f64" | "num_complex::Complex<f64>" => Kind::Number,
        "i64" => Kind::Whole(Some((i64::MIN.into(), i64::MAX.into()))),
        "u16" => Kind::Whole(Some((0, u16::MAX.into()))),
        "u32" | "usize" => Kind::Whole(None),
        "u64" => Kind::Whole(Some((0, u64::MAX.into()))),
        "bool" => Kind::Truth,
        "alloc::string::String" => Kind::Text,
        "[[f64; 2]; 3]" => Kind::Legs,
        _ => Kind::Other,
    }
}

/// A value as Python writes it, cut where it is long.
fn shown(value: &Bound<'_, PyAny>) -> String {
    const MOST: usize = 80;
    let text = value.repr().map_or_else(|_| value.get_type().to_string(), |repr| repr.to_string());
    if text.chars().count() <= MOST { text } else { text.chars().take(MOST - 1).chain(['…']).collect() }
}

/// A `TypeError` that says what a value is not.
pub fn is_not(name: &str, value: &Bound<'_, PyAny>, what: &str) -> PyErr {
    PyTypeError::new_err(format!("{name} = {} is {what}", shown(value)))
}

/// The error of a value that could not be extracted, by name, value and what it can be.
fn refused<T>(name: &str, value: &Bound<'_, PyAny>, e: &PyErr) -> PyErr {
    let too_large = e.is_instance_of::<PyOverflowError>(value.py());
    match kind_of::<T>() {
        Kind::Number if too_large => {
            PyValueError::new_err(format!("{name} is a whole number beyond the range of a float, 1.8e308"))
        }
        Kind::Number => is_not(name, value, "not a number"),
        Kind::Whole(Some((least, most))) if too_large => PyValueError::new_err(format!(
            "{name} = {} is outside the admissible range {least} to {most}",
            shown(value)
        )),
        Kind::Whole(Some((least, most))) => is_not(name, value, &format!("not a whole number from {least} to {most}")),
        Kind::Whole(None) if too_large => PyValueError::new_err(format!("{name} = {} is not admissible", shown(value))),
        Kind::Whole(None) => is_not(name, value, "not a whole number"),
        Kind::Truth => is_not(name, value, "neither True nor False"),
        Kind::Text => is_not(name, value, "not a text"),
        Kind::Legs => is_not(name, value, "not a pair of numbers for each of three legs"),
        Kind::Other => named(value.py(), name, e),
    }
}

/// Extracts a value, a tuple from a list or an array as well; an error has its name, the value, and what it can be.
pub fn extract<'py, T>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<T>
where
    T: for<'a> FromPyObject<'a, 'py>,
{
    let error = |e: <T as FromPyObject<'_, 'py>>::Error| refused::<T>(name, value, &e.into());
    // Python's truth values are whole numbers; one where a number is meant is a mistake.
    if value.is_instance_of::<PyBool>() && matches!(kind_of::<T>(), Kind::Number | Kind::Whole(..)) {
        return Err(is_not(name, value, "not a number"));
    }
    value.extract().or_else(|_| tuple(value)?.extract().map_err(error))
}

/// An argument with another default than None: what was given, None included, or nothing.
pub struct Given<'py>(Option<Bound<'py, PyAny>>);

impl<'py> Given<'py> {
    /// Nothing was given.
    pub const NOTHING: Self = Self(None);

    /// What was given, or the default.
    pub fn or<T>(&self, name: &str, default: T) -> PyResult<T>
    where
        T: for<'a> FromPyObject<'a, 'py>,
    {
        self.0.as_ref().map_or(Ok(default), |value| extract(name, value))
    }
}

impl<'a, 'py> FromPyObject<'a, 'py> for Given<'py> {
    type Error = PyErr;

    fn extract(value: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        Ok(Self(Some(value.to_owned())))
    }
}

/// Extracts an argument that may be left out.
pub fn extract_some<'py, T>(name: &str, value: Option<&Bound<'py, PyAny>>) -> PyResult<Option<T>>
where
    T: for<'a> FromPyObject<'a, 'py>,
{
    value.map(|value| extract(name, value)).transpose()
}

/// Extracts the fields of a class of the package; what has them not is named.
pub fn fields_of<'py, T>(name: &str, value: &Bound<'py, PyAny>, class: &str) -> PyResult<T>
where
    T: for<'a> FromPyObject<'a, 'py>,
{
    value.extract().map_err(|e: <T as FromPyObject<'_, 'py>>::Error| {
        let e: PyErr = e.into();
        if !e.is_instance_of::<PyAttributeError>(value.py()) {
            return e;
        }
        let hint = match value.extract::<&str>() {
            Ok("2.2kW" | "11kW") => format!(": give {class}.preset({})", shown(value)),
            _ => String::new(),
        };
        is_not(name, value, &format!("not a stillflux.{class}{hint}"))
    })
}

/// Extracts an optional tuple; an error says what its parts are.
pub fn parts<'py, T>(name: &str, value: &Bound<'py, PyAny>, meaning: &str) -> PyResult<Option<T>>
where
    T: for<'a> FromPyObject<'a, 'py>,
{
    let what = || format!("not ({meaning}), nor None");
    tuple(value)?.extract::<Option<T>>().map_err(|_| is_not(name, value, &what()))
}

/// Extracts a tuple; an error says what its parts are.
pub fn all_parts<'py, T>(name: &str, value: &Bound<'py, PyAny>, meaning: &str) -> PyResult<T>
where
    T: for<'a> FromPyObject<'a, 'py>,
{
    tuple(value)?.extract::<T>().map_err(|_| is_not(name, value, &format!("not ({meaning})")))
}

/// Refuses complex numbers where real ones are meant, whose imaginary parts numpy would drop, and masked values, behind which
/// any number may be.
fn real(name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    let kind = value.getattr("dtype").and_then(|d| d.getattr("kind")).and_then(|k| k.extract::<String>());
    if value.is_instance_of::<PyComplex>() || kind.is_ok_and(|kind| kind == "c") {
        return Err(PyTypeError::new_err(format!("{name} is complex, real numbers are needed")));
    }
    // An array or a float itself has no mask.
    let plain = value.is_exact_instance_of::<PyUntypedArray>() || value.is_exact_instance_of::<PyFloat>();
    if !plain && value.hasattr("mask")? {
        let masked = value.py().import("numpy")?.getattr("ma")?.call_method1("is_masked", (value,))?;
        if masked.is_truthy()? {
            return Err(PyValueError::new_err(format!("{name} has masked values, numbers are needed")));
        }
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

/// So many names are listed where one is unknown.
const FEW: usize = 12;

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
            let hint = match nearly(key.py(), &name, known)? {
                hint if hint.is_empty() && known.len() <= FEW => format!("; there are {}", known.join(", ")),
                hint => hint,
            };
            return Err(PyTypeError::new_err(format!("{owner} has no setting '{name}'{hint}")));
        }
    }
    Ok(())
}

/// Parameters that are changed by keywords, as `each_keyword` has them, and checked.
///
/// A whole number that the type of its field cannot hold is outside the range that the core admits, as the type's largest is:
/// the error has that range, which a user can do something with.
pub fn changed<'py, P>(
    mut params: P,
    keywords: Option<&Bound<'py, PyDict>>,
    (owner, known): (&str, &[&str]),
    mut set: impl FnMut(&mut P, &str, &Bound<'py, PyAny>) -> PyResult<bool>,
    validate: impl FnOnce(&P) -> Result<(), ParamError>,
) -> PyResult<P> {
    let mut beyond = None;
    each_keyword(keywords, owner, known, |name, value| {
        let py = value.py();
        let error = match set(&mut params, name, value) {
            Err(e) if e.is_instance_of::<PyValueError>(py) => e,
            done => return done,
        };
        let largest = u32::MAX.into_pyobject(py)?.into_any();
        let (Ok(given), Ok(true)) = (value.extract::<f64>(), set(&mut params, name, &largest)) else {
            return Err(error);
        };
        beyond = Some((name.to_owned(), given, error));
        Ok(true)
    })?;
    match (validate(&params), beyond) {
        (Ok(()), None) => Ok(params),
        (Ok(()), Some((_, _, error))) => Err(error),
        (Err(e), Some((name, given, _))) => Err(value_error(of_given(e, &name, given))),
        (Err(e), None) => Err(value_error(e)),
    }
}

/// An error of the core with the value that was given for a field, which its type could not hold.
fn of_given(e: ParamError, name: &str, value: f64) -> ParamError {
    // "plant encoder_lines" is a field of the plant, beside one of the drive.
    if e.field.rsplit(' ').next() == Some(name) { ParamError { value, ..e } } else { e }
}

/// Hands a count to the core, whose error has the count as it was given.
pub fn counted<T>(
    name: &str,
    value: &Bound<'_, PyAny>,
    hand: impl FnOnce(u32) -> Result<T, ParamError>,
) -> PyResult<T> {
    let count = match extract(name, value) {
        Err(e) if e.is_instance_of::<PyValueError>(value.py()) => u32::MAX,
        count => count?,
    };
    let given = value.extract().unwrap_or(f64::INFINITY);
    hand(count).map_err(|e| value_error(of_given(e, name, given)))
}

/// Three phase values from a numpy array or any iterable of numbers.
pub fn three(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    let wrong =
        |n: usize| PyValueError::new_err(format!("{name} has {n} values, three are needed, those of the phases"));
    let no_three = || is_not(name, value, "not three numbers");
    real(name, value)?;
    if let Ok(array) = value.extract::<PyReadonlyArray1<'_, f64>>() {
        let array = array.as_array();
        return array.iter().copied().collect::<Vec<_>>().try_into().map_err(|v: Vec<f64>| wrong(v.len()));
    }
    let shape = value.getattr_opt("shape")?.and_then(|shape| shape.cast_into::<PyTuple>().ok());
    if let Some(shape) = shape.filter(|shape| shape.len() != 1) {
        return Err(PyValueError::new_err(format!("{name} has the shape {shape}, three numbers are needed")));
    }
    // The characters of a text are no numbers, and a set or the keys of a mapping have no order of phases.
    if value.is_instance_of::<PyString>()
        || value.is_instance_of::<PyBytes>()
        || value.is_instance_of::<PySet>()
        || value.is_instance_of::<PyFrozenSet>()
        || value.is_instance_of::<PyDict>()
    {
        return Err(no_three());
    }
    let items = value.try_iter().map_err(|_| no_three())?;
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
    if value.is_instance_of::<PyBool>() || value.is_instance_of::<PyString>() {
        return Err(is_not(name, value, "neither a complex space vector nor three numbers"));
    }
    match value.extract::<Complex64>() {
        Ok(o) => Ok(AlphaBeta::new(o.re, o.im).to_phases()),
        Err(_) if value.len().is_ok_and(|n| n == 2) => Err(PyValueError::new_err(format!(
            "{name} has 2 values, three are needed, those of the phases, or one complex number, the space vector"
        ))),
        Err(_) => three(name, value),
    }
}

/// A space vector as complex number.
pub fn complex(v: [f64; 2]) -> Complex64 {
    Complex64::new(v[0], v[1])
}

/// Quantities by name, as Python writes numbers of six digits: `psi_s=0.1-0.2j, omega_m=3`.
pub fn fields(complex: &[(&str, Complex64)], real: &[(&str, f64)]) -> String {
    let complex = complex.iter().map(|(name, z)| format!("{name}={}{}j", digits(z.re, false), digits(z.im, true)));
    let real = real.iter().map(|(name, x)| format!("{name}={}", digits(*x, false)));
    complex.chain(real).collect::<Vec<_>>().join(", ")
}

/// The same quantities as the arguments of a constructor that takes them in this order, for pickle.
pub fn arguments<'py>(py: Python<'py>, complex: &[Complex64], real: &[f64]) -> PyResult<Bound<'py, PyTuple>> {
    let complex = complex.iter().map(|z| PyComplex::from_doubles(py, z.re, z.im).into_any());
    let real = real.iter().map(|x| PyFloat::new(py, *x).into_any());
    PyTuple::new(py, complex.chain(real).collect::<Vec<_>>())
}

/// Six digits of a number, with a sign of plus if wanted.
fn digits(x: f64, plus: bool) -> String {
    if !x.is_finite() {
        return if plus { format!("{x:+}") } else { x.to_string() };
    }
    let rounded: f64 = format!("{x:.5e}").parse().unwrap_or(x);
    // No sign of a zero, and no long rows of zeros.
    let rounded = rounded + 0.0;
    let small = rounded != 0.0 && !(1e-4..1e16).contains(&rounded.abs());
    match (small, plus) {
        (true, true) => format!("{rounded:+e}"),
        (true, false) => format!("{rounded:e}"),
        (false, true) => format!("{rounded:+}"),
        (false, false) => rounded.to_string(),
    }
}

/// A complex number as space vector.
pub fn pair(z: Complex64) -> [f64; 2] {
    [z.re, z.im]
}

/// A space vector of the core as complex number, times its base.
pub fn scaled<F>(v: &Space<f64, F>, base: f64) -> Complex64 {
    Complex64::new(v.re() * base, v.im() * base)
}
