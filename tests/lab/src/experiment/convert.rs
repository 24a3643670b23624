//! Measures conversions of a large still scene: time, size, memory, beside splat-transform where installed;
//! and what decimation leaves of pictures.

mod decimate;
mod peer;

use std::{fs, path::Path, process::Command, time::Instant};

use anyhow::{Context, Result, ensure};
use render_host::{Backend, Camera, Image, Settings, metric};
use trainer_host::{
    Epoch, Scene, evaluator, export,
    import::{ImportOptions, import},
    viewpoint::{Framing, Ring},
};

use self::peer::{MIB, Taken, forget_peak, timed_peer, timed_ply_to_spz};
use super::demo::push_peak_memory;
use crate::{
    figures::{Bench, Figure, Machine},
    setup::{Setup, synth},
};

/// Formats by the ending of their files.
const FORMATS: [&str; 6] = ["ply", "compressed.ply", "spz", "splat", "sog", "glb"];
/// Side of the picture that is compared, pixels.
const SIDE: u32 = 256;
/// Names the peer's program where it is not on the path.
const PEER: &str = "SPLAT_TRANSFORM";
/// Names the program `ply_to_spz` of Niantic's spz.
const NIANTIC: &str = "PLY_TO_SPZ";

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
             order of ours and the peer alternates; ply_to_spz.niantic: the program of Niantic's spz; \
             memory: largest resident set of the process meanwhile"
        ),
    );
    let folder = std::env::temp_dir().join(format!("dgs-bench-convert-{}", std::process::id()));
    fs::create_dir_all(&folder)?;
    bench.also(decimate::PROTOCOL);
    let measured = measure(setup, &folder, count, &mut bench);
    fs::remove_dir_all(&folder)?;
    measured?;
    push_peak_memory(&mut bench);
    Ok(bench)
}

fn measure(setup: &Setup, folder: &Path, count: usize, bench: &mut Bench) -> Result<()> {
    let scene = synth("figure", count, 1)?;
    let source = folder.join("source.ply");
    fs::write(&source, export::ply::encode(&scene.epochs()[0], 0))?;
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
        let mut of_peer = None;
        if peer_writes && turn % 2 == 1 {
            of_peer = timed_peer(&peer, &source, &[], &theirs);
        }
        let begins_low = forget_peak();
        let start = Instant::now();
        let scene = import(&source, &ImportOptions::default())?;
        fs::write(&ours, encoded(format, &scene.epochs()[0])?)?;
        let seconds = start.elapsed().as_secs_f64();
        let peak = Machine::peak_memory_bytes("self").filter(|_| begins_low);
        // A quick writer of something else would be no figure.
        let again = import(&ours, &ImportOptions::default())?;
        let (found, wanted) = (again.max_count(), scene.max_count());
        ensure!(found == wanted, "{format}: {found} Gaussians of {wanted} come back");
        let error = metric::mse(&picture(&again, &camera)?, &expected)?;
        if peer_writes && turn % 2 == 0 {
            of_peer = timed_peer(&peer, &source, &[], &theirs);
        }
        let size = |path: &Path| fs::metadata(path).map(|found| found.len() as f64);
        let mut wall = Figure::new(format!("ply_to_{format}.wall_s"), seconds, "s")
            .runs(1)
            .error(error, "mean squared error of a picture, of 1");
        let mut bytes = Figure::new(format!("ply_to_{format}.bytes"), size(&ours)?, "bytes");
        let mut memory =
            peak.map(|peak| Figure::new(format!("ply_to_{format}.memory_mib"), peak as f64 / MIB, "MiB"));
        if let Some(Taken { seconds, peak }) = of_peer {
            wall = wall.peer("splat-transform", seconds, true);
            bytes = bytes.peer("splat-transform", size(&theirs)?, true);
            memory = memory.map(|memory| memory.peer("splat-transform", peak as f64 / MIB, true));
        }
        bench.push(wall);
        bench.push(bytes);
        match memory {
            Some(memory) => bench.push(memory),
            None => bench.skipped.push(format!("ply_to_{format}.memory_mib: this system does not tell")),
        }
    }
    niantic(folder, &source, (&camera, &expected), bench)?;
    decimate::measure(setup, folder, &source, has_peer.then_some(&*peer), bench)
}

/// Adds ours of `source`, of which a camera sees a picture, to SPZ, once more, beside Niantic's own program.
fn niantic(
    folder: &Path,
    source: &Path,
    (camera, expected): (&Camera, &Image),
    bench: &mut Bench,
) -> Result<()> {
    let Ok(program) = std::env::var(NIANTIC) else {
        bench.skipped.push(format!("Niantic's spz: {NIANTIC} names no program of it"));
        return Ok(());
    };
    let (ours, theirs) = (folder.join("again.spz"), folder.join("niantic.spz"));
    let taken = timed_ply_to_spz(&program, source, &theirs)
        .with_context(|| format!("{program}: does not run, or writes no file ({NIANTIC})"))?;
    let start = Instant::now();
    let scene = import(source, &ImportOptions::default())?;
    fs::write(&ours, encoded("spz", &scene.epochs()[0])?)?;
    let seconds = start.elapsed().as_secs_f64();
    let error = metric::mse(&picture(&import(&ours, &ImportOptions::default())?, camera)?, expected)?;
    let wall = Figure::new("ply_to_spz.niantic.wall_s", seconds, "s")
        .runs(1)
        .error(error, "mean squared error of a picture, of 1");
    bench.push(wall.peer("ply_to_spz", taken.seconds, true));
    let size = |path: &Path| fs::metadata(path).map(|found| found.len() as f64);
    let bytes = Figure::new("ply_to_spz.niantic.bytes", size(&ours)?, "bytes");
    bench.push(bytes.peer("ply_to_spz", size(&theirs)?, true));
    let peak = taken.peak as f64 / MIB;
    bench.push(Figure::new("ply_to_spz.niantic.its_memory_mib", peak, "MiB"));
    let again = import(&theirs, &ImportOptions::default())?;
    let (found, wanted) = (again.max_count(), scene.max_count());
    ensure!(found == wanted, "niantic.spz: {found} Gaussians of {wanted} are read");
    Ok(())
}

/// The first frame of `scene` as `camera` sees it.
fn picture(scene: &Scene, camera: &Camera) -> Result<Image> {
    Ok(evaluator::references(scene, &[0], camera, &Settings::default(), &Backend::Cpu)?.remove(0))
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
