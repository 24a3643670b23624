//! Renders many states of one frame together: blocks that look the same in two states are there once.

use std::collections::BTreeMap;

use codec_core::{Gaussian, ShDegree};
use rayon::prelude::*;
use render_host::{
    Camera, Image, Settings, Splats,
    counterfactual::{Engine, States, Variants, WorldBatch},
    metric,
};

use super::{
    coded::{BlockVersion, Moving},
    error::DeliveryError,
};

/// Worlds whose pictures exist at once.
const AT_ONCE: usize = 8;

/// All versions of all blocks that some states show at one frame.
pub(super) struct SharedWorlds {
    gaussians: Vec<Gaussian>,
    sh_rest: Vec<f32>,
    degree: ShDegree,
    /// Group of each Gaussian: a version of a block.
    groups: Vec<u32>,
    states: States,
}

/// What a block shows in each version.
#[derive(Default)]
struct Versions {
    known: BTreeMap<BlockVersion, usize>,
    gaussians: Vec<Vec<Gaussian>>,
    sh_rest: Vec<Vec<f32>>,
}

impl SharedWorlds {
    /// Those of `states` at `frame`.
    ///
    /// # Errors
    /// A frame that does not decode.
    pub(super) fn new(moving: &Moving<'_>, frame: u32, states: &[Vec<u8>]) -> Result<Self, DeliveryError> {
        let blocks = moving.blocks(frame);
        let mut versions: Vec<Versions> = blocks.iter().map(|_| Versions::default()).collect();
        let mut player = moving.coded().player();
        let mut degree = ShDegree::ZERO;
        // Per state, the version of each block.
        let mut chosen: Vec<Vec<usize>> = Vec::with_capacity(states.len());
        for state in states {
            let keys: Vec<BlockVersion> =
                blocks.iter().map(|block| moving.version(block, frame, state)).collect();
            if versions.iter().zip(&keys).any(|(versions, key)| !versions.known.contains_key(key)) {
                let shown = moving.shown(&mut player, state, frame)?;
                degree = shown.degree;
                let rest = degree.rest_len();
                for ((versions, &key), block) in versions.iter_mut().zip(&keys).zip(blocks) {
                    let range = block.gaussians.clone();
                    let bands = &shown.sh_rest[range.start * rest..range.end * rest];
                    versions.learn(key, &shown.gaussians[range], bands);
                }
            }
            let version = |(versions, key): (&Versions, &BlockVersion)| versions.known.get(key).copied();
            chosen.push(versions.iter().zip(&keys).map(|pair| version(pair).unwrap_or(0)).collect());
        }
        let mut out = Self {
            gaussians: Vec::new(),
            sh_rest: Vec::new(),
            degree,
            groups: Vec::new(),
            states: States::new(versions.iter().map(|v| v.gaussians.len()).sum()),
        };
        let mut first = 0;
        let mut firsts = Vec::with_capacity(versions.len());
        for versions in &versions {
            firsts.push(first);
            out.add(versions, first);
            first += versions.gaussians.len();
        }
        for chosen in &chosen {
            let mut present = vec![false; first];
            firsts.iter().zip(chosen).for_each(|(first, version)| present[first + version] = true);
            out.states.push(|group| present[group]);
        }
        Ok(out)
    }

    /// Adds the versions of a block in order of Gaussians, so that equal depths are drawn as in a single
    /// render.
    fn add(&mut self, versions: &Versions, first: usize) {
        let rest = self.degree.rest_len();
        for place in 0..versions.gaussians.first().map_or(0, Vec::len) {
            for (number, (gaussians, bands)) in versions.gaussians.iter().zip(&versions.sh_rest).enumerate() {
                // What is absent is drawn nowhere.
                if gaussians[place].opacity > 0.0 {
                    self.gaussians.push(gaussians[place]);
                    self.sh_rest.extend_from_slice(&bands[place * rest..(place + 1) * rest]);
                    self.groups.push((first + number) as u32);
                }
            }
        }
    }

    /// `measure` of each world's picture, seen by `camera`; pictures are bit for bit those of the worlds
    /// rendered alone.
    ///
    /// # Errors
    /// Settings that the renderer refuses, and what `measure` refuses.
    pub(super) fn measured<T: Send>(
        &self,
        camera: &Camera,
        settings: &Settings,
        measure: impl Fn(&Image) -> Result<T, DeliveryError> + Sync,
    ) -> Result<Vec<T>, DeliveryError> {
        let splats = Splats::new(&self.gaussians, &self.sh_rest, self.degree)?;
        let variants = Variants::new(splats, &self.groups, self.states.groups())?;
        let batch = WorldBatch::new(&variants, camera, settings)?;
        let mut out = Vec::with_capacity(self.states.len());
        for first in (0..self.states.len()).step_by(AT_ONCE) {
            let images = batch.images(&self.states.range(first..first + AT_ONCE))?;
            let measured: Result<Vec<T>, DeliveryError> = images.par_iter().map(&measure).collect();
            out.extend(measured?);
        }
        Ok(out)
    }

    /// Mean squared error of each world against `reference`.
    ///
    /// # Errors
    /// As [`SharedWorlds::measured`], and a reference of another size.
    pub(super) fn squared_errors(
        &self,
        camera: &Camera,
        reference: &Image,
        settings: &Settings,
    ) -> Result<Vec<f64>, DeliveryError> {
        let splats = Splats::new(&self.gaussians, &self.sh_rest, self.degree)?;
        let variants = Variants::new(splats, &self.groups, self.states.groups())?;
        let engine = Engine::new(&variants, camera, reference, settings)?;
        let values = reference.rgb().len().max(1) as f64;
        Ok(engine.strict(&self.states)?.into_iter().map(|sum| sum / values).collect())
    }
}

impl Versions {
    fn learn(&mut self, key: BlockVersion, gaussians: &[Gaussian], bands: &[f32]) {
        let next = self.gaussians.len();
        if let std::collections::btree_map::Entry::Vacant(entry) = self.known.entry(key) {
            entry.insert(next);
            self.gaussians.push(gaussians.to_vec());
            self.sh_rest.push(bands.to_vec());
        }
    }
}

/// `MSE + structure (1 − SSIM)` of `image` against `reference`.
///
/// # Errors
/// Different sizes.
pub(super) fn distortion(image: &Image, reference: &Image, structure: f64) -> Result<f64, DeliveryError> {
    let mse = metric::mse(image, reference)?;
    let lost = if structure > 0.0 { 1.0 - metric::ssim(image, reference)? } else { 0.0 };
    Ok(mse + structure * lost)
}

#[cfg(test)]
mod tests {
    use render_host::Renderer;

    use super::*;
    use crate::{
        encode,
        train::delivery::{
            LossModel, LossUnit, Masks,
            coded::{Coded, no_change},
            view::tests::study,
        },
    };

    /// For both profiles, in one window and in several, with and without parameters that have moved on.
    #[test]
    fn pictures_of_worlds_together_are_those_of_each_alone() {
        let (scene, references) = study(3, 1);
        let small =
            encode::EncodeOptions { packet_bytes: 300, block_len: 16, pictures: 0, ..Default::default() };
        let windows = encode::EncodeOptions { window_frames: Some(1), ..small.clone() };
        let paper = encode::EncodeOptions { window_frames: Some(1), ..encode::EncodeOptions::paper() };
        for options in [small, windows, paper.clone(), encode::EncodeOptions { window_frames: None, ..paper }]
        {
            let coded = Coded::first(&scene, &options).unwrap();
            // So much that states share what arrived in a window, and not what arrived before it.
            let loss = LossModel::Iid { probability: 0.5 };
            let masks = Masks::draw(&coded.encoded.stream, loss, LossUnit::Packet, 40, 5).unwrap();
            for change in [0.0, 0.1] {
                let mut parameters = no_change(&scene);
                parameters.all_mut().for_each(|values| values.fill(change));
                let moving = coded.moving(&scene, &parameters);
                let (frame, settings) = (2, Settings::default());
                let (camera, reference) = (&references[2].camera, &references[2].picture);
                let worlds = SharedWorlds::new(&moving, frame, &masks.states).unwrap();
                let images = worlds.measured(camera, &settings, |image| Ok(image.clone())).unwrap();
                let errors = worlds.squared_errors(camera, reference, &settings).unwrap();
                assert_eq!(images.len(), 40);
                let mut player = coded.player();
                for ((state, image), error) in masks.states.iter().zip(&images).zip(errors) {
                    let shown = moving.shown(&mut player, state, frame).unwrap();
                    let alone = Renderer::new().render(&shown.splats().unwrap(), camera, &settings).unwrap();
                    assert!(alone.image == *image);
                    assert!((metric::mse(image, reference).unwrap() - error).abs() < 1e-9);
                }
                assert!(images[0] != images[1], "the states differ, or this test says nothing");
            }
        }
    }
}
