//! Pictures of one instant in many states, each of which changes a few Gaussians: one world batch.
//!
//! The states that step one cell through its levels are a *family*. What a family changes becomes variants
//! of those Gaussians, the base's and one per state, each a group; so the renderer projects, orders and bins
//! once and composes again only what a state changes. Every distance equals, bit for bit, that of the state
//! rendered alone.

use codec_core::Gaussian;
use render_host::counterfactual::{States, Variants, WorldBatch};
use render_host::{Camera, Image, Renderer, Settings, Splats, metric};

use super::UtilityError;
use crate::scene::Instant;

/// Worlds drawn in one call: what one word of the renderer's class finder holds.
const BATCH: usize = 128;
/// Gaussians that no family changes.
const NOBODY: u32 = u32::MAX;

/// A state, as its difference from the base.
#[derive(Debug)]
struct World {
    family: u32,
    /// Index and value of each Gaussian that differs, in order of index.
    changes: Vec<(u32, Gaussian)>,
    /// Their higher bands.
    rest: Vec<f32>,
}

/// One instant and the states that are to be judged.
#[derive(Debug)]
pub(super) struct Pictures {
    base: Instant,
    worlds: Vec<World>,
    /// Family that changes each Gaussian.
    owner: Vec<u32>,
    /// Whether two families change one Gaussian; then each state is rendered alone.
    clash: bool,
}

impl Pictures {
    /// No states yet around `base`.
    pub(super) fn new(base: Instant) -> Self {
        let owner = vec![NOBODY; base.gaussians.len()];
        Self { base, worlds: Vec::new(), owner, clash: false }
    }

    /// Adds a state of `family`: as many Gaussians as the base, with as many values in `rest`.
    pub(super) fn add(&mut self, family: u32, gaussians: &[Gaussian], rest: &[f32]) {
        let each = self.base.sh_degree.rest_len();
        let mut world = World { family, changes: Vec::new(), rest: Vec::new() };
        for (index, (old, new)) in self.base.gaussians.iter().zip(gaussians).enumerate() {
            let bands = index * each..(index + 1) * each;
            let (old_rest, new_rest) = (&self.base.sh_rest[bands.clone()], &rest[bands]);
            let same = bits(old) == bits(new)
                && old_rest.iter().zip(new_rest).all(|(a, b)| a.to_bits() == b.to_bits());
            if !same {
                world.changes.push((index as u32, *new));
                world.rest.extend_from_slice(new_rest);
                let owner = &mut self.owner[index];
                self.clash |= *owner != NOBODY && *owner != family;
                *owner = family;
            }
        }
        self.worlds.push(world);
    }

    /// Distance of every state's picture from `reference`, in order of addition.
    ///
    /// # Errors
    /// Settings or a reference that the renderer refuses.
    pub(super) fn distances(
        &self,
        camera: &Camera,
        settings: &Settings,
        reference: &Image,
    ) -> Result<Vec<f64>, UtilityError> {
        if self.clash {
            return self.distances_alone(camera, settings, reference);
        }
        let (gaussians, rest, groups, count) = self.variants();
        let splats = Splats::new(&gaussians, &rest, self.base.sh_degree).map_err(refused)?;
        let variants = Variants::new(splats, &groups, count).map_err(refused)?;
        let batch = WorldBatch::new(&variants, camera, settings).map_err(refused)?;
        let (mut out, mut failed) = (Vec::with_capacity(self.worlds.len()), None);
        let judge = |_, images: Vec<Image>| {
            for image in images {
                match metric::distortion(&image, reference) {
                    Ok(distance) => out.push(distance),
                    Err(error) => failed = Some(error),
                }
            }
        };
        batch.for_each_batch(&self.states(count), BATCH, judge).map_err(refused)?;
        failed.map_or(Ok(out), |error| Err(refused(error)))
    }

    /// As [`Pictures::distances`], a full render each: the twin.
    pub(super) fn distances_alone(
        &self,
        camera: &Camera,
        settings: &Settings,
        reference: &Image,
    ) -> Result<Vec<f64>, UtilityError> {
        let (mut renderer, each) = (Renderer::new(), self.base.sh_degree.rest_len());
        let distance = |world: &World| {
            let (mut gaussians, mut rest) = (self.base.gaussians.clone(), self.base.sh_rest.clone());
            for (k, &(index, gaussian)) in world.changes.iter().enumerate() {
                let index = index as usize;
                gaussians[index] = gaussian;
                rest[index * each..(index + 1) * each].copy_from_slice(&world.rest[k * each..(k + 1) * each]);
            }
            let splats = Splats::new(&gaussians, &rest, self.base.sh_degree).map_err(refused)?;
            let image = renderer.render(&splats, camera, settings).map_err(refused)?.image;
            metric::distortion(&image, reference).map_err(refused)
        };
        self.worlds.iter().map(distance).collect()
    }

    /// Groups: 0 is what nobody changes, then one per family (its Gaussians as in the base), then one per
    /// state.
    fn families(&self) -> usize {
        self.worlds.iter().map(|world| world.family as usize + 1).max().unwrap_or(0)
    }

    /// All variants in order of index, so that equal depths are drawn in the order of a single render.
    fn variants(&self) -> (Vec<Gaussian>, Vec<f32>, Vec<u32>, usize) {
        let (each, families) = (self.base.sh_degree.rest_len(), self.families());
        let (mut gaussians, mut rest, mut groups) = (Vec::new(), Vec::new(), Vec::new());
        let mut of_family = vec![Vec::new(); families];
        for (index, world) in self.worlds.iter().enumerate() {
            of_family[world.family as usize].push(index);
        }
        // How far each state's changes have been read.
        let mut read = vec![0; self.worlds.len()];
        for (index, (&base, &owner)) in self.base.gaussians.iter().zip(&self.owner).enumerate() {
            let bands = &self.base.sh_rest[index * each..(index + 1) * each];
            let mut push = |gaussian, bands: &[f32], group: usize| {
                gaussians.push(gaussian);
                rest.extend_from_slice(bands);
                groups.push(group as u32);
            };
            if owner == NOBODY {
                push(base, bands, 0);
                continue;
            }
            push(base, bands, 1 + owner as usize);
            for &at in &of_family[owner as usize] {
                let (world, k, group) = (&self.worlds[at], read[at], 1 + families + at);
                match world.changes.get(k).filter(|change| change.0 as usize == index) {
                    Some(&(_, gaussian)) => {
                        push(gaussian, &world.rest[k * each..(k + 1) * each], group);
                        read[at] += 1;
                    }
                    None => push(base, bands, group),
                }
            }
        }
        (gaussians, rest, groups, 1 + families + self.worlds.len())
    }

    fn states(&self, count: usize) -> States {
        let families = self.families();
        let mut states = States::new(count);
        for (at, world) in self.worlds.iter().enumerate() {
            let own = 1 + world.family as usize;
            states.push(|group| if group <= families { group != own } else { group == 1 + families + at });
        }
        states
    }
}

fn refused(error: impl std::fmt::Display) -> UtilityError {
    UtilityError::Render(error.to_string())
}

fn bits(g: &Gaussian) -> [u32; 14] {
    let Gaussian { position: p, scale: s, rotation: q, opacity: o, sh0: c } = *g;
    [p[0], p[1], p[2], s[0], s[1], s[2], q[0], q[1], q[2], q[3], o, c[0], c[1], c[2]].map(f32::to_bits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use codec_core::ShDegree;
    use rand::RngExt;
    use rand_pcg::Pcg64;

    /// `n` Gaussians, half of them at one depth and place.
    fn instant(n: usize, rng: &mut Pcg64) -> Instant {
        let mut any = |low: f32, high: f32| rng.random_range(low..high);
        let gaussian = |i: usize, any: &mut dyn FnMut(f32, f32) -> f32| Gaussian {
            position: if i.is_multiple_of(2) { [0.1, 0.0, 0.0] } else { [0; 3].map(|_| any(-1.0, 1.0)) },
            scale: [0; 3].map(|_| any(0.02, 0.3)),
            rotation: [1.0, any(-0.5, 0.5), any(-0.5, 0.5), any(-0.5, 0.5)],
            opacity: any(0.0, 1.0),
            sh0: [0; 3].map(|_| any(-1.0, 1.0)),
        };
        let gaussians = (0..n).map(|i| gaussian(i, &mut any)).collect();
        let sh_degree = ShDegree::new(1).unwrap();
        Instant { gaussians, sh_rest: (0..9 * n).map(|_| any(-0.2, 0.2)).collect(), sh_degree }
    }

    fn case(clash: bool) -> (Pictures, Camera, Image) {
        let mut rng = Pcg64::new(5, 6);
        let mut pictures = Pictures::new(instant(240, &mut rng));
        for family in 0..12u32 {
            for level in 0..4 {
                // A state changes some of its family's twenty, or nothing at all; level 0 takes them away.
                let mut world = pictures.base.clone();
                let first = 20 * family as usize - if clash && family == 7 { 1 } else { 0 };
                for i in first..first + 20 - 6 * level {
                    let g = &mut world.gaussians[i];
                    *g = if level == 0 { Gaussian::ABSENT } else { *g };
                    g.scale = g.scale.map(|s| s * (1.0 + 0.1 * level as f32));
                    world.sh_rest[9 * i + level] += 0.1;
                }
                pictures.add(family, &world.gaussians, &world.sh_rest);
            }
            let same = pictures.base.clone();
            pictures.add(family, &same.gaussians, &same.sh_rest);
        }
        let camera = Camera::look_at([0.0, -3.0, 0.3], [0.0; 3], [0.0, 0.0, 1.0], 0.8, 50, 37).unwrap();
        let reference = Image::filled(50, 37, [0.3, 0.4, 0.5]).unwrap();
        (pictures, camera, reference)
    }

    #[test]
    fn distances_are_those_of_the_states_alone() {
        let settings = Settings { background: [0.1, 0.9, 0.4], ..Settings::default() };
        for clash in [false, true] {
            let (pictures, camera, reference) = case(clash);
            assert_eq!(pictures.clash, clash);
            let got = pictures.distances(&camera, &settings, &reference).unwrap();
            let alone = pictures.distances_alone(&camera, &settings, &reference).unwrap();
            assert_eq!(got.len(), 60);
            assert!(got.iter().zip(&alone).all(|(a, b)| a.to_bits() == b.to_bits()));
            // A comparator off by one state must not pass, and states do differ.
            assert!(got.iter().zip(&alone[1..]).any(|(a, b)| a != b));
        }
    }

    #[test]
    fn no_states_no_distances_and_a_wrong_reference_is_refused() {
        let (pictures, camera, _) = case(false);
        let empty = Pictures::new(pictures.base.clone());
        let reference = Image::filled(50, 37, [0.0; 3]).unwrap();
        assert!(empty.distances(&camera, &Settings::default(), &reference).unwrap().is_empty());
        let other = Image::filled(9, 9, [0.0; 3]).unwrap();
        assert!(pictures.distances(&camera, &Settings::default(), &other).is_err());
    }
}
