//! Holds one Gaussian before and after it is deformed.

/// A Gaussian as it is before any deformation.
pub struct Canonical<'a> {
    pub position: [f32; 3],
    /// A quaternion of any length.
    pub rotation: [f32; 4],
    pub log_scale: [f32; 3],
    pub opacity_logit: f32,
    pub sh0: [f32; 3],
    pub sh_rest: &'a [f32],
}

impl Canonical<'_> {
    /// All its harmonics, coefficient-major.
    pub fn harmonics(&self) -> Vec<f32> {
        self.sh0.iter().chain(self.sh_rest).copied().collect()
    }
}

/// A Gaussian at one time.
pub struct Deformed {
    pub position: [f32; 3],
    pub rotation: [f32; 4],
    pub log_scale: [f32; 3],
    pub opacity_logit: f32,
    /// All its harmonics, coefficient-major, if they move.
    pub harmonics: Vec<f32>,
}
