//! The stand-in for a block whose base is missing: one Gaussian, so that a loss thins a picture and
//! does not blank it.
//!
//! A proxy travels with the manifest, in 13 bytes relative to its cluster. Fields lie in planes, all
//! blocks' first bytes, then all second ones, so that like follows like and packs well.

use crate::{gaussian::Gaussian, math, wire::manifest::Cluster};

/// One block's proxy as it is sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Proxy {
    /// Centre from the cluster's, in 1/96 of its radius.
    pub offset: [i8; 3],
    /// Standard deviations as halvings of the cluster's radius, in half steps: 2^(−v/2).
    pub size: [u8; 3],
    /// Modified Rodrigues parameters in 1/12.
    pub rotation: [i8; 3],
    /// Band-0 colour in 1/10.
    pub sh0: [i8; 3],
    /// Opacity in 1/15; more counts as 1.
    pub opacity: u8,
}

impl Proxy {
    /// Bytes of one proxy, one in each plane.
    pub const BYTES: usize = 13;
    /// Units per radius of [`Proxy::offset`].
    pub const OFFSET_UNITS: f32 = 96.0;
    /// Units per one of [`Proxy::rotation`].
    pub const ROTATION_UNITS: f32 = 12.0;
    /// Units per one of [`Proxy::sh0`].
    pub const SH0_UNITS: f32 = 10.0;
    /// Units per one of [`Proxy::opacity`].
    pub const OPACITY_UNITS: f32 = 15.0;
    /// Largest [`Proxy::size`] that is told from smaller ones.
    pub const MAX_SIZE: u8 = 60;

    /// From one byte of each plane.
    pub const fn from_bytes(b: [u8; Self::BYTES]) -> Self {
        Self {
            offset: [b[0] as i8, b[1] as i8, b[2] as i8],
            size: [b[3], b[4], b[5]],
            rotation: [b[6] as i8, b[7] as i8, b[8] as i8],
            sh0: [b[9] as i8, b[10] as i8, b[11] as i8],
            opacity: b[12],
        }
    }

    /// One byte for each plane.
    pub const fn to_bytes(&self) -> [u8; Self::BYTES] {
        let Self { offset: o, size: s, rotation: r, sh0: c, opacity } = *self;
        [
            o[0] as u8, o[1] as u8, o[2] as u8, s[0], s[1], s[2], r[0] as u8, r[1] as u8, r[2] as u8,
            c[0] as u8, c[1] as u8, c[2] as u8, opacity,
        ]
    }

    /// The Gaussian: `origin` is the epoch's, `step` that of the cluster's positions at level 0.
    pub fn gaussian(&self, cluster: &Cluster, origin: [f32; 3], step: f32) -> Gaussian {
        let radius = f32::from(cluster.radius) * step;
        let centre = [cluster.centre_x, cluster.centre_y, cluster.centre_z];
        let mut position = [0f32; 3];
        for (d, value) in position.iter_mut().enumerate() {
            let middle = origin[d] + f32::from(centre[d]) * step;
            *value = middle + f32::from(self.offset[d]) * (radius / Self::OFFSET_UNITS);
        }
        let scale = self.size.map(|size| {
            let size = size.min(Self::MAX_SIZE);
            // Exact powers of two; the half step is one factor.
            let whole = f32::from_bits((127 - u32::from(size / 2)) << 23);
            radius * whole * if size % 2 == 1 { core::f32::consts::FRAC_1_SQRT_2 } else { 1.0 }
        });
        let rotation = self.rotation.map(|v| f32::from(v) / Self::ROTATION_UNITS);
        Gaussian {
            position,
            scale: scale.map(|s| s.clamp(1e-36, 1e35)),
            rotation: math::normalised(math::quat_from_mrp(rotation)),
            opacity: (f32::from(self.opacity) / Self::OPACITY_UNITS).min(1.0),
            sh0: self.sh0.map(|v| f32::from(v) / Self::SH0_UNITS),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_round_trip_and_mean_what_they_say() {
        let proxy = Proxy {
            offset: [-128, 0, 96],
            size: [0, 3, 255],
            rotation: [12, -3, 0],
            sh0: [-17, 0, 127],
            opacity: 200,
        };
        assert_eq!(Proxy::from_bytes(proxy.to_bytes()), proxy);
        let cluster = Cluster { centre_x: 10, radius: 8, ..Cluster::default() };
        let g = proxy.gaussian(&cluster, [1.0, 2.0, 3.0], 0.5);
        assert_eq!(g.position, [6.0 - 128.0 * (4.0 / 96.0), 2.0, 7.0]);
        assert_eq!((g.scale[0], g.opacity, g.sh0[0]), (4.0, 1.0, -1.7));
        assert!((g.scale[1] - 4.0 * 0.125f32.sqrt()).abs() < 1e-6 && g.scale[2] > 0.0);
        let length: f32 = g.rotation.iter().map(|v| v * v).sum();
        assert!((length - 1.0).abs() < 1e-6);
    }
}
