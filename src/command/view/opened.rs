//! Opens what is to be shown: the bytes of a stream, from a file or by encoding a scene.

use std::path::Path;

use anyhow::{Context, Result, bail};
use dgs_player::Stream;
use trainer_host::{encode::Protection, scene::Up};

use crate::{
    args::View,
    command::serve::name,
    pipeline::{self, Quiet},
};

/// A stream, and which way is up in it, if not as it says.
pub(super) struct Opened {
    pub bytes: Vec<u8>,
    #[cfg_attr(not(feature = "window"), allow(dead_code, reason = "a page takes it from its address"))]
    pub up: Option<Up>,
    /// Whether only a part of the input was read.
    pub damaged: bool,
}

/// Refuses inputs of which two would have one name on a page.
///
/// # Errors
/// Which two.
pub(super) fn check_names(inputs: &[String]) -> Result<()> {
    for (at, input) in inputs.iter().enumerate() {
        if let Some(before) = inputs[..at].iter().find(|before| name(before) == name(input)) {
            let called = name(input);
            bail!(
                "two streams are called {called}, {before} and {input}: rename a file; dgs encode makes a \
                 file of a scene"
            );
        }
    }
    Ok(())
}

/// Refuses an `input` that no page shows, or that is not there.
///
/// # Errors
/// A URL; no such file, folder or built-in scene.
pub(super) fn check(input: &str, args: &View) -> Result<()> {
    if input.contains("://") {
        bail!("{input}: a page shows files and scenes; --window shows URLs");
    }
    pipeline::check_input(input, &args.scene)
}

/// The stream `input`, or the scene `input` encoded.
///
/// # Errors
/// It cannot be read, or is neither.
pub(super) fn opened(input: &str, args: &View, quiet: Quiet, warn: &mut dyn FnMut(String)) -> Result<Opened> {
    check(input, args)?;
    if !pipeline::is_stream(input) {
        let loaded = pipeline::import(input, &args.scene)?;
        let damaged = loaded.damage.is_some();
        loaded.damage.into_iter().for_each(&mut *warn);
        let options = pipeline::encode_options(&args.codec, Protection::NONE);
        let stream = pipeline::encode(&loaded.scene, &options, quiet)?.stream;
        return Ok(Opened { bytes: stream.to_bytes()?, up: None, damaged });
    }
    pipeline::unused_options(input, &args.scene, Some(&args.codec)).into_iter().for_each(&mut *warn);
    let bytes = pipeline::input_bytes(Path::new(input))?.to_vec();
    let (_, damage) = Stream::from_bytes(&bytes).with_context(|| {
        format!("{input}: no .dgs file that can be shown (dgs encode makes one of a scene)")
    })?;
    if !damage.is_none() {
        warn(format!("{input}: {damage}"));
    }
    Ok(Opened { bytes, up: args.scene.up.map(Up::from), damaged: !damage.is_none() })
}
