//! Measures conversions of a large still scene: time, size, memory, beside splat-transform where installed.

use std::{path::Path, process::Command, time::Instant};

use anyhow::{Context, Result, ensure};
use render_host::{Backend, Camera, Image, Settings, metric};
use trainer_host::{
    Epoch, Scene, evaluator, export,
    import::{ImportOptions, import},
    viewpoint::{Framing, Ring},
};

use super::demo::peak_bytes;
use crate::{
    figures::{Bench, Figure},
    setup::{Setup, synth},
};

/// Formats by the ending of their files.
const FORMATS: [&str; 6] = ["ply", "compressed.ply", "spz", "splat", "sog", "glb"];
/// Side of the picture that is compared, pixels.
const SIDE: u32 = 256;
/// Names the peer's program where it is not on the path.
const PEER: &str = "SPLAT_TRANSFORM";

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let count = if setup.quick { 100_000 } else { 1_000_000 };
    let mut bench = Bench::new(
        "convert",
        format!(
            "synth figure of {count} Gaussians, one frame, no harmonics above band 0: PLY read from a file, \
             written to a file in each format, wall time of both together, once; error: mean squared error \
             of a picture ({SIDE}x{SIDE}, black, one camera) of what is read back; the peer is \
             splat-transform on the processor (-g cpu), a process of its own each time, its start included; \
             order of ours and the peer alternates"
        ),
    );
    let folder = std::env::temp_dir().join(format!("dgs-bench-convert-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let measured = measure(&folder, count, &mut bench);
    std::fs::remove_dir_all(&folder)?;
    measured?;
    match peak_bytes() {
        Some(bytes) => bench.push(Figure::new("peak_memory_mib", bytes / 1048576.0, "MiB")),
        None => bench.skipped.push("peak memory: this system does not tell (/proc/self/status)".into()),
    }
    Ok(bench)
}

fn measure(folder: &Path, count: usize, bench: &mut Bench) -> Result<()> {
    let scene = synth("figure", count, 1)?;
    let source = folder.join("source.ply");
    std::fs::write(&source, export::ply::encode(&scene.epochs()[0], 0))?;
    let camera = Framing::of(&scene).ring(Ring::HeldOut, 1, (SIDE, SIDE))?.remove(0);
    let expected = picture(&scene, &camera)?;
    drop(scene);
    let peer = std::env::var(PEER).unwrap_or_else(|_| "splat-transform".to_owned());
    let has_peer = Command::new(&peer).arg("--version").output().is_ok_and(|output| output.status.success());
    if !has_peer {
        bench.skipped.push(format!("splat-transform is not installed ({PEER} names it)"));
    }
    for (turn, format) in FORMATS.into_iter().enumerate() {
        let (ours, theirs) = (folder.join(format!("ours.{format}")), folder.join(format!("theirs.{format}")));
        // What the peer does not write is measured alone.
        let peer_writes = has_peer && format != "splat";
        let mut peer_s = None;
        if peer_writes && turn % 2 == 1 {
            peer_s = timed_peer(&peer, &source, &theirs);
        }
        let start = Instant::now();
        let scene = import(&source, &ImportOptions::default())?;
        std::fs::write(&ours, encoded(format, &scene.epochs()[0])?)?;
        let seconds = start.elapsed().as_secs_f64();
        // A quick writer of something else would be no figure.
        let again = import(&ours, &ImportOptions::default())?;
        let (found, wanted) = (again.max_count(), scene.max_count());
        ensure!(found == wanted, "{format}: {found} Gaussians of {wanted} come back");
        let error = metric::mse(&picture(&again, &camera)?, &expected)?;
        if peer_writes && turn % 2 == 0 {
            peer_s = timed_peer(&peer, &source, &theirs);
        }
        let size = |path: &Path| std::fs::metadata(path).map(|found| found.len() as f64);
        let mut wall = Figure::new(format!("ply_to_{format}.wall_s"), seconds, "s")
            .runs(1)
            .error(error, "mean squared error of a picture, of 1");
        let mut bytes = Figure::new(format!("ply_to_{format}.bytes"), size(&ours)?, "bytes");
        if let Some(peer_s) = peer_s {
            wall = wall.peer("splat-transform", peer_s, true);
            bytes = bytes.peer("splat-transform", size(&theirs)?, true);
        }
        bench.push(wall);
        bench.push(bytes);
    }
    Ok(())
}

/// The first frame of `scene` as `camera` sees it.
fn picture(scene: &Scene, camera: &Camera) -> Result<Image> {
    Ok(evaluator::references(scene, &[0], camera, &Settings::default(), &Backend::Cpu)?.remove(0))
}

/// Seconds that the peer takes, if it can do it.
fn timed_peer(peer: &str, from: &Path, to: &Path) -> Option<f64> {
    let start = Instant::now();
    let ended = Command::new(peer).args(["-q", "-w", "-g", "cpu"]).args([from, to]).output().ok()?;
    (ended.status.success() && to.is_file()).then(|| start.elapsed().as_secs_f64())
}

fn encoded(format: &str, epoch: &Epoch) -> Result<Vec<u8>> {
    let failed = || format!("ply to {format}");
    Ok(match format {
        "compressed.ply" => export::compressed_ply::encode(epoch, 0),
        "spz" => export::spz::encode(epoch, 0, &export::spz::SpzOptions::default()).with_context(failed)?,
        "splat" => export::splat::encode(epoch, 0),
        "sog" => export::sog::encode(epoch, 0, false).with_context(failed)?,
        "glb" => export::gltf::encode(epoch, 0).with_context(failed)?,
        _ => export::ply::encode(epoch, 0),
    })
}
