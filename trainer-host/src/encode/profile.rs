//! Decides and writes once, in the profile that options or decisions name.

use codec_core::internals::{ids::Level, limits, wire::manifest::Profile};

use super::{
    Analysis, Decisions, EncodeError, EncodeOptions, Encoded, Progress, dgs1, paper,
    progress::{part, report},
};
use crate::scene::{Scene, Track};

/// Share of an encoding in profile `paper`, and in `dgs1`, that goes to deciding, about: the rest is writing.
const DECIDING: [f64; 2] = [0.1, 0.8];

/// Encodes the scene of `analysis` at the quality of `options`, whatever their target and search.
pub(super) fn decide_and_write(
    analysis: &Analysis<'_>,
    options: &EncodeOptions,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    let mut options = options.clone();
    let deciding = if options.profile == Profile::Paper { DECIDING[0] } else { DECIDING[1] };
    loop {
        let decisions = decide(analysis, &options, &part(progress, 0.0, deciding))?;
        match write(analysis.scene, &decisions, &part(progress, deciding, 1.0)) {
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
    report(progress, "entropy-code", 0.0)?;
    let decided = dgs1::with_levels(scene, decided.clone(), highest, table_choices)?;
    write(scene, &Decisions::Dgs1(decided), &part(progress, 0.5, 1.0))
}

/// Encodes `scene`, whose canonical values `decisions` were made for or which have changed a little since:
/// motion, with steps `motion` times as long, and entropy tables are decided anew, packets as `options` say,
/// and the rest stays. Where symbols of a block no longer fit a packet all blocks are halved until they do,
/// unless proxies were trained for them. Profile `paper` keeps all.
///
/// # Errors
/// As [`write()`].
pub fn reencode(
    scene: &Scene,
    decisions: &Decisions,
    motion: f32,
    options: &EncodeOptions,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    let Decisions::Dgs1(decided) = decisions else { return write(scene, decisions, progress) };
    decisions.check(scene)?;
    let mut decided = decided.clone();
    let may_be_halved = decided.epochs.iter().all(|epoch| epoch.proxy_changes.is_empty());
    loop {
        report(progress, "decide", 0.0)?;
        let again = dgs1::reencode(scene, decided.clone(), motion, options)?;
        match write(scene, &Decisions::Dgs1(again), &part(progress, 0.7, 1.0)) {
            Err(EncodeError::BlockTooLarge { .. }) if may_be_halved && decided.block_len > 1 => {
                decided.block_len = decided.block_len.div_ceil(2);
            }
            result => return result,
        }
    }
}

/// What a manifest holds of frame rates, which are frames per 1000 seconds where they are no whole numbers.
const FRAME_RATE: (f64, f64) = (0.001, 1e6);
/// Largest magnitude of a coordinate that a manifest holds, scene units.
const MAX_AWAY: f32 = 1e9;

/// Refuses a scene that is empty or beyond the bounds of the format.
pub(super) fn check_scene(scene: &Scene) -> Result<(), EncodeError> {
    let within = |what, found: usize, most: usize| {
        if found <= most { Ok(()) } else { Err(EncodeError::Bound { what, found, most }) }
    };
    within("epochs", scene.epochs().len(), limits::MAX_EPOCHS)?;
    within("frames", scene.frames(), limits::MAX_FRAMES as usize)?;
    within("Gaussians in an epoch", scene.max_count(), limits::MAX_EPOCH_GAUSSIANS as usize)?;
    let (found, (low, high)) = (scene.frames_per_second(), FRAME_RATE);
    if !(low..=high).contains(&found) {
        return Err(EncodeError::FrameRate { found, low, high });
    }
    if scene.max_count() == 0 {
        return Err(EncodeError::Empty { what: "the scene's list of Gaussians" });
    }
    check_positions(scene)
}

/// Refuses the first Gaussian that is too far away.
fn check_positions(scene: &Scene) -> Result<(), EncodeError> {
    let mut first_frame = 0;
    for (index, epoch) in scene.epochs().iter().enumerate() {
        let positions = match &epoch.attributes().positions {
            Track::Constant(positions) | Track::PerFrame(positions) => positions,
        };
        let is_far = |position: &[f32; 3]| position.iter().any(|v| v.abs() > MAX_AWAY);
        if let Some(at) = positions.iter().position(is_far) {
            return Err(EncodeError::Position {
                epoch: index,
                gaussian: at % epoch.count(),
                frame: first_frame + at / epoch.count(),
                position: positions[at],
                most: MAX_AWAY,
            });
        }
        first_frame += epoch.frames();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Attributes, Epoch,
        encode::{EncodeOptions, encode, no_progress},
        import::{
            Limits,
            synth::{self, SynthKind, SynthOptions},
        },
        stream::Player,
    };

    /// Gaussians at these places, `frames` of them one after the other.
    fn scene(frames: usize, positions: Vec<[f32; 3]>) -> Scene {
        let count = positions.len() / frames;
        let attributes = Attributes {
            positions: Track::PerFrame(positions),
            rotations: Track::Constant(vec![[1.0, 0.0, 0.0, 0.0]; count]),
            log_scales: Track::Constant(vec![[0.0; 3]; count]),
            opacity_logits: Track::Constant(vec![1.0; count]),
            sh0: Track::Constant(vec![[0.5; 3]; count]),
            sh_rest: Vec::new(),
            sh_degree: codec_core::ShDegree::ZERO,
        };
        Scene::new(vec![Epoch::new(frames, attributes).unwrap()], 30.0).unwrap()
    }

    #[test]
    fn scenes_that_are_empty_or_too_far_away_are_refused_by_name() {
        let options = EncodeOptions { pictures: 0, ..EncodeOptions::default() };
        let said = |scene| encode(&scene, &options, &no_progress).unwrap_err().to_string();
        let error = said(scene(1, Vec::new()));
        assert_eq!(error, "the scene's list of Gaussians is empty; at least one is needed");
        let mut positions = vec![[0.0; 3]; 6];
        positions[5] = [0.0, -2e9, 0.0];
        let error = said(scene(2, positions));
        assert!(
            error.starts_with("Gaussian 2 of epoch 0 is at [0.0, -2000000000.0, 0.0] at frame 1"),
            "{error}"
        );
        assert!(error.contains("-1e9 to 1e9 scene units"), "{error}");
        for rate in [4e-4, 2e6] {
            let epochs = scene(1, vec![[0.0; 3]; 3]).epochs().to_vec();
            let error = said(Scene::new(epochs, rate).unwrap());
            let words = "0.001 to 1000000 frames per second are allowed";
            assert_eq!(error, format!("the scene's frame rate is {rate}; {words}"));
        }
        encode(&scene(1, vec![[1e9, -1e9, 0.0]; 3]), &options, &no_progress).unwrap();
    }

    /// With packets too small for blocks as they were decided, the same values in smaller blocks.
    #[test]
    fn blocks_that_no_longer_fit_are_halved_where_a_scene_is_encoded_again() {
        let options =
            SynthOptions { gaussians: 1000, frames: 8, kind: SynthKind::Figure, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let options = EncodeOptions { pictures: 0, block_len: 256, ..EncodeOptions::default() };
        let first = encode(&scene, &options, &no_progress).unwrap();
        let small = EncodeOptions { packet_bytes: 200, ..options };
        let again = reencode(&scene, &first.decisions, 1.0, &small, &no_progress).unwrap();
        assert!(
            again.stream.packets().iter().all(|packet| packet.len() <= 200) && again.order == first.order
        );
        let block_len = |encoded: &Encoded| match &encoded.decisions {
            Decisions::Dgs1(decisions) => decisions.block_len,
            Decisions::Paper(_) => 0,
        };
        let lens = (block_len(&first), block_len(&again));
        assert!(lens.1 < lens.0, "{lens:?}");
        let shown = |encoded: &Encoded| {
            let received = encoded.stream.receive().unwrap();
            let content = received.content();
            let mut player = Player::new(content.manifest);
            player.show(&content, 0).unwrap().gaussians.to_vec()
        };
        let (before, after) = (shown(&first), shown(&again));
        assert!(before.iter().zip(&after).all(|(a, b)| a.sh0 == b.sh0 && a.scale == b.scale));
    }
}
