//! Evaluation renders a trained scene as held-out cameras saw it and compares.

use std::borrow::Cow;

use codec_core::Footprint;
use rayon::prelude::*;
use render_host::{
    Image, ImageError, RenderError, Renderer, Settings, Splats, SplatsError,
    metric::{self, Lpips},
};
use serde::Serialize;

use super::{
    model::Model,
    pixel_mask::PixelMask,
    views::{PosedPhotograph, Views},
};
use crate::scene::Instant;

/// PSNR of a picture that is its photograph value for value, dB; none counts more.
pub(super) const EQUAL_DB: f64 = 100.0;

/// How well pictures agree with photographs. A view whose mask leaves no pixel that counts is left out of all
/// means; what no view is left for is not a number, which JSON has as null.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Width and height of the pictures, pixels, of the first view.
    pub size: (u32, u32),
    /// Background of both.
    pub background: [f32; 3],
    /// Mean over views of each view's PSNR, dB, at most 100; of a photograph with a mask over pixels that
    /// count: those of a smaller picture that cover only such pixels.
    pub psnr_db: f64,
    /// Mean over views of the PSNR over pixels whose alpha is at least a half, dB; views without such pixels
    /// are left out.
    pub foreground_psnr_db: f64,
    /// Lowest PSNR of a view, dB.
    pub worst_psnr_db: f64,
    /// Mean SSIM; of a photograph with a mask over windows whose middle counts, in which pixels that do not
    /// count are equal ([`metric::ssim_where_counted`]).
    pub ssim: f64,
    /// PSNR of each view, dB, in the order of the views; not a number of one that is left out.
    pub psnr_of_views_db: Vec<f64>,
}

/// How different pictures look from photographs to a person. Pixels that a mask leaves out are equal; views
/// are left out as of an [`Evaluation`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Perceptual {
    /// Mean FLIP, 0 to 1.
    pub flip: f64,
    /// Mean LPIPS (AlexNet), where weights are there.
    pub lpips: Option<f64>,
}

/// An evaluation that could not be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EvaluationError {
    /// A picture could not be rendered.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// Two images do not fit together.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A view that is not there.
    #[error("view {index} is asked for; the split has {count}")]
    Index {
        /// The index, from 0.
        index: usize,
        /// Views there are.
        count: usize,
    },
    /// Pictures of no size.
    #[error("pictures reduced {0} times are asked for; at least 1 is allowed")]
    Reduced(u32),
    /// Gaussians whose arrays do not fit together.
    #[error(transparent)]
    Splats(#[from] SplatsError),
    /// There is nothing to evaluate on.
    #[error("the split is empty; at least one view is needed")]
    Empty,
}

/// A picture beside the photograph of the same view.
#[derive(Clone, Debug)]
pub struct Compared {
    /// What was rendered, clamped to 0..=1.
    pub rendered: Image,
    /// The photograph over the background.
    pub photograph: Image,
    /// What of it is compared, where a mask of its size says so.
    pub counted: Option<PixelMask>,
}

impl Compared {
    /// Whether some of it is compared.
    pub(super) fn counts(&self) -> bool {
        self.counted.as_ref().is_none_or(|mask| mask.values().contains(&255))
    }

    /// What was rendered, equal to the photograph where a mask leaves pixels out.
    ///
    /// # Errors
    /// Parts of different sizes.
    pub fn where_counted(&self) -> Result<Cow<'_, Image>, ImageError> {
        Ok(match &self.counted {
            Some(mask) => Cow::Owned(metric::where_counted(&self.rendered, &self.photograph, mask.values())?),
            None => Cow::Borrowed(&self.rendered),
        })
    }
}

/// A scene that can be shown at any time from 0 to 1.
pub trait DynamicScene: Sync {
    /// The Gaussians at `time`, into memory that is used again.
    fn pose(&self, time: f32, out: &mut Instant);

    /// How they are drawn.
    fn footprint(&self) -> Footprint;
}

impl DynamicScene for Model {
    fn pose(&self, time: f32, out: &mut Instant) {
        self.instant_into(time, out);
    }

    fn footprint(&self) -> Footprint {
        self.footprint
    }
}

/// Frames spread evenly from time 0 to 1: the nearest one is shown.
#[derive(Clone, Debug, Default)]
pub struct Clip {
    /// The frames.
    pub instants: Vec<Instant>,
    /// How they are drawn.
    pub footprint: Footprint,
}

impl DynamicScene for Clip {
    fn pose(&self, time: f32, out: &mut Instant) {
        let last = self.instants.len().saturating_sub(1);
        let frame = (f64::from(time) * last as f64).round() as usize;
        out.clone_from(self.instants.get(frame.min(last)).unwrap_or(&Instant::default()));
    }

    fn footprint(&self) -> Footprint {
        self.footprint
    }
}

/// Renders `scene` as view `index` sees it, `reduced` times smaller, over `background`.
///
/// # Errors
/// An index past the end, a size that `reduced` does not divide, `reduced` 0, or a picture that cannot be
/// rendered.
pub fn compare<S>(
    scene: &dyn DynamicScene,
    views: &Views<S>,
    index: usize,
    reduced: u32,
    background: [f32; 3],
) -> Result<Compared, EvaluationError> {
    let count = views.photographs().len();
    let view = views.photographs().get(index).ok_or(EvaluationError::Index { index, count })?;
    compare_view(scene, view, reduced, background)
}

/// As [`compare`], of one view.
pub(super) fn compare_view(
    scene: &dyn DynamicScene,
    view: &PosedPhotograph,
    reduced: u32,
    background: [f32; 3],
) -> Result<Compared, EvaluationError> {
    if reduced == 0 {
        return Err(EvaluationError::Reduced(reduced));
    }
    let (width, height) = (view.camera.width() / reduced, view.camera.height() / reduced);
    let camera = view.camera.resized(width, height).map_err(|_| ImageError::Size { width, height })?;
    let settings = Settings::over(background).with_footprint(scene.footprint());
    let mut instant = Instant::default();
    scene.pose(view.time, &mut instant);
    let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
    let rendered = Renderer::new().render(&splats, &camera, &settings)?.image;
    let clamped = rendered.rgb().iter().map(|v| v.clamp(0.0, 1.0)).collect();
    let mut photograph = view.photograph.over(background);
    if reduced > 1 {
        photograph = photograph.resized_box(width, height)?;
    }
    let counted = view.counted.as_ref().map(|mask| mask.reduced(reduced));
    Ok(Compared { rendered: Image::new(width, height, clamped)?, photograph, counted })
}

/// Evaluates `scene` on all `views`, `reduced` times smaller, over `background`.
///
/// # Errors
/// No views, a size that `reduced` does not divide, or a picture that cannot be rendered.
pub fn evaluate<S: Sync>(
    scene: &dyn DynamicScene,
    views: &Views<S>,
    reduced: u32,
    background: [f32; 3],
) -> Result<Evaluation, EvaluationError> {
    let measured = views.photographs().par_iter().enumerate().map(|(index, view)| {
        let compared = compare(scene, views, index, reduced, background)?;
        let counts = compared.counts();
        let Compared { rendered, photograph, counted } = compared;
        let coverage = |x: u32, y: u32| -> u32 {
            let at = (y * view.photograph.width() + x) as usize;
            let alpha = || view.photograph.rgba().get(4 * at + 3).copied().unwrap_or(0).into();
            view.foreground.as_ref().map_or_else(alpha, |mask| 255 * u32::from(mask.at(x, y)))
        };
        // Of a pixel that stands for several, their mean.
        let is_foreground = |x: u32, y: u32| {
            let pixels =
                (0..reduced * reduced).map(|k| (x * reduced + k % reduced, y * reduced + k / reduced));
            pixels.map(|(x, y)| u64::from(coverage(x, y))).sum::<u64>() >= 128 * u64::from(reduced).pow(2)
        };
        let is_counted = |x: u32, y: u32| counted.as_ref().is_none_or(|mask| mask.at(x, y));
        Ok::<_, EvaluationError>(OfView {
            size: rendered.size(),
            psnr_db: match &counted {
                Some(_) => psnr_where(&rendered, &photograph, is_counted),
                None => Some(metric::psnr(&rendered, &photograph)?.min(EQUAL_DB)),
            },
            foreground_db: psnr_where(&rendered, &photograph, |x, y| is_foreground(x, y) && is_counted(x, y)),
            ssim: match &counted {
                Some(mask) if counts => {
                    Some(metric::ssim_where_counted(&rendered, &photograph, mask.values())?)
                }
                Some(_) => None,
                None => Some(metric::ssim(&rendered, &photograph)?),
            },
        })
    });
    let measured = measured.collect::<Result<Vec<_>, _>>()?;
    let size = measured.first().ok_or(EvaluationError::Empty)?.size;
    let mean = |value: fn(&OfView) -> Option<f64>| {
        let values: Vec<f64> = measured.iter().filter_map(value).collect();
        if values.is_empty() { f64::NAN } else { values.iter().sum::<f64>() / values.len() as f64 }
    };
    Ok(Evaluation {
        size,
        background,
        psnr_db: mean(|view| view.psnr_db),
        foreground_psnr_db: mean(|view| view.foreground_db),
        worst_psnr_db: measured.iter().filter_map(|view| view.psnr_db).reduce(f64::min).unwrap_or(f64::NAN),
        ssim: mean(|view| view.ssim),
        psnr_of_views_db: measured.iter().map(|view| view.psnr_db.unwrap_or(f64::NAN)).collect(),
    })
}

/// What one view gives.
struct OfView {
    size: (u32, u32),
    /// `None` where no pixel counts.
    psnr_db: Option<f64>,
    /// `None` where the photograph shows none.
    foreground_db: Option<f64>,
    /// `None` where no pixel counts.
    ssim: Option<f64>,
}

/// How different `scene` looks from all `views`, `reduced` times smaller, over `background`.
///
/// # Errors
/// As [`evaluate`], or pictures too small for LPIPS.
pub fn perceptual<S>(
    scene: &dyn DynamicScene,
    views: &Views<S>,
    reduced: u32,
    background: [f32; 3],
    network: Option<&Lpips>,
) -> Result<Perceptual, EvaluationError> {
    let (mut flip, mut lpips, mut count) = (0.0, 0.0, 0.0);
    for index in 0..views.photographs().len() {
        let compared = compare(scene, views, index, reduced, background)?;
        if !compared.counts() {
            continue;
        }
        count += 1.0;
        let (rendered, photograph) = (compared.where_counted()?, &compared.photograph);
        flip += metric::flip(&rendered, photograph, metric::flip::PIXELS_PER_DEGREE)?.mean;
        if let Some(network) = network {
            lpips += network.distance(&rendered, photograph)?;
        }
    }
    if views.is_empty() {
        return Err(EvaluationError::Empty);
    }
    // Not a number where there is none.
    Ok(Perceptual { flip: flip / count, lpips: network.map(|_| lpips / count) })
}

/// PSNR in dB over the pixels that `counts` accepts, 100 where none of them differs; `None` without any.
fn psnr_where(a: &Image, b: &Image, counts: impl Fn(u32, u32) -> bool) -> Option<f64> {
    let width = a.width() as usize;
    let (mut sum, mut values) = (0.0, 0usize);
    for (index, (a, b)) in a.rgb().chunks_exact(3).zip(b.rgb().chunks_exact(3)).enumerate() {
        if counts((index % width) as u32, (index / width) as u32) {
            sum += a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
            values += 3;
        }
    }
    let error = (values > 0).then(|| sum / values as f64)?;
    Some(if error > 0.0 { (-10.0 * error.log10()).min(EQUAL_DB) } else { EQUAL_DB })
}

#[cfg(test)]
mod tests {
    use render_host::{Camera, adjoint::loss::photograph::Photograph};

    use super::{
        super::views::{PosedPhotograph, Test},
        *,
    };

    const SIDE: u32 = 32;

    /// An opaque photograph of one grey level, with a mask of pixels that all count or none of them do.
    fn view(grey: u8, counts: Option<bool>) -> PosedPhotograph {
        let values = |value: u8| vec![value; (SIDE * SIDE) as usize];
        let rgba = [grey, grey, grey, 255].repeat((SIDE * SIDE) as usize);
        PosedPhotograph {
            name: "a".to_owned(),
            camera: Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.7, SIDE, SIDE).unwrap(),
            time: 0.0,
            photograph: Photograph::new(SIDE, SIDE, rgba).unwrap(),
            foreground: PixelMask::new(SIDE, SIDE, values(1)),
            counted: counts.and_then(|counts| PixelMask::new(SIDE, SIDE, values(u8::from(counts)))),
        }
    }

    fn views(photographs: Vec<PosedPhotograph>) -> Views<Test> {
        Views::new(photographs).unwrap()
    }

    #[test]
    fn views_of_which_nothing_counts_are_left_out() {
        let nothing = Clip::default();
        let of = |views: &Views<Test>| {
            let found = evaluate(&nothing, views, 1, [0.0; 3]).unwrap();
            (found, perceptual(&nothing, views, 1, [0.0; 3], None).unwrap())
        };
        let (alone, seen_alone) = of(&views(vec![view(60, None), view(90, Some(true))]));
        let (with, seen) = of(&views(vec![view(60, None), view(250, Some(false)), view(90, Some(true))]));
        assert!(alone.psnr_db < 15.0 && alone.ssim < 0.9 && seen_alone.flip > 0.0, "{alone:?}");
        assert_eq!((with.psnr_db, with.ssim), (alone.psnr_db, alone.ssim));
        assert_eq!(with.worst_psnr_db, alone.worst_psnr_db);
        assert_eq!((with.foreground_psnr_db, seen), (alone.foreground_psnr_db, seen_alone));
        let of_views = &with.psnr_of_views_db;
        assert_eq!([of_views[0], of_views[2]], alone.psnr_of_views_db[..]);
        assert!(of_views[1].is_nan() && of_views.len() == 3, "{of_views:?}");
    }

    #[test]
    fn figures_of_nothing_are_not_a_number() {
        let all_left_out = views(vec![view(60, Some(false)); 2]);
        let found = evaluate(&Clip::default(), &all_left_out, 1, [0.0; 3]).unwrap();
        let json = serde_json::to_value(&found).unwrap();
        for field in ["psnr_db", "foreground_psnr_db", "worst_psnr_db", "ssim"] {
            assert!(json[field].is_null(), "{field}: {json}");
        }
        assert_eq!(json["psnr_of_views_db"], serde_json::json!([null, null]));
        assert!(perceptual(&Clip::default(), &all_left_out, 1, [0.0; 3], None).unwrap().flip.is_nan());
        // A photograph that counts and shows nothing that moves.
        let mut empty = view(60, None);
        empty.foreground = PixelMask::new(SIDE, SIDE, vec![0; (SIDE * SIDE) as usize]);
        let found = evaluate(&Clip::default(), &views(vec![empty]), 1, [0.0; 3]).unwrap();
        assert!(found.foreground_psnr_db.is_nan() && found.psnr_db < 15.0, "{found:?}");
    }
}
