//! Times a saving with and without it, on one thread, and says whether it pays.

use anyhow::Result;
use render_host::{Image, Settings};

use crate::{
    experiment::clock::seconds,
    figures::{Figure, bootstrap95, median},
};

/// `part` of `whole` in percent.
pub(super) fn share(part: u64, whole: u64) -> f64 {
    if whole == 0 { 0.0 } else { 100.0 * part as f64 / whole as f64 }
}

/// Largest difference of two pictures of one size.
pub(super) fn max_abs(a: &Image, b: &Image) -> f64 {
    a.rgb().iter().zip(b.rgb()).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max)
}

/// Milliseconds of processor time that `work` takes of this thread: it does not grow with what else runs.
pub(super) fn time(work: impl FnOnce() -> Result<()>) -> Result<f64> {
    let start = seconds();
    work()?;
    Ok(1e3 * (seconds() - start))
}

/// Default settings on one thread, whose time is what is measured.
pub(super) fn serial() -> Settings {
    Settings { parallel: false, ..Settings::default() }
}

/// Paired times with and without a saving, as one figure: the median with it beside the median without it,
/// the median ratio of pairs and its interval.
pub(super) fn pair(key: String, on: &[f64], off: &[f64]) -> Figure {
    let ratios: Vec<f64> = on.iter().zip(off).map(|(on, off)| off / on).collect();
    let mut figure = Figure::new(key, median(on), "ms").peer("off", median(off), true).runs(on.len());
    figure.ratio = Some(median(&ratios));
    figure.ci95 = bootstrap95(&ratios, median, 7);
    figure
}

/// Whether a figure of [`pair`] says that the saving saves.
pub(super) fn pays(figure: &Figure) -> bool {
    figure.ci95.is_some_and(|[low, _]| low > 1.0)
}

/// Names what does not pay on a scene.
pub(super) fn verdict(key: &str, failing: &[&str]) -> Figure {
    let names = if failing.is_empty() { "none".to_owned() } else { failing.join(", ") };
    Figure::new(format!("{key}.not_paying"), failing.len() as f64, &format!("skips: {names}"))
}
