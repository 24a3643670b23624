//! Quantises canonical values to their finest indices, which levels and orders are made from.

use codec_core::internals::{
    ids::Level,
    math::mrp_from_quat,
    quant::{Class, Quantiser, decorrelate},
    wire::manifest::Quant,
};

use crate::scene::{Epoch, activation::sigmoid};

/// Finest indices of a cluster: per class and component, one per Gaussian.
pub(in crate::encode) type Indices = [Vec<Vec<i32>>; Class::COUNT];

/// The finest indices of `members` under `quant`, positions counted from `origin`.
pub(in crate::encode) fn indices(epoch: &Epoch, members: &[u32], quant: &Quant, origin: [f32; 3]) -> Indices {
    let (n, a) = (epoch.count(), epoch.attributes());
    let (p, q) = (a.positions.frame(0, n), a.rotations.frame(0, n));
    let (s, o, c) = (a.log_scales.frame(0, n), a.opacity_logits.frame(0, n), a.sh0.frame(0, n));
    let rest = a.sh_degree.rest_len();
    let plain = |class: Class, component: usize, i: usize| -> f32 {
        match class {
            Class::Position => p[i][component] - origin[component],
            Class::Scale => s[i][component],
            Class::Rotation => mrp_from_quat(q[i])[component],
            Class::Opacity => sigmoid(o[i]),
            Class::Sh0 => c[i][component],
            Class::Sh1 => a.sh_rest[i * rest + component],
            Class::Sh2 => a.sh_rest[i * rest + 9 + component],
            Class::Sh3 => a.sh_rest[i * rest + 24 + component],
        }
    };
    let value = |class: Class, component: usize, i: usize| -> f32 {
        if !quant.canonical[class.index()].decorrelated() {
            return plain(class, component, i);
        }
        let first = component / 3 * 3;
        decorrelate([0, 1, 2].map(|k| plain(class, first + k, i)))[component % 3]
    };
    Class::ALL.map(|class| {
        if class.sh_degree() > a.sh_degree.get() {
            return Vec::new();
        }
        let quantiser = quant.canonical[class.index()];
        (0..class.components())
            .map(|d| members.iter().map(|&i| quantiser.index(value(class, d, i as usize))).collect())
            .collect()
    })
}

/// First-level index and refinements of finest index `q`.
pub(super) fn split(quantiser: &Quantiser, class: Class, q: i32) -> [i32; Level::COUNT] {
    quantiser.split(q, class.first_level())
}

/// Bits of the finest indices of one component, block by block: the logarithm of their mean distance from
/// the block's mean, which a distribution of any one shape costs up to a constant.
pub(in crate::encode) fn spread_bits(indices: &[i32], block_len: usize) -> f64 {
    let block = |block: &[i32]| {
        let n = block.len() as f64;
        let mean = block.iter().map(|&q| f64::from(q)).sum::<f64>() / n;
        let distance = block.iter().map(|&q| (f64::from(q) - mean).abs()).sum::<f64>() / n;
        n * (1.0 + 2.0 * distance).log2()
    };
    indices.chunks(block_len).map(block).sum()
}
