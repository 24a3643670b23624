//! Measures public files as they are: their size, and what `dgs1` needs at the same count.

use anyhow::Result;
use render_host::{Backend, Settings, metric};
use trainer_host::{
    Scene, evaluator,
    viewpoint::{Framing, Ring},
};

use super::{
    bjontegaard::{RateCurve, efficient},
    codec::Codec,
    scenes::Evaluator,
};
use crate::{
    figures::{Bench, Figure},
    setup::{Setup, load},
};

/// The files measured: sizes of the biker's two encodings and of the playbot's detail levels.
///
/// # Errors
/// What importing says.
pub fn run(bench: &mut Bench, setup: &Setup, size: u32, ours: &Codec) -> Result<()> {
    for (key, path) in [
        ("biker.spz-file", "scenes/splat-biker/biker.spz"),
        ("biker.compressed-ply-file", "scenes/splat-biker/biker.compressed.ply"),
    ] {
        let Some(path) = setup.data(path, bench)? else { continue };
        let bytes = std::fs::metadata(&path)?.len() as f64;
        bench.push(Figure::new(format!("{key}.bytes"), bytes, "byte"));
        if !setup.quick {
            let count = load(&path, 0)?.max_count() as f64;
            bench.push(Figure::new(format!("{key}.bits_per_gaussian"), 8.0 * bytes / count, "bit"));
        }
    }
    if setup.quick {
        return Ok(());
    }
    readers(bench, setup, size)?;
    for level in [2, 3, 4] {
        let Some(folder) = setup.data(&format!("scenes/splat-playbot-lod/{level}_0"), bench)? else {
            continue;
        };
        let mut bytes = 0;
        for entry in std::fs::read_dir(&folder)? {
            bytes += entry?.metadata()?.len();
        }
        let scene = load(&folder.join("meta.json"), 0)?;
        sog(bench, &format!("playbot-{level}"), &scene, bytes as f64, size, ours)?;
    }
    Ok(())
}

/// A SOG scene: its own bits, and those at which `dgs1` looks like it to 45 dB. The SOG file's own error is
/// unknown, since its source is; `dgs1` is charged for reproducing that error too.
fn sog(bench: &mut Bench, key: &str, scene: &Scene, bytes: f64, size: u32, ours: &Codec) -> Result<()> {
    let count = scene.max_count() as f64;
    let own = 8.0 * bytes / count;
    bench.push(Figure::new(format!("{key}.sog-file.bits_per_gaussian"), own, "bit"));
    let evaluator = Evaluator::of(scene, size, 1)?;
    let mut points = Vec::new();
    for &setting in ours.settings.iter().step_by(2) {
        let coded = (ours.code)(scene, setting, ours.level, &evaluator.frames)?;
        points.push((8.0 * coded.bytes as f64 / count, evaluator.marks(&coded.shown)?.psnr));
    }
    match RateCurve::new(&efficient(&points)) {
        Ok(curve) => {
            for psnr in [40.0, 45.0, 50.0] {
                if let Some(bits) = curve.rate_at(psnr) {
                    let figure = Figure::new(format!("{key}.dgs1.bits_at_{psnr}_db"), bits, "bit");
                    bench.push(figure.peer("sog", own, true));
                }
            }
        }
        Err(why) => bench.skipped.push(format!("{key}: {why}")),
    }
    Ok(())
}

/// The two encodings of one scene, through two readers.
fn readers(bench: &mut Bench, setup: &Setup, size: u32) -> Result<()> {
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
    let camera = &Framing::of(&a).ring(Ring::HeldOut, 3, (size, size))?[0];
    let settings = Settings::default();
    let one = evaluator::references(&a, &[0], camera, &settings, &Backend::Cpu)?;
    let psnr = metric::psnr(&evaluator::render(&turned, camera, &settings)?, &one[0])?;
    bench.push(Figure::new("biker.readers.psnr", psnr, "dB"));
    let apart = a.max_count().abs_diff(b.max_count()) as f64;
    bench.push(Figure::new("biker.readers.gaussians_apart", apart, ""));
    Ok(())
}
