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

use self::{
    profile::{check_scene, decide_and_write},
    progress::part,
};
use crate::scene::Scene;

/// Encodes `scene`: analyses it once, then decides and writes until target and search are satisfied.
///
/// Deterministic: equal scenes and options give equal bytes on any number of threads. `progress` hears stages
/// "analyse" to "packetise", or of a search for a target "encoding 1 of at most 8" and so on, and at last
/// "done".
///
/// # Errors
/// An option out of range, a scene beyond the bounds of the format, a target that no coarseness meets, or
/// `progress` stops the work.
pub fn encode(
    scene: &Scene,
    options: &EncodeOptions,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    options.check()?;
    check_scene(scene)?;
    let rising = progress::rising(progress);
    let encodings = if options.target.is_some() { target::MOST } else { 1 };
    let searched = if options.search > 0 { options.search + target::MOST } else { 0 };
    let all = ANALYSIS + (encodings + searched) as f64;
    let (analysed, encoded) = (ANALYSIS / all, (ANALYSIS + encodings as f64) / all);
    let analysis = Analysis::of(scene, options, &part(&rising, 0.0, analysed))?;
    let heard = part(&rising, analysed, encoded);
    let mut found = match options.target {
        Some(target) => target::encode(&analysis, options, target, &heard)?,
        None => decide_and_write(&analysis, options, &heard)?,
    };
    if options.search > 0 {
        found = search::encode(&analysis, options, found, &part(&rising, encoded, 1.0))?;
    }
    progress::report(&rising, "done", 1.0)?;
    Ok(found)
}

/// What an analysis takes beside an encoding, about.
const ANALYSIS: f64 = 0.5;
