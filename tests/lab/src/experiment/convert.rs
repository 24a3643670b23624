//! Measures conversions of a large still scene: time, size, memory, beside splat-transform where installed.

use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, ensure};
use render_host::{Backend, Camera, Image, Settings, metric};
use trainer_host::{
    Epoch, Scene, evaluator, export,
    import::{ImportOptions, import},
    viewpoint::{Framing, Ring},
};

use super::demo::{peak_bytes, peak_bytes_of};
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

/// Bytes of a mebibyte.
const MIB: f64 = 1048576.0;
/// How often it is looked how much memory the peer takes.
const WATCH: Duration = Duration::from_millis(5);

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
             order of ours and the peer alternates; memory: largest resident set of the process meanwhile"
        ),
    );
    let folder = std::env::temp_dir().join(format!("dgs-bench-convert-{}", std::process::id()));
    fs::create_dir_all(&folder)?;
    let measured = measure(&folder, count, &mut bench);
    fs::remove_dir_all(&folder)?;
    measured?;
    match peak_bytes() {
        Some(bytes) => bench.push(Figure::new("peak_memory_mib", bytes / MIB, "MiB")),
        None => bench.skipped.push("peak memory: this system does not tell (/proc/self/status)".into()),
    }
    Ok(bench)
}

fn measure(folder: &Path, count: usize, bench: &mut Bench) -> Result<()> {
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
            of_peer = timed_peer(&peer, &source, &theirs);
        }
        let begins_low = forget_peak();
        let start = Instant::now();
        let scene = import(&source, &ImportOptions::default())?;
        fs::write(&ours, encoded(format, &scene.epochs()[0])?)?;
        let seconds = start.elapsed().as_secs_f64();
        let peak = peak_bytes().filter(|_| begins_low);
        // A quick writer of something else would be no figure.
        let again = import(&ours, &ImportOptions::default())?;
        let (found, wanted) = (again.max_count(), scene.max_count());
        ensure!(found == wanted, "{format}: {found} Gaussians of {wanted} come back");
        let error = metric::mse(&picture(&again, &camera)?, &expected)?;
        if peer_writes && turn % 2 == 0 {
            of_peer = timed_peer(&peer, &source, &theirs);
        }
        let size = |path: &Path| fs::metadata(path).map(|found| found.len() as f64);
        let mut wall = Figure::new(format!("ply_to_{format}.wall_s"), seconds, "s")
            .runs(1)
            .error(error, "mean squared error of a picture, of 1");
        let mut bytes = Figure::new(format!("ply_to_{format}.bytes"), size(&ours)?, "bytes");
        let mut memory =
            peak.map(|peak| Figure::new(format!("ply_to_{format}.memory_mib"), peak / MIB, "MiB"));
        if let Some(Taken { seconds, peak }) = of_peer {
            wall = wall.peer("splat-transform", seconds, true);
            bytes = bytes.peer("splat-transform", size(&theirs)?, true);
            memory = memory.map(|memory| memory.peer("splat-transform", peak / MIB, true));
        }
        bench.push(wall);
        bench.push(bytes);
        match memory {
            Some(memory) => bench.push(memory),
            None => bench.skipped.push(format!("ply_to_{format}.memory_mib: this system does not tell")),
        }
    }
    Ok(())
}

/// The first frame of `scene` as `camera` sees it.
fn picture(scene: &Scene, camera: &Camera) -> Result<Image> {
    Ok(evaluator::references(scene, &[0], camera, &Settings::default(), &Backend::Cpu)?.remove(0))
}

/// Lets the largest resident set of this process begin anew; false where the system cannot.
fn forget_peak() -> bool {
    fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// What the peer took: time, and its largest resident set, bytes.
struct Taken {
    seconds: f64,
    peak: f64,
}

/// What the peer takes, if it can do it.
fn timed_peer(peer: &str, from: &Path, to: &Path) -> Option<Taken> {
    let start = Instant::now();
    let mut command = Command::new(peer);
    command.args(["-q", "-w", "-g", "cpu"]).args([from, to]);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().ok()?;
    let mut peak: f64 = 0.0;
    let status = loop {
        // Its counter only grows, so that the last look has all but the last moment.
        peak = peak.max(peak_bytes_of(&child.id().to_string()).unwrap_or(0.0));
        if let Some(status) = child.try_wait().ok()? {
            break status;
        }
        thread::sleep(WATCH);
    };
    (status.success() && to.is_file()).then(|| Taken { seconds: start.elapsed().as_secs_f64(), peak })
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
