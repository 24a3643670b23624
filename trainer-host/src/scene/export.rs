//! Exporters: one frame, or all of them as a numbered sequence, in formats others read.
//!
//! A frame is written from its [`Attributes`](crate::scene::Attributes), not from a rendered instant,
//! so logs and logits survive without a detour through `exp` and `ln`.

pub mod ply;
pub mod spz;

use std::{
    io,
    path::{Path, PathBuf},
};

use crate::scene::{Epoch, Scene};

/// Writes every frame of `scene` into `folder` as `PREFIX_00000.ENDING` and so on, in display order,
/// and returns the files. `encode` turns a frame of an epoch into bytes.
fn sequence(
    scene: &Scene,
    folder: &Path,
    prefix: &str,
    ending: &str,
    mut encode: impl FnMut(&Epoch, usize) -> io::Result<Vec<u8>>,
) -> io::Result<Vec<PathBuf>> {
    std::fs::create_dir_all(folder)?;
    let frames = scene.epochs().iter().flat_map(|epoch| (0..epoch.frames()).map(move |t| (epoch, t)));
    frames
        .enumerate()
        .map(|(number, (epoch, t))| {
            let path = folder.join(format!("{prefix}_{number:05}.{ending}"));
            std::fs::write(&path, encode(epoch, t)?)?;
            Ok(path)
        })
        .collect()
}
