//! Finds where in the scene each group lies, by decoding a stream at the beginning of each of its windows.
//!
//! What a window shows of a cluster lies in a box around its Gaussians at the beginning of that window and of
//! the next; what an epoch has of it, in the boxes of its windows. The distance from which utilities were
//! measured is that of the validation ring around the decoded frames.

use std::{collections::BTreeMap, ops::Range};

use codec_core::internals::{
    ids::{ClusterId, EpochId, Group, Span, WindowId},
    receiver::Content,
};
use dgs_player::FrameDecoder;
use emulator_host::graph::{Ball, Place};
use trainer_host::{
    scene::Up,
    viewpoint::{Framing, Ring},
};

use super::coverage;

/// Most frames that are decoded.
const MAX_FRAMES: usize = 256;
/// Most balls of a place.
const MAX_BALLS: usize = 8;
/// Cameras of the ring that utilities are measured on, and the side of their pictures, of which nothing
/// depends here.
const CAMERAS: (usize, (u32, u32)) = (3, (64, 64));

/// Where groups lie; the levels of a cluster lie in the same place.
#[derive(Debug, Default)]
pub struct Places(BTreeMap<(Span, ClusterId), Place>);

/// The box around some Gaussians: smallest and largest coordinates.
#[derive(Clone, Copy, Debug)]
struct Extent([[f64; 3]; 2]);

impl Extent {
    const NOTHING: Self = Self([[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]]);

    fn add(&mut self, other: &Self) {
        let [low, high] = &mut self.0;
        for k in 0..3 {
            low[k] = low[k].min(other.0[0][k]);
            high[k] = high[k].max(other.0[1][k]);
        }
    }

    /// The ball around it, seen by validation cameras at `eyes`; none around nothing.
    fn ball(&self, eyes: &[[f64; 3]]) -> Option<Ball> {
        let [low, high] = self.0;
        let centre = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
        let squared = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>();
        let radius = squared(high, centre).sqrt();
        let nearness = eyes.iter().map(|eye| 1.0 / squared(*eye, centre)).sum::<f64>() / eyes.len() as f64;
        Ball::new(centre, radius, nearness.sqrt().recip())
    }
}

/// One decoded frame: the extent of each cluster of its epoch.
struct Moment {
    frame: u32,
    epoch: EpochId,
    extents: Vec<Extent>,
}

impl Places {
    /// Where the groups of `content` lie that show in `frames`.
    ///
    /// # Errors
    /// None in practice: what is asked for is there.
    pub fn of(content: &Content<'_>, frames: Range<u32>) -> codec_core::Result<Self> {
        let (moments, eyes) = moments(content, frames)?;
        let manifest = content.manifest;
        let mut places = BTreeMap::new();
        for (id, epoch) in (0..).map(EpochId).zip(manifest.epochs()) {
            let own: Vec<&Moment> = moments.iter().filter(|moment| moment.epoch == id).collect();
            for cluster in (0..epoch.clusters).map(|cluster| ClusterId(cluster as u16)) {
                let mut balls = Vec::new();
                for window in epoch.first_window..epoch.first_window + epoch.windows {
                    let span = Span::Motion(WindowId(window as u16));
                    let (first, frames) = coverage(manifest, span);
                    let Some(ball) = ball(&own, cluster, first..first + frames, &eyes) else { continue };
                    places.extend(Place::new(&[ball]).map(|place| ((span, cluster), place)));
                    balls.push(ball);
                }
                if balls.is_empty() {
                    let all = epoch.first_frame..epoch.first_frame + epoch.frames;
                    balls.extend(ball(&own, cluster, all, &eyes));
                }
                let place = Place::new(&thinned(&balls, MAX_BALLS));
                places.extend(place.map(|place| ((Span::Canonical(id), cluster), place)));
            }
        }
        Ok(Self(places))
    }

    /// Where `group` lies, if that is known.
    pub fn get(&self, group: &Group) -> Option<Place> {
        self.0.get(&(group.span, group.cluster)).cloned()
    }
}

/// Decoded frames at the beginnings of windows and epochs and at the end, ascending, and the centres of the
/// validation cameras.
fn moments(content: &Content<'_>, frames: Range<u32>) -> codec_core::Result<(Vec<Moment>, Vec<[f64; 3]>)> {
    let manifest = content.manifest;
    let windows = manifest.windows().map(|window| window.first_frame);
    let mut wanted: Vec<u32> = manifest.epochs().map(|epoch| epoch.first_frame).chain(windows).collect();
    wanted.push(frames.end.saturating_sub(1));
    wanted.retain(|frame| frames.contains(frame));
    wanted.sort_unstable();
    wanted.dedup();
    let wanted = thinned(&wanted, MAX_FRAMES);
    let framed: Vec<usize> = Framing::sampled(wanted.len()).collect();
    let mut decoder = FrameDecoder::new(manifest);
    let (mut moments, mut positions) = (Vec::new(), Vec::new());
    for (at, frame) in wanted.into_iter().enumerate() {
        let Some(epoch) = manifest.epoch_at(frame) else { continue };
        let gaussians = decoder.frame(content, frame)?.gaussians;
        if framed.contains(&at) {
            let present = gaussians.iter().filter(|gaussian| !gaussian.is_absent());
            positions.push(present.map(|gaussian| gaussian.position).collect::<Vec<_>>());
        }
        let mut rest = gaussians;
        let clusters = manifest.epoch(epoch).map_or(0, |epoch| epoch.clusters);
        let extents = (0..clusters).map(|cluster| {
            let count = manifest.cluster(epoch, ClusterId(cluster as u16)).map_or(0, |own| own.gaussians);
            let (own, after) = rest.split_at(usize::from(count).min(rest.len()));
            rest = after;
            let mut extent = Extent::NOTHING;
            for gaussian in own.iter().filter(|gaussian| !gaussian.is_absent()) {
                let [x, y, z] = gaussian.scale;
                let reach = x.max(y).max(z);
                let side = |sign: f32| gaussian.position.map(|v| f64::from(v + sign * reach));
                extent.add(&Extent([side(-1.0), side(1.0)]));
            }
            extent
        });
        moments.push(Moment { frame, epoch, extents: extents.collect() });
    }
    let positions: Vec<&[[f32; 3]]> = positions.iter().map(Vec::as_slice).collect();
    let framing = Framing::of_positions(&positions, Up::default());
    // A ring of this size always exists; without one nothing is known of distances.
    let cameras = framing.ring(Ring::Validation, CAMERAS.0, CAMERAS.1).unwrap_or_default();
    Ok((moments, cameras.iter().map(render_host::Camera::centre).collect()))
}

/// The ball around `cluster` in `frames`: from the last moment that is not after their beginning to the first
/// that is not before their end, of an epoch's `moments`.
fn ball(moments: &[&Moment], cluster: ClusterId, frames: Range<u32>, eyes: &[[f64; 3]]) -> Option<Ball> {
    let from = moments.partition_point(|moment| moment.frame <= frames.start).checked_sub(1)?;
    let until = moments.partition_point(|moment| moment.frame < frames.end);
    let mut extent = Extent::NOTHING;
    for moment in moments.iter().take(until + 1).skip(from) {
        extent.add(moment.extents.get(usize::from(cluster.0))?);
    }
    extent.ball(eyes)
}

/// Up to `most` of `all`, evenly spread, first and last among them.
fn thinned<T: Copy>(all: &[T], most: usize) -> Vec<T> {
    if all.len() <= most {
        return all.to_vec();
    }
    (0..most).map(|at| all[at * (all.len() - 1) / (most - 1)]).collect()
}

#[cfg(test)]
mod tests {
    use trainer_host::{
        encode::{self, EncodeOptions},
        import::{
            Limits,
            synth::{self, SynthKind, SynthOptions},
        },
    };

    use super::*;

    /// A stream that moves, in windows of ten frames.
    fn received() -> dgs_player::Player {
        let kind = SynthKind::from_name("figure").unwrap();
        let options = SynthOptions { kind, gaussians: 1500, frames: 40, ..SynthOptions::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let coding = EncodeOptions { window_frames: Some(10), pictures: 0, ..EncodeOptions::default() };
        encode::encode(&scene, &coding, &encode::no_progress).unwrap().stream.receive().unwrap()
    }

    /// The slow twin: every Gaussian of every frame, by its cluster and window.
    #[test]
    fn clusters_lie_in_their_balls() {
        let received = received();
        let content = received.content();
        let (manifest, places) = (content.manifest, Places::of(&content, 0..40).unwrap());
        let mut decoder = FrameDecoder::new(manifest);
        let (mut inside, mut all, mut radii) = (0, 0, Vec::new());
        for frame in 0..40 {
            let epoch = manifest.epoch_at(frame).unwrap();
            let window = manifest.window_at(frame).unwrap();
            let gaussians = decoder.frame(&content, frame).unwrap().gaussians.to_vec();
            let mut at = 0;
            for cluster in (0..manifest.epoch(epoch).unwrap().clusters).map(|c| ClusterId(c as u16)) {
                let count = usize::from(manifest.cluster(epoch, cluster).unwrap().gaussians);
                let place = places.0.get(&(Span::Motion(window), cluster)).unwrap();
                let [ball] = place.balls() else { panic!("{place:?}") };
                for gaussian in &gaussians[at..at + count] {
                    let away = |k: usize| f64::from(gaussian.position[k]) - ball.centre()[k];
                    let distance = (0..3).map(|k| away(k).powi(2)).sum::<f64>().sqrt();
                    inside += usize::from(distance <= ball.radius());
                    all += 1;
                    if frame % 10 == 0 {
                        assert!(distance <= ball.radius(), "{distance} of {}", ball.radius());
                    }
                }
                radii.push(ball.radius() / ball.usual_distance());
                let whole = places.0.get(&(Span::Canonical(epoch), cluster)).unwrap();
                assert!(whole.balls().contains(ball) && whole.balls().len() == 4);
                at += count;
            }
            assert_eq!(at, gaussians.len());
        }
        // Between moments a swinging arm may leave the ball, and hardly anything does.
        assert!(inside * 100 >= all * 97, "{inside} of {all}");
        // And the balls say something: they are much smaller than the scene is far away.
        let mean = radii.iter().sum::<f64>() / radii.len() as f64;
        assert!(mean < 0.2, "{mean}");
    }

    #[test]
    fn what_lies_outside_the_frames_has_no_place() {
        let received = received();
        let places = Places::of(&received.content(), 10..21).unwrap();
        let level = codec_core::internals::ids::Level::BASE;
        let group = |window| Group { span: Span::Motion(WindowId(window)), cluster: ClusterId(0), level };
        let known = [0, 1, 2, 3].map(|window| places.get(&group(window)).is_some());
        assert_eq!(known, [false, true, true, true]);
    }

    #[test]
    fn lists_are_thinned_evenly() {
        assert_eq!(thinned(&[1, 2, 3], 3), [1, 2, 3]);
        assert_eq!(thinned(&(0..100).collect::<Vec<_>>(), 4), [0, 33, 66, 99]);
    }
}
