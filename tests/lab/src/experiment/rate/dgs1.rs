//! Encodes our two profiles through the same pipeline as every verb.

use anyhow::Result;
use dgs::{
    args::ProfileName,
    pipeline::{self, Quiet},
};
use trainer_host::{
    Scene,
    encode::{Encoded, Protection},
    stream::{Player, Stream},
};

use super::coded::{Coded, Timer};
use crate::setup::codec_args;

/// Profile `dgs1`.
pub fn dgs1(scene: &Scene, coarseness: f32, _: i32, shown: &[u32]) -> Result<Coded> {
    code(scene, ProfileName::Dgs1, coarseness, shown)
}

/// Profile `dgs1` with the same steps for all Gaussians.
pub fn even(scene: &Scene, coarseness: f32, _: i32, shown: &[u32]) -> Result<Coded> {
    let timer = Timer::start();
    let options = pipeline::encode_options(&codec_args(ProfileName::Dgs1), Protection::NONE);
    let quality = options.quality.scaled(coarseness);
    let options = trainer_host::encode::EncodeOptions { quality, pictures: 0, ..options };
    decoded(scene, &pipeline::encode(scene, &options, Quiet(true))?.stream, timer.seconds(), shown)
}

/// Profile `paper`.
pub fn paper(scene: &Scene, coarseness: f32, _: i32, shown: &[u32]) -> Result<Coded> {
    code(scene, ProfileName::Paper, coarseness, shown)
}

/// The stream of `scene` in `profile`, steps times `coarseness`, without repair.
pub fn stream(scene: &Scene, profile: ProfileName, coarseness: f32) -> Result<Encoded> {
    let options = pipeline::encode_options(&codec_args(profile), Protection::NONE);
    let quality = options.quality.scaled(coarseness);
    pipeline::encode(scene, &trainer_host::encode::EncodeOptions { quality, ..options }, Quiet(true))
}

fn code(scene: &Scene, profile: ProfileName, coarseness: f32, shown: &[u32]) -> Result<Coded> {
    let timer = Timer::start();
    let encoded = stream(scene, profile, coarseness)?;
    decoded(scene, &encoded.stream, timer.seconds(), shown)
}

fn decoded(scene: &Scene, stream: &Stream, encode_s: f64, shown: &[u32]) -> Result<Coded> {
    let timer = Timer::start();
    let received = stream.receive()?;
    let content = received.content();
    let mut player = Player::new(content.manifest);
    for frame in 0..scene.frames() as u32 {
        player.show(&content, frame)?;
    }
    let decode_s = timer.seconds();
    let shown: Result<Vec<_>, _> = shown.iter().map(|&f| player.instant(&content, f)).collect();
    Ok(Coded { bytes: stream.wire_bytes(), encode_s, decode_s, shown: shown? })
}
