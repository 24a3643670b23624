//! Chooses colours: palettes that sit well together, and a soft baked light.

use glam::DVec3;

/// Warm and cool colours of similar weight.
pub(super) const PALETTE: [[f32; 3]; 8] = [
    [0.89, 0.34, 0.27],
    [0.98, 0.70, 0.28],
    [0.30, 0.62, 0.54],
    [0.25, 0.42, 0.71],
    [0.58, 0.40, 0.66],
    [0.93, 0.55, 0.52],
    [0.46, 0.68, 0.30],
    [0.24, 0.66, 0.78],
];

/// `colour` under a soft light from above front left, as baked into a surface facing `normal`.
pub(super) fn lit(colour: [f32; 3], normal: DVec3) -> [f32; 3] {
    let light = DVec3::new(-0.4, 0.8, 0.45).normalize();
    let shade = (0.68 + 0.32 * normal.dot(light)) as f32;
    colour.map(|c| (c * shade).clamp(0.0, 1.0))
}

/// `a` at 0, `b` at 1.
pub(super) fn mix(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t)
}

/// Light and dark floor tiles of `side` units.
pub(super) fn tiles(x: f64, z: f64, side: f64) -> [f32; 3] {
    let odd = ((x / side).floor() + (z / side).floor()).rem_euclid(2.0) >= 1.0;
    if odd { [0.42, 0.44, 0.48] } else { [0.82, 0.80, 0.76] }
}
