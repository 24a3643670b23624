//! Pipes pictures to an installed ffmpeg, which makes H.264 in MP4 of them.

use std::{
    fs::File,
    io::{ErrorKind, Read as _, Seek as _, Write as _},
    path::{Path, PathBuf},
    process::{ChildStdin, Command, Stdio},
    thread,
    time::Duration,
};

use anyhow::{Context, Result, bail};
use render_host::Image;

use crate::files::{PendingFile, Writer};

/// Encoders of ffmpeg that make H.264, best first, each with its options of quality.
const ENCODERS: [(&str, &[&str]); 2] =
    [("libx264", &["-crf", "17", "-preset", "medium"]), ("libopenh264", &["-b:v", "8M"])];

/// The encoder of the installed ffmpeg, with its options.
///
/// # Errors
/// No ffmpeg, or one without such an encoder.
pub(super) fn find() -> Result<(&'static str, &'static [&'static str])> {
    let listed = Command::new("ffmpeg").args(["-hide_banner", "-encoders"]).stdin(Stdio::null()).output();
    let listed = match listed {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            bail!("no ffmpeg is installed, which makes H.264; .mp4 and .webm with AV1 need none")
        }
        other => other.context("ffmpeg: cannot run")?,
    };
    let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
    let has = |name: &str| listed.split_whitespace().any(|word| word == name);
    ENCODERS.into_iter().find(|(name, _)| has(name)).with_context(|| {
        let names = ENCODERS.map(|encoder| encoder.0);
        format!("the installed ffmpeg has none of the encoders {}", names.join(", "))
    })
}

/// The constant rate factor, 0 (best) to 51, of a quality of 1 to 100.
fn crf(quality: u8) -> u8 {
    (51.0 * (1.0 - f64::from(quality) / 100.0)).round() as u8
}

/// How long to wait before it is checked again whether ffmpeg has ended.
const POLL_INTERVAL: Duration = Duration::from_millis(10);

/// A video on its way.
pub struct FfmpegVideo {
    /// Dropped before `pending`: ffmpeg ends first, then its file goes.
    ffmpeg: Writer,
    pipe: Option<ChildStdin>,
    pending: PendingFile,
    target: PathBuf,
    size: (u32, u32),
    /// What ffmpeg says.
    log: File,
}

impl FfmpegVideo {
    /// Begins a video of pictures of `size` (width, height) at `quality`, 1 to 100. Odd sides are padded by a
    /// row or column.
    pub(super) fn begin(
        target: &Path,
        size: (u32, u32),
        frames_per_second: f64,
        quality: Option<u8>,
    ) -> Result<Self> {
        let (encoder, usual) = find()?;
        if quality.is_some() && encoder != "libx264" {
            bail!(
                "--quality: the installed ffmpeg has no libx264, which takes one; left out, it is the usual"
            );
        }
        let options: Vec<String> = match quality {
            Some(quality) => {
                ["-crf", &crf(quality).to_string(), "-preset", "medium"].map(str::to_owned).into()
            }
            None => usual.iter().map(|&option| option.to_owned()).collect(),
        };
        let pending = PendingFile::begin(target)?;
        let log = tempfile::tempfile().context("ffmpeg: cannot keep what it says")?;
        let mut command = Command::new("ffmpeg");
        command
            // Without -xerror it ends well where the disk is full when it writes where frames lie.
            .args(["-hide_banner", "-loglevel", "error", "-xerror", "-y"])
            .args(["-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-video_size", &format!("{}x{}", size.0, size.1)])
            .args(["-framerate", &frames_per_second.to_string(), "-i", "-"])
            // Players need even sides and say which colours they take bytes for.
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2,scale=out_color_matrix=bt709:out_range=tv"])
            .args(["-pix_fmt", "yuv420p", "-colorspace", "bt709", "-color_primaries", "bt709"])
            .args(["-color_trc", "bt709", "-c:v", encoder])
            .args(options)
            .args(["-f", "mp4"])
            .arg(pending.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(log.try_clone().context("ffmpeg: cannot keep what it says")?);
        let (ffmpeg, pipe) = Writer::start(&mut command).context("ffmpeg: cannot run")?;
        Ok(Self { ffmpeg, pipe, pending, target: target.to_owned(), size, log })
    }

    /// Adds the next picture.
    pub(super) fn add(&mut self, picture: &Image) -> Result<()> {
        if picture.size() != self.size {
            let ((w, h), (width, height)) = (picture.size(), self.size);
            bail!("found {w} × {h} pixels; {width} × {height}, as of the first, are allowed");
        }
        let Some(pipe) = &mut self.pipe else { bail!("ffmpeg takes no more pictures") };
        if pipe.write_all(&picture.to_rgb8()).is_ok() {
            return Ok(());
        }
        // It has ended, and says why, unless this process is being ended too.
        self.ffmpeg.ended().context("ffmpeg: cannot wait for its end")?;
        bail!("ffmpeg: {}", self.said())
    }

    /// Ends the video and gives it its name.
    pub(super) fn finish(mut self) -> Result<()> {
        drop(self.pipe.take());
        let status = loop {
            match self.ffmpeg.ended().context("ffmpeg: cannot wait for its end")? {
                Some(status) => break status,
                None => thread::sleep(POLL_INTERVAL),
            }
        };
        if !status.success() {
            let said = self.said();
            bail!("{}: ffmpeg ended with {status}: {said}", self.target.display());
        }
        self.pending.finish()
    }

    fn said(&mut self) -> String {
        let mut text = String::new();
        // What cannot be read is not said.
        let _ = self.log.rewind().and_then(|()| self.log.read_to_string(&mut text));
        // What went wrong first is why what follows did.
        let first = text.lines().map(str::trim).find(|line| !line.is_empty());
        first.unwrap_or("it says nothing").to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::crf;

    #[test]
    fn qualities_are_rate_factors() {
        assert_eq!([1, 67, 100].map(crf), [50, 17, 0]);
    }
}
