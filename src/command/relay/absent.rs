//! Says that this build speaks to no relays.

use anyhow::{Result, bail};
use dgs_quic::socket::{
    ClientConfig, FrameSink, Locator, PlayError, PlayReport, Played, ServedStream, Trust,
};

use crate::{output::VerbOutput, pipeline::Quiet};

/// What is missing.
const MISSING: &str = "Media over QUIC is in builds with `--features moq`; this is none";

/// Refuses.
pub(in crate::command) fn check(relay: &Locator, _streams: usize) -> Result<()> {
    bail!("{relay}: {MISSING}")
}

/// Refuses.
pub(in crate::command) fn publish(
    relay: &Locator,
    _trust: Trust,
    _offers: &[ServedStream],
    _quiet: Quiet,
) -> Result<VerbOutput> {
    bail!("{relay}: {MISSING}")
}

/// Refuses.
pub(in crate::command) async fn play(
    _config: &ClientConfig,
    _screen: &mut dyn FrameSink,
    _stop: impl Future<Output = ()>,
) -> Played {
    let error = Some(PlayError::Relay(MISSING.to_owned()));
    Played { report: PlayReport::default(), player: None, error }
}
