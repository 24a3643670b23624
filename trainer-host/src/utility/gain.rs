//! Gains are what groups add once everything else is there: what schedules, cuts and files go by.
//!
//! A clip that is delivered at all is nearly whole, and a group decides over the picture among what is there
//! already. On cameras that nothing was measured from, orders by gain leave smaller errors at the same bytes
//! than orders by the risk-adjusted utility over random states (`dgs bench utility`), and a gain takes one
//! state where that takes 32.
//!
//! But gains do not add up ([`super::GroupUtility::together`]): where a link carries a part of the base only,
//! a schedule by their sums buys motion of parts that are not there. So those of level 0 are scaled, span by
//! span, to what they gain at once; their order within a span stays. A still scene is one span, and is left
//! as it is: there orders by gains as measured leave the smaller error.

use std::collections::BTreeMap;

use codec_core::internals::ids::{Level, Span};
use render_host::{Camera, CameraError};

use super::{Table, truncation::group_bytes};
use crate::{
    scene::Scene,
    stream::{PacketMap, Stream},
    viewpoint::{Framing, Ring},
};

/// Share of a group's expected gain that is what its bytes gain in all groups of its kind: a few cameras miss
/// what a group adds elsewhere, so that none counts for nothing.
const SHARED: f64 = 0.02;
/// Most that what a span gains at once scales the gains of its groups, either way: both are measured from few
/// views.
const LARGEST_SCALE: f64 = 4.0;

/// The cameras that gains are measured from, from where viewers look: one validation ring.
///
/// # Errors
/// None in practice: the size is one that cameras accept.
pub fn gain_cameras(scene: &Scene) -> Result<Vec<Camera>, CameraError> {
    Framing::of(scene).ring(Ring::Validation, 8, (160, 160))
}

impl Table {
    /// What each group of `stream`, whose map is `map`, is expected to add to a frame in which it shows: at
    /// least 0, and 0 only where no group of its kind (level; window or epoch) that the stream has gains
    /// anything. Measured gains, where they are positive, drawn by 2 % towards what the kind gains per byte;
    /// those of level 0, where there are several spans, scaled so that a span's add up to what they gain at
    /// once.
    /// In the unit of D, in the order of [`PacketMap::groups`].
    pub fn expected_gains(&self, stream: &Stream, map: &PacketMap) -> Vec<f64> {
        let bytes = group_bytes(stream, map);
        let gains = self.gains_at_once(map);
        let kinds = map.groups().iter().map(|(group, _)| {
            2 * usize::from(group.level.get()) + usize::from(matches!(group.span, Span::Motion(_)))
        });
        let mut sums = [(0.0, 0.0); 8];
        let groups = || gains.iter().zip(&bytes).zip(kinds.clone());
        // Of a stream that was cut, what is not there tells nothing of the bytes that are.
        for ((gain, bytes), kind) in groups().filter(|((_, bytes), _)| **bytes > 0.0) {
            sums[kind].0 += gain;
            sums[kind].1 += bytes;
        }
        let expected = groups().map(|((gain, bytes), kind)| {
            let (all_gains, all_bytes) = sums[kind];
            let per_byte = if all_bytes > 0.0 { all_gains / all_bytes } else { 0.0 };
            (1.0 - SHARED) * gain + SHARED * per_byte * bytes
        });
        expected.collect()
    }

    /// Measured gains where they are positive, else 0; those of level 0 scaled so that a span's add up to
    /// what they gain at once, where that was measured.
    fn gains_at_once(&self, map: &PacketMap) -> Vec<f64> {
        let mut gains: Vec<f64> = self.groups.iter().map(|group| group.gain.max(0.0)).collect();
        let mut bases: BTreeMap<Span, Vec<usize>> = BTreeMap::new();
        for (at, (group, _)) in map.groups().iter().enumerate() {
            if group.level == Level::BASE {
                bases.entry(group.span).or_default().push(at);
            }
        }
        for span in bases.values() {
            let sum: f64 = span.iter().map(|at| gains[*at]).sum();
            let together = span.first().and_then(|at| self.groups[*at].together);
            if let Some(together) = together.filter(|together| *together > 0.0 && sum > 0.0) {
                let scale = (together / sum).clamp(1.0 / LARGEST_SCALE, LARGEST_SCALE);
                span.iter().for_each(|at| gains[*at] *= scale);
            }
        }
        gains
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        encode::{EncodeOptions, encode, no_progress},
        import::{Limits, synth},
        utility::{GroupUtility, References, UtilityOptions, measure},
    };

    /// A made figure in so many frames, its groups and their gains.
    fn measured(frames: usize) -> (Stream, PacketMap, Table) {
        let options = synth::SynthOptions { gaussians: 1000, frames, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let options = EncodeOptions { pictures: 0, ..Default::default() };
        let stream = encode(&scene, &options, &no_progress).unwrap().stream;
        let map = PacketMap::of(&stream).unwrap();
        let cameras = Framing::of(&scene).ring(Ring::Validation, 2, (40, 30)).unwrap();
        let references = References::renders(&scene, &cameras, &cameras);
        let how = UtilityOptions { complete: true, ..UtilityOptions::paper() };
        let received = stream.receive().unwrap();
        let table = measure(&references, &received.content(), &map, &how, &|_| {}).unwrap();
        (stream, map, table)
    }

    #[test]
    fn gains_that_were_measured_keep_their_order_and_what_measured_none_counts_a_little() {
        let (stream, map, mut table) = measured(20);
        let level = |group: &GroupUtility| usize::from(group.level);
        table.groups.iter_mut().for_each(|group| group.together = None);
        // Level 1 gains nothing anywhere; of the others, every third group was not seen.
        for (at, group) in table.groups.iter_mut().enumerate() {
            match (level(group), at % 3) {
                (1, _) => group.gain = -1e-5,
                (_, 0) => group.gain = 0.0,
                _ => {}
            }
        }
        let expected = table.expected_gains(&stream, &map);
        let pairs = || table.groups.iter().zip(&expected);
        assert!(pairs().all(|(group, expected)| (*expected > 0.0) == (level(group) != 1)));
        let largest = pairs().max_by(|a, b| a.0.gain.total_cmp(&b.0.gain)).unwrap();
        let unseen = pairs().filter(|(group, _)| level(group) == level(largest.0) && group.gain == 0.0);
        assert!(unseen.count() > 2 && (largest.1 / largest.0.gain - 1.0).abs() < SHARED);
        // What a kind gains is shared, not made.
        let sum = |values: &dyn Fn(&GroupUtility, f64) -> f64| -> f64 {
            pairs().map(|(group, expected)| values(group, *expected)).sum()
        };
        let (before, after) = (sum(&|group, _| group.gain.max(0.0)), sum(&|_, expected| expected));
        assert!((after / before - 1.0).abs() < 1e-9, "{before} {after}");
    }

    /// The bases of a span are expected to add what they add at once.
    #[test]
    fn bases_add_up_to_what_they_gain_at_once() {
        let (_, map, mut table) = measured(20);
        let places = |table: &Table, level: u8| {
            let of_epoch = |at: &usize| matches!(map.groups()[*at].0.span, Span::Canonical(_));
            (0..table.groups.len()).filter(of_epoch).filter(|at| table.groups[*at].level == level).collect()
        };
        let (bases, upper): (Vec<usize>, Vec<usize>) = (places(&table, 0), places(&table, 1));
        let sum = |table: &Table, places: &[usize]| -> f64 {
            let gains = table.gains_at_once(&map);
            places.iter().map(|at| gains[*at]).sum()
        };
        let together = table.groups[bases[0]].together.unwrap();
        assert!((sum(&table, &bases) / together - 1.0).abs() < 1e-9);
        let refined = sum(&table, &upper);
        // What they gain at once scales them, and only them; beyond a factor of 4 it is not believed.
        bases.iter().for_each(|at| table.groups[*at].together = Some(2.0 * together));
        assert!((sum(&table, &bases) / together - 2.0).abs() < 1e-9 && sum(&table, &upper) == refined);
        bases.iter().for_each(|at| table.groups[*at].together = None);
        let unscaled = sum(&table, &bases);
        bases.iter().for_each(|at| table.groups[*at].together = Some(100.0 * unscaled));
        assert!((sum(&table, &bases) / unscaled - LARGEST_SCALE).abs() < 1e-9);
    }

    #[test]
    fn a_still_scene_goes_by_gains_as_measured() {
        let (_, map, mut table) = measured(1);
        assert!(table.groups.iter().all(|group| group.together.is_none()));
        let gains: Vec<f64> = table.groups.iter().map(|group| group.gain.max(0.0)).collect();
        assert_eq!(table.gains_at_once(&map), gains);
        // If it were measured, it would count.
        let sum: f64 = table.groups.iter().filter(|group| group.level == 0).map(|group| group.gain).sum();
        table.groups.iter_mut().for_each(|group| group.together = Some(2.0 * sum));
        assert_ne!(table.gains_at_once(&map), gains);
    }
}
