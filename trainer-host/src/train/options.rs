//! Options of a reconstruction: how much, how fast, how rigid. Plain data with defaults that work.

use codec_core::{Footprint, ShDegree};
use render_host::adjoint::loss::photograph::Weights;
use serde::{Deserialize, Serialize};

use crate::scene::footprint_name;

/// How a scene is reconstructed.
///
/// Lengths are in units of the scene's extent (half the side of the cube that holds it), so that the same
/// numbers work for a scene of any size.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainOptions {
    /// Seed of everything random.
    pub seed: u64,
    /// Gaussians to begin with.
    pub initial_gaussians: usize,
    /// Gaussians at the end, at most.
    pub max_gaussians: usize,
    /// Control nodes of the last layer; 0 for a scene that does not move.
    pub nodes: usize,
    /// Degree of the harmonics, 0 to 3.
    pub sh_degree: u8,
    /// Time whose Gaussians are stored, 0 to 1: others are moved ones.
    pub canonical_time: f32,
    /// Longest side of the photographs that are trained on, pixels: larger ones are reduced.
    pub max_side: u32,
    /// How Gaussians are drawn, by name: "pixel" is right at any size of pixels, "dilated" is what most
    /// viewers of splat files draw; without it, that of the dataset.
    #[serde(with = "footprint_name::option")]
    pub footprint: Option<Footprint>,
    /// Background that the result is judged over.
    pub background: [f32; 3],
    /// Weight of the mean absolute error in the loss.
    pub absolute_weight: f32,
    /// Weight of `1 - SSIM` in the loss.
    pub structure_weight: f32,
    /// Weight of rigid motion of neighbouring nodes at the start; it falls to a twentieth.
    pub rigidity: f32,
    /// Weight in the loss of how far the mean node moves and turns, extents and half radians.
    pub stillness: f32,
    /// Gaussians that stay this close to the middle of their path become static, in extents of the scene; the
    /// limit is halved while the PSNR of training views falls by it. 0: none.
    pub stand_still_within: f32,
    /// Weight in the loss of how unevenly nodes move over time.
    pub smoothness: f32,
    /// Weight in the loss, per nat and Gaussian, of an estimate of what motion costs that clusters' tracks do
    /// not code, from [`Schedule::residual_from`] on: the mean of `ln(1 + |r|² / s²) / 2`, `r` being what the
    /// affine motion of its neighbourhood leaves of a Gaussian's and `s` a quantiser step. 0: none.
    pub residual_weight: f32,
    /// Weight of the mean opacity in the loss.
    pub opacity_weight: f32,
    /// Weight of the mean scale in the loss, extents.
    pub scale_weight: f32,
    /// How new Gaussians come about.
    pub density: DensityControl,
    /// Learning rates.
    pub rates: Rates,
    /// When what happens.
    pub schedule: Schedule,
    /// What makes the scene small.
    pub finish: Finish,
}

/// How a training ends: what the scene does not need goes, and the rest learns to be rounded.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Finish {
    /// Shares of the training, in order, at which Gaussians that pictures hardly need are removed; 1: never.
    /// At least [`Schedule::density_end`]. From `round_from` on nothing is removed.
    pub prune_at: [f64; 2],
    /// Share of the Gaussians that each pruning removes.
    pub prune: f64,
    /// From this share of the training on it runs as the encoder rounds and with what values cost; 1: never.
    /// At least [`Schedule::density_end`]: choices of the encoder hold for the Gaussians that there are.
    pub round_from: f64,
    /// Quantiser steps from then on, of the encoder's default.
    pub coarseness: f32,
    /// Weight in the loss of what values cost, kilobits per Gaussian.
    pub rate_weight: f32,
    /// Bytes that the stream is to have at most; `coarseness` and `motion` then grow or shrink together. 0:
    /// whatever they lead to.
    pub target_bytes: u64,
    /// Steps of motion from then on, of the encoder's default.
    pub motion: f32,
}

impl Default for Finish {
    fn default() -> Self {
        Self {
            prune_at: [0.65, 0.75],
            prune: 0.25,
            round_from: 0.8,
            coarseness: 2.0,
            rate_weight: 0.01,
            target_bytes: 0,
            motion: 1.0,
        }
    }
}

/// Shares of the training, 0 to 1, at which things change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Schedule {
    /// Until here only views near the canonical instant are used, and nothing moves.
    pub still: f64,
    /// Over this share after it the span of time grows to all of the clip.
    pub growth: f64,
    /// From here a layer of a quarter as many nodes as `nodes` adds to the motion of the first, of a
    /// sixteenth.
    pub quarter_of_nodes: f64,
    /// From here the last layer, of all nodes, adds to both.
    pub all_nodes: f64,
    /// From here nodes can change their motion twice as fast; 1: never.
    pub fine_time: f64,
    /// From here nodes can change their motion twice as fast again, where training photographs have at least
    /// 128 different times; 1: never.
    pub finest_time: f64,
    /// From here motion that clusters' tracks do not code has a price; 1: never.
    pub residual_from: f64,
    /// From here on, four times until values are rounded and not before a thousand steps, Gaussians that
    /// hardly move are stood still.
    pub stand_still_from: f64,
    /// From here Gaussians are neither added nor removed.
    pub density_end: f64,
    /// Until here photographs have their smallest, second and third size (an eighth, a quarter and a half of
    /// the last); of fewer sizes the first numbers count.
    pub sizes: [f64; 3],
    /// Rates of positions and nodes at the end, of those at the start.
    pub motion_decay: f64,
    /// Other rates at the end, of those at the start.
    pub decay: f64,
    /// Weight of rigidity at the end, of that at the start.
    pub rigidity_decay: f64,
    /// Until here every step judges each channel of a photograph with transparency over the background or
    /// the opposite one, at random, so that nothing but an outline explains it. At 1 the scene stands before
    /// any background; less gives more on [`TrainOptions::background`] alone.
    pub opposite_end: f64,
    /// From here the scene is the moving average of the parameters over a hundred steps; 1: never, the scene
    /// is what the last step led to.
    pub average_from: f64,
    /// Share of the training between two bands of the harmonics: band 1 begins after one such share, band 2
    /// after two, band 3 after three (Kerbl et al. 2023, section 7.1). Until then a band is 0, and is neither
    /// evaluated nor differentiated; bands that the scene begins with learn from the first step. 0: all do.
    /// At most 0.25, and [`TrainOptions::sh_degree`] times it at most [`Finish::round_from`].
    pub harmonics_every: f64,
}

impl Default for Schedule {
    fn default() -> Self {
        Self {
            still: 0.03,
            growth: 0.12,
            quarter_of_nodes: 0.1,
            all_nodes: 0.22,
            fine_time: 0.3,
            finest_time: 0.35,
            residual_from: 0.35,
            stand_still_from: 0.35,
            density_end: 0.6,
            sizes: [0.12, 0.35, 0.6],
            motion_decay: 0.02,
            decay: 1.0,
            rigidity_decay: 0.05,
            opposite_end: 1.0,
            average_from: 0.9,
            harmonics_every: 0.0,
        }
    }
}

impl Finish {
    /// Checks every number with `real`, which takes a field, its value, the most and what is allowed.
    fn validate(
        &self,
        real: impl Fn(&'static str, f32, f32, &'static str) -> Result<(), OptionsError>,
    ) -> Result<(), OptionsError> {
        let Self {
            prune_at: [first, second],
            prune,
            round_from,
            coarseness,
            rate_weight,
            target_bytes: _,
            motion,
        } = *self;
        let shares = [
            ("finish.prune_at[0]", first),
            ("finish.prune_at[1]", second),
            ("finish.prune", prune),
            ("finish.round_from", round_from),
        ];
        for (field, value) in shares {
            real(field, value as f32, 1.0, "0 to 1")?;
        }
        let in_order = if first <= second { 1.0 } else { -1.0 };
        real("finish.prune_at[1]", second as f32, in_order, "finish.prune_at[0] to 1")?;
        real("finish.rate_weight", rate_weight, 100.0, "0 to 100")?;
        for (field, value) in [("finish.coarseness", coarseness), ("finish.motion", motion)] {
            // Below the least that is allowed, it is outside of what is.
            let most = if value > 0.0 { 64.0 } else { -1.0 };
            real(field, value, most, "above 0, to 64")?;
        }
        Ok(())
    }
}

/// How Gaussians are added where the pictures ask for more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DensityControl {
    /// Those whose centres are pulled most are split along their longest axis; pulls of single pixels add up
    /// by length, so that those in opposite directions count (Ye et al., "AbsGS", 2024).
    Split,
    /// As `Split`, by the length of the sum of pulls (Kerbl et al. 2023, section 5).
    SplitBySum,
    /// Transparent ones move to opaque ones, and all jitter (Kheradmand et al. 2024).
    Relocate,
}

/// Learning rates at the start, per step of Adam. Lengths are in extents.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rates {
    /// Positions.
    pub position: f32,
    /// Logarithms of scales.
    pub log_scale: f32,
    /// Quaternions.
    pub rotation: f32,
    /// Logits of opacities.
    pub opacity: f32,
    /// Band 0 of the harmonics.
    pub sh0: f32,
    /// Higher bands.
    pub sh_rest: f32,
    /// Weights of nodes.
    pub skin: f32,
    /// Shifts and turns of the last layer of nodes; each before it learns at 0.3 of the next one's.
    pub node_motion: f32,
    /// Logarithms of factors, and offsets, by which photographs from each place differ in colour; 0: none do.
    /// Only of rigs: photographs with outlines, or with a place of their own each, have none.
    pub exposure: f32,
}

impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            seed: 1,
            initial_gaussians: 4000,
            max_gaussians: 26_000,
            nodes: 512,
            sh_degree: 2,
            canonical_time: 0.5,
            max_side: 800,
            footprint: None,
            background: [1.0; 3],
            absolute_weight: 0.8,
            structure_weight: 0.2,
            rigidity: 1e-2,
            stillness: 1e-2,
            stand_still_within: 0.04,
            smoothness: 0.03,
            residual_weight: 0.0005,
            opacity_weight: 0.0,
            scale_weight: 0.0,
            density: DensityControl::Split,
            rates: Rates::default(),
            schedule: Schedule::default(),
            finish: Finish::default(),
        }
    }
}

impl Default for Rates {
    fn default() -> Self {
        Self {
            position: 4.6e-4,
            log_scale: 2.4e-2,
            rotation: 1.2e-2,
            opacity: 4e-2,
            sh0: 8e-3,
            sh_rest: 3e-3,
            skin: 1e-2,
            node_motion: 2e-3,
            exposure: 1e-2,
        }
    }
}

/// An option out of range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} is {found}; {allowed} is allowed")]
pub struct OptionsError {
    /// Which option.
    pub field: &'static str,
    /// Its value.
    pub found: String,
    /// What is allowed.
    pub allowed: String,
}

impl TrainOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// The first that is out of range.
    pub fn validate(&self) -> Result<(), OptionsError> {
        let refuse = |field, found, allowed| Err(OptionsError { field, found, allowed });
        let whole = |field, found: usize, low: usize, high: usize, allowed: &'static str| {
            let fits = (low..=high).contains(&found);
            if fits { Ok(()) } else { refuse(field, found.to_string(), allowed.to_owned()) }
        };
        let real = |field, found: f32, high: f32, allowed: &'static str| {
            let fits = (0.0..=high).contains(&found);
            if fits { Ok(()) } else { refuse(field, found.to_string(), allowed.to_owned()) }
        };
        whole("initial_gaussians", self.initial_gaussians, 1, 5_000_000, "1 to 5000000")?;
        whole("max_gaussians", self.max_gaussians, 1, 5_000_000, "1 to 5000000")?;
        whole("nodes", self.nodes, 0, 65_536, "0 to 65536")?;
        whole("sh_degree", usize::from(self.sh_degree), 0, 3, "0 to 3")?;
        whole("max_side", self.max_side as usize, 16, 16_384, "16 to 16384")?;
        real("canonical_time", self.canonical_time, 1.0, "0 to 1")?;
        for value in self.background {
            real("background", value, 1.0, "0 to 1")?;
        }
        let Rates { position, log_scale, rotation, opacity, sh0, sh_rest, skin, node_motion, exposure } =
            self.rates;
        let rates = [
            ("rates.position", position),
            ("rates.log_scale", log_scale),
            ("rates.rotation", rotation),
            ("rates.opacity", opacity),
            ("rates.sh0", sh0),
            ("rates.sh_rest", sh_rest),
            ("rates.skin", skin),
            ("rates.node_motion", node_motion),
            ("rates.exposure", exposure),
        ];
        let weights = [
            ("absolute_weight", self.absolute_weight),
            ("structure_weight", self.structure_weight),
            ("rigidity", self.rigidity),
            ("stillness", self.stillness),
            ("stand_still_within", self.stand_still_within),
            ("smoothness", self.smoothness),
            ("residual_weight", self.residual_weight),
            ("opacity_weight", self.opacity_weight),
            ("scale_weight", self.scale_weight),
        ];
        for (field, value) in rates.into_iter().chain(weights) {
            real(field, value, 100.0, "0 to 100")?;
        }
        let Schedule {
            still,
            growth,
            quarter_of_nodes,
            all_nodes,
            fine_time,
            finest_time,
            residual_from,
            stand_still_from,
            density_end,
            sizes: [first, second, third],
            motion_decay,
            decay,
            rigidity_decay,
            opposite_end,
            average_from,
            harmonics_every,
        } = self.schedule;
        let shares = [
            ("schedule.still", still),
            ("schedule.growth", growth),
            ("schedule.quarter_of_nodes", quarter_of_nodes),
            ("schedule.all_nodes", all_nodes),
            ("schedule.fine_time", fine_time),
            ("schedule.finest_time", finest_time),
            ("schedule.residual_from", residual_from),
            ("schedule.stand_still_from", stand_still_from),
            ("schedule.density_end", density_end),
            ("schedule.sizes[0]", first),
            ("schedule.sizes[1]", second),
            ("schedule.sizes[2]", third),
            ("schedule.motion_decay", motion_decay),
            ("schedule.decay", decay),
            ("schedule.rigidity_decay", rigidity_decay),
            ("schedule.opposite_end", opposite_end),
            ("schedule.average_from", average_from),
        ];
        for (field, value) in shares {
            real(field, value as f32, 1.0, "0 to 1")?;
        }
        real("schedule.harmonics_every", harmonics_every as f32, 0.25, "0 to 0.25")?;
        self.finish.validate(real)?;
        let (round_from, density_end) = (self.finish.round_from, density_end);
        let [pruned_from, _] = self.finish.prune_at;
        if self.finish.prune > 0.0 && pruned_from < 1.0 && pruned_from < density_end {
            let allowed = format!("0 to {pruned_from} (finish.prune_at[0])");
            return refuse("schedule.density_end", density_end.to_string(), allowed);
        }
        if round_from < density_end {
            let allowed = format!("{density_end} (schedule.density_end) to 1");
            return refuse("finish.round_from", round_from.to_string(), allowed);
        }
        // What the encoder chooses when rounding begins holds to the end, and says which bands are sent.
        let latest = self.finish.round_from / f64::from(self.sh_degree.max(1));
        if self.sh_degree > 0 && harmonics_every > latest {
            let allowed = format!("0 to {latest} (finish.round_from / sh_degree)");
            return refuse("schedule.harmonics_every", harmonics_every.to_string(), allowed);
        }
        Ok(())
    }

    /// Weights of the loss.
    pub(super) fn weights(&self) -> Weights {
        Weights { absolute: self.absolute_weight, squared: 0.0, structure: self.structure_weight }
    }

    pub(super) fn degree(&self) -> ShDegree {
        ShDegree::new(self.sh_degree).unwrap_or_default()
    }
}
