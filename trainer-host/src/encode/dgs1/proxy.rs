//! Makes the proxies of blocks: one Gaussian with the first two moments of those it stands for.

use codec_core::internals::{ids::Level, math::mrp_from_quat, quant::Class, wire::manifest::Proxy};
use nalgebra::{Matrix3, Rotation3, SymmetricEigen, UnitQuaternion, Vector3};

use super::{
    super::{
        decisions::{EpochDecisions, ProxyChange},
        factorise::rotation_matrix,
        packetise::CellSymbols,
    },
    canonical::Canonical,
};
use crate::scene::Epoch;

/// The proxies of an epoch's blocks, clusters in order.
pub(super) fn proxies(epoch: &Epoch, decided: &EpochDecisions, canonical: &Canonical) -> Vec<Proxy> {
    let mut proxies = Vec::new();
    for (cluster, cell) in decided.clusters.iter().zip(&canonical.cells) {
        for block in cluster.gaussians.chunks(cell.shape.block_len.get() as usize) {
            let change = decided.proxy_changes.get(proxies.len()).copied().unwrap_or_default();
            proxies.push(proxy(epoch, block, cell, canonical, change));
        }
    }
    proxies
}

fn proxy(
    epoch: &Epoch,
    block: &[u32],
    cell: &CellSymbols,
    canonical: &Canonical,
    change: ProxyChange,
) -> Proxy {
    let (n, a) = (epoch.count(), epoch.attributes());
    let (p, q) = (a.positions.frame(0, n), a.rotations.frame(0, n));
    let (s, o, c) = (a.log_scales.frame(0, n), a.opacity_logits.frame(0, n), a.sh0.frame(0, n));
    let point = |g: u32| Vector3::from(p[g as usize].map(f64::from));
    // What a Gaussian covers: opacity times the area of its two long axes.
    let area = |sizes: [f64; 3]| {
        let least = sizes.into_iter().fold(f64::INFINITY, f64::min);
        sizes.iter().product::<f64>() / least.max(1e-30)
    };
    let sizes = |g: u32| s[g as usize].map(|s| f64::from(s).exp());
    let alpha = |g: u32| 1.0 / (1.0 + f64::from(-o[g as usize]).exp());
    let weight = |g: u32| (alpha(g) * area(sizes(g))).max(1e-30);
    let total: f64 = block.iter().map(|&g| weight(g)).sum();
    let mean = block.iter().fold(Vector3::zeros(), |sum, &g| sum + point(g) * (weight(g) / total));
    let mut covariance = Matrix3::zeros();
    let mut colour = [0.0f64; 3];
    for &g in block {
        let share = weight(g) / total;
        let turn = rotation_matrix(q[g as usize].map(f64::from));
        let axes = Matrix3::from_diagonal(&Vector3::from(sizes(g).map(|v| v * v)));
        let offset = point(g) - mean;
        covariance += (turn * axes * turn.transpose() + offset * offset.transpose()) * share;
        (0..3).for_each(|d| colour[d] += share * f64::from(c[g as usize][d]));
    }
    let eigen = SymmetricEigen::new(covariance);
    let mut axes = eigen.eigenvectors;
    if axes.determinant() < 0.0 {
        axes.set_column(0, &-axes.column(0));
    }
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let turn = [turn.w, turn.i, turn.j, turn.k].map(|v| v as f32);
    let own: [f64; 3] = std::array::from_fn(|d| eigen.eigenvalues[d].max(1e-30).sqrt());
    let sigma = own.map(|sigma| sigma * f64::from(change.log_scale).exp());

    let record = cell.shape.cluster;
    let step = f64::from(cell.shape.quant.canonical[Class::Position.index()].step(Level::BASE));
    let radius = f64::from(record.radius) * step;
    let centre = [record.centre_x, record.centre_y, record.centre_z];
    let whole = |value: f64, low: f64, high: f64| value.round().clamp(low, high);
    let halvings = |sigma: f64| whole(-2.0 * (sigma / radius).log2(), 0.0, f64::from(Proxy::MAX_SIZE));
    let size = sigma.map(|sigma| halvings(sigma) as u8);
    // Opacity as the area that is left once the size has been rounded; a change of size leaves it.
    let rounded = own.map(|sigma| radius * (-halvings(sigma) / 2.0).exp2());
    let opacity = ((total / area(rounded)).min(1.0) + f64::from(change.opacity)).clamp(0.0, 1.0);
    Proxy {
        offset: std::array::from_fn(|d| {
            let middle = f64::from(canonical.origin[d]) + f64::from(centre[d]) * step;
            let centre = mean[d] + f64::from(change.offset[d]);
            whole((centre - middle) / radius * f64::from(Proxy::OFFSET_UNITS), -128.0, 127.0) as i8
        }),
        size,
        rotation: mrp_from_quat(turn).map(|v| whole(f64::from(v * Proxy::ROTATION_UNITS), -12.0, 12.0) as i8),
        sh0: std::array::from_fn(|d| {
            let colour = colour[d] + f64::from(change.sh0[d]);
            whole(colour * f64::from(Proxy::SH0_UNITS), -128.0, 127.0) as i8
        }),
        opacity: whole(opacity * f64::from(Proxy::OPACITY_UNITS), 0.0, 15.0) as u8,
    }
}

#[cfg(test)]
mod tests {
    use codec_core::{Gaussian, ShDegree};

    use super::*;
    use crate::{
        encode::{Decisions, EncodeOptions, encode, write},
        import::{
            Limits,
            synth::{self, SynthKind},
        },
        scene::{Attributes, Scene, Track},
        stream::Player,
    };

    /// A flat tilted patch of 64 small discs: its proxy lies in the patch, is as wide, as flat and of
    /// its colour; without any packet it is all there is to see.
    #[test]
    fn a_patch_becomes_one_flat_gaussian_in_its_place() {
        let tilt = [(0.4f32).cos(), (0.4f32).sin(), 0.0, 0.0];
        let turn = rotation_matrix(tilt.map(f64::from));
        let positions: Vec<[f32; 3]> = (0..64)
            .map(|i| {
                let flat =
                    Vector3::new(f64::from(i % 8) / 8.0 - 0.4375, f64::from(i / 8) / 8.0 - 0.4375, 0.0);
                let p = turn * flat + Vector3::new(3.0, 1.0, -2.0);
                [p[0] as f32, p[1] as f32, p[2] as f32]
            })
            .collect();
        let attributes = Attributes {
            positions: Track::Constant(positions),
            rotations: Track::Constant(vec![tilt; 64]),
            log_scales: Track::Constant(vec![[-2.8, -2.8, -6.0]; 64]),
            opacity_logits: Track::Constant(vec![3.0; 64]),
            sh0: Track::Constant(vec![[0.5, -0.3, 1.2]; 64]),
            sh_rest: Vec::new(),
            sh_degree: ShDegree::ZERO,
        };
        let scene = Scene::new(vec![Epoch::new(1, attributes).unwrap()], 30.0).unwrap();
        let stream = encode(&scene, &EncodeOptions::default(), &crate::encode::no_progress).unwrap().stream;
        let received = stream.receive().unwrap();
        let content = received.content();
        let none = vec![0u8; content.blocks.len()];
        let mut player = Player::new(content.manifest);
        let shown = player.show(&content.with_state(&none), 0).unwrap();
        let seen: Vec<&Gaussian> = shown.gaussians.iter().filter(|g| g.opacity > 0.0).collect();
        assert_eq!(seen.len(), 1);
        let g = seen[0];
        for (found, wanted) in g.position.iter().zip([3.0, 1.0, -2.0]) {
            assert!((found - wanted).abs() < 0.03, "{:?}", g.position);
        }
        let mut sizes = g.scale;
        sizes.sort_by(f32::total_cmp);
        // 8 × 8 points an eighth apart have a deviation of 0.286.
        assert!(
            sizes[0] < 0.01 && (0.2..0.42).contains(&sizes[1]) && (0.2..0.42).contains(&sizes[2]),
            "{sizes:?}"
        );
        assert!((0.4..=1.0).contains(&g.opacity) && (g.sh0[2] - 1.2).abs() < 0.06, "{g:?}");
    }

    /// Changes move what stands in for a block, and must be as many as there are blocks.
    #[test]
    fn changes_show_and_misfits_are_named() {
        let options =
            synth::SynthOptions { gaussians: 1000, frames: 1, kind: SynthKind::Balls, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let options = EncodeOptions { pictures: 0, ..EncodeOptions::default() };
        let mut decisions = encode(&scene, &options, &crate::encode::no_progress).unwrap().decisions;
        let shown = |decisions: &Decisions| -> Vec<Gaussian> {
            let stream = write(&scene, decisions, &crate::encode::no_progress).unwrap().stream;
            let received = stream.receive().unwrap();
            let content = received.content();
            let none = vec![0u8; content.blocks.len()];
            let mut player = Player::new(content.manifest);
            player.show(&content.with_state(&none), 0).unwrap().gaussians.to_vec()
        };
        let before = shown(&decisions);
        let Decisions::Dgs1(decided) = &mut decisions else { panic!("profile dgs1") };
        let blocks: usize =
            decided.epochs[0].clusters.iter().map(|c| c.gaussians.len().div_ceil(options.block_len)).sum();
        let ln2 = std::f32::consts::LN_2;
        let change = ProxyChange { offset: [0.1, 0.0, 0.0], log_scale: -ln2, opacity: -0.2, sh0: [0.5; 3] };
        decided.epochs[0].proxy_changes = vec![change; blocks];
        let after = shown(&decisions);
        let (mut moved, mut seen) = (0.0, 0);
        for (a, b) in before.iter().zip(&after).filter(|(a, _)| a.opacity > 0.0) {
            assert!((b.scale[0] / a.scale[0] - 0.5).abs() < 1e-4, "{a:?} {b:?}");
            assert!((b.sh0[1] - a.sh0[1] - 0.5).abs() < 1e-4 && (a.opacity - b.opacity - 0.2).abs() < 1e-4);
            moved += b.position[0] - a.position[0];
            seen += 1;
        }
        assert_eq!(seen, blocks);
        assert!((moved / blocks as f32 - 0.1).abs() < 0.02, "{moved}");

        let refused = |change: &dyn Fn(&mut Vec<ProxyChange>)| {
            let mut decisions = decisions.clone();
            if let Decisions::Dgs1(decided) = &mut decisions {
                change(&mut decided.epochs[0].proxy_changes);
            }
            write(&scene, &decisions, &crate::encode::no_progress).unwrap_err().to_string()
        };
        assert!(refused(&|changes| changes.truncate(1)).contains("proxy_changes"));
        assert!(refused(&|changes| changes[1].opacity = f32::NAN).contains("block 1"));
    }
}
