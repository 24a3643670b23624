//! Reads named arrays of floats: members of a NumPy archive, or tensors of a safetensors file.

use half::{bf16, f16};
use safetensors::{Dtype, SafeTensors};

use super::{
    Limits,
    archive::Archive,
    bytes::array,
    error::{ErrorKind, Format, ImportError},
    points_npz::npy::Array,
};

/// Most arrays of one name and a number.
const MAX_NUMBERED: usize = 128;

/// An array and its lengths along the axes.
pub(super) struct Tensor {
    pub shape: Vec<usize>,
    /// The values, the last axis first.
    pub values: Vec<f32>,
}

/// Where the arrays are.
enum Source<'a> {
    Npz(Archive<'a>),
    Safetensors(SafeTensors<'a>),
}

/// The arrays of a file.
pub(super) struct Tensors<'a> {
    source: Source<'a>,
    format: Format,
    limits: &'a Limits,
}

/// Whether `bytes` start as a safetensors file does: the length of its JSON, then that.
pub(super) fn is_safetensors(bytes: &[u8]) -> bool {
    let length = array(bytes, 0).map(u64::from_le_bytes);
    length.is_some_and(|length| length < bytes.len() as u64) && bytes.get(8) == Some(&b'{')
}

impl<'a> Tensors<'a> {
    /// Opens a file of either kind, on behalf of `format`.
    ///
    /// # Errors
    /// A file that is damaged, or larger than `limits` allow.
    pub fn open(bytes: &'a [u8], limits: &'a Limits, format: Format) -> Result<Self, ImportError> {
        limits.bytes(format, "file", bytes.len() as u64)?;
        let source = if is_safetensors(bytes) {
            let opened = SafeTensors::deserialize(bytes);
            Source::Safetensors(opened.map_err(|e| format.malformed("safetensors", e, "an undamaged file"))?)
        } else {
            Source::Npz(Archive::new(bytes, limits, format)?)
        };
        Ok(Self { source, format, limits })
    }

    /// Whether there is an array of this name.
    pub fn has(&self, name: &str) -> bool {
        match &self.source {
            Source::Npz(archive) => archive.has(&format!("{name}.npy")),
            Source::Safetensors(file) => file.tensor(name).is_ok(),
        }
    }

    /// One more than the largest number that follows `prefix.` in a name: what is missing below it is missed.
    ///
    /// # Errors
    /// More than any network has.
    pub fn numbered(&self, prefix: &str) -> Result<usize, ImportError> {
        let number = |name: &str| -> Option<usize> {
            let rest = name.strip_prefix(prefix)?.strip_prefix('.')?;
            rest.split('.').next()?.parse().ok()
        };
        let last = match &self.source {
            Source::Npz(archive) => archive.names().filter_map(number).max(),
            Source::Safetensors(file) => file.names().into_iter().filter_map(number).max(),
        };
        let count = last.map_or(0, |last| last.saturating_add(1));
        if count > MAX_NUMBERED {
            let allowed = format_args!("numbers below {MAX_NUMBERED}");
            return Err(self.format.error(ErrorKind::TooLarge, prefix, count - 1, allowed));
        }
        Ok(count)
    }

    /// An array, its shape checked against the limits before its values are read.
    ///
    /// # Errors
    /// No such array, one of other things than numbers, or more than the limits allow.
    pub fn get(&mut self, name: &str) -> Result<Tensor, ImportError> {
        let too_many = |shape: &[usize]| {
            let count = shape.iter().try_fold(4u64, |n, &length| n.checked_mul(length as u64));
            self.limits.bytes(self.format, name, count.unwrap_or(u64::MAX)).map(drop)
        };
        match &mut self.source {
            Source::Npz(archive) => {
                let array = Array::open(archive, name)?;
                let shape = array.shape().to_vec();
                too_many(&shape)?;
                let mut values = Vec::new();
                array.rows(1, |v| values.push(v[0] as f32))?;
                Ok(Tensor { shape, values })
            }
            Source::Safetensors(file) => {
                let malformed = |found: &str, allowed: &str| self.format.malformed(name, found, allowed);
                let view = file.tensor(name).map_err(|_| malformed("nothing", "a tensor of this name"))?;
                too_many(view.shape())?;
                let bytes = view.data();
                let values = match view.dtype() {
                    Dtype::F32 => floats(bytes, f32::from_le_bytes),
                    Dtype::F64 => floats(bytes, |b| f64::from_le_bytes(b) as f32),
                    Dtype::F16 => floats(bytes, |b| f16::from_le_bytes(b).to_f32()),
                    Dtype::BF16 => floats(bytes, |b| bf16::from_le_bytes(b).to_f32()),
                    other => return Err(malformed(&format!("{other:?}"), "F16, BF16, F32 or F64")),
                };
                Ok(Tensor { shape: view.shape().to_vec(), values })
            }
        }
    }

    /// The format that errors name.
    pub fn format(&self) -> Format {
        self.format
    }
}

fn floats<const N: usize>(bytes: &[u8], value: impl Fn([u8; N]) -> f32) -> Vec<f32> {
    bytes.as_chunks::<N>().0.iter().map(|&chunk| value(chunk)).collect()
}

impl Tensor {
    /// Refuses another shape than `allowed`.
    pub fn expect(self, format: Format, name: &str, allowed: &[usize]) -> Result<Self, ImportError> {
        if self.shape == allowed {
            return Ok(self);
        }
        Err(format.malformed(format!("shape of {name}"), format!("{:?}", self.shape), format!("{allowed:?}")))
    }
}
