//! Reads the parameters of a gsplat training from a NumPy archive or a safetensors file: one frame of
//! Gaussians.
//!
//! Arrays, under gsplat's names: `means` (N×3), `scales` (N×3, logarithms), `quats` (N×4, wxyz), `opacities`
//! (N or N×1, logits), `sh0` (N×3 or N×1×3) and, where there are higher bands, `shN` (N×K×3, K 3, 8 or 15).
//! Others are skipped. Axes are kept: those of COLMAP, y down.

use codec_core::ShDegree;

use super::super::{
    Limits,
    error::{Format, ImportError},
    snapshot::{Columns, scene_error},
    tensors::{Tensors, Unread},
};
use crate::scene::Scene;

const FORMAT: Format = Format::GsplatNpz;
/// Arrays that only files of this kind have together.
const MARKS: [&str; 2] = ["means", "quats"];

/// Whether a file holds such parameters.
pub(in super::super) fn is_in(tensors: &Tensors<'_>) -> bool {
    MARKS.iter().all(|mark| tensors.has(mark))
}

/// Reads the file as a scene of one frame.
///
/// # Errors
/// A damaged file, a missing or misshapen array, values that are not numbers, or more than `limits` allow.
pub(super) fn parse(
    mut tensors: Tensors<'_>,
    frames_per_second: f64,
    limits: &Limits,
) -> Result<Scene, ImportError> {
    let means = tensors.unread("means")?;
    let &[n, 3] = means.shape() else { return Err(means.misshapen("N x 3")) };
    limits.gaussians(FORMAT, n as u64)?;
    let mut columns = Columns::with_capacity(0, ShDegree::ZERO);
    means.rows(3, |v| columns.positions.push(three(v)))?;
    opened(&mut tensors, "scales", &[&[n, 3]])?.rows(3, |v| columns.log_scales.push(three(v)))?;
    opened(&mut tensors, "quats", &[&[n, 4]])?
        .rows(4, |v| columns.rotations.push([0, 1, 2, 3].map(|i| v[i] as f32)))?;
    opened(&mut tensors, "opacities", &[&[n], &[n, 1]])?
        .rows(1, |v| columns.opacity_logits.push(v[0] as f32))?;
    opened(&mut tensors, "sh0", &[&[n, 3], &[n, 1, 3]])?.rows(3, |v| columns.sh0.push(three(v)))?;
    if tensors.has("shN") {
        let rest = tensors.unread("shN")?;
        let bands = match *rest.shape() {
            [count, bands, 3] if count == n => bands,
            _ => return Err(rest.misshapen(&format!("{n} x K x 3"))),
        };
        let degree = (0..=3).filter_map(ShDegree::new).find(|degree| degree.rest_len() == 3 * bands);
        columns.sh_degree = degree.ok_or_else(|| rest.misshapen(&format!("{n} x 0, 3, 8 or 15 x 3")))?;
        if bands > 0 {
            rest.rows(3 * bands, |v| columns.sh_rest.extend(v.iter().map(|v| *v as f32)))?;
        }
    }
    let snapshot = columns.finish(FORMAT, limits, Vec::new())?;
    let mut scene =
        Scene::new(vec![snapshot.epoch], frames_per_second).map_err(|e| scene_error(FORMAT, &e))?;
    scene.notes = snapshot.notes;
    Ok(scene)
}

/// The array `name`, of one of `shapes`.
fn opened<'m, 'a>(
    tensors: &'m mut Tensors<'a>,
    name: &'m str,
    shapes: &[&[usize]],
) -> Result<Unread<'m, 'a>, ImportError> {
    let array = tensors.unread(name)?;
    if shapes.contains(&array.shape()) {
        return Ok(array);
    }
    let shown = |shape: &&[usize]| shape.iter().map(usize::to_string).collect::<Vec<_>>().join(" x ");
    Err(array.misshapen(&shapes.iter().map(shown).collect::<Vec<_>>().join(" or ")))
}

fn three(v: &[f64]) -> [f32; 3] {
    [v[0] as f32, v[1] as f32, v[2] as f32]
}

#[cfg(test)]
pub(in super::super) mod tests {
    use super::super::{
        super::dynamic_npz::tests::{archive, safetensors_of},
        Limits, parse,
    };

    /// Two Gaussians of degree 1; `edit` may change a member's shape.
    pub fn sample(edit: impl Fn(&str, &str) -> String) -> Vec<u8> {
        archive(
            &[
                ("means", "2, 3", &[0.0, 0.0, 0.0, 1.0, 2.0, 3.0]),
                ("scales", "2, 3", &[-3.0; 6]),
                ("quats", "2, 4", &[[2.0, 0.0, 0.0, 0.0]; 2].concat()),
                ("opacities", "2", &[0.0, 1.0]),
                ("sh0", "2, 1, 3", &[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]),
                ("shN", "2, 3, 3", &[0.01; 18]),
            ],
            edit,
        )
    }

    #[test]
    fn parameters_come_as_they_were_trained() {
        let scene = parse(&sample(|_, shape| shape.to_owned()), 30.0, &Limits::default()).unwrap();
        let attributes = scene.epochs()[0].attributes();
        assert_eq!((scene.max_count(), attributes.sh_degree.get(), attributes.sh_rest.len()), (2, 1, 18));
        let g = scene.instant(0).unwrap().gaussians;
        assert_eq!((g[1].position, g[1].sh0, g[0].opacity), ([1.0, 2.0, 3.0], [0.4, 0.5, 0.6], 0.5));
        assert_eq!(g[0].rotation, [1.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn a_safetensors_file_of_the_same_arrays_is_the_same_scene() {
        let npz = sample(|_, shape| shape.to_owned());
        let names = ["means", "scales", "quats", "opacities", "sh0", "shN"];
        let tensors = safetensors_of(&npz, &names);
        let [scene, same] = [&npz, &tensors].map(|bytes| parse(bytes, 30.0, &Limits::default()).unwrap());
        assert_eq!(same.instant(0), scene.instant(0));
        let still = parse(&safetensors_of(&npz, &names[..5]), 30.0, &Limits::default()).unwrap();
        assert_eq!(still.epochs()[0].attributes().sh_degree.get(), 0);
        let flat = sample(|name, shape| if name == "quats" { "8, 1".to_owned() } else { shape.to_owned() });
        let error = parse(&safetensors_of(&flat, &names), 30.0, &Limits::default()).unwrap_err().to_string();
        assert!(error.contains("shape of quats: found [8, 1]; allowed: 2 x 4"), "{error}");
    }

    #[test]
    fn shapes_that_contradict_each_other_are_named() {
        for (name, shape) in [
            ("means", "6"),
            ("scales", "3, 2"),
            ("quats", "1, 8"),
            ("opacities", "1, 2"),
            ("sh0", "2, 3, 1"),
            ("shN", "2, 9"),
            ("shN", "2, 2, 3"),
            ("means", "99999999999, 3"),
        ] {
            let edit =
                |member: &str, has: &str| if member == name { shape.to_owned() } else { has.to_owned() };
            let error = parse(&sample(edit), 30.0, &Limits::default()).unwrap_err().to_string();
            assert!(error.contains(name) || shape.starts_with("9999"), "{name}: {error}");
        }
    }
}
