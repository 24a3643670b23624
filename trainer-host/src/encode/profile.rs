//! Decides and writes once, in the profile that options or decisions name.

use codec_core::internals::{ids::Level, limits, wire::manifest::Profile};

use super::{Analysis, Decisions, EncodeError, EncodeOptions, Encoded, Progress, dgs1, paper};
use crate::scene::Scene;

/// Encodes the scene of `analysis` at the quality of `options`, whatever their target and search.
pub(super) fn decide_and_write(
    analysis: &Analysis<'_>,
    options: &EncodeOptions,
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
    options: &EncodeOptions,
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

/// Encodes `scene`, whose canonical values `decisions` were made for or which have changed a little since:
/// motion, with steps `motion` times as long, and entropy tables are decided anew, packets as `options` say,
/// and the rest stays. Profile `paper` keeps all.
///
/// # Errors
/// As [`write()`].
pub fn again(
    scene: &Scene,
    decisions: &Decisions,
    motion: f32,
    options: &EncodeOptions,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    let Decisions::Dgs1(decided) = decisions else { return write(scene, decisions, progress) };
    decisions.check(scene)?;
    let decided = dgs1::again(scene, decided.clone(), motion, options)?;
    write(scene, &Decisions::Dgs1(decided), progress)
}

/// Refuses a scene beyond the bounds of the format.
pub(super) fn check_scene(scene: &Scene) -> Result<(), EncodeError> {
    let within = |what, found: usize, most: usize| {
        if found <= most { Ok(()) } else { Err(EncodeError::Bound { what, found, most }) }
    };
    within("epochs", scene.epochs().len(), limits::MAX_EPOCHS)?;
    within("frames", scene.frames(), limits::MAX_FRAMES as usize)?;
    within("Gaussians in an epoch", scene.max_count(), limits::MAX_EPOCH_GAUSSIANS as usize)
}
