//! Positions of profile `paper` against the paper's equation 1 in binary64, term for term:
//! position = A(cluster, frame) · canonical + Σ basis(frame, r) · q(r) + δ₂(frame) + δ₃(frame).

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test's helpers fail like tests")]

#[allow(dead_code, reason = "the tests of golden streams use the rest")]
#[path = "conformance/session.rs"]
mod session;

use std::path::Path;

use session::{Received, Session, parts, unpacked};

/// Largest difference to binary64, scene units, in scenes of a few units.
const TOLERANCE: f64 = 2e-6;

fn u16_at(bytes: &[u8], at: usize) -> usize {
    usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]))
}

fn u32_at(bytes: &[u8], at: usize) -> usize {
    u16_at(bytes, at) | u16_at(bytes, at + 2) << 16
}

fn f32_at(bytes: &[u8], at: usize) -> f64 {
    f64::from(f32::from_bits(u32_at(bytes, at) as u32))
}

/// One epoch's manifest and symbols, by the offsets of `SPEC.md` sections 5.3 and 10.
struct Paper<'a> {
    raw: &'a [u8],
    symbols: &'a [i16],
}

/// Terms of the equation that count: learned motion, second and third refinement.
type Terms = [bool; 3];

impl Paper<'_> {
    fn clusters(&self) -> usize {
        u32_at(self.raw, 24)
    }

    fn frames(&self) -> usize {
        u32_at(self.raw, 4)
    }

    fn gaussians(&self, cluster: usize) -> usize {
        u16_at(self.raw, 44 + 52 + 12 * cluster)
    }

    fn rank(&self) -> usize {
        usize::from(self.raw[44 + 48])
    }

    /// Symbols of the four levels of `cluster`.
    fn sizes(&self, cluster: usize) -> [usize; 4] {
        let degree = usize::from(self.raw[44 + 52 + 12 * cluster + 3] & 3);
        let (n, frames) = (self.gaussians(cluster), self.frames());
        let bands = 3 * ((degree + 1).pow(2) - 1);
        [14 * n, n * (3 * self.rank() + 11 * frames + bands), 14 * n * frames, 14 * n * frames]
    }

    /// The step at `level` of quantiser `index` of the cluster's profile: 0 canonical, 8 moving Position.
    fn step(&self, cluster: usize, index: usize, level: usize) -> f64 {
        let quant = usize::from(self.raw[44 + 52 + 12 * cluster + 2]);
        let at = 44 + 52 + 12 * self.clusters() + 104 * quant + 8 * index;
        (level..3).fold(f32_at(self.raw, at), |step, l| step * f64::from(self.raw[at + 4 + l]))
    }

    /// Positions of all Gaussians at `frame`, of the terms that count.
    fn positions(&self, frame: usize, terms: Terms) -> Vec<[f64; 3]> {
        let repairs = 16 * u16_at(self.raw, 32);
        let basis = 44 + 52 + 12 * self.clusters() + 104 * u16_at(self.raw, 28) + repairs;
        let transforms = basis + 4 * u32_at(self.raw, 36);
        let origin = [0, 1, 2].map(|d| f32_at(self.raw, 44 + 28 + 4 * d));
        let (mut start, mut positions) = (0, Vec::new());
        for cluster in 0..self.clusters() {
            let n = self.gaussians(cluster);
            let sizes = self.sizes(cluster);
            let first = |level: usize| start + sizes[..level].iter().sum::<usize>();
            let symbol = |level: usize, place: usize| f64::from(self.symbols[first(level) + place]);
            let steps = [1, 2, 3].map(|level| self.step(cluster, 8, level));
            let matrix =
                |i: usize| f32_at(self.raw, transforms + 4 * ((cluster * self.frames() + frame) * 12 + i));
            for i in 0..n {
                let fine = self.step(cluster, 0, 3);
                let canonical = [0, 1, 2].map(|d| origin[d] + symbol(0, d * n + i) * fine);
                positions.push([0, 1, 2].map(|d| {
                    let affine: f64 =
                        (0..3).map(|c| matrix(4 * d + c) * canonical[c]).sum::<f64>() + matrix(4 * d + 3);
                    let learned: f64 = (0..self.rank())
                        .map(|r| {
                            let weight = f32_at(self.raw, basis + 4 * (frame * self.rank() + r));
                            weight * symbol(1, (3 * r + d) * n + i) * steps[0]
                        })
                        .sum();
                    let delta = |level: usize| symbol(level, (14 * frame + d) * n + i) * steps[level - 1];
                    let parts = [learned, delta(2), delta(3)];
                    affine
                        + parts
                            .iter()
                            .zip(terms)
                            .map(|(part, counts)| if counts { *part } else { 0.0 })
                            .sum::<f64>()
                }));
            }
            start += sizes.iter().sum::<usize>();
        }
        positions
    }
}

/// Largest difference between the decoder's positions and the equation's, over all frames.
fn difference(paper: &Paper<'_>, received: &Received, terms: Terms) -> f64 {
    let mut most = 0f64;
    for (frame, (gaussians, _)) in received.frames.iter().enumerate() {
        for (decoded, wanted) in gaussians.iter().zip(paper.positions(frame, terms)) {
            for (a, b) in decoded.position.iter().zip(wanted) {
                most = most.max((f64::from(*a) - b).abs());
            }
        }
    }
    most
}

#[test]
fn positions_are_those_of_equation_one_at_every_level() {
    for name in ["paper", "paper-repaired"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/conformance/{name}.dgs"));
        let file = std::fs::read(path).unwrap();
        let (message, packets) = parts(&file);
        let raw = unpacked(message);
        assert_eq!((raw[0], u16_at(&raw, 20)), (0, 1), "profile paper, one epoch");
        for usable in 1..=4u8 {
            let brought: Vec<&[u8]> =
                packets.iter().copied().filter(|p| p[0] >> 5 == 0b100 && p[0] & 3 < usable).collect();
            let received = Session::open(message).after(&brought);
            let paper = Paper { raw: &raw, symbols: &received.symbols };
            let terms = [usable > 1, usable > 2, usable > 3];
            let most = difference(&paper, &received, terms);
            assert!(most < TOLERANCE, "{name}, {usable} levels: {most}");
            // The comparison sees each term: without it the positions are others.
            for term in 0..3 {
                let mut without = terms;
                without[term] = false;
                let most = difference(&paper, &received, without);
                let used = terms[term] && (term > 0 || paper.rank() > 0);
                assert_eq!(
                    most > 10.0 * TOLERANCE,
                    used,
                    "{name}, {usable} levels without term {term}: {most}"
                );
            }
        }
    }
}
