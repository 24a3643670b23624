//! Says what is wrong with a camera or a file of cameras: which field, where, what was found, what is
//! allowed.

/// A camera, or a file of cameras, that cannot be rendered from.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// A number is NaN, infinite or out of range.
    #[error("{field} is {}; {} to {} is allowed", short(*.found), short(*.low), short(*.high))]
    Range {
        /// Which number.
        field: &'static str,
        /// Its value.
        found: f64,
        /// Smallest allowed.
        low: f64,
        /// Largest allowed.
        high: f64,
    },
    /// The rotation has columns that are not unit, not orthogonal, or mirror.
    #[error("rotation differs from an orthonormal right-handed one by {found:.3e}; 1e-3 is allowed")]
    Rotation {
        /// Largest entry of |R·Rᵀ − I|, or of the determinant's difference from 1.
        found: f64,
    },
    /// `K` has entries a pinhole camera does not: skew, or a last row other than 0 0 1.
    #[error("K[{row}][{column}] is {found}; a pinhole camera has {allowed} there")]
    Matrix {
        /// Row of the entry.
        row: usize,
        /// Column of the entry.
        column: usize,
        /// Its value.
        found: f64,
        /// The value it must have.
        allowed: f64,
    },
    /// The last row of a 4×4 matrix is not 0 0 0 1: the matrix may be transposed.
    #[error("{matrix}[3][{column}] is {found}; {allowed} is allowed there: the matrix may be transposed")]
    LastRow {
        /// Which matrix.
        matrix: &'static str,
        /// Column of the entry.
        column: usize,
        /// Its value.
        found: f64,
        /// The value it must have.
        allowed: f64,
    },
    /// The eye is at the target, or `up` points along the view.
    #[error("look_at: {0} has no direction")]
    Direction(&'static str),
    /// The text is not the JSON it should be.
    #[error("line {line}, column {column}: {message}")]
    Json {
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What the parser found.
        message: String,
    },
    /// The bytes end inside a field.
    #[error("{field} at byte {offset}: {found} bytes left, {needed} needed")]
    Short {
        /// Which field.
        field: &'static str,
        /// Byte offset at which it starts.
        offset: usize,
        /// Bytes left from there.
        found: usize,
        /// Bytes needed.
        needed: u64,
    },
    /// A field holds a value that is not allowed there.
    #[error("{field} at byte {offset} is {found}; {allowed} is allowed")]
    Field {
        /// Which field.
        field: &'static str,
        /// Byte offset at which it starts.
        offset: usize,
        /// Its value.
        found: u64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// A line of text holds something that is not allowed there.
    #[error("line {line}: {field} is {found:?}; {allowed} is allowed")]
    Line {
        /// Line, from 1.
        line: usize,
        /// Which field.
        field: &'static str,
        /// What stands there; nothing where the line has ended.
        found: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// A lens that bends straight lines. Renderers here do not: images are to be undistorted first.
    #[error(
        "camera {camera} has model {model}{}; {allowed} is allowed: undistort the images first",
        shown(.values)
    )]
    Distorted {
        /// The camera, as the file names it.
        camera: String,
        /// Name of the model.
        model: String,
        /// Its distortion parameters, where they are known.
        values: Vec<f64>,
        /// What is allowed.
        allowed: &'static str,
    },
    /// Neither the file nor the caller says how large the images are.
    #[error("the file has no w and h: the width and height of its images must be given")]
    SizeUnknown,
    /// Nothing says how long the lens is.
    #[error("no focal length: camera_angle_x, camera_angle_y, fl_x or fl_y is needed")]
    FocalLengthUnknown,
    /// An error about one camera of many.
    #[error("{name}: {source}")]
    Of {
        /// Name of the image, as the file gives it.
        name: String,
        /// What is wrong with it.
        source: Box<CameraError>,
    },
}

/// `value` without a digit after digit of zeros: with an exponent where it is very large or very small.
fn short(value: f64) -> String {
    let is_plain = value == 0.0 || !value.is_finite() || (1e-5..1e7).contains(&value.abs());
    if is_plain { value.to_string() } else { format!("{value:e}") }
}

fn shown(values: &[f64]) -> String {
    if values.is_empty() { String::new() } else { format!(" with distortion {values:?}") }
}

impl CameraError {
    pub(super) fn of(self, name: &str) -> Self {
        Self::Of { name: name.to_owned(), source: Box::new(self) }
    }
}

impl CameraError {
    /// What [`CameraError::Direction`] names where the view is along the direction that is to be up.
    pub const ALONG_UP: &'static str = "up across the view";
}
