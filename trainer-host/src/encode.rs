//! Encodes a scene into a stream: analyse, decide, write.
//!
//! ```text
//! scene ─▶ analyse ─▶ Analysis ─▶ decide ─▶ Decisions ─▶ write ─▶ Encoded
//!          pictures,               clusters' order,        quantise, entropy-code,
//!          sensitivities,          quantisers, motion,     packetise, seal
//!          clusters                tables, packets
//!             ▲                       ▲
//!          once per scene          again and again: target, search, truncation
//! ```
//!
//! Whatever is chosen is in [`Decisions`], which is plain data; [`write()`] has no choice in it.

mod analysis;
pub mod clip;
pub mod cluster;
pub mod decisions;
mod dgs1;
mod error;
pub mod evaluator;
pub mod factorise;
mod ledger;
mod options;
mod packet_report;
mod packetise;
mod paper;
mod parity;
mod profile;
mod progress;
mod protection;
mod quantiser_class;
mod report;
pub(crate) mod rounding;
mod search;
pub mod sensitivity;
mod statistics;
mod steps;
mod target;

pub use analysis::Analysis;
pub use decisions::Decisions;
pub use error::EncodeError;
pub use evaluator::MeasuredViews;
pub use ledger::{Ledger, LedgerPart, Share};
pub use options::{EncodeOptions, Target, TargetViews};
pub use packet_report::PacketReport;
pub use profile::{decide, reencode, with_levels, write};
pub use progress::{Progress, no_progress};
pub use protection::{Protection, ProtectionError, Strength};
pub use report::{ClusteringReport, Encoded, Report, SearchReport, TargetReport};
pub use steps::QuantiserSteps;
pub use target::{COARSENESS, reencode_to_size};

use self::profile::{check_scene, decide_and_write};
use crate::scene::Scene;

/// Encodes `scene`: analyses it once, then decides and writes until target and search are satisfied.
///
/// Deterministic: equal scenes and options give equal bytes on any number of threads.
///
/// # Errors
/// An option out of range, a scene beyond the bounds of the format, or a target that no coarseness
/// meets.
pub fn encode(
    scene: &Scene,
    options: &EncodeOptions,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    options.check()?;
    check_scene(scene)?;
    let analysis = Analysis::of(scene, options, progress)?;
    let encoded = match options.target {
        Some(target) => target::encode(&analysis, options, target, progress)?,
        None => decide_and_write(&analysis, options, progress)?,
    };
    if options.search == 0 { Ok(encoded) } else { search::encode(&analysis, options, encoded, progress) }
}
