//! Measures what fewer Gaussians leave of pictures: ours, splat-transform's, and what is left by dropping.

use std::{fs, path::Path, time::Instant};

use anyhow::{Result, ensure};
use codec_core::{Footprint, Gaussian};
use dgs::pipeline;
use render_host::{Camera, Image, Settings, Splats, metric};
use trainer_host::{
    Instant as Frame, Scene, edit,
    evaluator::PSNR_CAP_DB,
    export,
    import::{ImportOptions, import},
    viewpoint::{Framing, Ring},
};

use super::peer::{MIB, forget_peak, timed_peer};
use crate::{
    figures::{Bench, Figure, Machine, mean},
    setup::{Setup, scene_args, synth},
};

/// What is said of it in the protocol of the bench.
pub(super) const PROTOCOL: &str = "; decimation: PSNR against the whole scene, mean and worst of the three \
    default cameras of dgs compare (512x512, black), of the share of Gaussians in per cent that the key \
    names; dropped: what has most opacity times area of its two longer axes is left; time and memory of a \
    tenth of the synth figure, from a PLY to a PLY";
/// Shares of Gaussians left, per cent.
const SHARES: [usize; 3] = [50, 25, 10];
/// Scenes of the data folder.
const SCENES: [(&str, &str); 3] = [
    ("biker", "scenes/splat-biker/biker.compressed.ply"),
    ("human", "scenes/splat-seq-human/000020.asset"),
    ("playbot-2", "scenes/splat-playbot-lod/2_0"),
];
/// Gaussians of the scene that `--quick` measures instead.
const QUICK: usize = 10_000;
/// Cameras, and the side of their pictures, pixels: those of `dgs compare`.
const CAMERAS: usize = 3;
const SIDE: u32 = 512;

/// Adds the figures of decimation to `bench`: of `source`, a PLY of the bench's large scene, and of scenes.
/// Files go to `folder`; `peer` is the program of splat-transform.
pub(super) fn measure(
    setup: &Setup,
    folder: &Path,
    source: &Path,
    peer: Option<&str>,
    bench: &mut Bench,
) -> Result<()> {
    time(folder, source, peer, bench)?;
    if setup.quick {
        return quality("figure", &synth("figure", QUICK, 1)?, folder, peer, bench);
    }
    for (name, path) in SCENES {
        if let Some(path) = setup.data(path, bench)? {
            // Cameras stand where they do for `dgs compare`: up is that of the format.
            let args = dgs::args::SceneArgs { up: None, ..scene_args(1) };
            let scene = pipeline::import(&path.to_string_lossy(), &args)?.scene;
            quality(name, &scene, folder, peer, bench)?;
        }
    }
    Ok(())
}

/// Time and memory of leaving a tenth of `source`.
fn time(folder: &Path, source: &Path, peer: Option<&str>, bench: &mut Bench) -> Result<()> {
    let begins_low = forget_peak();
    let start = Instant::now();
    let scene = import(source, &ImportOptions::default())?;
    let few = edit::decimate(&scene, 0.1, &mut |_| {})?;
    fs::write(folder.join("few.ply"), export::ply::encode(&few.epochs()[0], 0))?;
    let seconds = start.elapsed().as_secs_f64();
    let peak = Machine::peak_memory_bytes("self").filter(|_| begins_low);
    let (found, of) = (few.max_count(), scene.max_count());
    ensure!((10 * found).abs_diff(of) < 10, "a tenth of {of}: {found} Gaussians are left");
    let mut wall = Figure::new("decimate.tenth.wall_s", seconds, "s").runs(1);
    let mut memory = peak.map(|peak| Figure::new("decimate.tenth.memory_mib", peak as f64 / MIB, "MiB"));
    let theirs = folder.join("few-theirs.ply");
    if let Some(taken) = peer.and_then(|peer| timed_peer(peer, source, &["--decimate", "10%"], &theirs)) {
        wall = wall.peer("splat-transform", taken.seconds, true);
        memory = memory.map(|memory| memory.peer("splat-transform", taken.peak as f64 / MIB, true));
    }
    bench.push(wall);
    match memory {
        Some(memory) => bench.push(memory),
        None => bench.skipped.push("decimate.tenth.memory_mib: this system does not tell".to_owned()),
    }
    Ok(())
}

/// What shares of the first frame of `scene` look like.
fn quality(name: &str, scene: &Scene, folder: &Path, peer: Option<&str>, bench: &mut Bench) -> Result<()> {
    let first = edit::frames(scene, 0, 0)?;
    let whole = frame(&first)?;
    let views = Views::of(&first, &whole)?;
    let source = folder.join(format!("{name}.ply"));
    fs::write(&source, export::ply::encode(&first.epochs()[0], 0))?;
    for percent in SHARES {
        let few = frame(&edit::decimate(&first, percent as f64 / 100.0, &mut |_| {})?)?;
        let ours = views.marks(&few)?;
        let dropped = views.marks(&dropped(&whole, few.gaussians.len()))?;
        ensure!(ours[0] > dropped[0], "{name}, {percent} %: {} dB, dropping leaves {}", ours[0], dropped[0]);
        let target = folder.join(format!("{name}-{percent}.ply"));
        let share = format!("{percent}%");
        let theirs = peer.and_then(|peer| timed_peer(peer, &source, &["--decimate", &share], &target));
        let theirs = match theirs {
            Some(_) => Some(views.marks(&frame(&import(&target, &ImportOptions::default())?)?)?),
            None => None,
        };
        for (k, mark) in ["psnr_db", "worst_db"].into_iter().enumerate() {
            let key = format!("decimate.{name}.{percent}");
            let mut figure = Figure::new(format!("{key}.{mark}"), ours[k], "dB");
            if let Some(theirs) = theirs {
                figure = figure.peer("splat-transform", theirs[k], false);
            }
            bench.push(figure);
            bench.push(Figure::new(format!("{key}.dropped.{mark}"), dropped[k], "dB"));
        }
    }
    Ok(())
}

/// Pictures of a whole scene, and what they are taken with.
struct Views {
    cameras: Vec<Camera>,
    footprint: Footprint,
    pictures: Vec<Image>,
}

impl Views {
    fn of(scene: &Scene, whole: &Frame) -> Result<Self> {
        let cameras = Framing::of(scene).ring(Ring::HeldOut, CAMERAS, (SIDE, SIDE))?;
        let mut views = Self { cameras, footprint: scene.footprint, pictures: Vec::new() };
        views.pictures = views.seen(whole)?;
        Ok(views)
    }

    fn seen(&self, frame: &Frame) -> Result<Vec<Image>> {
        let splats = Splats::new(&frame.gaussians, &frame.sh_rest, frame.sh_degree)?;
        let settings = Settings::default().with_footprint(self.footprint);
        self.cameras.iter().map(|camera| Ok(render_host::render(&splats, camera, &settings)?.image)).collect()
    }

    /// PSNR of `frame`, mean and worst, dB.
    fn marks(&self, frame: &Frame) -> Result<[f64; 2]> {
        let mut each = Vec::new();
        for (found, wanted) in self.seen(frame)?.iter().zip(&self.pictures) {
            each.push(metric::psnr(found, wanted)?.min(PSNR_CAP_DB));
        }
        Ok([mean(&each), each.iter().copied().fold(f64::INFINITY, f64::min)])
    }
}

/// The first frame of `scene`.
fn frame(scene: &Scene) -> Result<Frame> {
    scene.instant(0).ok_or_else(|| anyhow::anyhow!("the scene has no frame"))
}

/// The `left` Gaussians of most opacity times area of the two longer axes; all others are dropped.
fn dropped(frame: &Frame, left: usize) -> Frame {
    let shows = |gaussian: &Gaussian| {
        let least = gaussian.scale.into_iter().fold(f32::MAX, f32::min);
        gaussian.opacity * gaussian.scale.iter().product::<f32>() / least.max(f32::MIN_POSITIVE)
    };
    let mut order: Vec<usize> = (0..frame.gaussians.len()).collect();
    order.sort_by(|&a, &b| shows(&frame.gaussians[b]).total_cmp(&shows(&frame.gaussians[a])));
    order.truncate(left);
    let bands = frame.sh_degree.rest_len();
    Frame {
        gaussians: order.iter().map(|&i| frame.gaussians[i]).collect(),
        sh_rest: order.iter().flat_map(|&i| &frame.sh_rest[i * bands..][..bands]).copied().collect(),
        sh_degree: frame.sh_degree,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_shows_most() {
        let scene = synth("figure", 1000, 1).unwrap();
        let whole = frame(&scene).unwrap();
        let views = Views::of(&scene, &whole).unwrap();
        assert_eq!(views.marks(&whole).unwrap(), [PSNR_CAP_DB; 2]);
        let [few, fewer] = [500, 100].map(|left| views.marks(&dropped(&whole, left)).unwrap());
        assert!(few[0] > fewer[0] && few[0] >= few[1], "{few:?} {fewer:?}");
        // The faintest go first.
        let least = |frame: &Frame| frame.gaussians.iter().map(|g| g.opacity).fold(f32::MAX, f32::min);
        assert!(least(&dropped(&whole, 100)) >= least(&whole));
        assert_eq!(dropped(&whole, 100).gaussians.len(), 100);
    }
}
