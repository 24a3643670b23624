//! Measures videos: pictures per second, bytes and error of AV1, beside encoders of an installed ffmpeg.

use std::{
    fs,
    io::{Cursor, Write as _},
    path::Path,
    process::{Command, Stdio},
    time::Instant,
};

use anyhow::{Context, Result, ensure};
use dgs_video::{Container, Video};
use render_host::{Image, Renderer, Settings, Splats, metric};
use trainer_host::viewpoint::{Framing, Ring};

use crate::{
    figures::{Bench, Figure, median},
    setup::{Setup, load, synth},
};

const FRAMES_PER_SECOND: f64 = 30.0;
const RUNS: usize = 3;
/// Names, encoders and options of ffmpeg, as near in error as their steps of quality allow.
const PEERS: [(&str, &[&str]); 2] =
    [("libsvtav1", &["-crf", "26", "-preset", "6"]), ("libx264", &["-crf", "17", "-preset", "medium"])];
/// To planes and back, by the same code for all encoders.
const CONVERSION: &str = "accurate_rnd+full_chroma_int+full_chroma_inp";

/// A clip and what a video of it is called by.
struct Clip {
    name: String,
    size: (u32, u32),
    pictures: Vec<Image>,
}

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (size, frames) = if setup.quick { ((192, 144), 8) } else { ((640, 360), 90) };
    let mut bench = Bench::new(
        "video",
        format!(
            "the first {frames} frames of a scene, {} × {}, held-out ring camera, black background, 30 \
             frames per second; time of encoding alone, in memory for dgs-video, through a pipe for \
             ffmpeg; PSNR of the red, green and blue that an installed ffmpeg decodes; all processors; \
             medians of {RUNS} interleaved runs",
            size.0, size.1
        ),
    );
    let gaussians = if setup.quick { 3000 } else { 20_000 };
    let mut scenes = vec![("figure", synth("figure", gaussians, frames)?)];
    if let Some(path) = setup.data("scenes/gltf-fox/Fox.glb", &mut bench)? {
        scenes.push(("fox", load(&path, gaussians)?));
    }
    let folder = tempfile::tempdir()?;
    for (name, scene) in &scenes {
        let camera = &Framing::of(scene).ring(Ring::HeldOut, 3, size)?[0];
        let mut renderer = Renderer::new();
        let mut pictures = Vec::new();
        for frame in 0..scene.frames().min(frames) {
            let instant = scene.instant(frame).unwrap_or_default();
            let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
            pictures.push(renderer.render(&splats, camera, &Settings::default())?.image);
        }
        compare(&mut bench, &Clip { name: (*name).to_owned(), size, pictures }, folder.path())?;
    }
    Ok(bench)
}

fn compare(bench: &mut Bench, clip: &Clip, folder: &Path) -> Result<()> {
    let target = folder.join("peer.mp4");
    let mut own = Vec::new();
    let mut peers = PEERS.map(|_| Ok((Vec::new(), Vec::new())));
    for _ in 0..RUNS {
        own.push(timed(|| encode(clip))?);
        for (peer, (encoder, options)) in peers.iter_mut().zip(PEERS) {
            let Ok((seconds, file)) = peer else { continue };
            match timed(|| encode_by_ffmpeg(clip, encoder, options, &target)) {
                Ok((took, ())) => {
                    seconds.push(took);
                    *file = fs::read(&target)?;
                }
                Err(error) => *peer = Err(error),
            }
        }
    }
    let (seconds, mut files): (Vec<f64>, Vec<Vec<u8>>) = own.into_iter().unzip();
    ensure!(files.windows(2).all(|pair| pair[0] == pair[1]), "the same pictures gave other bytes");
    report(bench, clip, ("dgs-video", median(&seconds)), files.swap_remove(0), folder)?;
    for ((encoder, _), peer) in PEERS.iter().zip(peers) {
        match peer {
            Ok((seconds, file)) => report(bench, clip, (encoder, median(&seconds)), file, folder)?,
            Err(error) => bench.skipped.push(format!("{encoder}: {error:#}")),
        }
    }
    Ok(())
}

/// What `work` gives, after the seconds that it took.
fn timed<T>(work: impl FnOnce() -> Result<T>) -> Result<(f64, T)> {
    let start = Instant::now();
    let done = work()?;
    Ok((start.elapsed().as_secs_f64(), done))
}

/// Figures of a video that took `seconds` to encode.
fn report(
    bench: &mut Bench,
    clip: &Clip,
    (encoder, seconds): (&str, f64),
    file: Vec<u8>,
    folder: &Path,
) -> Result<()> {
    let key = |what: &str| format!("{}.{encoder}.{what}", clip.name);
    let count = clip.pictures.len() as f64;
    let speed = Figure::new(key("pictures_per_s"), count / seconds, "1/s").runs(RUNS);
    let path = folder.join("decoded.mp4");
    fs::write(&path, &file)?;
    match decode(&path, clip.size) {
        Ok(shown) => {
            let db = mean_psnr(&shown, &clip.pictures).with_context(|| key("psnr"))?;
            bench.push(speed.error(db, "dB PSNR"));
            bench.push(Figure::new(key("psnr"), db, "dB"));
        }
        Err(error) => {
            bench.push(speed);
            bench.skipped.push(format!("{}: {error:#}", key("psnr")));
        }
    }
    bench.push(Figure::new(key("bytes_per_picture"), file.len() as f64 / count, "bytes"));
    Ok(())
}

fn encode(clip: &Clip) -> Result<Vec<u8>> {
    let file = Cursor::new(Vec::new());
    let mut video = Video::begin(file, Container::Mp4, clip.size, FRAMES_PER_SECOND, clip.pictures.len())?;
    clip.pictures.iter().try_for_each(|picture| video.add(picture))?;
    Ok(video.finish()?.into_inner())
}

fn encode_by_ffmpeg(clip: &Clip, encoder: &str, options: &[&str], target: &Path) -> Result<()> {
    let mut child = Command::new("ffmpeg")
        .args(["-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"])
        .args(["-video_size", &format!("{}x{}", clip.size.0, clip.size.1)])
        .args(["-framerate", &FRAMES_PER_SECOND.to_string(), "-i", "-", "-sws_flags", CONVERSION])
        .args(["-vf", "scale=out_color_matrix=bt709:out_range=tv", "-pix_fmt", "yuv420p"])
        .args(["-colorspace", "bt709", "-c:v", encoder])
        .args(options)
        .arg(target)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .context("no ffmpeg is installed")?;
    let mut pipe = child.stdin.take().context("ffmpeg takes no pictures")?;
    // One that has ended says so by its status.
    let _ = clip.pictures.iter().try_for_each(|picture| pipe.write_all(&picture.to_rgb8()));
    drop(pipe);
    ensure!(child.wait()?.success(), "the installed ffmpeg does not encode so");
    Ok(())
}

/// The pictures that an installed ffmpeg shows.
fn decode(file: &Path, size: (u32, u32)) -> Result<Vec<Image>> {
    let output = Command::new("ffmpeg")
        .args(["-hide_banner", "-loglevel", "error", "-i"])
        .arg(file)
        .args(["-sws_flags", CONVERSION, "-vf", "scale=in_color_matrix=bt709:in_range=tv"])
        .args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-"])
        .stdin(Stdio::null())
        .output()
        .context("no ffmpeg is installed")?;
    ensure!(output.status.success(), "the installed ffmpeg does not decode it");
    let pictures = output.stdout.chunks(3 * size.0 as usize * size.1 as usize);
    let pictures = pictures.map(|picture| {
        let values = picture.iter().map(|&value| f32::from(value) / 255.0).collect();
        Image::new(size.0, size.1, values).context("part of a picture")
    });
    pictures.collect()
}

/// Over all pictures, of which as many must be shown.
fn mean_psnr(shown: &[Image], pictures: &[Image]) -> Result<f64> {
    ensure!(shown.len() == pictures.len(), "{} of {} pictures are shown", shown.len(), pictures.len());
    let mut sum = 0.0;
    for (shown, picture) in shown.iter().zip(pictures) {
        sum += metric::psnr(shown, picture)?;
    }
    Ok(sum / pictures.len().max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_that_is_missing_or_another_is_seen() {
        let grey = |value: f32| Image::filled(16, 16, [value; 3]).unwrap();
        let pictures = [grey(0.2), grey(0.8)];
        let shown = [grey(0.201), grey(0.799)];
        assert!(mean_psnr(&shown, &pictures).unwrap() > 50.0);
        let swapped = [grey(0.799), grey(0.201)];
        assert!(mean_psnr(&swapped, &pictures).unwrap() < 10.0);
        let error = mean_psnr(&shown[..1], &pictures).unwrap_err().to_string();
        assert!(error.contains("1 of 2 pictures"), "{error}");
    }
}
