//! Encodes what was trained, unless a person asks to stop.

use anyhow::{Context, Result};
use trainer_host::{
    Scene,
    encode::{Encoded, Protection, encode},
};

use super::interruption::Interruption;
use crate::{
    args::train::Train,
    pipeline::{self, Quiet},
    progress::Progress,
};

/// The stream of `scene`; between two stages of the encoder a person may leave with `what_is_left`.
pub(super) fn encoded(
    args: &Train,
    scene: &Scene,
    stop: &Interruption,
    what_is_left: &str,
    quiet: Quiet,
) -> Result<Encoded> {
    let bar = Progress::new("encode", quiet.0);
    let options = pipeline::encode_options(&args.codec, Protection::NONE);
    let progress = |stage: &'static str, share: f64| {
        stop.leave(what_is_left);
        bar.stage(stage, share);
    };
    encode(scene, &options, &progress).context("cannot encode")
}
