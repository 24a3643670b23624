//! Compares two scenes, streams or sets of pictures, by pictures and by Gaussians: `dgs compare`.

mod attributes;
mod side;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use codec_core::internals::ids::Level;
use render_host::{
    Backend, Camera, FrameRenderer, Image, Settings, Splats,
    metric::{self, Lpips, flip::PIXELS_PER_DEGREE},
};
use serde::Serialize;
use serde_json::json;
use trainer_host::{evaluator::PSNR_CAP_DB, viewpoint::Ring};

use self::{
    attributes::{AttributeDifferences, differences},
    side::Side,
};
use crate::{
    args::Compare,
    figures::mean,
    files::{self, FrameFolder},
    output::VerbOutput,
    pipeline::{self, Frames, Quiet, Showing, Surroundings},
    progress::Progress,
};

/// Cameras around scenes without their own.
const CAMERAS: usize = 3;
/// Width and height of pictures where nothing else says, pixels.
const SIZE: (u32, u32) = (512, 512);
/// Lines of pictures that are printed; `--json` has them all.
const LINES: usize = 20;

/// What is compared with what, once.
struct Pair {
    /// File name of the heat map, without its ending.
    name: String,
    frame: u32,
    camera: usize,
    a: Source,
    b: Source,
}

/// Where one picture of a pair comes from.
enum Source {
    File(PathBuf),
    Render(Box<Camera>),
}

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
    if let Some(out) = &args.out {
        FrameFolder::create(out, args.overwrite)?;
    }
    let network = args.lpips.as_deref().map(lpips).transpose()?;
    let backend = Backend::open(args.device.into()).context("--device")?;
    let level = Level::from_bits(args.level);
    let mut warnings = Vec::new();
    let mut open = |input: &str| Side::open(input, &args.scene, level, &mut |w| warnings.push(w));
    let (mut a, mut b) = (open(&args.a)?, open(&args.b)?);
    let (pairs, cameras) = pairs(args, &mut a, &mut b)?;
    let settings = pipeline::settings(&args.view);

    let mut folder = args.out.as_deref().map(|out| FrameFolder::create(out, args.overwrite)).transpose()?;
    let mut renderers = [backend.frames()?, backend.frames()?];
    let mut rows = Vec::with_capacity(pairs.len());
    let progress = Progress::new("compare", quiet.0);
    for (done, pair) in pairs.iter().enumerate() {
        progress.step("comparing", done, pairs.len());
        let [of_a, of_b] = &mut renderers;
        let a = picture(&pair.a, &mut a, pair.frame, of_a, &settings)?;
        let b = picture(&pair.b, &mut b, pair.frame, of_b, &settings)?;
        let (row, map) = compared(pair, &a, &b, network.as_ref())?;
        if let Some(folder) = &mut folder {
            let heat = metric::heat::map(a.width(), a.height(), &map, 1.0)?;
            folder.add(format!("{}.png", pair.name), &Image::strip(&[&a, &b, &heat], 3, 2)?.to_png()?)?;
        }
        rows.push(row);
    }
    drop(progress);
    if let Some(folder) = folder {
        folder.finish(args.overwrite)?;
    }
    let gaussians = gaussians(&mut a, &mut b, &pairs)?;
    let summaries = summaries(&rows);
    let background = args.view.background;
    let notes: Vec<&String> = [&a, &b].into_iter().flat_map(notes).collect();
    let mut text = format!(
        "{} against {}: {} pictures, {cameras}, background {background:?}\n",
        args.a,
        args.b,
        rows.len()
    );
    text += &table(&rows, &summaries);
    text += &attribute_lines(&gaussians);
    for note in &notes {
        text += &format!("  note: {note}\n");
    }
    if let Some(out) = &args.out {
        text += &format!("A, B and FLIP of each picture → {}\n", out.display());
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

fn lpips(path: &Path) -> Result<Lpips> {
    let failed = || format!("--lpips {}", path.display());
    let bytes = std::fs::read(path).with_context(failed)?;
    Lpips::from_safetensors(&bytes).with_context(failed)
}

fn notes(side: &Side) -> &[String] {
    match side {
        Side::Frames(frames) => frames.notes(),
        Side::Pictures(_) => &[],
    }
}

/// What is compared with what, and from where, for people.
fn pairs(args: &Compare, a: &mut Side, b: &mut Side) -> Result<(Vec<Pair>, String)> {
    match (a, b) {
        (Side::Pictures(a), Side::Pictures(b)) => {
            let pairs = side::pairs(a, b)?.into_iter().enumerate();
            let pair = |(i, (a, b)): (usize, (PathBuf, PathBuf))| {
                let name = side::stem(&b.to_string_lossy()).to_owned();
                Pair { name, frame: i as u32, camera: 0, a: Source::File(a), b: Source::File(b) }
            };
            Ok((unique(pairs.map(pair).collect()), "as they are".to_owned()))
        }
        (Side::Frames(a), Side::Frames(b)) => {
            let count = matched_frames(args, a.count(), b.count())?;
            let (list, cameras) = views(args, b, count, None)?;
            let pair = |Shown { name, frame, camera, from }: Shown| {
                let render = Source::Render(Box::new(from));
                let twin = match &render {
                    Source::Render(camera) => Source::Render(camera.clone()),
                    Source::File(path) => Source::File(path.clone()),
                };
                Pair { name, frame, camera, a: render, b: twin }
            };
            Ok((list.into_iter().map(pair).collect(), cameras))
        }
        (Side::Frames(frames), Side::Pictures(paths)) => {
            photographed(args, frames, paths, |name, frame, camera, rendered, file| Pair {
                name,
                frame,
                camera,
                a: rendered,
                b: file,
            })
        }
        (Side::Pictures(paths), Side::Frames(frames)) => {
            photographed(args, frames, paths, |name, frame, camera, rendered, file| Pair {
                name,
                frame,
                camera,
                a: file,
                b: rendered,
            })
        }
    }
}

/// Pairs of renders of `frames` and pictures that are there.
fn photographed(
    args: &Compare,
    frames: &mut Frames,
    paths: &[PathBuf],
    pair: impl Fn(String, u32, usize, Source, Source) -> Pair,
) -> Result<(Vec<Pair>, String)> {
    let first = paths.first().context("no pictures")?;
    let size = side::read(first, args.view.background)?.size();
    let count = frames.count();
    let (list, cameras) = views(args, frames, count, Some(size))?;
    let names: Vec<&str> = list.iter().map(|shown| shown.name.as_str()).collect();
    let (paths, how) = match side::by_name(paths, &names) {
        Some(paths) => (paths, "matched by name"),
        None if paths.len() == list.len() => (paths.to_vec(), "matched by order"),
        None => {
            bail!(
                "{} pictures, and cameras and frames for {}; as many are needed: --camera, --frames",
                paths.len(),
                list.len()
            )
        }
    };
    let pairs = list.into_iter().zip(paths).map(|(shown, path)| {
        let render = Source::Render(Box::new(shown.from));
        pair(shown.name, shown.frame, shown.camera, render, Source::File(path))
    });
    Ok((pairs.collect(), format!("{cameras}, {how}")))
}

/// A picture that is to be rendered.
struct Shown {
    name: String,
    frame: u32,
    camera: usize,
    from: Camera,
}

/// Of how many frames some are compared: both sides have as many, or those that were chosen. A side of one
/// frame stands for any one frame.
fn matched_frames(args: &Compare, a: u32, b: u32) -> Result<u32> {
    let most = a.max(b);
    let chosen = args.frames.map(|range| range.within(most)).transpose()?;
    let has = |count: u32| {
        chosen.as_ref().is_some_and(|chosen| chosen.end <= count || (count == 1 && chosen.len() == 1))
    };
    if a != b && !(has(a) && has(b)) {
        let (first, second) = (&args.a, &args.b);
        bail!("{first} and {second} have {a} and {b} frames; as many are needed, or --frames that both have");
    }
    Ok(most)
}

/// The frame of `side` that stands for `frame`.
fn frame_of(side: &Frames, frame: u32) -> u32 {
    if side.count() == 1 { 0 } else { frame }
}

/// The pictures to render, of a clip of `count` frames, and from where, for people.
fn views(
    args: &Compare,
    frames: &mut Frames,
    count: u32,
    size: Option<(u32, u32)>,
) -> Result<(Vec<Shown>, String)> {
    let (own, up) = (frames.cameras().to_vec(), frames.up());
    let mut around = Surroundings {
        own: &own,
        framing: &mut || frames.framing(),
        ring: (Ring::HeldOut, CAMERAS),
        size: size.unwrap_or(SIZE),
        up,
    };
    let found = pipeline::viewpoints(&args.cameras, &args.view, &mut around)?;
    let chosen = match args.frames {
        None => 0..count,
        Some(range) => range.within(count)?,
    };
    let mut list = Vec::new();
    for (camera, view) in found.views.iter().enumerate() {
        let name = side::stem(&view.name);
        let shown = |frame: u32, name: String| Shown { name, frame, camera, from: view.camera.clone() };
        if found.showing == Showing::Clip {
            let each = chosen.clone().map(|frame| shown(frame, format!("{frame:05}_camera{camera}")));
            list.extend(each);
        } else {
            let frame = found.showing.frame_of(view, camera, count)?;
            let name = if name.is_empty() { format!("{camera:05}") } else { name.to_owned() };
            list.push(shown(frame, name));
        }
    }
    if list.is_empty() {
        bail!("nothing to compare: no frame is chosen");
    }
    Ok((list, found.description))
}

/// Gives pictures of the same name a number.
fn unique(mut pairs: Vec<Pair>) -> Vec<Pair> {
    let mut names = std::collections::BTreeSet::new();
    for (i, pair) in pairs.iter_mut().enumerate() {
        if !names.insert(pair.name.clone()) {
            pair.name = format!("{}_{i:05}", pair.name);
            names.insert(pair.name.clone());
        }
    }
    pairs
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
    };
    Ok((row, flip.map))
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

/// Mean and worst of every metric.
fn summaries(rows: &[PictureDifference]) -> Vec<MetricSummary> {
    let metrics: [(&str, bool, Metric); 4] = [
        ("psnr_db", true, |row| Some(row.psnr_db)),
        ("ssim", true, |row| Some(row.ssim)),
        ("flip", false, |row| Some(row.flip)),
        ("lpips", false, |row| row.lpips),
    ];
    let mut out = Vec::new();
    for (metric, higher_is_better, value) in metrics {
        let values: Option<Vec<f64>> = rows.iter().map(value).collect();
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
        };
        let found = summaries(&[row("a", 40.0, 0.3), row("b", 20.0, 0.1)]);
        assert_eq!(found.len(), 3, "no LPIPS without weights");
        assert_eq!((found[0].mean, found[0].worst, found[0].worst_name.as_str()), (30.0, 20.0, "b"));
        assert_eq!((found[2].worst, found[2].worst_name.as_str()), (0.3, "a"));
    }
}
