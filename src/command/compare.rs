//! Compares two scenes, streams or sets of pictures, by pictures and by Gaussians: `dgs compare`.

mod attributes;
mod named;
mod pairs;
mod side;

use std::path::Path;

use anyhow::{Context, Result, bail};
use codec_core::internals::ids::Level;
use render_host::{
    Backend, FrameRenderer, Image, Settings, Splats,
    metric::{self, Lpips, flip::PIXELS_PER_DEGREE},
};
use serde::Serialize;
use serde_json::json;
use trainer_host::evaluator::PSNR_CAP_DB;

use self::{
    attributes::{AttributeDifferences, differences},
    pairs::{Chosen, Pair, Source, frame_of},
    side::Side,
};
use crate::{
    args::Compare,
    figures::{counted, mean},
    files,
    output::VerbOutput,
    pictures::{PictureOutput, PictureRun, PictureWriter},
    pipeline::{self, Frames, Quiet},
    progress::Progress,
};

/// Lines of pictures that are printed; `--json` has them all.
const LINES: usize = 20;

/// How far picture A is from picture B.
#[derive(Clone, Debug, Serialize)]
struct PictureDifference {
    name: String,
    frame: u32,
    camera: usize,
    width: u32,
    height: u32,
    psnr_db: f64,
    ssim: f64,
    flip: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    lpips: Option<f64>,
    /// Whether it is a render and shows nothing of A nor B: it does not count.
    nothing_seen: bool,
}

/// A metric over all pictures.
#[derive(Clone, Debug, Serialize)]
struct MetricSummary {
    metric: &'static str,
    mean: f64,
    worst: f64,
    /// The picture that it is worst in.
    worst_name: String,
}

/// Runs the verb.
pub fn run(args: &Compare, quiet: Quiet) -> Result<VerbOutput> {
    let output = args.out.as_deref().map(|out| sheets(args, out)).transpose()?;
    let network = args.lpips.as_deref().map(lpips).transpose()?;
    let backend = Backend::open(args.device.into()).context("--device")?;
    let level = Level::from_bits(args.level);
    let mut warnings = Vec::new();
    let mut open = |input: &str| Side::open(input, &args.scene, level, &mut |w| warnings.push(w));
    let (mut a, mut b) = (open(&args.a)?, open(&args.b)?);
    let turned = side::turned_alike(args, &mut a, &mut b)?;
    let Chosen { mut pairs, cameras, notes: mut doubts } = pairs::choose(args, &mut a, &mut b)?;
    if output.is_some_and(PictureOutput::is_moving) {
        // The clip of one camera after that of another.
        pairs.sort_by_key(|pair| pair.camera);
    }
    let settings = pipeline::settings(&args.view);

    let frames_per_second = [&b, &a].into_iter().find_map(rate);
    let frames_per_second = frames_per_second.unwrap_or_else(|| args.scene.frames_per_second());
    doubts.extend(output.and_then(|output| output.rounded_rate(frames_per_second)));
    let (pictures, overwrite) = (pairs.len(), args.overwrite);
    let run = PictureRun { pictures, frames_per_second, quality: None, overwrite };
    let begin = |(out, output)| PictureWriter::begin(out, output, run);
    let mut writer = args.out.as_deref().zip(output).map(begin).transpose()?;
    let mut renderers = [backend.frames()?, backend.frames()?];
    let mut rows = Vec::with_capacity(pairs.len());
    let progress = Progress::new("compare", quiet.0);
    for (done, pair) in pairs.iter().enumerate() {
        progress.step("comparing", done, pairs.len());
        let [of_a, of_b] = &mut renderers;
        let a = picture(&pair.a, &mut a, pair.frame, of_a, &settings)?;
        let b = picture(&pair.b, &mut b, pair.frame, of_b, &settings)?;
        let (mut row, map) = compared(pair, &a, &b, network.as_ref())?;
        let is_blank = |picture: &Image| is_blank(picture, args.view.background);
        row.nothing_seen = pair.is_rendered() && is_blank(&a) && is_blank(&b);
        if let Some((writer, output)) = writer.as_mut().zip(output) {
            let heat = metric::heat::map(a.width(), a.height(), &map, 1.0)?;
            let sheet = Image::strip(&[&a, &b, &heat], 3, 2)?;
            if done == 0 {
                doubts.extend(output.rounded_up(sheet.width(), sheet.height()));
            }
            writer.add(&pair.name, &sheet)?;
        }
        rows.push(row);
    }
    writer.map(PictureWriter::finish).transpose()?;
    drop(progress);
    let gaussians = gaussians(&mut a, &mut b, &pairs)?;
    let unseen: Vec<&str> = rows.iter().filter(|row| row.nothing_seen).map(|row| &*row.name).collect();
    let unseen = (!unseen.is_empty()).then(|| not_counted(&unseen, rows.len())).transpose()?;
    let summaries = summaries(&rows);
    let background = args.view.background;
    let of_sides = [(&a, &args.a), (&b, &args.b)].map(|(side, input)| notes(side, input)).concat();
    let notes: Vec<&String> = of_sides.iter().chain(&turned).chain(&doubts).chain(&unseen).collect();
    let mut text = format!(
        "{} against {}: {}, {cameras}, background {background:?}\n",
        args.a,
        args.b,
        counted(rows.len(), "picture")
    );
    text += &table(&rows, &summaries);
    text += &attribute_lines(&gaussians);
    for note in &notes {
        text += &format!("  note: {note}\n");
    }
    if let Some(out) = &args.out {
        let (a, b, out) = (&args.a, &args.b, out.display());
        text += &format!("of each picture, from left to right, A ({a}), B ({b}) and FLIP → {out}\n");
    }
    let (gaussians, why) = match gaussians {
        None => (None, None),
        Some(Ok(found)) => (Some(found), None),
        Some(Err(why)) => (None, Some(why)),
    };
    let json = json!({
        "a": args.a, "b": args.b, "cameras": cameras, "background": background, "device": backend.name(),
        "psnr_cap_db": PSNR_CAP_DB, "flip_pixels_per_degree": PIXELS_PER_DEGREE, "summary": summaries,
        "pictures": rows, "gaussians": gaussians, "gaussians_not_compared": why, "notes": notes,
        "out": args.out.as_deref().map(files::shown), "warnings": warnings,
    });
    let damaged = !warnings.is_empty();
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// What A, B and FLIP are written as, side by side; asked before the work.
fn sheets(args: &Compare, out: &Path) -> Result<PictureOutput> {
    let output = PictureOutput::of(out, None)?;
    if output.is_still() {
        bail!(
            "{}: several pictures are written: name a folder, without an ending, or .mp4, .webm, .apng or \
             .gif",
            out.display()
        );
    }
    files::check_apart(out, &[Path::new(&args.a), Path::new(&args.b)])?;
    output.check(out, args.overwrite)?;
    Ok(output)
}

/// Frames per second of what has any.
fn rate(side: &Side) -> Option<f64> {
    match side {
        Side::Frames(frames) => Some(frames.frames_per_second()),
        Side::Pictures(_) => None,
    }
}

fn lpips(path: &Path) -> Result<Lpips> {
    let failed = || format!("--lpips {}", path.display());
    let bytes = std::fs::read(path).with_context(failed)?;
    Lpips::from_safetensors(&bytes).with_context(failed)
}

/// What a person should know of `side`, each with the name of the `input` that it is of.
fn notes(side: &Side, input: &str) -> Vec<String> {
    match side {
        Side::Frames(frames) => frames.notes().iter().map(|note| pipeline::note_of(input, note)).collect(),
        Side::Pictures(_) => Vec::new(),
    }
}

/// The picture of `source`.
fn picture(
    source: &Source,
    side: &mut Side,
    frame: u32,
    renderer: &mut FrameRenderer,
    settings: &Settings,
) -> Result<Image> {
    match (source, side) {
        (Source::Render(camera), Side::Frames(frames)) => {
            let instant = frames.instant(frame_of(frames, frame))?;
            let settings = settings.clone().with_footprint(frames.footprint());
            let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
            Ok(renderer.render(&splats, camera, &settings)?.image.clone())
        }
        (Source::File(path), _) => side::read(path, settings.background),
        (Source::Render(_), Side::Pictures(_)) => bail!("pictures are not rendered"),
    }
}

/// The difference of `a` from `b`, and FLIP pixel by pixel.
fn compared(
    pair: &Pair,
    a: &Image,
    b: &Image,
    network: Option<&Lpips>,
) -> Result<(PictureDifference, Vec<f32>)> {
    let failed = || pair.name.clone();
    let flip = metric::flip(a, b, PIXELS_PER_DEGREE).with_context(failed)?;
    let row = PictureDifference {
        name: pair.name.clone(),
        frame: pair.frame,
        camera: pair.camera,
        width: a.width(),
        height: a.height(),
        psnr_db: metric::psnr(a, b).with_context(failed)?.min(PSNR_CAP_DB),
        ssim: metric::ssim(a, b).with_context(failed)?,
        flip: flip.mean,
        lpips: network.map(|network| network.distance(a, b)).transpose().with_context(failed)?,
        nothing_seen: false,
    };
    Ok((row, flip.map))
}

/// Whether `picture` is `background` everywhere.
fn is_blank(picture: &Image, background: [f32; 3]) -> bool {
    picture
        .rgb()
        .chunks_exact(3)
        .all(|pixel| pixel.iter().zip(&background).all(|(a, b)| (a - b).abs() < 0.5 / 255.0))
}

/// What is said of the pictures `unseen` of `all`, which show nothing and would count as perfect.
///
/// # Errors
/// All are: nothing is compared.
fn not_counted(unseen: &[&str], all: usize) -> Result<String> {
    if unseen.len() == all {
        let pictures = counted(all, "picture");
        bail!(
            "nothing of A or B is seen in any of {pictures}; --cameras, --eye and --turntable place cameras"
        );
    }
    let named: Vec<&str> = unseen.iter().copied().take(LINES).collect();
    let more = if unseen.len() > LINES { " and others" } else { "" };
    let pictures = counted(unseen.len(), "picture");
    Ok(format!("nothing of A or B is seen in {pictures}, which do not count: {}{more}", named.join(", ")))
}

/// The Gaussians of the first frame that was compared, if both sides have any.
fn gaussians(
    a: &mut Side,
    b: &mut Side,
    pairs: &[Pair],
) -> Result<Option<Result<AttributeDifferences, String>>> {
    let (Side::Frames(a), Side::Frames(b), Some(first)) = (a, b, pairs.first()) else { return Ok(None) };
    let radius = b.framing()?.radius;
    let frame = first.frame;
    let instant = |side: &mut Frames| side.instant(frame_of(side, frame));
    let (of_a, of_b) = (instant(a)?, instant(b)?);
    Ok(Some(differences(frame, &of_a, &of_b, radius)))
}

/// The value of a metric, where it was measured.
type Metric = fn(&PictureDifference) -> Option<f64>;

/// Mean and worst of every metric over the pictures that count.
fn summaries(rows: &[PictureDifference]) -> Vec<MetricSummary> {
    let rows: Vec<&PictureDifference> = rows.iter().filter(|row| !row.nothing_seen).collect();
    let metrics: [(&str, bool, Metric); 4] = [
        ("psnr_db", true, |row| Some(row.psnr_db)),
        ("ssim", true, |row| Some(row.ssim)),
        ("flip", false, |row| Some(row.flip)),
        ("lpips", false, |row| row.lpips),
    ];
    let mut out = Vec::new();
    for (metric, higher_is_better, value) in metrics {
        let values: Option<Vec<f64>> = rows.iter().map(|row| value(row)).collect();
        let Some(values) = values.filter(|values| !values.is_empty()) else { continue };
        let sign = if higher_is_better { 1.0 } else { -1.0 };
        let ranked = (0..values.len()).min_by(|&i, &j| (sign * values[i]).total_cmp(&(sign * values[j])));
        let worst = ranked.unwrap_or(0);
        out.push(MetricSummary {
            metric,
            mean: mean(&values),
            worst: values[worst],
            worst_name: rows[worst].name.clone(),
        });
    }
    out
}

fn table(rows: &[PictureDifference], summaries: &[MetricSummary]) -> String {
    let has_lpips = rows.iter().any(|row| row.lpips.is_some());
    let heading = if has_lpips { "   LPIPS" } else { "" };
    let mut text =
        format!("  {:28} {:>11} {:>8} {:>8} {:>8}{heading}\n", "picture", "size", "PSNR", "SSIM", "FLIP");
    for row in rows.iter().take(LINES) {
        let size = format!("{}×{}", row.width, row.height);
        let lpips = row.lpips.map(|v| format!("{v:>8.4}")).unwrap_or_default();
        text += &format!(
            "  {:28} {size:>11} {:>8.2} {:>8.4} {:>8.4}{lpips}\n",
            row.name, row.psnr_db, row.ssim, row.flip
        );
    }
    if rows.len() > LINES {
        text += &format!("  … {} more; --json has them all\n", rows.len() - LINES);
    }
    for MetricSummary { metric, mean, worst, worst_name } in summaries {
        text += &format!("  {metric:8} mean {mean:.4}, worst {worst:.4} in {worst_name}\n");
    }
    text
}

fn attribute_lines(gaussians: &Option<Result<AttributeDifferences, String>>) -> String {
    match gaussians {
        None => String::new(),
        Some(Err(why)) => format!("  Gaussians are not compared: {why}\n"),
        Some(Ok(found)) => {
            let mut text =
                format!("  {} Gaussians, row by row, in frame {}:\n", found.gaussians, found.frame);
            for attribute in &found.attributes {
                text += &format!(
                    "    {:10} rms {:.6}, at most {:.6} ({})\n",
                    attribute.name, attribute.rms, attribute.largest, attribute.unit
                );
            }
            text
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_is_low_for_psnr_and_high_for_flip() {
        let row = |name: &str, psnr_db: f64, flip: f64| PictureDifference {
            name: name.to_owned(),
            frame: 0,
            camera: 0,
            width: 8,
            height: 8,
            psnr_db,
            ssim: 0.9,
            flip,
            lpips: None,
            nothing_seen: false,
        };
        let found = summaries(&[row("a", 40.0, 0.3), row("b", 20.0, 0.1)]);
        assert_eq!(found.len(), 3, "no LPIPS without weights");
        assert_eq!((found[0].mean, found[0].worst, found[0].worst_name.as_str()), (30.0, 20.0, "b"));
        assert_eq!((found[2].worst, found[2].worst_name.as_str()), (0.3, "a"));
        let blank = PictureDifference { nothing_seen: true, ..row("c", 99.0, 0.0) };
        assert_eq!(
            summaries(&[row("a", 40.0, 0.3), blank])[0].mean,
            40.0,
            "what shows nothing is not perfect"
        );
        assert!(not_counted(&["c"], 1).is_err() && not_counted(&["c"], 2).unwrap().ends_with(": c"));
    }
}
