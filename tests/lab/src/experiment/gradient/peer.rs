//! Runs a public peer, OpenSplat on the processor, as a program of its own (`peers/opensplat.cpp`).

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, ensure};
use render_host::{Camera, Image, Splats, harmonics};

/// Names the peer's program.
pub(super) const PROGRAM: &str = "OPENSPLAT";

/// What one call of the peer found.
#[derive(Debug, Default)]
pub(super) struct Timed {
    /// Milliseconds of one picture, a run each.
    pub forward: Vec<f64>,
    /// Milliseconds of one picture with all gradients of the mean squared error, a run each.
    pub with_mse: Vec<f64>,
    /// The picture over black, rows from the top, red, green, blue.
    pub rgb: Vec<f32>,
}

/// The peer, with a folder for what it reads and writes.
#[derive(Debug)]
pub(super) struct Peer {
    program: PathBuf,
    folder: PathBuf,
}

impl Peer {
    /// The peer that [`PROGRAM`] names, if it names one.
    ///
    /// # Errors
    /// That there is no folder for its files.
    pub fn installed() -> Result<Option<Self>> {
        std::env::var_os(PROGRAM).map(|program| Self::of(program.into())).transpose()
    }

    /// The peer `program`.
    ///
    /// # Errors
    /// That there is no folder for its files.
    pub fn of(program: PathBuf) -> Result<Self> {
        let folder = std::env::temp_dir().join(format!("dgs-bench-gradient-{}", std::process::id()));
        fs::create_dir_all(&folder).with_context(|| format!("{}: cannot make", folder.display()))?;
        Ok(Self { program, folder })
    }

    /// Times `runs` pictures of `splats` without harmonics, and their gradients.
    ///
    /// # Errors
    /// What the peer says, or files that cannot be written or read.
    pub fn time(&self, splats: &Splats, camera: &Camera, target: &Image, runs: usize) -> Result<Timed> {
        let (input, output) = (self.folder.join("input"), self.folder.join("output"));
        fs::write(&input, scene(splats, camera, target))?;
        let ran = Command::new(&self.program).arg(&input).arg(runs.to_string()).arg(&output).output();
        let ran = ran.with_context(|| format!("{}: cannot run ({PROGRAM})", self.program.display()))?;
        ensure!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr).trim());
        let mut timed = Timed { rgb: picture(&output, target)?, ..Timed::default() };
        for line in String::from_utf8(ran.stdout)?.lines() {
            let (forward, with_mse) = line.split_once(' ').context("the peer does not print two times")?;
            timed.forward.push(forward.parse()?);
            timed.with_mse.push(with_mse.parse()?);
        }
        ensure!(timed.forward.len() == runs, "the peer ran {} times for {runs}", timed.forward.len());
        Ok(timed)
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // What stays behind in the folder for temporary files harms nobody.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// What the peer reads: see `peers/opensplat.cpp`.
fn scene(splats: &Splats, camera: &Camera, target: &Image) -> Vec<u8> {
    let lens = camera.intrinsics();
    let sizes = [splats.len() as u32, camera.width(), camera.height()];
    let mut out: Vec<u8> = sizes.iter().flat_map(|v| v.to_le_bytes()).collect();
    let mut push = |values: &[f32]| out.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    push(&[lens.fx, lens.fy, lens.cx, lens.cy].map(|v| v as f32));
    for (row, along) in camera.rotation().iter().zip(camera.translation()) {
        push(&[row[0], row[1], row[2], along].map(|v| v as f32));
    }
    push(&[0.0, 0.0, 0.0, 1.0]);
    for g in splats.gaussians() {
        push(&g.position);
        push(&g.scale);
        push(&g.rotation);
        push(&[g.opacity]);
        push(&g.sh0.map(|v| (0.5 + harmonics::C0 as f32 * v).max(0.0)));
    }
    push(target.rgb());
    out
}

fn picture(path: &Path, target: &Image) -> Result<Vec<f32>> {
    let bytes = fs::read(path)?;
    ensure!(bytes.len() == 4 * target.rgb().len(), "the peer's picture has {} bytes", bytes.len());
    Ok(bytes.as_chunks().0.iter().map(|value| f32::from_le_bytes(*value)).collect())
}
