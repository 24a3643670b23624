//! Encode a scene into a stream: analyse, decide, write.
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
mod protection;
mod quantiser_class;
mod report;
mod search;
pub mod sensitivity;
mod statistics;
mod steps;
mod target;

pub use analysis::Analysis;
pub use decisions::Decisions;
pub use error::EncodeError;
pub use ledger::{Ledger, LedgerPart, Share};
pub use options::Options;
pub use packet_report::PacketReport;
pub use protection::{Protection, ProtectionError, Strength};
pub use report::{ClusteringReport, Encoded, QuantiserClass, Report};
pub use search::Searched;
pub use steps::Quality;
pub use target::{COARSENESS, Reached, Target};

use codec_core::internals::{
    ids::{Level, PacketId},
    limits,
    wire::manifest::Profile,
};

use crate::scene::Scene;

/// Hears how far the encoder is: stage name and share done, 0..=1.
pub type Progress<'p> = &'p (dyn Fn(&'static str, f64) + Sync);

/// Encodes `scene`: analyses it once, then decides and writes until target and search are satisfied.
///
/// Deterministic: equal scenes and options give equal bytes on any number of threads.
///
/// # Errors
/// An option out of range, a scene beyond the bounds of the format, or a target that no coarseness
/// meets.
pub fn encode(scene: &Scene, options: &Options, progress: Progress<'_>) -> Result<Encoded, EncodeError> {
    options.check()?;
    check_scene(scene)?;
    let analysis = Analysis::of(scene, options, progress)?;
    let encoded = match options.target {
        Some(target) => target::encode(&analysis, options, target, progress)?,
        None => decide_and_write(&analysis, options, progress)?,
    };
    if options.search == 0 { Ok(encoded) } else { search::encode(&analysis, options, encoded, progress) }
}

/// Encodes the scene of `analysis` at the quality of `options`, whatever their target and search.
fn decide_and_write(
    analysis: &Analysis<'_>,
    options: &Options,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    let mut options = options.clone();
    loop {
        let decisions = decide(analysis, &options, progress)?;
        match write(analysis.scene, &decisions, progress) {
            // A block whose symbols do not fit one packet is halved until they do.
            Err(EncodeError::BlockTooLarge { .. }) if options.block_len > 1 => {
                options.block_len = options.block_len.div_ceil(2);
            }
            result => return result,
        }
    }
}

/// Decides everything that is to be chosen for a stream of the scene of `analysis`.
///
/// # Errors
/// Steps or tables that the format does not hold.
pub fn decide(
    analysis: &Analysis<'_>,
    options: &Options,
    progress: Progress<'_>,
) -> Result<Decisions, EncodeError> {
    match options.profile {
        Profile::Dgs1 => dgs1::decide(analysis, options, progress).map(Decisions::Dgs1),
        Profile::Paper => paper::decide(analysis, options, progress).map(Decisions::Paper),
    }
}

/// Writes `scene` as `decisions` say: quantises, entropy-codes, packetises and seals, with no choice of its
/// own. Equal scenes and decisions give equal bytes.
///
/// # Errors
/// Decisions that do not fit the scene; a block too large for a packet; what the format refuses.
pub fn write(scene: &Scene, decisions: &Decisions, progress: Progress<'_>) -> Result<Encoded, EncodeError> {
    check_scene(scene)?;
    decisions.check(scene)?;
    match decisions {
        Decisions::Dgs1(decisions) => dgs1::write(scene, decisions, progress),
        Decisions::Paper(decisions) => paper::write(scene, decisions, progress),
    }
}

/// Writes `scene` again with no level of a cell above that of `highest`, canonical cells first as in the
/// lattice; cells past its end stay as they are. Entropy tables, at most `table_choices` to a set, are
/// decided anew. Profile `paper` sends every level, whatever `highest` says.
///
/// # Errors
/// As [`write()`].
pub fn with_levels(
    scene: &Scene,
    decisions: &Decisions,
    highest: &[Level],
    table_choices: usize,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    let Decisions::Dgs1(decided) = decisions else { return write(scene, decisions, progress) };
    decisions.check(scene)?;
    let decided = dgs1::with_levels(scene, decided.clone(), highest, table_choices)?;
    write(scene, &Decisions::Dgs1(decided), progress)
}

fn check_scene(scene: &Scene) -> Result<(), EncodeError> {
    let within = |what, found: usize, most: usize| {
        if found <= most { Ok(()) } else { Err(EncodeError::Bound { what, found, most }) }
    };
    within("epochs", scene.epochs().len(), limits::MAX_EPOCHS)?;
    within("frames", scene.frames(), limits::MAX_FRAMES as usize)?;
    within("Gaussians in an epoch", scene.max_count(), limits::MAX_EPOCH_GAUSSIANS as usize)
}

/// The frame rate as a fraction: frames, seconds.
fn rate(scene: &Scene) -> (u32, u32) {
    let fps = scene.frames_per_second();
    for seconds in [1u32, 1001, 1000] {
        let frames = fps * f64::from(seconds);
        if frames.fract().abs() < 1e-9 && frames <= 1e9 {
            return ((frames as u32).max(1), seconds);
        }
    }
    (((fps * 1000.0).round().clamp(1.0, 1e9)) as u32, 1000)
}

fn packet_id(id: usize) -> Result<PacketId, EncodeError> {
    let most = PacketId::MAX as usize;
    u32::try_from(id).ok().and_then(PacketId::new).ok_or(EncodeError::Bound {
        what: "packets",
        found: id,
        most,
    })
}
