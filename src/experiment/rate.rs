//! Rate and quality of the complete decoded state, both profiles, real and synthetic scenes.

use std::time::Instant;

use anyhow::Result;
use rayon::prelude::*;
use render_host::{Settings, metric};
use trainer_host::{
    Scene,
    encode::Protection,
    stream::Player,
    viewpoint::{Framing, Ring},
};

use super::{Setup, codec_args, load, spread, synth};
use crate::{
    args::ProfileName,
    figures::{Bench, Figure, mean, median},
    pipeline, quality,
};

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (size, shown) = if setup.quick { (200, 2) } else { (400, 6) };
    let mut bench = Bench::new(
        "rate",
        format!(
            "complete decoded state against the uncompressed source's own render; 3 held-out ring cameras at {size}x{size}, \
             black background, up to {shown} frames spread over the clip; default quality, PSNR capped at 99 dB; \
             decode = packets to symbols to Gaussians, per frame"
        ),
    );
    let n = if setup.quick { 3000 } else { 20_000 };
    for kind in ["balls", "figure", "cloth", "births"] {
        let scene = synth(kind, n, if setup.quick { 20 } else { 60 })?;
        measure(&mut bench, &format!("synth-{kind}"), &scene, size, shown, setup)?;
    }
    let samples = if setup.quick { 4000 } else { 20_000 };
    for (key, path) in [
        ("fox", "scenes/gltf-fox/Fox.glb"),
        ("cesium-man", "scenes/gltf-cesium-man/CesiumMan.glb"),
        ("biker-spz", "scenes/splat-biker/biker.spz"),
        ("biker-ply", "scenes/splat-biker/biker.compressed.ply"),
        ("human", "scenes/splat-seq-human"),
    ] {
        if let Some(path) = setup.data(path, &mut bench)? {
            if setup.quick && !matches!(key, "fox" | "cesium-man") {
                bench.skipped.push(format!("{key}: left out by --quick"));
                continue;
            }
            let scene = load(&path, samples)?;
            measure(&mut bench, key, &scene, size, shown, setup)?;
        }
    }
    readers(&mut bench, setup, size)?;
    Ok(bench)
}

fn measure(
    bench: &mut Bench,
    key: &str,
    scene: &Scene,
    size: u32,
    shown: usize,
    setup: &Setup,
) -> Result<()> {
    let framing = Framing::of(scene, [0.0, 1.0, 0.0]);
    let cameras = framing.ring(Ring::HeldOut, 3, (size, size))?;
    let frames = spread(scene.frames(), shown);
    let settings = Settings::default();
    let mut bits = Vec::new();
    for profile in [ProfileName::Dgs1, ProfileName::Paper] {
        let options = pipeline::encode_options(&codec_args(profile), Protection::NONE);
        let name = pipeline::profile_name(options.profile);
        let start = Instant::now();
        let stream = pipeline::encode(scene, &options, setup.quiet)?;
        let encode_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let received = stream.receive()?;
        let receive_s = start.elapsed().as_secs_f64();
        let content = received.content();
        let mut player = Player::new(&content.manifest);
        let start = Instant::now();
        for frame in 0..scene.frames() as u32 {
            player.show(&content, frame)?;
        }
        let show_s = start.elapsed().as_secs_f64();
        let mut scores = Vec::new();
        for camera in &cameras {
            let references = quality::references(scene, &frames, camera, &settings)?;
            let states: Vec<_> = frames.iter().map(|&f| (f, Some(content.blocks))).collect();
            let images = quality::renders(&content, &states, camera, &settings)?;
            let these: Result<Vec<_>> = images
                .par_iter()
                .zip(&references)
                .map(|(a, b)| Ok((quality::score(a, b)?, quality::flip(a, b)?)))
                .collect();
            scores.extend(these?);
        }
        let ledger = stream.ledger();
        let column =
            |f: &dyn Fn(&(quality::Score, f64)) -> f64| -> Vec<f64> { scores.iter().map(f).collect() };
        let frames = scene.frames() as f64;
        let key = |what: &str| format!("{key}.{name}.{what}");
        bench.push(Figure::new(key("bits_per_gaussian"), ledger.bits_per_gaussian(), "bit"));
        bench.push(Figure::new(key("bytes_per_frame"), ledger.bytes_per_frame(), "byte"));
        bench.push(Figure::new(key("manifest"), ledger.manifest, "byte"));
        bench.push(Figure::new(key("psnr_mean"), mean(&column(&|s| s.0.psnr_db)), "dB"));
        bench.push(Figure::new(
            key("psnr_min"),
            column(&|s| s.0.psnr_db).into_iter().fold(f64::MAX, f64::min),
            "dB",
        ));
        bench.push(Figure::new(key("ssim"), mean(&column(&|s| s.0.ssim)), ""));
        bench.push(Figure::new(key("flip"), mean(&column(&|s| s.1)), ""));
        let psnr = median(&column(&|s| s.0.psnr_db));
        bench.push(Figure::new(key("encode"), encode_s, "s").error(psnr, "dB median PSNR"));
        let decode = 1000.0 * (receive_s + show_s) / frames;
        bench.push(Figure::new(key("decode"), decode, "ms/frame").error(psnr, "dB median PSNR"));
        bits.push(ledger.bits_per_gaussian());
    }
    let ratio = Figure::new(format!("{key}.dgs1_over_paper"), bits[0], "bit").peer("paper", bits[1], true);
    bench.push(ratio);
    Ok(())
}

/// The two encodings of one scene, through two readers.
fn readers(bench: &mut Bench, setup: &Setup, size: u32) -> Result<()> {
    if setup.quick {
        return Ok(());
    }
    let spz = setup.data("scenes/splat-biker/biker.spz", bench)?;
    let ply = setup.data("scenes/splat-biker/biker.compressed.ply", bench)?;
    let Some((spz, ply)) = spz.zip(ply) else { return Ok(()) };
    let (a, b) = (load(&spz, 0)?, load(&ply, 0)?);
    // The two files hold the same object half a turn about x apart.
    let mut turned = b.instant(0).unwrap_or_default();
    for g in &mut turned.gaussians {
        let ([x, y, z], [qw, qx, qy, qz]) = (g.position, g.rotation);
        g.position = [x, -y, -z];
        g.rotation = [-qx, qw, -qz, qy];
    }
    let camera = &Framing::of(&a, [0.0, 1.0, 0.0]).ring(Ring::HeldOut, 3, (size, size))?[0];
    let settings = Settings::default();
    let one = quality::references(&a, &[0], camera, &settings)?;
    let psnr = metric::psnr(&quality::render(&turned, camera, &settings)?, &one[0])?;
    bench.push(Figure::new("biker.readers.psnr", psnr, "dB"));
    bench.push(Figure::new(
        "biker.readers.gaussians_apart",
        a.max_count().abs_diff(b.max_count()) as f64,
        "",
    ));
    Ok(())
}
