//! Reads named arrays of floats: members of a NumPy archive, or tensors of a safetensors file.

use half::{bf16, f16};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

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
                let view = tensor(file, name, self.format)?;
                too_many(view.shape())?;
                Ok(Tensor { shape: view.shape().to_vec(), values: values(&view, name, self.format)? })
            }
        }
    }

    /// An array whose values are still to be read, so that its shape can be refused before.
    ///
    /// # Errors
    /// No such array, or one of a kind that is not read.
    pub fn unread<'m>(&'m mut self, name: &'m str) -> Result<Unread<'m, 'a>, ImportError> {
        let format = self.format;
        Ok(match &mut self.source {
            Source::Npz(archive) => Unread::Npz(Box::new(Array::open(archive, name)?)),
            Source::Safetensors(file) => {
                Unread::Safetensors { view: tensor(file, name, format)?, name, format }
            }
        })
    }

    /// The format that errors name.
    pub fn format(&self) -> Format {
        self.format
    }
}

/// An array whose shape is known and whose values have not been read.
pub(super) enum Unread<'m, 'a> {
    /// A member of an archive.
    Npz(Box<Array<'m, 'a>>),
    /// A tensor, and what errors name.
    Safetensors { view: TensorView<'a>, name: &'m str, format: Format },
}

impl Unread<'_, '_> {
    /// Lengths along the axes. The caller accepts them before it asks for values.
    pub fn shape(&self) -> &[usize] {
        match self {
            Self::Npz(array) => array.shape(),
            Self::Safetensors { view, .. } => view.shape(),
        }
    }

    /// Gives every `width` values in a row (at least one) to `take`, the last axis first.
    ///
    /// # Errors
    /// Fewer values than the shape says, values that are no floats, or a damaged member.
    pub fn rows(self, width: usize, mut take: impl FnMut(&[f64])) -> Result<(), ImportError> {
        match self {
            Self::Npz(array) => array.rows(width, take),
            Self::Safetensors { view, name, format } => {
                let mut row = Vec::with_capacity(width);
                for found in values(&view, name, format)?.chunks_exact(width) {
                    row.clear();
                    row.extend(found.iter().map(|&value| f64::from(value)));
                    take(&row);
                }
                Ok(())
            }
        }
    }

    /// The error of a shape that is not `allowed`.
    pub fn misshapen(&self, allowed: &str) -> ImportError {
        match self {
            Self::Npz(array) => array.misshapen(allowed),
            Self::Safetensors { view, name, format } => {
                format.malformed(format!("shape of {name}"), format!("{:?}", view.shape()), allowed)
            }
        }
    }
}

/// The tensor `name` of a file, on behalf of `format`.
fn tensor<'a>(file: &SafeTensors<'a>, name: &str, format: Format) -> Result<TensorView<'a>, ImportError> {
    file.tensor(name).map_err(|_| format.malformed(name, "nothing", "a tensor of this name"))
}

/// The values of tensor `name`, the last axis first.
fn values(view: &TensorView<'_>, name: &str, format: Format) -> Result<Vec<f32>, ImportError> {
    let bytes = view.data();
    Ok(match view.dtype() {
        Dtype::F32 => floats(bytes, f32::from_le_bytes),
        Dtype::F64 => floats(bytes, |b| f64::from_le_bytes(b) as f32),
        Dtype::F16 => floats(bytes, |b| f16::from_le_bytes(b).to_f32()),
        Dtype::BF16 => floats(bytes, |b| bf16::from_le_bytes(b).to_f32()),
        other => return Err(format.malformed(name, format!("{other:?}"), "F16, BF16, F32 or F64")),
    })
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
