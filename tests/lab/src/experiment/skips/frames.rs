//! Measures what a sequence keeps between frames of one camera, and between delivery states of one frame.

use anyhow::{Result, ensure};
use codec_core::Gaussian;
use dgs::{
    args::ProfileName,
    pipeline::{self, Quiet},
};
use render_host::{Camera, Rendered, Renderer, ReuseCounts, ReuseOptions, SequenceRenderer, Splats};
use trainer_host::{
    Instant, Scene,
    encode::Protection,
    stream::{PacketMap, Player},
};

use super::paired::{max_abs, pair, pays, serial, share, time, verdict};
use crate::{
    figures::{Bench, Figure},
    setup::codec_args,
};

/// Delivery states of a clip.
const STATES: usize = 12;

/// Consecutive frames of a scene: the middle of the clip.
pub(super) fn consecutive(
    bench: &mut Bench,
    name: &str,
    scene: &Scene,
    camera: &Camera,
    frames: usize,
    runs: usize,
) -> Result<()> {
    let frames = frames.min(scene.frames());
    let first = (scene.frames() - frames) / 2;
    let instants: Vec<Instant> = (first..first + frames).filter_map(|f| scene.instant(f)).collect();
    measure(bench, &format!("{name}.frames"), &instants, camera, runs)
}

/// One frame of a scene while the packets of its stream arrive.
pub(super) fn states(
    bench: &mut Bench,
    name: &str,
    scene: &Scene,
    camera: &Camera,
    runs: usize,
    quiet: Quiet,
) -> Result<()> {
    let options = pipeline::encode_options(&codec_args(ProfileName::Dgs1), Protection::NONE);
    let stream = pipeline::encode(scene, &options, quiet)?.stream;
    let map = PacketMap::of(&stream)?;
    let received = stream.receive()?;
    let content = received.content();
    let mut player = Player::new(content.manifest);
    let (packets, frame) = (stream.packets().len(), scene.frames() as u32 / 2);
    let instants: Result<Vec<Instant>> = (1..=STATES)
        .map(|step| {
            let state = map.state(|id| id < packets * step / STATES);
            Ok(player.instant(&content.with_state(&state), frame)?)
        })
        .collect();
    measure(bench, &format!("{name}.states"), &instants?, camera, runs)
}

/// The first frame of a scene while its Gaussians arrive in equal parts, in order of index.
pub(super) fn arrivals(
    bench: &mut Bench,
    name: &str,
    scene: &Scene,
    camera: &Camera,
    runs: usize,
) -> Result<()> {
    let whole = scene.instant(0).unwrap_or_default();
    let n = whole.gaussians.len();
    let state = |step: usize| {
        let mut instant = whole.clone();
        instant.gaussians[n * step / STATES..].fill(Gaussian::ABSENT);
        instant
    };
    let instants: Vec<Instant> = (1..=STATES).map(state).collect();
    measure(bench, &format!("{name}.states"), &instants, camera, runs)
}

fn splats(instant: &Instant) -> Result<Splats<'_>> {
    Ok(Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?)
}

/// Everything kept, and each kind not kept, against fresh renders.
fn measure(bench: &mut Bench, key: &str, instants: &[Instant], camera: &Camera, runs: usize) -> Result<()> {
    let Some((first, rest)) = instants.split_first().filter(|(_, rest)| !rest.is_empty()) else {
        return Ok(());
    };
    let settings = serial();
    let mut renderer = Renderer::new();
    let mut sequence = SequenceRenderer::default();
    let (mut error, mut reused) = (0.0f64, Vec::new());
    for instant in instants {
        let fresh = renderer.render(&splats(instant)?, camera, &settings)?;
        let got = sequence.render(&splats(instant)?, camera, &settings)?;
        error = error.max(max_abs(&got.image, &fresh.image));
        reused.push((sequence.reused(), fresh.counters.tiles, instant.gaussians.len() as u64));
    }
    ensure!(error == 0.0, "{key}: a kept frame differs from a fresh one by {error}");
    let sum = |part: fn(&ReuseCounts) -> u64, whole: fn(&(ReuseCounts, u64, u64)) -> u64| {
        let frames = &reused[1..];
        share(frames.iter().map(|k| part(&k.0)).sum(), frames.iter().map(whole).sum())
    };
    bench.push(Figure::new(
        format!("{key}.projection.removed"),
        sum(|r| r.projections_reused, |k| k.2),
        "% of Gaussians not projected",
    ));
    bench.push(Figure::new(
        format!("{key}.lists.removed"),
        sum(|r| r.lists_reused, |k| k.1),
        "% of tile lists neither made nor mended",
    ));
    bench.push(Figure::new(
        format!("{key}.tiles.removed"),
        sum(|r| r.tiles_reused, |k| k.1),
        "% of tiles not blended (empty ones kept included)",
    ));

    // One pass over the frames after the first, per frame.
    let per_frame = rest.len() as f64;
    let mut out = Rendered::default();
    let fresh = |renderer: &mut Renderer, out: &mut Rendered| -> Result<f64> {
        let pass =
            || rest.iter().try_for_each(|i| Ok(renderer.render_into(&splats(i)?, camera, &settings, out)?));
        Ok(time(pass)? / per_frame)
    };
    let all = ReuseOptions::default();
    let choices = [
        ("projection", ReuseOptions { projection: false, ..all }),
        ("lists", ReuseOptions { order: false, ..all }),
        ("tiles", ReuseOptions { tiles: false, ..all }),
    ];
    let mut sequences: Vec<SequenceRenderer> = choices
        .iter()
        .map(|(_, reuse)| SequenceRenderer::new(*reuse))
        .chain([SequenceRenderer::default()])
        .collect();
    let mut times = vec![Vec::new(); sequences.len()];
    let mut plain = Vec::new();
    for _ in 0..runs {
        plain.push(fresh(&mut renderer, &mut out)?);
        for (sequence, times) in sequences.iter_mut().zip(&mut times) {
            sequence.render(&splats(first)?, camera, &settings)?;
            let pass = || {
                rest.iter().try_for_each(|i| {
                    sequence.render(&splats(i)?, camera, &settings)?;
                    Ok(())
                })
            };
            times.push(time(pass)? / per_frame);
        }
    }
    let mut failing = Vec::new();
    let Some((sequence, others)) = times.split_last() else { return Ok(()) };
    for ((name, _), other) in choices.iter().zip(others) {
        let figure = pair(format!("{key}.{name}"), sequence, other).error(error, "max abs to fresh");
        if !pays(&figure) {
            failing.push(*name);
        }
        bench.push(figure);
    }
    let mut whole = pair(format!("{key}.sequence"), sequence, &plain).error(error, "max abs to fresh");
    whole.peer = Some("fresh renders".to_owned());
    if !pays(&whole) {
        failing.push("sequence");
    }
    bench.push(whole);
    bench.push(verdict(key, &failing));
    Ok(())
}
