//! Writes 3DGS PLY, which every splat viewer reads. Lossless: 32-bit floats in the scene's own domains.
//!
//! Properties in the usual order, without normals; `f_rest_*` channel-major, as the format has it.

use crate::scene::Epoch;

/// Frame `t` of `epoch` as a binary little-endian PLY. `t` must be below the epoch's frame count.
pub fn encode(epoch: &Epoch, t: usize) -> Vec<u8> {
    let (n, a) = (epoch.count(), epoch.attributes());
    let rest = a.sh_degree.rest_len();
    let mut names: Vec<String> = ["x", "y", "z"].map(String::from).into();
    let numbered =
        |prefix: &str, count: usize| (0..count).map(|i| format!("{prefix}_{i}")).collect::<Vec<_>>();
    names.extend(numbered("f_dc", 3));
    names.extend(numbered("f_rest", rest));
    names.push("opacity".to_owned());
    names.extend(numbered("scale", 3));
    names.extend(numbered("rot", 4));
    let mut head = format!("ply\nformat binary_little_endian 1.0\nelement vertex {n}\n");
    for name in &names {
        head += &format!("property float {name}\n");
    }
    head += "end_header\n";

    let mut out = head.into_bytes();
    out.reserve(n * names.len() * 4);
    let (p, q) = (a.positions.frame(t, n), a.rotations.frame(t, n));
    let (s, o, c) = (a.log_scales.frame(t, n), a.opacity_logits.frame(t, n), a.sh0.frame(t, n));
    for i in 0..n {
        let bands = &a.sh_rest[i * rest..(i + 1) * rest];
        let channels = (0..3).flat_map(|channel| bands.iter().skip(channel).step_by(3));
        let row = p[i].iter().chain(&c[i]).chain(channels).chain([&o[i]]).chain(&s[i]).chain(&q[i]);
        out.extend(row.flat_map(|v| v.to_le_bytes()));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::import::{self, Identity, ImportOptions, Limits, synth};

    #[test]
    fn a_sequence_reads_back_as_the_same_epoch() {
        let make = synth::SynthOptions { gaussians: 1_000, frames: 5, ..synth::SynthOptions::default() };
        let scene = synth::make(&make, &Limits::default()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        for t in 0..5 {
            std::fs::write(folder.path().join(format!("ball_{t}.ply")), encode(&scene.epochs()[0], t))
                .unwrap();
        }
        let options = ImportOptions { identity: Identity::Stored, ..ImportOptions::default() };
        let back = import::import(folder.path(), &options).unwrap();
        // Rotations are normalised again on entry, which may move their last bit.
        let (a, b) = (scene.epochs()[0].attributes(), back.epochs()[0].attributes());
        assert_eq!((&a.positions, &a.log_scales, &a.sh0), (&b.positions, &b.log_scales, &b.sh0));
        for t in 0..5 {
            for (x, y) in a.rotations.frame(t, 1_000).iter().zip(b.rotations.frame(t, 1_000)) {
                assert!(x.iter().zip(y).all(|(x, y)| (x - y).abs() < 1e-6));
            }
        }
    }

    #[test]
    fn harmonics_keep_their_order() {
        use codec_core::ShDegree;
        let degree = ShDegree::new(2).unwrap();
        let epoch = crate::Epoch::new(
            1,
            crate::Attributes {
                positions: crate::Track::Constant(vec![[1.0, 2.0, 3.0]]),
                rotations: crate::Track::Constant(vec![[1.0, 0.0, 0.0, 0.0]]),
                log_scales: crate::Track::Constant(vec![[-1.0; 3]]),
                opacity_logits: crate::Track::Constant(vec![0.5]),
                sh0: crate::Track::Constant(vec![[0.1, 0.2, 0.3]]),
                sh_rest: (0..24).map(|i| i as f32).collect(),
                sh_degree: degree,
            },
        )
        .unwrap();
        let back = import::ply::parse(&encode(&epoch, 0), &Limits::default()).unwrap();
        assert_eq!(back.epoch, epoch);
    }
}
