//! Reads arrays of numbers as Python programs hold them, and gives arrays back.
//!
//! The rule for what comes in: whatever `numpy.asarray` takes (arrays of any strides, tensors on the
//! processor, lists), of floating-point numbers; other widths than 32 bits are converted, integers and
//! everything else are refused. Values are copied once.

use numpy::{IxDyn, PyArrayDyn, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods, get_array_module};
use pyo3::prelude::*;

use crate::error::refused;

/// The numbers of an array in C order.
pub struct Numbers<T> {
    /// Its name in messages.
    pub field: &'static str,
    /// Its lengths, outermost first.
    pub shape: Vec<usize>,
    /// As many values as the lengths multiply to.
    pub values: Vec<T>,
}

/// Types of numbers that arrays are converted to.
pub trait Width: numpy::Element + Copy {
    /// What numpy calls it.
    const NAME: &'static str;
    /// Kinds of numpy types that are converted.
    const KINDS: &'static str;
    /// Whether it is neither infinite nor not a number.
    fn is_finite(self) -> bool;
    /// Whether it is a number at all.
    fn is_number(self) -> bool;
}

impl Width for f32 {
    const NAME: &'static str = "float32";
    const KINDS: &'static str = "f";

    fn is_finite(self) -> bool {
        self.is_finite()
    }

    fn is_number(self) -> bool {
        !self.is_nan()
    }
}

/// Cameras are in whole numbers as often as not.
impl Width for f64 {
    const NAME: &'static str = "float64";
    const KINDS: &'static str = "fiu";

    fn is_finite(self) -> bool {
        self.is_finite()
    }

    fn is_number(self) -> bool {
        !self.is_nan()
    }
}

impl<T: Width> Numbers<T> {
    /// The numbers of `value`, all finite.
    pub fn read(field: &'static str, value: &Bound<'_, PyAny>) -> PyResult<Self> {
        Self::read_where(field, value, "finite numbers", T::is_finite)
    }

    /// The numbers of `value`, infinite ones too.
    pub fn read_unbounded(field: &'static str, value: &Bound<'_, PyAny>) -> PyResult<Self> {
        Self::read_where(field, value, "numbers", T::is_number)
    }

    fn read_where(
        field: &'static str,
        value: &Bound<'_, PyAny>,
        allowed: &str,
        is_allowed: fn(T) -> bool,
    ) -> PyResult<Self> {
        let array = get_array_module(value.py())?.call_method1("asarray", (value,))?;
        let untyped = array.cast::<PyUntypedArray>()?;
        let kind: String = untyped.dtype().getattr("kind")?.extract()?;
        if !T::KINDS.contains(&kind) {
            let found = untyped.dtype();
            return Err(refused(format!("{field}: found dtype {found}; float32 or float64 are wanted")));
        }
        let array = array.call_method1("astype", (T::NAME,))?.cast_into::<PyArrayDyn<T>>()?;
        let array = array.try_readonly().map_err(refused)?;
        let shape = array.shape().to_vec();
        let values: Vec<T> = array.as_array().iter().copied().collect();
        match values.iter().position(|&v| !is_allowed(v)) {
            None => Ok(Self { field, shape, values }),
            Some(at) => {
                let at = place(&shape, at);
                Err(refused(format!("{field}: a value at {at:?} is inf or nan; {allowed} are wanted")))
            }
        }
    }

    /// Refuses the array as one of another shape than `wanted`.
    pub fn misshapen(&self, wanted: impl std::fmt::Display) -> PyErr {
        refused(format!("{}: found shape {:?}; {wanted} is wanted", self.field, self.shape))
    }

    /// The values in rows of `N`.
    pub fn rows<const N: usize>(&self) -> Vec<[T; N]> {
        self.values.as_chunks::<N>().0.to_vec()
    }

    /// Refuses the first value that is not `allowed`, said as `wanted`.
    pub fn check(&self, wanted: &str, allowed: impl Fn(T) -> bool) -> PyResult<()>
    where
        T: std::fmt::Display,
    {
        let Some(at) = self.values.iter().position(|&v| !allowed(v)) else { return Ok(()) };
        let (found, at) = (self.values[at], place(&self.shape, at));
        Err(refused(format!("{}: found {found} at {at:?}; {wanted} are wanted", self.field)))
    }
}

/// The place of value `at`, counted in C order, in an array of `shape`.
fn place(shape: &[usize], mut at: usize) -> Vec<usize> {
    let mut place: Vec<usize> = shape
        .iter()
        .rev()
        .map(|&length| {
            let here = at % length.max(1);
            at /= length.max(1);
            here
        })
        .collect();
    place.reverse();
    place
}

/// `values` as an array of `shape`.
pub fn array<'py, T: numpy::Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    numpy::PyArray1::from_vec(py, values).reshape(IxDyn(shape))
}
