//! Holds what every part of the bench of training measures with: weights, a clock, distances of gradients.

use anyhow::Result;
use render_host::{Gradients, adjoint::loss::photograph::Weights};

use super::super::clock::seconds;

/// Weights of L1 and of `1 - SSIM`, as trainers have them.
pub(super) const WEIGHTS: Weights = Weights { absolute: 0.8, squared: 0.0, structure: 0.2 };
pub(super) const WHITE: [f32; 3] = [1.0; 3];

/// Milliseconds of `work` on this thread.
pub(super) fn ms(times: &mut Vec<f64>, work: impl FnOnce() -> Result<()>) -> Result<()> {
    let start = seconds();
    work()?;
    times.push(1000.0 * (seconds() - start));
    Ok(())
}

/// Relative L2 distance of the gradients of positions.
pub(super) fn apart(found: &Gradients, expected: &Gradients) -> f64 {
    let (mut off, mut all) = (0.0, 0.0);
    for (a, b) in found.splats.iter().zip(&expected.splats) {
        for (a, b) in a.position.iter().zip(b.position) {
            off += f64::from(a - b).powi(2);
            all += f64::from(b).powi(2);
        }
    }
    (off / all).sqrt()
}
