//! Makes what is typed ready to be sent: a stream and its graph, from a file or by encoding a scene.

use std::path::Path;

use anyhow::Result;
use emulator_host::PacketGraph;
use trainer_host::{
    Stream,
    encode::Protection,
    stream::PacketMap,
    utility::{References, UtilityOptions, gain_cameras},
    viewpoint::{Framing, Ring},
};

use super::{
    Quiet,
    cache::{utilities, utilities_beside},
};
use crate::args::{CodecArgs, PolicyName, SceneArgs};

/// A stream that can be sent.
#[derive(Debug)]
pub struct Sendable {
    /// Its bytes.
    pub stream: Stream,
    /// What each packet brings.
    pub map: PacketMap,
    /// The same as schedulers see it.
    pub graph: PacketGraph,
    /// Whether what was read was damaged, and used as far as it goes.
    pub damaged: bool,
}

/// Reads the stream `input` with the utilities beside it, or encodes the scene `input` and measures what
/// `policy` goes by: gains, which take one state, and for the paper's scheduler its risk-adjusted utilities
/// besides, which take 32.
///
/// # Errors
/// What cannot be read, encoded or sent.
pub fn sendable(
    input: &str,
    scene: &SceneArgs,
    codec: &CodecArgs,
    policy: PolicyName,
    quiet: Quiet,
    warn: &mut dyn FnMut(String),
) -> Result<Sendable> {
    let mut damaged = false;
    let (stream, table) = if super::is_stream(input) {
        super::unused_options(input, scene, Some(codec)).into_iter().for_each(&mut *warn);
        let path = Path::new(input);
        let stream = super::read_stream(path, &mut |warning| {
            damaged = true;
            warn(warning);
        })?;
        let table = utilities_beside(path, &stream, warn)?;
        (stream, table)
    } else {
        let loaded = super::import(input, scene)?;
        damaged = loaded.damage.is_some();
        loaded.damage.into_iter().for_each(&mut *warn);
        let options = super::encode_options(codec, Protection::STANDARD);
        let stream = super::encode(&loaded.scene, &options, quiet)?.stream;
        let cameras = Framing::of(&loaded.scene).ring(Ring::Validation, 3, (128, 128))?;
        let gain_cameras = gain_cameras(&loaded.scene)?;
        let complete = policy != PolicyName::DeadlineUtilityPaper;
        let how = UtilityOptions { complete, ..UtilityOptions::paper() };
        let state_cameras = if complete { &gain_cameras } else { &cameras };
        let references = References::renders(&loaded.scene, state_cameras, &gain_cameras);
        let table = utilities(&references, &stream, &how, None, quiet, &mut |_| ())?;
        (stream, Some(table))
    };
    let map = PacketMap::of(&stream)?;
    let graph = super::graph(&stream, &map, table.as_ref())?;
    Ok(Sendable { stream, map, graph, damaged })
}
