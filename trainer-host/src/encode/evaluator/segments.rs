//! Measures rate and distortion window by window: what a server needs to share out a link.

use codec_core::internals::{
    ids::{EpochId, Level, Span, WindowId},
    wire::manifest::Manifest,
};

use super::{EvaluationError, Evaluator, spread};
use crate::{
    scene::Scene,
    stream::{PacketMap, Stream},
};

/// The frames of one window, or of an epoch in which nothing moves.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Segment {
    /// Epoch, from 0.
    pub epoch: u16,
    /// Window over the whole stream, if anything moves.
    pub window: Option<u16>,
    /// First frame.
    pub first_frame: u32,
    /// Number of frames.
    pub frames: u32,
    /// Per level 0..=3 what it costs and where it leads.
    pub levels: [Point; Level::COUNT],
}

/// One level of a segment.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Point {
    /// Bytes of canonical packets of the level; they count in the epoch's first segment, which
    /// cannot be shown without them.
    pub canonical_bytes: u64,
    /// Bytes of the window's own packets of the level.
    pub motion_bytes: u64,
    /// Bytes of the segment up to this level; media packets only, neither manifest nor parity.
    pub cumulative_bytes: u64,
    /// PSNR of the segment's frames with every level up to this one, of everything, dB: mean over
    /// validation cameras and frames.
    pub psnr_db: f64,
}

/// Rate and distortion of all segments of `stream`, an encoding of `scene`, in display order; each
/// evaluated on up to `frames` of its frames.
///
/// # Errors
/// A stream that does not decode, or what the renderer refuses.
pub fn segments(scene: &Scene, stream: &Stream, frames: u32) -> Result<Vec<Segment>, EvaluationError> {
    let map = PacketMap::of(stream)?;
    let received = stream.receive()?;
    let content = received.content();
    let mut segments = outline(content.manifest);
    for (id, packet) in stream.packets().iter().enumerate() {
        // All marks of a packet of `dgs1` are of one span and level; `paper` has one.
        let Some(mark) = map.placements(id).first() else { continue };
        let bytes = packet.len() as u64;
        let (span, level) = (mark.group.span, mark.group.level.index());
        let its = |s: &&mut Segment| match span {
            Span::Canonical(epoch) => s.epoch == epoch.0,
            Span::Motion(window) => s.window == Some(window.0),
        };
        let Some(segment) = segments.iter_mut().find(its) else { continue };
        let point = &mut segment.levels[level];
        match span {
            Span::Canonical(_) => point.canonical_bytes += bytes,
            Span::Motion(_) => point.motion_bytes += bytes,
        }
    }
    for segment in &mut segments {
        let evaluator = Evaluator::validation(scene, spread(segment.first_frame, segment.frames, frames))?;
        let mut cumulative = 0;
        for (level, point) in Level::ALL.into_iter().zip(&mut segment.levels) {
            let keep = (2u8 << level.get()) - 1;
            let state: Vec<u8> = content.blocks.iter().map(|mask| mask & keep).collect();
            let each = evaluator.psnr(&content, &state)?;
            cumulative += point.canonical_bytes + point.motion_bytes;
            point.cumulative_bytes = cumulative;
            point.psnr_db = each.iter().sum::<f64>() / each.len().max(1) as f64;
        }
    }
    Ok(segments)
}

/// The segments of a manifest with nothing measured.
fn outline(manifest: &Manifest<'_>) -> Vec<Segment> {
    let segment = |epoch, window, first_frame, frames| Segment {
        epoch,
        window,
        first_frame,
        frames,
        levels: Default::default(),
    };
    let windows: Vec<_> = manifest.windows().collect();
    let mut segments = Vec::new();
    for (e, epoch) in manifest.epochs().enumerate() {
        let id = EpochId(e as u16);
        let own = windows.iter().enumerate().filter(|(_, w)| w.epoch == id.0);
        let before = segments.len();
        segments.extend(own.map(|(w, window)| {
            segment(id.0, Some(WindowId(w as u16).0), window.first_frame, u32::from(window.frames))
        }));
        if segments.len() == before {
            segments.push(segment(id.0, None, epoch.first_frame, epoch.frames));
        }
    }
    segments
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        encode::{EncodeOptions, Protection, encode},
        import::{
            Limits,
            synth::{self, SynthKind},
        },
    };

    #[test]
    fn segments_hold_every_packet_and_each_level_adds_quality() {
        for (kind, windows) in [(SynthKind::Figure, 2), (SynthKind::Births, 1)] {
            let options = synth::SynthOptions { gaussians: 1000, frames: 40, kind, ..Default::default() };
            let scene = synth::make(&options, &Limits::default()).unwrap();
            let options = EncodeOptions { repair: Protection::xor(4), ..EncodeOptions::default() };
            let encoded = encode(&scene, &options, &crate::encode::no_progress).unwrap();
            let segments = segments(&scene, &encoded.stream, 1).unwrap();
            assert!(segments.len() >= windows);
            assert_eq!(segments.iter().map(|s| s.frames).sum::<u32>(), 40);
            let total: u64 = segments.iter().map(|s| s.levels[3].cumulative_bytes).sum();
            let ledger = &encoded.report.ledger;
            assert_eq!(total as f64, ledger.wire() - ledger.parity - ledger.manifest);
            for s in &segments {
                let [base, .., last] = s.levels;
                assert!(last.psnr_db > base.psnr_db + 3.0, "{s:?}");
                assert!(s.levels.windows(2).all(|l| l[0].cumulative_bytes <= l[1].cumulative_bytes));
            }
        }
    }
}
