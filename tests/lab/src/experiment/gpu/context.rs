//! Holds what every part of the GPU bench measures with: the device and the scenes.

use anyhow::Result;
use render_host::{Settings, gpu::Executor};

use crate::experiment::{cloud::CloudShape, partial::Partial};

/// The scenes of the engines over states, and the start of their keys; only A when it must be quick.
pub(super) fn partials(n: usize, side: u32, quick: bool) -> Result<Vec<(String, Partial)>> {
    let kinds = CloudShape::ALL.into_iter().take(if quick { 1 } else { 2 });
    kinds
        .map(|(kind, letter)| {
            Ok((format!("{letter}.{side}"), Partial::new(kind, n, side, &Settings::default())?))
        })
        .collect()
}

/// What every part measures with.
pub(super) struct Context {
    pub executor: Executor,
    /// Smaller sizes and three runs.
    pub quick: bool,
    /// The adapter is a CPU.
    pub is_cpu: bool,
}
