//! Decodes the `paper` profile's Gaussians: equation 1 exactly, per-frame attributes in four planes.

use glam::Vec3;

use super::cluster::ClusterDecode;
use crate::{
    error::{Error, Result},
    gaussian::Gaussian,
    ids::Level,
    layout::{paper as layout, rest_len},
    math,
    quant::{Class, Quantiser},
    wire::manifest::{Epoch, Manifest},
};

/// The class of each of the 11 attributes with refinements, in storage order.
const CLASSES: [Class; layout::ATTRIBUTES] = {
    use Class::{Opacity, Rotation, Scale, Sh0};
    [Scale, Scale, Scale, Rotation, Rotation, Rotation, Rotation, Opacity, Sh0, Sh0, Sh0]
};
/// Refinements that have planes of their own: level and index.
const FINE: [(Level, usize); 2] = [(Level::ALL[2], 2), (Level::ALL[3], 3)];

/// Dequantises the whole cluster at frame `t` of its epoch with `usable` levels.
pub(super) fn dequantise(part: &mut ClusterDecode<'_, '_>, t: u32, usable: usize) -> Result<()> {
    let n = part.shape.gaussians();
    if usable == 0 {
        part.out.fill(Gaussian::ABSENT);
        part.sh_rest.fill(0.0);
        return Ok(());
    }
    let t = t as usize;
    let mut levels = [&[][..]; Level::COUNT];
    for (symbols, level) in levels.iter_mut().zip(Level::ALL) {
        let (start, len) = (part.shape.range(level, 0..1).0, part.shape.level_len(level));
        let found = part.symbols.get(start..start + len);
        *symbols =
            found.ok_or_else(|| Error::too_small("memory.symbols", part.symbols.len(), start + len))?;
    }
    let frames = part.epoch.frames as usize;
    let cluster = ClusterValues {
        manifest: part.content.manifest,
        epoch: part.epoch,
        canonical: &part.shape.quant.canonical,
        motion: part.shape.quant.motion[Class::Position.index()],
        levels,
        n,
        usable,
        t,
        transform: part.epoch.transform_first as usize + (part.cluster.index() * frames + t) * 12,
    };
    for (i, gaussian) in part.out.iter_mut().enumerate().take(n) {
        *gaussian = cluster.gaussian(i).ok_or_else(|| cluster.short())?;
    }
    if part.rest == 0 {
        return Ok(());
    }
    part.sh_rest.fill(0.0);
    if usable > 1 {
        let step = part.shape.quant.canonical[Class::Sh1.index()].step(Level::ALL[3]);
        let offset = layout::rest(n, frames, usize::from(part.epoch.rank));
        let degree_rest = rest_len(part.shape.cluster.sh_degree());
        for (i, values) in part.sh_rest.chunks_exact_mut(part.rest).enumerate() {
            for (j, value) in values.iter_mut().take(degree_rest).enumerate() {
                *value = cluster.symbol(1, j, offset, i).ok_or_else(|| cluster.short())? * step;
            }
        }
    }
    Ok(())
}

/// What the Gaussians of one cluster at one frame are made of.
struct ClusterValues<'c> {
    manifest: &'c Manifest<'c>,
    epoch: &'c Epoch,
    canonical: &'c [Quantiser; Class::COUNT],
    motion: Quantiser,
    /// Symbols of each level.
    levels: [&'c [i16]; Level::COUNT],
    /// Gaussians of the cluster.
    n: usize,
    /// Usable levels, at least one.
    usable: usize,
    /// Frame of the epoch.
    t: usize,
    /// First value of the cluster's transform at the frame.
    transform: usize,
}

impl ClusterValues<'_> {
    /// Symbol of Gaussian `i` in list `component` of those from `offset` on.
    fn symbol(&self, level: usize, component: usize, offset: usize, i: usize) -> Option<f32> {
        let symbols: &[i16] = self.levels.get(level)?;
        symbols.get(offset + component * self.n + i).copied().map(f32::from)
    }

    /// Some symbol or value of the manifest is not there.
    #[cold]
    fn short(&self) -> Error {
        let symbols = self.levels.iter().map(|symbols| symbols.len()).sum();
        Error::too_small("memory.symbols", symbols, symbols + 1)
    }

    /// Position of Gaussian `i`.
    fn position(&self, i: usize) -> Option<[f32; 3]> {
        let step = self.canonical[Class::Position.index()].step(Level::ALL[3]);
        let canonical = Vec3::new(
            self.epoch.origin_x + self.symbol(0, 0, 0, i)? * step,
            self.epoch.origin_y + self.symbol(0, 1, 0, i)? * step,
            self.epoch.origin_z + self.symbol(0, 2, 0, i)? * step,
        );
        let transform = |i: usize| self.manifest.transform_value(self.transform + i);
        let rank = usize::from(self.epoch.rank);
        let basis = self.epoch.basis_first as usize + self.t * rank;
        let mut position = [0f32; 3];
        for (d, value) in position.iter_mut().enumerate() {
            *value = transform(4 * d)? * canonical.x
                + transform(4 * d + 1)? * canonical.y
                + transform(4 * d + 2)? * canonical.z
                + transform(4 * d + 3)?;
            if self.usable > 1 {
                for r in 0..rank {
                    let q = self.symbol(1, 3 * r + d, 0, i)? * self.motion.step(Level::ALL[1]);
                    *value += self.manifest.paper_basis(basis + r)? * q;
                }
            }
            for (level, index) in FINE {
                if self.usable > index {
                    let offset = self.t * (3 + layout::ATTRIBUTES) * self.n;
                    *value += self.symbol(index, d, offset, i)? * self.motion.step(level);
                }
            }
        }
        Some(position)
    }

    /// Gaussian `i`.
    fn gaussian(&self, i: usize) -> Option<Gaussian> {
        let (n, t, rank) = (self.n, self.t, usize::from(self.epoch.rank));
        let mut attributes = [0f32; layout::ATTRIBUTES];
        for (at, (value, class)) in attributes.iter_mut().zip(CLASSES).enumerate() {
            let quantiser = &self.canonical[class.index()];
            *value = self.symbol(0, 3 + at, 0, i)? * quantiser.step(Level::BASE);
            if self.usable > 1 {
                let offset = layout::refinement1(n, rank) + t * layout::ATTRIBUTES * n;
                *value += self.symbol(1, at, offset, i)? * quantiser.step(Level::ALL[1]);
            }
            for (level, index) in FINE {
                if self.usable > index {
                    let offset = (t * (3 + layout::ATTRIBUTES) + 3) * n;
                    *value += self.symbol(index, at, offset, i)? * quantiser.step(level);
                }
            }
        }
        let [s0, s1, s2, w, x, y, z, opacity, c0, c1, c2] = attributes;
        Some(Gaussian {
            position: self.position(i)?,
            scale: [math::exp(s0), math::exp(s1), math::exp(s2)],
            rotation: math::normalised([w, x, y, z]),
            opacity: opacity.clamp(0.0, 1.0),
            sh0: [c0, c1, c2],
        })
    }
}
