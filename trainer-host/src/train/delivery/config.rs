//! Says how to fine-tune: by a name, or by a JSON file.

use std::path::{Path, PathBuf};

use codec_core::internals::digest::Digest;
use rand::RngExt;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::{
    channel::{Link, LossModel},
    error::DeliveryError,
};
use crate::encode;

/// Which worlds are sampled and which terms count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Variant {
    /// Everything arrives: D of the complete state alone.
    Reconstruction,
    /// Independent losses: E\[D\] alone.
    Iid,
    /// Bursts of loss: E\[D\] and the tail.
    BurstCvar,
    /// Clean anchors, independent losses, bursts and whole links, with every term: named `mixed`.
    #[serde(rename = "mixed")]
    Combined,
}

impl Variant {
    /// All, in the order of the paper's study.
    pub const ALL: [Self; 4] = [Self::Reconstruction, Self::Iid, Self::BurstCvar, Self::Combined];

    /// Its name, as in a configuration.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Reconstruction => "reconstruction",
            Self::Iid => "iid",
            Self::BurstCvar => "burst-cvar",
            Self::Combined => "mixed",
        }
    }

    /// The weights of `given` that count in it.
    pub(super) fn weights(self, given: &Weights) -> Weights {
        let none = Weights { cvar: 0.0, rate: 0.0, temporal: 0.0, monotone: 0.0, anchor: 0.0, ..*given };
        match self {
            Self::Reconstruction | Self::Iid => none,
            Self::BurstCvar => Weights { cvar: given.cvar, ..none },
            Self::Combined => *given,
        }
    }
}

/// Weights of the objective's terms; the defaults are the paper's, section 4.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Weights {
    /// Of `1 − SSIM` in D.
    pub structure: f64,
    /// λc, of the tail.
    pub cvar: f64,
    /// The fraction of worlds in the tail, 0..=1.
    pub cvar_fraction: f64,
    /// λr, of the rate in kilobits per Gaussian; the paper reports 0.
    pub rate: f64,
    /// λt, of errors in the change from frame to frame.
    pub temporal: f64,
    /// λm, of prefixes worse than a shorter one.
    pub monotone: f64,
    /// Of D of the complete prefix.
    pub anchor: f64,
}

impl Default for Weights {
    fn default() -> Self {
        Self {
            structure: 0.20,
            cvar: 0.30,
            cvar_fraction: 0.05,
            rate: 0.0,
            temporal: 0.10,
            monotone: 2.0,
            anchor: 0.50,
        }
    }
}

/// What is lost at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LossUnit {
    /// A packet: some blocks of a group in `dgs1`.
    Packet,
    /// A completion group: in training the packets that begin with it, in [`Masks::draw`](super::Masks::draw)
    /// it alone.
    Group,
}

/// What links are drawn from, each evenly: lowest, highest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ChannelRanges {
    /// Whole streams per second.
    pub capacity: [f64; 2],
    /// Round-trip time, seconds.
    pub round_trip_s: [f64; 2],
    /// Display deadline, seconds after the first byte is sent.
    pub deadline_s: [f64; 2],
    /// Probability of an independent loss.
    pub iid: [f64; 2],
    /// Share that bursts take; at most L / (1 + L), where L is the lowest of `burst_length`.
    pub burst_share: [f64; 2],
    /// Mean length of a burst, packets or groups.
    pub burst_length: [f64; 2],
}

impl Default for ChannelRanges {
    fn default() -> Self {
        Self {
            capacity: [0.5, 4.0],
            round_trip_s: [0.02, 0.2],
            deadline_s: [0.3, 2.0],
            iid: [0.01, 0.20],
            burst_share: [0.02, 0.20],
            burst_length: [3.0, 12.0],
        }
    }
}

impl ChannelRanges {
    /// The link of the world of `number` in `variant`. Variants of one loss have no deadline; the combined
    /// one takes turns: of three worlds that follow each other two have one loss each, and the third has a
    /// deadline and either loss by turns.
    pub(super) fn link(&self, variant: Variant, number: usize, rng: &mut Pcg64) -> Link {
        let mut draw = |[low, high]: [f64; 2]| low + (high - low) * rng.random::<f64>();
        let iid = LossModel::Iid { probability: draw(self.iid) };
        let burst = LossModel::Burst { share: draw(self.burst_share), length: draw(self.burst_length) };
        let limited = [draw(self.capacity), draw(self.round_trip_s), draw(self.deadline_s)];
        // Without a deadline nothing is sent again either: the losses are what is trained for.
        let endless = |loss| Link { capacity: 1.0, round_trip_s: 0.0, deadline_s: 1.0 + 1e-9, loss };
        match (variant, number % 3) {
            (Variant::Reconstruction, _) => endless(LossModel::None),
            (Variant::Iid, _) | (Variant::Combined, 0) => endless(iid),
            (Variant::BurstCvar, _) | (Variant::Combined, 1) => endless(burst),
            (Variant::Combined, _) => {
                let [capacity, round_trip_s, deadline_s] = limited;
                let loss = if (number / 3).is_multiple_of(2) { iid } else { burst };
                Link { capacity, round_trip_s, deadline_s, loss }
            }
        }
    }
}

/// Largest steps per update; they fall to a tenth over the updates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearningRates {
    /// Centre, in units of the Gaussian's size.
    pub position: f64,
    /// Natural log of each scale.
    pub log_scale: f64,
    /// Turn, radians.
    pub turn: f64,
    /// Opacity logit.
    pub opacity: f64,
    /// Band 0 of colour.
    pub colour: f64,
    /// Factor on all of these for proxies, whose steps are coarser; 0 leaves them as they are.
    pub proxies: f64,
}

impl Default for LearningRates {
    fn default() -> Self {
        Self { position: 0.03, log_scale: 0.015, turn: 0.01, opacity: 0.03, colour: 0.015, proxies: 3.0 }
    }
}

/// How candidates are compared: on states and pictures that no update is made on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Validation {
    /// Every so many references are for validation, at least 2, where none are for it alone.
    pub every: usize,
    /// States, half after independent losses of 5 % and half after bursts of as much; 0 to 10,000, at least 1
    /// where there are candidates.
    pub states: usize,
    /// Candidates, evenly over the updates after the warm-up, 0 to 1000; with 0 the last scene is taken as it
    /// is.
    pub candidates: usize,
}

impl Default for Validation {
    fn default() -> Self {
        Self { every: 5, states: 32, candidates: 4 }
    }
}

/// How to fine-tune a scene for delivery. As JSON, fields left out have their defaults.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DeliveryOptions {
    /// Which worlds and terms.
    pub variant: Variant,
    /// Weights of the terms; a variant counts some of them.
    pub weights: Weights,
    /// Worlds per update and view, 1 to 10,000.
    pub worlds: usize,
    /// Of those, complete ones in variant `mixed`; a quarter, as in the paper, if absent; 0 to
    /// 10,000.
    pub clean_worlds: Option<usize>,
    /// Pictures per update, 1 to 1000, each with worlds of its own.
    pub views: usize,
    /// Updates, 1 to 1,000,000.
    pub updates: usize,
    /// Share of the updates, at the start, in which only the complete state counts, 0..=1.
    pub warm_up: f64,
    /// Seed of worlds and of the order of pictures.
    pub seed: u64,
    /// What is lost at once.
    pub unit: LossUnit,
    /// What links are drawn from.
    pub channel: ChannelRanges,
    /// A file of recorded states ([`Recording`](super::Recording)): every other world of `mixed` is one that
    /// was displayed in the motion window of the picture, where there is any.
    pub recorded: Option<PathBuf>,
    /// Largest steps.
    pub learning_rates: LearningRates,
    /// Whether the quantisers' steps are learned too, after the warm-up: at the size that the encoder's would
    /// give, or at the price of `weights.rate` where that is not 0.
    pub learn_steps: bool,
    /// Updates between two encodings, at least 1: in between, decoded values move with their parameters.
    pub encode_every: usize,
    /// How candidates are compared.
    pub validation: Validation,
    /// Where weights, hashes and the selection rule are written before the first update.
    #[serde(skip)]
    pub registration: Option<PathBuf>,
    /// How the scene is encoded.
    #[serde(skip)]
    pub encode: encode::EncodeOptions,
}

impl Default for DeliveryOptions {
    /// The paper's mixed objective with its 240 updates, at 24 worlds instead of 96.
    fn default() -> Self {
        Self {
            variant: Variant::Combined,
            weights: Weights::default(),
            worlds: 24,
            clean_worlds: None,
            views: 1,
            updates: 240,
            warm_up: 0.20,
            seed: 1,
            unit: LossUnit::Packet,
            channel: ChannelRanges::default(),
            recorded: None,
            learning_rates: LearningRates::default(),
            learn_steps: true,
            encode_every: 4,
            validation: Validation::default(),
            registration: None,
            encode: encode::EncodeOptions::default(),
        }
    }
}

impl DeliveryOptions {
    /// The defaults with `variant`.
    pub fn of(variant: Variant) -> Self {
        Self { variant, ..Self::default() }
    }

    /// What `config` says: the name of a variant, or the path of a JSON file.
    ///
    /// # Errors
    /// A file that cannot be read, holds an unknown field, or a value out of range.
    pub fn read(config: &str) -> Result<Self, DeliveryError> {
        if let Some(variant) = Variant::ALL.into_iter().find(|variant| variant.name() == config) {
            return Ok(Self::of(variant));
        }
        let path = Path::new(config).to_owned();
        let text = std::fs::read_to_string(&path)
            .map_err(|error| DeliveryError::File { path: path.clone(), error })?;
        let options: Self = serde_json::from_str(&text)
            .map_err(|error| DeliveryError::Content { path, message: error.to_string() })?;
        options.check()?;
        Ok(options)
    }

    /// Complete worlds per update of variant `mixed`.
    pub(super) fn clean(&self) -> usize {
        self.clean_worlds.unwrap_or(self.worlds / 4).min(self.worlds)
    }

    /// FNV-1a, 64 bits, over everything that the result depends on but the scene and its pictures.
    pub fn hash(&self) -> u64 {
        // Where the registration is written is no part of it.
        let json = serde_json::to_string(self).unwrap_or_default();
        Digest::new().bytes(json.as_bytes()).bytes(format!("{:?}", self.encode).as_bytes()).get()
    }

    /// # Errors
    /// The first field out of range.
    pub(super) fn check(&self) -> Result<(), DeliveryError> {
        let refuse = |field, found: &dyn std::fmt::Display, allowed: &str| {
            Err(DeliveryError::Setting { field, found: found.to_string(), allowed: allowed.to_owned() })
        };
        let Validation { every, states, candidates } = self.validation;
        for (field, found, range, allowed) in [
            ("worlds", self.worlds, 1..=10_000, "1 to 10000"),
            ("clean_worlds", self.clean_worlds.unwrap_or(0), 0..=10_000, "0 to 10000"),
            ("views", self.views, 1..=1000, "1 to 1000"),
            ("updates", self.updates, 1..=1_000_000, "1 to 1000000"),
            ("encode_every", self.encode_every, 1..=usize::MAX, "1 or more"),
            ("validation.every", every, 2..=usize::MAX, "2 or more"),
            ("validation.states", states, 0..=10_000, "0 to 10000"),
            ("validation.candidates", candidates, 0..=1000, "0 to 1000"),
        ] {
            if !range.contains(&found) {
                return refuse(field, &found, allowed);
            }
        }
        let recorded = self.recorded.as_deref().map(Path::display);
        if let Some(path) = recorded.filter(|_| self.variant != Variant::Combined) {
            let allowed = format!("a file with variant mixed alone, not with {},", self.variant.name());
            return refuse("recorded", &path, &allowed);
        }
        if self.recorded.is_some() && self.clean() == self.worlds {
            let allowed = format!("fewer than worlds ({}) where states are recorded", self.worlds);
            return refuse("clean_worlds", &self.clean(), &allowed);
        }
        if candidates > 0 && states == 0 {
            return refuse("validation.states", &states, "1 to 10000 where validation.candidates is not 0");
        }
        let (w, rates, c) = (&self.weights, &self.learning_rates, &self.channel);
        for (field, found) in [("warm_up", self.warm_up), ("weights.cvar_fraction", w.cvar_fraction)] {
            if !(0.0..=1.0).contains(&found) {
                return refuse(field, &found, "0 to 1");
            }
        }
        for (field, found) in [
            ("weights.structure", w.structure),
            ("weights.cvar", w.cvar),
            ("weights.rate", w.rate),
            ("weights.temporal", w.temporal),
            ("weights.monotone", w.monotone),
            ("weights.anchor", w.anchor),
            ("learning_rates.position", rates.position),
            ("learning_rates.log_scale", rates.log_scale),
            ("learning_rates.turn", rates.turn),
            ("learning_rates.opacity", rates.opacity),
            ("learning_rates.colour", rates.colour),
            ("learning_rates.proxies", rates.proxies),
        ] {
            if !(0.0..=1e3).contains(&found) {
                return refuse(field, &found, "0 to 1000");
            }
        }
        for (field, [low, high], least, most, allowed) in [
            ("channel.capacity", c.capacity, 1e-6, 1e6, "lowest and highest within 1e-6 to 1e6"),
            ("channel.round_trip_s", c.round_trip_s, 0.0, 100.0, "lowest and highest within 0 to 100"),
            ("channel.deadline_s", c.deadline_s, 0.0, 1e6, "lowest and highest within 0 to 1e6"),
            ("channel.iid", c.iid, 0.0, 1.0, "lowest and highest within 0 to 1"),
            ("channel.burst_share", c.burst_share, 0.0, 0.99, "lowest and highest within 0 to 0.99"),
            ("channel.burst_length", c.burst_length, 1.0, 1e6, "lowest and highest within 1 to 1e6"),
        ] {
            if !(least <= low && low <= high && high <= most) {
                return refuse(field, &format!("[{low}, {high}]"), allowed);
            }
        }
        let ([low, high], [shortest, _]) = (c.burst_share, c.burst_length);
        let most = LossModel::most_in_bursts(shortest);
        if high > most {
            let allowed = format!("a highest of {most} at most, with channel.burst_length from {shortest},");
            return refuse("channel.burst_share", &format!("[{low}, {high}]"), &allowed);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_files_are_read_and_the_defaults_are_the_papers() {
        for variant in Variant::ALL {
            assert_eq!(DeliveryOptions::read(variant.name()).unwrap().variant, variant);
            assert_eq!(serde_json::to_value(variant).unwrap(), variant.name());
        }
        let Weights { structure, cvar, cvar_fraction, rate, temporal, monotone, anchor } = Weights::default();
        assert_eq!([structure, cvar, cvar_fraction, rate], [0.20, 0.30, 0.05, 0.0]);
        assert_eq!([temporal, monotone, anchor], [0.10, 2.0, 0.50]);
        assert_eq!((DeliveryOptions::default().warm_up, DeliveryOptions::default().updates), (0.20, 240));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.json");
        std::fs::write(&path, r#"{"variant": "iid", "worlds": 7, "weights": {"cvar": 0.1}}"#).unwrap();
        let options = DeliveryOptions::read(path.to_str().unwrap()).unwrap();
        assert_eq!((options.variant, options.worlds, options.weights.cvar), (Variant::Iid, 7, 0.1));
        assert_eq!(options.weights.anchor, 0.50);
    }

    #[test]
    fn what_is_out_of_range_or_unknown_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.json");
        for (text, named) in [
            (r#"{"wrlds": 1}"#, "wrlds"),
            (r#"{"worlds": 0}"#, "worlds is 0; 1 to 10000 is allowed"),
            (r#"{"worlds": 100000000000}"#, "worlds is 100000000000; 1 to 10000 is allowed"),
            (r#"{"clean_worlds": 10001}"#, "clean_worlds is 10001; 0 to 10000 is allowed"),
            (r#"{"views": 9999999}"#, "views is 9999999; 1 to 1000 is allowed"),
            (r#"{"updates": 1000001}"#, "updates is 1000001; 1 to 1000000 is allowed"),
            (r#"{"validation": {"states": 100000000000}}"#, "validation.states is 100000000000; 0 to 10000"),
            (r#"{"validation": {"states": 0}}"#, "validation.states is 0; 1 to 10000 where"),
            (r#"{"validation": {"candidates": 1001}}"#, "validation.candidates is 1001; 0 to 1000"),
            (r#"{"warm_up": 1.5}"#, "warm_up is 1.5; 0 to 1"),
            (r#"{"weights": {"cvar": -1}}"#, "weights.cvar is -1; 0 to 1000"),
            (r#"{"channel": {"iid": [0.5, 0.1]}}"#, "channel.iid is [0.5, 0.1]"),
            (
                r#"{"channel": {"burst_share": [0.1, 0.8]}}"#,
                "channel.burst_share is [0.1, 0.8]; a highest of 0.75 at most, with channel.burst_length \
                 from 3, is allowed",
            ),
            (r#"{"variant": "all"}"#, "variant"),
            (
                r#"{"variant": "iid", "recorded": "a.json"}"#,
                "recorded is a.json; a file with variant mixed alone, not with iid, is allowed",
            ),
            (
                r#"{"worlds": 4, "clean_worlds": 4, "recorded": "a.json"}"#,
                "clean_worlds is 4; fewer than worlds (4) where states are recorded is allowed",
            ),
            (r#"{"registration": "a.json"}"#, "unknown field `registration`"),
        ] {
            std::fs::write(&path, text).unwrap();
            let error = DeliveryOptions::read(path.to_str().unwrap()).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
        let most = r#"{"channel": {"burst_share": [0.1, 0.5], "burst_length": [1.0, 12.0]}}"#;
        std::fs::write(&path, most).unwrap();
        assert!(DeliveryOptions::read(path.to_str().unwrap()).is_ok());
        assert!(DeliveryOptions::read("no-such-name").unwrap_err().to_string().contains("no-such-name"));
    }

    #[test]
    fn combined_worlds_take_turns_with_every_kind_of_link() {
        let ranges = ChannelRanges { capacity: [2.0; 2], ..ChannelRanges::default() };
        let kinds: Vec<(bool, bool)> = (0..6)
            .map(|number| {
                let link = ranges.link(Variant::Combined, number, &mut Pcg64::new(1, 7));
                (link.capacity == 2.0, matches!(link.loss, LossModel::Burst { .. }))
            })
            .collect();
        let [iid, burst] = [(false, false), (false, true)];
        assert_eq!(kinds, [iid, burst, (true, false), iid, burst, (true, true)]);
    }

    #[test]
    fn variants_count_their_own_terms_and_the_hash_sees_a_weight() {
        let given = Weights::default();
        assert_eq!(Variant::Combined.weights(&given), given);
        let burst = Variant::BurstCvar.weights(&given);
        assert_eq!((burst.cvar, burst.temporal, burst.anchor), (0.30, 0.0, 0.0));
        assert_eq!(Variant::Iid.weights(&given).cvar, 0.0);
        let options = DeliveryOptions::default();
        let mut other = options.clone();
        other.registration = Some("elsewhere.json".into());
        assert_eq!(options.hash(), other.hash(), "where it is written changes nothing");
        other.weights.cvar = 0.31;
        assert_ne!(options.hash(), other.hash());
    }
}
