//! Poisons one field of one Gaussian with a value that is no number, each field in its turn.

use codec_core::{Gaussian, ShDegree};
use render_host::Settings;

use super::{
    StressCase,
    parts::{BOUND, ball, camera, neighbours},
};

/// Names of the fields of a [`Gaussian`], then the first and the last of its harmonics.
const FIELDS: [&str; 16] = [
    "position.x",
    "position.y",
    "position.z",
    "scale.x",
    "scale.y",
    "scale.z",
    "rotation.w",
    "rotation.x",
    "rotation.y",
    "rotation.z",
    "opacity",
    "sh0.r",
    "sh0.g",
    "sh0.b",
    "first of sh rest",
    "last of sh rest",
];
/// Values and the family that each makes.
const VALUES: [(&str, f32); 6] = [
    ("NaN in one field", f32::NAN),
    ("+infinity in one field", f32::INFINITY),
    ("-infinity in one field", f32::NEG_INFINITY),
    ("denormal in one field", 1e-45),
    ("largest f32 in one field", f32::MAX),
    ("smallest f32 in one field", f32::MIN),
];

/// All of them. The poisoned Gaussian is the middle one of three.
pub(super) fn cases() -> Vec<StressCase> {
    let degree = ShDegree::MAX;
    let each = degree.rest_len();
    let mut out = Vec::new();
    for (family, value) in VALUES {
        for (k, field) in FIELDS.into_iter().enumerate() {
            let mut gaussians = neighbours(ball());
            let mut rest: Vec<f32> = (0..3 * each).map(|i| 0.02 * (i as f32).sin()).collect();
            match k {
                14 => rest[each] = value,
                15 => rest[2 * each - 1] = value,
                _ => poison(&mut gaussians[1], k, value),
            }
            // An infinite opacity is no opacity; one of minus infinity or nearly 0 is a Gaussian that is
            // absent.
            let skipped = if value.is_finite() { None } else { Some(1) };
            out.push(StressCase {
                family,
                name: format!("{field} = {value:e}"),
                gaussians,
                rest,
                degree,
                camera: camera(33, 25),
                settings: Settings::default(),
                bound: Some(BOUND),
                skipped,
            });
        }
    }
    out
}

fn poison(g: &mut Gaussian, field: usize, value: f32) {
    *match field {
        0..3 => &mut g.position[field],
        3..6 => &mut g.scale[field - 3],
        6..10 => &mut g.rotation[field - 6],
        10 => &mut g.opacity,
        _ => &mut g.sh0[(field - 11) % 3],
    } = value;
}
