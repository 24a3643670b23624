//! Canonical attributes of a block: nested indices to values.

use super::{
    Part,
    column::{Column, Runs, SPAN, Values, carried, each, rows},
};
use crate::{
    gaussian::Gaussian,
    ids::Level,
    math,
    quant::{Class, unmix},
    wire::manifest::{Cluster, Epoch},
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
    let mut runs = Runs::of(part.shape, part.symbols(), block, level);
    for class in [Class::Position, Class::Scale, Class::Rotation, Class::Opacity, Class::Sh0] {
        let quantiser = part.shape.quant.canonical[class.index()];
        let carries = carried(part.shape, class);
        let Cluster { centre_x, centre_y, centre_z, .. } = part.shape.cluster;
        let Epoch { origin_x, origin_y, origin_z, .. } = *part.epoch;
        let (starts, origins) = match class {
            Class::Position => ([centre_x, centre_y, centre_z], [origin_x, origin_y, origin_z]),
            _ => ([0; 3], [0.0; 3]),
        };
        let mut columns = [const { None }; 3];
        for ((column, start), _) in columns.iter_mut().zip(starts).zip(0..class.components()) {
            *column = Some(Column::new(runs.next(carries), quantiser, Level::BASE, level, start));
        }
        let step = quantiser.step(level);
        let out = part.canonical.get_mut(first..first + n).unwrap_or(&mut []);
        for out in out.chunks_mut(SPAN) {
            let mut values = [[0f32; SPAN]; 3];
            for ((values, column), origin) in values.iter_mut().zip(&mut columns).zip(origins) {
                let Some(column) = column else { continue };
                for (value, q) in values.iter_mut().zip(column.take()) {
                    *value = origin + q as f32 * step;
                }
            }
            put(class, class.mixes() && quantiser.mixed(), values, out);
        }
    }
}

/// The attribute that `values` of `class` stand for, to `out`.
fn put(class: Class, mixed: bool, mut values: Values<3>, out: &mut [Gaussian]) {
    if mixed {
        let [a, b, c] = &mut values;
        for ((a, b), c) in a.iter_mut().zip(b).zip(c) {
            [*a, *b, *c] = unmix([*a, *b, *c]);
        }
    }
    match class {
        Class::Position => each(&values, out, |gaussian, position| gaussian.position = position),
        Class::Scale => {
            for value in values.as_flattened_mut() {
                *value = math::exp(*value);
            }
            each(&values, out, |gaussian, scale| gaussian.scale = scale);
        }
        Class::Rotation => {
            let mut turns = [[0.0; SPAN]; 4];
            for (i, [x, y, z]) in rows(&values).enumerate() {
                let turn = math::quat_from_mrp([x, y, z]);
                turns.iter_mut().zip(turn).for_each(|(turns, value)| turns[i] = value);
            }
            math::normalise(&mut turns);
            each(&turns, out, |gaussian, rotation| gaussian.rotation = rotation);
        }
        Class::Opacity => {
            each(&values, out, |gaussian, [value, ..]| gaussian.opacity = value.clamp(0.0, 1.0));
        }
        _ => each(&values, out, |gaussian, sh0| gaussian.sh0 = sh0),
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
    let mut runs = Runs::of(part.shape, part.symbols(), block, level);
    let mut offset = 0;
    for class in Class::ALL {
        let (components, carries) = (class.components(), carried(part.shape, class));
        let quantiser = part.shape.quant.canonical[class.index()];
        let step = quantiser.step(level);
        let is_here = class.first_level() > Level::BASE && class.first_level() <= level;
        let is_here = is_here && carries[class.first_level().index()];
        for component in 0..components {
            let runs = runs.next(carries);
            if !is_here {
                continue;
            }
            let mut column = Column::new(runs, quantiser, class.first_level(), level, 0);
            let out = part.sh_rest.get_mut(first * rest..(first + n) * rest).unwrap_or(&mut []);
            for out in out.chunks_mut(SPAN * rest) {
                for (values, q) in out.chunks_exact_mut(rest).zip(column.take()) {
                    if let Some(value) = values.get_mut(offset + component) {
                        *value = q as f32 * step;
                    }
                }
            }
        }
        if is_here && quantiser.mixed() {
            let out = part.sh_rest.get_mut(first * rest..(first + n) * rest).unwrap_or(&mut []);
            for values in out.chunks_exact_mut(rest) {
                let values = values.get_mut(offset..offset + components).unwrap_or(&mut []);
                values.as_chunks_mut::<3>().0.iter_mut().for_each(|triple| *triple = unmix(*triple));
            }
        }
        if class.sh_degree() > 0 {
            offset += components;
        }
    }
}
