//! The decoded Gaussian: what a decode yields and a renderer takes.

use bytemuck::{Pod, Zeroable};

/// One renderable Gaussian at one instant.
///
/// All fields are in the domain a renderer uses directly: `scale` and `opacity` are linear, the
/// rotation is a unit quaternion. Higher spherical-harmonic bands travel beside this struct in a
/// separate slice, because most scenes have none.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(C)]
pub struct Gaussian {
    /// Centre in world space, scene units (metres where the scene is metric).
    pub position: [f32; 3],
    /// Standard deviations along the three local axes, scene units, > 0.
    pub scale: [f32; 3],
    /// Unit quaternion, wxyz, local axes to world.
    pub rotation: [f32; 4],
    /// Peak opacity in 0..=1. Zero means absent: nothing of it is drawn.
    pub opacity: f32,
    /// Spherical-harmonic band 0 (`f_dc`): display colour is `0.5 + 0.28209479 * sh0`.
    pub sh0: [f32; 3],
}

impl Gaussian {
    /// The value a missing Gaussian decodes to: nothing of it is drawn.
    pub const ABSENT: Self = Self {
        position: [0.0; 3],
        scale: [1.0; 3],
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity: 0.0,
        sh0: [0.0; 3],
    };

    /// True when nothing of this Gaussian is drawn.
    pub fn is_absent(&self) -> bool {
        self.opacity <= 0.0
    }
}

/// Spherical-harmonic degree, 0..=3.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ShDegree(u8);

impl ShDegree {
    /// View-independent colour only.
    pub const ZERO: Self = Self(0);
    /// The highest degree this codec carries.
    pub const MAX: Self = Self(3);

    /// `degree` in 0..=3, or `None`.
    pub const fn new(degree: u8) -> Option<Self> {
        if degree <= 3 { Some(Self(degree)) } else { None }
    }

    /// The degree as a number, 0..=3.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// Coefficients per Gaussian above band 0, all three channels: 0, 9, 24 or 45.
    ///
    /// Layout of the separate slice: Gaussian-major, then coefficient, then channel (r, g, b).
    pub const fn rest_len(self) -> usize {
        let d = self.0 as usize;
        ((d + 1) * (d + 1) - 1) * 3
    }
}
