//! Quantises a scene into the symbols of a `dgs1` stream, as decisions say.

use codec_core::internals::{
    ids::{EpochId, Level, Span, WindowId},
    wire::manifest::{Proxy, Quant},
};

use super::{
    super::{
        EncodeError,
        decisions::{Dgs1Decisions, EpochDecisions, Quantisers, misfit},
        packetise::{CellSymbols, each_run},
        statistics::{Model, Streams},
    },
    canonical, canonical_rotation, levels_sent,
    motion::{self, WindowSymbols},
    proxy,
};
use crate::scene::{Epoch, Scene};

/// One epoch, quantised.
pub(super) struct EpochSymbols {
    pub first_frame: usize,
    pub frames: usize,
    /// Canonical cells, one per cluster.
    pub cells: Vec<CellSymbols>,
    pub windows: Vec<WindowSymbols>,
    pub proxies: Vec<Proxy>,
    /// Values that did not fit their symbol and were clamped.
    pub saturated: u64,
}

/// The symbols of all epochs of `scene`.
///
/// # Errors
/// Quantisers out of range; a track too fine for its symbols.
pub(super) fn quantise(scene: &Scene, decisions: &Dgs1Decisions) -> Result<Vec<EpochSymbols>, EncodeError> {
    let mut epochs = Vec::new();
    let mut first_frame = 0;
    for (epoch, decided) in scene.epochs().iter().zip(&decisions.epochs) {
        let epoch = &in_canonical_rotation(epoch, decided);
        let mut symbols = quantise_epoch(epoch, decided, decisions.block_len, decisions.proxies)?;
        symbols.first_frame = first_frame;
        first_frame += epoch.frames();
        epochs.push(symbols);
    }
    Ok(epochs)
}

/// `epoch` with its rotations and scales in the form that was decided.
pub(super) fn in_canonical_rotation(epoch: &Epoch, decided: &EpochDecisions) -> Epoch {
    let mut sets: Vec<Vec<u32>> = decided.clusters.iter().map(|c| c.gaussians.clone()).collect();
    // Sums over a cluster are rounded alike whatever the order in which it is sent.
    sets.iter_mut().for_each(|set| set.sort_unstable());
    canonical_rotation::reduced(epoch, &sets, decided.canonical_rotation)
}

/// The symbols of `epoch`, whose rotations are in the form that was decided.
///
/// # Errors
/// As [`quantise`].
pub(super) fn quantise_epoch(
    epoch: &Epoch,
    decided: &EpochDecisions,
    block_len: usize,
    with_proxies: bool,
) -> Result<EpochSymbols, EncodeError> {
    let quants: Result<Vec<Quant>, EncodeError> = decided.quantisers.iter().map(Quantisers::quant).collect();
    let mut canonical = canonical::quantise(epoch, decided, &quants?, block_len)?;
    let mut saturated = canonical.saturated;
    let mut windows = Vec::new();
    let mut first_frame = 0;
    for (w, window) in decided.windows.iter().enumerate() {
        let mut symbols = motion::quantise(epoch, (w, first_frame), decided, &canonical)?;
        levels_sent::cut_motion(&mut symbols.cells, decided, w);
        saturated += symbols.saturated;
        first_frame += window.frames;
        windows.push(symbols);
    }
    let proxies = if with_proxies { proxy::proxies(epoch, decided, &canonical) } else { Vec::new() };
    levels_sent::cut_canonical(&mut canonical.cells, decided);
    let mut cells = canonical.cells;
    let decided_cells = decided.clusters.iter().map(|c| &c.table_indices);
    for (cell, indices) in cells.iter_mut().zip(decided_cells) {
        cell.table_indices = parsed(indices)?;
    }
    for (window, decided) in windows.iter_mut().zip(&decided.windows) {
        for (cell, motion) in window.cells.iter_mut().zip(&decided.motions) {
            cell.table_indices = parsed(&motion.table_indices)?;
            follow_track(cell);
        }
    }
    Ok(EpochSymbols { first_frame: 0, frames: epoch.frames(), cells, windows, proxies, saturated })
}

/// Table indices from their digits.
fn parsed(digits: &[String; Level::COUNT]) -> Result<[Vec<u8>; Level::COUNT], EncodeError> {
    let mut indices: [Vec<u8>; Level::COUNT] = Default::default();
    for (indices, digits) in indices.iter_mut().zip(digits) {
        for digit in digits.bytes() {
            if !(b'0'..b'8').contains(&digit) {
                return Err(misfit("a cell", "table_indices", char::from(digit), "digits 0 to 7"));
            }
            indices.push(digit - b'0');
        }
    }
    Ok(indices)
}

/// Fits the tables of a track, all of a motion cell's base, to the frequency bands that it has now: those of
/// turns, then those of moves. A band that was not coded when tables were decided takes the first of its set.
fn follow_track(cell: &mut CellSymbols) {
    let mut bands = 0;
    symbol_runs(cell, |level, _, _| bands += usize::from(level == Level::BASE));
    let decided = &mut cell.table_indices[Level::BASE.index()];
    let moves = decided.split_off(decided.len() / 2);
    decided.resize(bands / 2, 0);
    decided.extend(moves.into_iter().chain(std::iter::repeat(0)).take(bands / 2));
}

/// Whether every symbol run of `epochs` has a table of its stream's set, and no more.
///
/// # Errors
/// Names the cell that has too few or too many table indices, or one past the end of its set.
pub(super) fn check_table_indices(epochs: &[EpochSymbols], model: &Model) -> Result<(), EncodeError> {
    for (span, cells) in spans(epochs) {
        for (c, cell) in cells.iter().enumerate() {
            let place = || match span {
                Span::Canonical(epoch) => format!("epoch {}, cluster {c}", epoch.0),
                Span::Motion(window) => format!("window {} of the stream, cluster {c}", window.0),
            };
            let mut left = cell.table_indices.each_ref().map(|indices| indices.iter());
            let mut missing = Ok(());
            symbol_runs(cell, |level, stream, _| {
                let choices = model.table_sets[stream].len();
                match left[level.index()].next() {
                    Some(&index) if usize::from(index) < choices => {}
                    Some(index) if missing.is_ok() => {
                        missing = Err(misfit(place(), "table_indices", index, format_args!("0..{choices}")));
                    }
                    None if missing.is_ok() => {
                        missing = Err(misfit(place(), "table_indices", "too few", "one per symbol run"));
                    }
                    _ => {}
                }
            });
            missing?;
            if left.iter_mut().any(|rest| rest.next().is_some()) {
                return Err(misfit(place(), "table_indices", "too many", "one per symbol run"));
            }
        }
    }
    Ok(())
}

/// All cells with their spans, canonical cells of an epoch before its windows.
pub(super) fn spans(epochs: &[EpochSymbols]) -> Vec<(Span, &[CellSymbols])> {
    let mut spans = Vec::new();
    let mut windows = 0u16;
    for (e, epoch) in epochs.iter().enumerate() {
        spans.push((Span::Canonical(EpochId(e as u16)), epoch.cells.as_slice()));
        for window in &epoch.windows {
            spans.push((Span::Motion(WindowId(windows)), window.cells.as_slice()));
            windows += 1;
        }
    }
    spans
}

/// Calls `visit` with level, stream and symbols of each symbol run of a cell.
pub(super) fn symbol_runs<'c>(cell: &'c CellSymbols, mut visit: impl FnMut(Level, usize, &'c [i16])) {
    for level in Level::ALL {
        if cell.shape.level_len(level) > 0 {
            each_run(cell, level, 0..cell.shape.blocks(), |stream, run| visit(level, stream, run));
        }
    }
}

/// The symbol runs of all cells by stream.
pub(super) fn streams(epochs: &[EpochSymbols]) -> Streams<'_> {
    let mut streams = Streams::default();
    for (_, cells) in spans(epochs) {
        for cell in cells {
            symbol_runs(cell, |_, stream, run| streams.add(stream, run));
        }
    }
    streams
}

#[cfg(test)]
mod tests {
    use codec_core::Gaussian;
    use glam::Vec3;

    use crate::{
        encode::{Decisions, EncodeOptions, encode, write},
        import::{
            Limits,
            synth::{self, SynthKind, SynthOptions},
        },
        scene::{Attributes, Epoch, Scene, Track},
    };

    /// The first frame of every `period` frames, held until the next.
    fn jumpy(scene: &Scene, period: usize) -> Scene {
        let hold = |epoch: &Epoch| {
            let (n, a) = (epoch.count(), epoch.attributes().clone());
            let frames = || (0..epoch.frames()).map(|t| t / period * period);
            let positions = frames().flat_map(|t| a.positions.frame(t, n).to_vec()).collect();
            let rotations = frames().flat_map(|t| a.rotations.frame(t, n).to_vec()).collect();
            let attributes = Attributes {
                positions: Track::PerFrame(positions),
                rotations: Track::PerFrame(rotations),
                ..a
            };
            Epoch::new(epoch.frames(), attributes).unwrap()
        };
        Scene::new(scene.epochs().iter().map(hold).collect(), scene.frames_per_second()).unwrap()
    }

    fn bases(decisions: &Decisions) -> usize {
        let Decisions::Dgs1(decisions) = decisions else { return 0 };
        let windows = decisions.epochs.iter().flat_map(|epoch| &epoch.windows);
        windows.flat_map(|w| &w.motions).filter(|motion| !motion.table_indices[0].is_empty()).count()
    }

    /// How far any Gaussian is in the last frame from where it is in the first, scene units.
    fn furthest(stream: &dgs_player::Stream) -> f32 {
        let mut receiver = stream.receive().unwrap();
        let first = receiver.frame(0).unwrap().gaussians.to_vec();
        let last = receiver.frame(7).unwrap().gaussians;
        let moved = |a: &Gaussian, b: &Gaussian| Vec3::from(a.position).distance(b.position.into());
        first.iter().zip(last).map(|(a, b)| moved(a, b)).fold(0.0, f32::max)
    }

    #[test]
    fn tracks_come_and_go_under_one_set_of_decisions() {
        let options =
            SynthOptions { gaussians: 1200, frames: 8, kind: SynthKind::Figure, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let options = EncodeOptions { pictures: 0, window_frames: Some(4), ..Default::default() };
        let moving = encode(&scene, &options, &crate::encode::no_progress).unwrap();
        assert!(bases(&moving.decisions) > 0);
        // Nothing moves: no track has anything to say.
        let still = write(&jumpy(&scene, 8), &moving.decisions, &crate::encode::no_progress).unwrap();
        // Tracks of nothing are coded to a step of the quantiser.
        assert!(furthest(&still.stream) < 1e-3);
        // It jumps: tracks have more frequencies.
        let jumping = write(&jumpy(&scene, 2), &moving.decisions, &crate::encode::no_progress).unwrap();
        assert!(furthest(&jumping.stream) > 1e-2, "{}", furthest(&jumping.stream));
        // Nothing moved when tables were decided, but tracks were.
        let mut decisions = moving.decisions.clone();
        if let Decisions::Dgs1(decisions) = &mut decisions {
            let windows = decisions.epochs.iter_mut().flat_map(|epoch| &mut epoch.windows);
            windows.flat_map(|w| &mut w.motions).for_each(|motion| motion.table_indices[0].clear());
        }
        let again = write(&scene, &decisions, &crate::encode::no_progress).unwrap();
        let (mut a, mut b) = (moving.stream.receive().unwrap(), again.stream.receive().unwrap());
        assert_eq!(a.frame(5).unwrap().gaussians, b.frame(5).unwrap().gaussians);
        // Of anything else a table is missed.
        if let Decisions::Dgs1(decisions) = &mut decisions {
            decisions.epochs[0].clusters[0].table_indices[0].clear();
        }
        let error = write(&scene, &decisions, &crate::encode::no_progress).unwrap_err().to_string();
        assert!(error.contains("epoch 0, cluster 0: table_indices is too few"), "{error}");
    }
}
