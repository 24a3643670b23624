//! Canonical attributes of a block: nested indices to values.

use super::Part;
use crate::{
    gaussian::Gaussian,
    ids::Level,
    limits::MAX_BLOCK_LEN,
    math,
    quant::{Class, unmix},
    wire::manifest::Epoch,
};

/// Dequantises block `block` at its `usable` levels into the canonical cache; without any, its first
/// Gaussian is the block's proxy and the others are absent.
pub(super) fn dequantise(part: &mut Part<'_, '_>, block: usize, usable: u8) {
    let n = part.shape.block_gaussians(block);
    let first = block * part.shape.block_len;
    let Some(level) = usable.checked_sub(1).and_then(Level::new) else {
        if let Some(out) = part.canonical.get_mut(first..first + n) {
            out.fill(Gaussian::ABSENT);
            let proxy = part.content.manifest.proxy(part.cell.blocks as usize + block);
            if let Some((first, proxy)) = out.first_mut().zip(proxy) {
                let step = part.shape.quant.canonical[Class::Position.index()].step(Level::BASE);
                let Epoch { origin_x, origin_y, origin_z, .. } = *part.epoch;
                *first = proxy.gaussian(&part.shape.cluster, [origin_x, origin_y, origin_z], step);
            }
        }
        return;
    };
    let mut indices = [0i32; MAX_BLOCK_LEN];
    for class in [Class::Position, Class::Scale, Class::Rotation, Class::Opacity, Class::Sh0] {
        let step = part.shape.quant.canonical[class.index()].step(level);
        for component in 0..class.components() {
            let Some(indices) = indices.get_mut(..n) else { return };
            nested(part, block, class, component, level, indices);
            let origin = match (class, component) {
                (Class::Position, 0) => part.epoch.origin_x,
                (Class::Position, 1) => part.epoch.origin_y,
                (Class::Position, _) => part.epoch.origin_z,
                _ => 0.0,
            };
            let out = part.canonical.get_mut(first..first + n).unwrap_or(&mut []);
            // No class here has more than three components.
            let axis = component.min(2);
            for (gaussian, &q) in out.iter_mut().zip(indices.iter()) {
                let value = origin + q as f32 * step;
                match class {
                    Class::Position => gaussian.position[axis] = value,
                    Class::Scale => gaussian.scale[axis] = value,
                    Class::Rotation => gaussian.rotation[axis + 1] = value,
                    Class::Opacity => gaussian.opacity = value.clamp(0.0, 1.0),
                    _ => gaussian.sh0[axis] = value,
                }
            }
        }
    }
    let quant = &part.shape.quant.canonical;
    let mixed = [Class::Scale, Class::Sh0].map(|class| quant[class.index()].mixed());
    for gaussian in part.canonical.get_mut(first..first + n).unwrap_or(&mut []) {
        if mixed[0] {
            gaussian.scale = unmix(gaussian.scale);
        }
        gaussian.scale = gaussian.scale.map(math::exp);
        if mixed[1] {
            gaussian.sh0 = unmix(gaussian.sh0);
        }
        let [_, x, y, z] = gaussian.rotation;
        gaussian.rotation = math::normalised(math::quat_from_mrp([x, y, z]));
    }
}

/// Writes the higher bands of block `block` to the output; bands not there are zero.
pub(super) fn rest(part: &mut Part<'_, '_>, block: usize, usable: u8) {
    let n = part.shape.block_gaussians(block);
    let first = block * part.shape.block_len;
    let rest = part.rest;
    let Some(out) = part.sh_rest.get_mut(first * rest..(first + n) * rest) else { return };
    out.fill(0.0);
    let Some(level) = usable.checked_sub(1).and_then(Level::new) else { return };
    let mut indices = [0i32; MAX_BLOCK_LEN];
    let mut offset = 0;
    for class in [Class::Sh1, Class::Sh2, Class::Sh3] {
        let components = class.components();
        if part.shape.carries(class, class.first_level()) && class.first_level() <= level {
            let quantiser = part.shape.quant.canonical[class.index()];
            let step = quantiser.step(level);
            for component in 0..components {
                let Some(indices) = indices.get_mut(..n) else { return };
                nested(part, block, class, component, level, indices);
                let out = part.sh_rest.get_mut(first * rest..(first + n) * rest).unwrap_or(&mut []);
                for (values, &q) in out.chunks_exact_mut(rest).zip(indices.iter()) {
                    if let Some(value) = values.get_mut(offset + component) {
                        *value = q as f32 * step;
                    }
                }
            }
            let out = part.sh_rest.get_mut(first * rest..(first + n) * rest).unwrap_or(&mut []);
            for values in out.chunks_exact_mut(rest).filter(|_| quantiser.mixed()) {
                let values = values.get_mut(offset..offset + components).unwrap_or(&mut []);
                values.as_chunks_mut::<3>().0.iter_mut().for_each(|triple| *triple = unmix(*triple));
            }
        }
        offset += components;
    }
}

/// Indices of one component of a block at `level`: prediction undone, then refined upwards.
fn nested(
    part: &Part<'_, '_>,
    block: usize,
    class: Class,
    component: usize,
    level: Level,
    indices: &mut [i32],
) {
    let symbols = part.symbols();
    let shape = part.shape;
    let quantiser = shape.quant.canonical[class.index()];
    let centre = shape.cluster;
    let start = match (class, component) {
        (Class::Position, 0) => centre.centre_x,
        (Class::Position, 1) => centre.centre_y,
        (Class::Position, _) => centre.centre_z,
        _ => 0,
    };
    let n = indices.len();
    for l in Level::ALL.into_iter().take(level.index() + 1) {
        if l < class.first_level() {
            continue;
        }
        if !shape.carries(class, l) {
            indices.iter_mut().for_each(|q| *q = quantiser.refine(*q, 0, l));
            continue;
        }
        // Symbols of this level before the component: whole blocks, then classes in order.
        let (at, _) = shape.range(l, block..block + 1);
        let earlier: usize = shape.components(l).take_while(|&(c, ..)| c != class).map(|(.., d)| d).sum();
        let from = at + (earlier + component) * n;
        let run = symbols.get(from..from + n).unwrap_or(&[]);
        if l == class.first_level() {
            let mut previous = i32::from(start);
            for (q, &symbol) in indices.iter_mut().zip(run) {
                *q = i32::from(symbol).saturating_add(previous);
                if quantiser.predicted() {
                    previous = *q;
                }
            }
        } else {
            for (q, &symbol) in indices.iter_mut().zip(run) {
                *q = quantiser.refine(*q, symbol, l);
            }
        }
    }
}
