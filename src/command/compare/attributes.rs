//! Compares the Gaussians themselves, where row by row they are the same ones.

use codec_core::Gaussian;
use render_host::harmonics;
use serde::Serialize;
use trainer_host::Instant;

/// Rows are the same Gaussians if half of them have moved by less than this share of the scene's radius.
const SAME: f64 = 0.01;

/// How far two frames are apart, attribute by attribute.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct AttributeDifferences {
    /// The frame compared.
    pub frame: u32,
    /// Gaussians compared.
    pub gaussians: usize,
    /// One per attribute.
    pub attributes: Vec<AttributeDifference>,
}

/// How far one attribute is off.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct AttributeDifference {
    /// Which.
    pub name: &'static str,
    /// Of `rms` and `largest`.
    pub unit: &'static str,
    /// Root of the mean square over Gaussians.
    pub rms: f64,
    /// Of the Gaussian that is off most.
    pub largest: f64,
}

/// The differences of `a` from `b`, or why rows are not the same Gaussians. `radius` is the scene's.
pub(super) fn differences(
    frame: u32,
    a: &Instant,
    b: &Instant,
    radius: f64,
) -> Result<AttributeDifferences, String> {
    let count = b.gaussians.len();
    if a.gaussians.len() != count {
        return Err(format!("A has {} Gaussians and B {count}", a.gaussians.len()));
    }
    let mut moved: Vec<f64> =
        a.gaussians.iter().zip(&b.gaussians).map(|(a, b)| distance(&a.position, &b.position)).collect();
    let middle = count / 2;
    let median = moved.get(middle).is_some().then(|| *moved.select_nth_unstable_by(middle, f64::total_cmp).1);
    if median.is_some_and(|median| median > SAME * radius) {
        return Err("rows are in another order, or other Gaussians".to_owned());
    }
    let each = |name, unit, difference: &dyn Fn(&Gaussian, &Gaussian) -> f64| {
        let values = a.gaussians.iter().zip(&b.gaussians).map(|(a, b)| difference(a, b));
        summary(name, unit, values)
    };
    let mut attributes = vec![
        each("position", "scene units", &|a, b| distance(&a.position, &b.position)),
        each("scale", "natural log", &|a, b| distance(&a.scale.map(log), &b.scale.map(log))),
        each("rotation", "degrees", &|a, b| angle(&a.rotation, &b.rotation)),
        each("opacity", "0 to 1", &|a, b| f64::from((a.opacity - b.opacity).abs())),
        each("colour", "0 to 1", &|a, b| harmonics::C0 * distance(&a.sh0, &b.sh0)),
    ];
    if a.sh_degree == b.sh_degree && a.sh_degree.rest_len() > 0 {
        let rest = a.sh_degree.rest_len();
        let rows = a.sh_rest.chunks_exact(rest).zip(b.sh_rest.chunks_exact(rest));
        attributes.push(summary("harmonics", "coefficients", rows.map(|(a, b)| distance(a, b))));
    }
    Ok(AttributeDifferences { frame, gaussians: count, attributes })
}

fn summary(name: &'static str, unit: &'static str, values: impl Iterator<Item = f64>) -> AttributeDifference {
    let (mut squares, mut largest, mut count) = (0.0, 0.0f64, 0usize);
    for value in values {
        squares += value * value;
        largest = largest.max(value);
        count += 1;
    }
    AttributeDifference { name, unit, rms: (squares / count.max(1) as f64).sqrt(), largest }
}

/// A size of nothing is as small as the importers' smallest.
fn log(scale: f32) -> f32 {
    scale.max(2e-9).ln()
}

fn distance(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt()
}

/// The angle between two ellipsoids' orientations, degrees: half a turn about an axis of its own leaves an
/// ellipsoid as it was.
fn angle(a: &[f32; 4], &[w, x, y, z]: &[f32; 4]) -> f64 {
    let same = [[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]];
    let chords = same.iter().flat_map(|b| [distance(a, b), distance(a, &b.map(|v| -v))]);
    // By the chord, which is exact for small angles too.
    (4.0 * (0.5 * chords.fold(2.0, f64::min)).min(1.0).asin()).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn instant(count: usize) -> Instant {
        let gaussian = |i: usize| Gaussian {
            position: [i as f32, 0.0, 0.0],
            scale: [0.1; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity: 0.5,
            sh0: [0.0; 3],
        };
        Instant { gaussians: (0..count).map(gaussian).collect(), ..Instant::default() }
    }

    #[test]
    fn each_attribute_is_measured_in_its_own_unit() {
        let (a, mut b) = (instant(4), instant(4));
        let half = 0.5 * 30.0f32.to_radians();
        b.gaussians[1].rotation = [-half.cos(), 0.0, -half.sin(), 0.0];
        b.gaussians[2].opacity = 0.25;
        b.gaussians[3].position[1] = 0.03;
        let found = differences(7, &b, &a, 10.0).unwrap();
        let largest = |name: &str| found.attributes.iter().find(|a| a.name == name).unwrap().largest;
        assert!((largest("position") - 0.03).abs() < 1e-6 && (largest("opacity") - 0.25).abs() < 1e-6);
        assert!((largest("rotation") - 30.0).abs() < 1e-3, "{}", largest("rotation"));
        assert_eq!((largest("scale"), largest("colour"), found.gaussians), (0.0, 0.0, 4));
        // Half a turn about an axis of its own.
        b.gaussians[1].rotation = [0.0, 0.0, 1.0, 0.0];
        let found = differences(7, &b, &a, 10.0).unwrap();
        assert!(found.attributes.iter().find(|a| a.name == "rotation").unwrap().largest < 1e-3);
    }

    #[test]
    fn other_rows_are_not_compared() {
        let (a, mut b) = (instant(9), instant(9));
        b.gaussians.reverse();
        assert!(differences(0, &a, &b, 9.0).unwrap_err().contains("another order"));
        assert!(differences(0, &a, &instant(8), 9.0).unwrap_err().contains("9 Gaussians and B 8"));
    }
}
