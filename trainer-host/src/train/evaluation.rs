//! Evaluation renders a trained scene as held-out cameras saw it and compares.

use std::borrow::Cow;

use codec_core::Footprint;
use rayon::prelude::*;
use render_host::{
    Image, ImageError, RenderError, Renderer, Settings, Splats, SplatsError,
    metric::{self, Lpips},
};
use serde::Serialize;

use super::{model::Model, pixel_mask::PixelMask, views::Views};
use crate::scene::Instant;

/// PSNR of a picture that is its photograph value for value, dB; none counts more.
pub(super) const EQUAL_DB: f64 = 100.0;

/// How well pictures agree with photographs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Width and height of the pictures, pixels, of the first view.
    pub size: (u32, u32),
    /// Background of both.
    pub background: [f32; 3],
    /// Mean over views of each view's PSNR, dB, at most 100; of a photograph with a mask over pixels that
    /// count: those of a smaller picture that cover only such pixels.
    pub psnr_db: f64,
    /// Mean over views of the PSNR over pixels whose alpha is at least a half, dB.
    pub foreground_psnr_db: f64,
    /// Lowest PSNR of a view, dB.
    pub worst_psnr_db: f64,
    /// Mean SSIM; of a photograph with a mask over windows whose middle counts, in which pixels that do not
    /// count are equal ([`metric::ssim_where_counted`]).
    pub ssim: f64,
    /// PSNR of each view, dB, in the order of the views.
    pub psnr_of_views_db: Vec<f64>,
}

/// How different pictures look from photographs to a person. Pixels that a mask leaves out are equal.
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
        let Compared { rendered, photograph, counted } = compare(scene, views, index, reduced, background)?;
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
        let of_counted = counted.as_ref().and_then(|_| psnr_where(&rendered, &photograph, is_counted));
        Ok::<_, EvaluationError>(OfView {
            size: rendered.size(),
            psnr_db: of_counted.map_or_else(|| metric::psnr(&rendered, &photograph), Ok)?.min(EQUAL_DB),
            foreground_db: psnr_where(&rendered, &photograph, |x, y| is_foreground(x, y) && is_counted(x, y)),
            ssim: match &counted {
                Some(mask) => metric::ssim_where_counted(&rendered, &photograph, mask.values())?,
                None => metric::ssim(&rendered, &photograph)?,
            },
        })
    });
    let measured = measured.collect::<Result<Vec<_>, _>>()?;
    let size = measured.first().ok_or(EvaluationError::Empty)?.size;
    let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
    let psnr_of_views_db: Vec<f64> = measured.iter().map(|view| view.psnr_db).collect();
    let with_foreground: Vec<f64> = measured.iter().filter_map(|view| view.foreground_db).collect();
    Ok(Evaluation {
        size,
        background,
        psnr_db: mean(psnr_of_views_db.clone()),
        foreground_psnr_db: if with_foreground.is_empty() { EQUAL_DB } else { mean(with_foreground) },
        worst_psnr_db: psnr_of_views_db.iter().copied().fold(f64::INFINITY, f64::min),
        ssim: mean(measured.iter().map(|view| view.ssim).collect()),
        psnr_of_views_db,
    })
}

/// What one view gives.
struct OfView {
    size: (u32, u32),
    psnr_db: f64,
    /// `None` where the photograph shows none.
    foreground_db: Option<f64>,
    ssim: f64,
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
    let (mut flip, mut lpips) = (0.0, 0.0);
    for index in 0..views.photographs().len() {
        let compared = compare(scene, views, index, reduced, background)?;
        let (rendered, photograph) = (compared.where_counted()?, &compared.photograph);
        flip += metric::flip(&rendered, photograph, metric::flip::PIXELS_PER_DEGREE)?.mean;
        if let Some(network) = network {
            lpips += network.distance(&rendered, photograph)?;
        }
    }
    let count = views.photographs().len() as f64;
    if views.is_empty() {
        return Err(EvaluationError::Empty);
    }
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
