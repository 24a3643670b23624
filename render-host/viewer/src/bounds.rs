//! Bounds say where a frame's Gaussians are, so that a camera finds them: a middle and a radius.

use render_host::Gaussian;

/// Opacity below which a Gaussian is no part of what people look at.
const VISIBLE: f32 = 0.1;
/// Share of the Gaussians left out on each side of each axis: stray ones would push the camera away.
const STRAY: f64 = 0.02;

/// The middle of `gaussians` and the radius around it, scene units, whatever their order; `None` if none of
/// them is seen.
pub fn bounds(gaussians: &[Gaussian]) -> Option<([f64; 3], f64)> {
    let visible = |g: &&Gaussian| g.opacity >= VISIBLE && g.position.iter().all(|v| v.is_finite());
    let seen: Vec<[f32; 3]> = gaussians.iter().filter(visible).map(|g| g.position).collect();
    if seen.is_empty() {
        return None;
    }
    let stray = (STRAY * seen.len() as f64) as usize;
    let sides: [[f64; 2]; 3] = std::array::from_fn(|axis| {
        let mut values: Vec<f32> = seen.iter().map(|position| position[axis]).collect();
        values.sort_unstable_by(f32::total_cmp);
        [values[stray], values[values.len() - 1 - stray]].map(f64::from)
    });
    let middle = sides.map(|[low, high]| 0.5 * (low + high));
    let half = sides.map(|[low, high]| 0.5 * (high - low));
    let radius = half.iter().map(|v| v * v).sum::<f64>().sqrt();
    Some((middle, if radius > 0.0 { radius } else { 1.0 }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(position: [f32; 3]) -> Gaussian {
        Gaussian { position, opacity: 1.0, ..Gaussian::ABSENT }
    }

    #[test]
    fn strays_absent_ones_and_order_do_not_matter() {
        let mut all: Vec<Gaussian> = (0..=100).map(|k| at([k as f32, 5.0, -(k as f32)])).collect();
        let (middle, radius) = bounds(&all).unwrap();
        assert_eq!(middle, [50.0, 5.0, -50.0]);
        assert!((radius - 48.0 * 2f64.sqrt()).abs() < 1e-9, "{radius}");
        all.extend([
            at([1e9, 0.0, 0.0]),
            at([f32::NAN; 3]),
            Gaussian { position: [1e6; 3], ..Gaussian::ABSENT },
        ]);
        all.reverse();
        let (stray, _) = bounds(&all).unwrap();
        assert!((stray[0] - 50.0).abs() < 2.0, "{stray:?}");
        assert_eq!((bounds(&[]), bounds(&[Gaussian::ABSENT])), (None, None));
        assert_eq!(bounds(&[at([2.0; 3])]), Some(([2.0; 3], 1.0)));
    }
}
