//! The `paper` profile's Gaussians: equation 1 exactly, per-frame attributes in four planes.

use glam::Vec3;

use super::{Part, lacking};
use crate::{
    error::Result,
    gaussian::Gaussian,
    ids::Level,
    layout::{paper as layout, rest_len},
    math,
    quant::Class,
};

/// Classes of the 11 attributes with refinements, in storage order, with their components.
const ATTRIBUTES: [(Class, usize); 4] =
    [(Class::Scale, 3), (Class::Rotation, 4), (Class::Opacity, 1), (Class::Sh0, 3)];

/// Dequantises the whole cluster at frame `t` of its epoch with `usable` levels.
pub(super) fn dequantise(part: &mut Part<'_, '_>, t: u32, usable: usize) -> Result<()> {
    let n = part.shape.gaussians();
    if usable == 0 {
        part.out.fill(Gaussian::ABSENT);
        part.sh_rest.fill(0.0);
        return Ok(());
    }
    let (frames, t) = (part.epoch.frames as usize, t as usize);
    let rank = usize::from(part.epoch.rank);
    let degree_rest = rest_len(part.shape.cluster.sh_degree());
    let mut levels = [&[][..]; Level::COUNT];
    for (symbols, level) in levels.iter_mut().zip(Level::ALL) {
        let (start, len) = (part.shape.range(level, 0..1).0, part.shape.level_len(level));
        let found = part.symbols.get(start..start + len);
        *symbols = found.ok_or_else(|| lacking("memory.symbols", part.symbols.len(), start + len))?;
    }
    let symbol = |level: usize, component: usize, offset: usize, i: usize| -> f32 {
        levels[level].get(offset + component * n + i).copied().map_or(0.0, f32::from)
    };
    let manifest = &part.content.manifest;
    let quant = &part.shape.quant;
    let transform_at = part.epoch.transform_first as usize + (part.cluster.index() * frames + t) * 12;
    let transform = |i: usize| manifest.transform_value(transform_at + i);
    let basis_at = part.epoch.basis_first as usize + t * rank;
    let motion = quant.motion[Class::Position.index()];
    let position_step = quant.canonical[Class::Position.index()].step(Level::ALL[3]);
    let delta_at = |plane: usize| plane * n;
    for (i, gaussian) in part.out.iter_mut().enumerate().take(n) {
        let canonical = Vec3::new(
            part.epoch.origin_x + symbol(0, 0, 0, i) * position_step,
            part.epoch.origin_y + symbol(0, 1, 0, i) * position_step,
            part.epoch.origin_z + symbol(0, 2, 0, i) * position_step,
        );
        let mut position = [0f32; 3];
        for (d, value) in position.iter_mut().enumerate() {
            *value = transform(4 * d) * canonical.x
                + transform(4 * d + 1) * canonical.y
                + transform(4 * d + 2) * canonical.z
                + transform(4 * d + 3);
            if usable > 1 {
                for r in 0..rank {
                    let q = symbol(1, 3 * r + d, 0, i) * motion.step(Level::ALL[1]);
                    *value += manifest.paper_basis(basis_at + r) * q;
                }
            }
            for level in [2usize, 3] {
                if usable > level {
                    let offset = delta_at(t * (3 + layout::ATTRIBUTES));
                    *value += symbol(level, d, offset, i) * motion.step(Level::ALL[level]);
                }
            }
        }
        let mut attributes = [0f32; layout::ATTRIBUTES];
        let mut at = 0;
        for (class, components) in ATTRIBUTES {
            let quantiser = quant.canonical[class.index()];
            for _ in 0..components {
                let mut value = symbol(0, 3 + at, 0, i) * quantiser.step(Level::BASE);
                if usable > 1 {
                    let offset = layout::refinement1(n, rank) + t * layout::ATTRIBUTES * n;
                    value += symbol(1, at, offset, i) * quantiser.step(Level::ALL[1]);
                }
                for level in [2usize, 3] {
                    if usable > level {
                        let offset = delta_at(t * (3 + layout::ATTRIBUTES) + 3);
                        value += symbol(level, at, offset, i) * quantiser.step(Level::ALL[level]);
                    }
                }
                if let Some(attribute) = attributes.get_mut(at) {
                    *attribute = value;
                }
                at += 1;
            }
        }
        let [s0, s1, s2, w, x, y, z, opacity, c0, c1, c2] = attributes;
        *gaussian = Gaussian {
            position,
            scale: [math::exp(s0), math::exp(s1), math::exp(s2)],
            rotation: math::normalised([w, x, y, z]),
            opacity: opacity.clamp(0.0, 1.0),
            sh0: [c0, c1, c2],
        };
    }
    let rest = part.rest;
    if rest > 0 {
        part.sh_rest.fill(0.0);
        if usable > 1 {
            let step = quant.canonical[Class::Sh1.index()].step(Level::ALL[3]);
            let offset = layout::rest(n, frames, rank);
            for (i, values) in part.sh_rest.chunks_exact_mut(rest).enumerate() {
                for (j, value) in values.iter_mut().take(degree_rest).enumerate() {
                    *value = symbol(1, j, offset, i) * step;
                }
            }
        }
    }
    Ok(())
}
