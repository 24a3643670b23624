//! Canonical attributes of a block: nested indices to values.

use super::{
    cluster::{ClusterDecode, cut},
    column::{Column, Runs, SPAN, Values, carrying_levels, each, triple},
};
use crate::{
    error::{Error, Result},
    gaussian::Gaussian,
    ids::Level,
    math,
    quant::{Class, recorrelate},
    wire::manifest::{Cluster, Epoch},
};

/// Dequantises block `block` at its `usable` levels into the canonical cache; without any, its first
/// Gaussian is the block's proxy and the others are absent.
pub(super) fn dequantise(part: &mut ClusterDecode<'_, '_>, block: usize, usable: u8) -> Result<()> {
    let n = part.shape.block_gaussians(block);
    let first = part.shape.first_of(block);
    let Some(level) = usable.checked_sub(1).and_then(Level::new) else {
        let out = cut("decode.canonical", part.canonical, first..first + n)?;
        out.fill(Gaussian::ABSENT);
        let proxy = part.content.manifest.proxy(part.cell.blocks as usize + block)?;
        if let Some((first, proxy)) = out.first_mut().zip(proxy) {
            let step = part.shape.quant.canonical[Class::Position.index()].step(Level::BASE);
            let Epoch { origin_x, origin_y, origin_z, .. } = *part.epoch;
            *first = proxy.gaussian(&part.shape.cluster, [origin_x, origin_y, origin_z], step);
        }
        return Ok(());
    };
    let mut runs = Runs::of(part.shape, part.symbols, block, level)?;
    for class in [Class::Position, Class::Scale, Class::Rotation, Class::Opacity, Class::Sh0] {
        let quantiser = part.shape.quant.canonical[class.index()];
        let carries = carrying_levels(part.shape, class);
        let Cluster { centre_x, centre_y, centre_z, .. } = part.shape.cluster;
        let Epoch { origin_x, origin_y, origin_z, .. } = *part.epoch;
        let (starts, origins) = match class {
            Class::Position => ([centre_x, centre_y, centre_z], [origin_x, origin_y, origin_z]),
            _ => ([0; 3], [0.0; 3]),
        };
        let mut columns = [const { None }; 3];
        for ((column, start), _) in columns.iter_mut().zip(starts).zip(0..class.components()) {
            *column = Some(Column::new(runs.next(carries)?, quantiser, Level::BASE, level, start));
        }
        let step = quantiser.step(level);
        let out = cut("decode.canonical", part.canonical, first..first + n)?;
        for out in out.chunks_mut(SPAN) {
            let mut values = [[0f32; SPAN]; 3];
            for ((values, column), origin) in values.iter_mut().zip(&mut columns).zip(origins) {
                let Some(column) = column else { continue };
                for (value, q) in values.iter_mut().zip(column.take()) {
                    *value = origin + q as f32 * step;
                }
            }
            put(class, quantiser.decorrelated(), &mut values, out);
        }
    }
    Ok(())
}

/// The attribute that `values` of `class` stand for, to `out`.
#[inline(never)]
fn put(class: Class, decorrelated: bool, values: &mut Values, out: &mut [Gaussian]) {
    if decorrelated && class.decorrelates() {
        let [a, b, c] = &mut *values;
        for ((a, b), c) in a.iter_mut().zip(b).zip(c) {
            [*a, *b, *c] = recorrelate([*a, *b, *c]);
        }
    }
    match class {
        Class::Opacity => {
            let [opacities, ..] = values;
            for (gaussian, opacity) in out.iter_mut().zip(opacities) {
                gaussian.opacity = opacity.clamp(0.0, 1.0);
            }
            return;
        }
        Class::Rotation => {
            let mut w = [0.0; SPAN];
            let [x, y, z] = &mut *values;
            for (((w, x), y), z) in w.iter_mut().zip(&mut *x).zip(&mut *y).zip(&mut *z) {
                [*w, *x, *y, *z] = math::quat_from_mrp([*x, *y, *z]);
            }
            math::normalise([&mut w, x, y, z]);
            for (gaussian, w) in out.iter_mut().zip(w) {
                gaussian.rotation[0] = w;
            }
        }
        Class::Scale => math::exp_all(values.as_flattened_mut()),
        _ => {}
    }
    each(values, out, |gaussian, values| *triple(gaussian, class) = values);
}

/// Writes the higher bands of block `block` to the output; bands not there are zero.
pub(super) fn rest(part: &mut ClusterDecode<'_, '_>, block: usize, usable: u8) -> Result<()> {
    let n = part.shape.block_gaussians(block);
    let first = part.shape.first_of(block);
    let rest = part.rest;
    let out = cut("decode.sh_rest", part.sh_rest, first * rest..(first + n) * rest)?;
    out.fill(0.0);
    let Some(level) = usable.checked_sub(1).and_then(Level::new) else { return Ok(()) };
    let mut runs = Runs::of(part.shape, part.symbols, block, level)?;
    let mut offset = 0;
    for class in Class::ALL {
        let (components, carries) = (class.components(), carrying_levels(part.shape, class));
        let quantiser = part.shape.quant.canonical[class.index()];
        let step = quantiser.step(level);
        let is_here = class.first_level() > Level::BASE && class.first_level() <= level;
        let is_here = is_here && carries[class.first_level().index()];
        if is_here && offset + components > rest {
            return Err(Error::too_small("decode.sh_rest", rest, offset + components));
        }
        for component in 0..components {
            let runs = runs.next(carries)?;
            if !is_here {
                continue;
            }
            let mut column = Column::new(runs, quantiser, class.first_level(), level, 0);
            for out in out.chunks_mut(SPAN * rest) {
                let values = out.iter_mut().skip(offset + component).step_by(rest);
                for (value, q) in values.zip(column.take()) {
                    *value = q as f32 * step;
                }
            }
        }
        if is_here && quantiser.decorrelated() {
            for values in out.chunks_exact_mut(rest) {
                let values = cut("decode.sh_rest", values, offset..offset + components)?;
                values.as_chunks_mut::<3>().0.iter_mut().for_each(|triple| *triple = recorrelate(*triple));
            }
        }
        if class.sh_degree() > 0 {
            offset += components;
        }
    }
    Ok(())
}
