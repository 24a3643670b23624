//! Groups that change colours and nothing else: the squared error of all 2ᴳ states without rendering.
//!
//! Alpha and transmittance do not depend on colours, so with `m` the set of groups that are there the
//! picture is `I₀ + Σ m_g·R_g`, where `R_g` is the picture of what group `g` adds to each Gaussian's
//! colour. Its squared error against a reference is the quadratic form `c + 2·b·m + mᵀ·G·m` with
//! `G = ⟨R_g, R_h⟩`, made once, tile by tile (groups that share no tile have no entry), in f64.
//!
//! One thing is not linear: a colour below 0 is drawn as 0. The form is that of the picture *without*
//! this clamp. Where no state can bring a colour below 0 the two are the same. Elsewhere
//! [`Quadratic::clamp`] bounds the distance, for every state at once: the roots of the two squared errors
//! differ by at most that much.

use codec_core::Gaussian;

use super::scaffold::Shared;
use super::squares::cut;
use super::{CounterfactualError, States, Utilities, Variants};
use crate::camera::dot;
use crate::harmonics::{C0, basis, count};
use crate::image::{Image, same_size};
use crate::{Camera, Settings, Splats, parallel};

mod tile;

use tile::{Part, Room};

/// What a group adds to the colour of one Gaussian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// Index of the Gaussian.
    pub gaussian: u32,
    /// The group.
    pub group: u32,
    /// Added to band 0 of the harmonics.
    pub sh0: [f32; 3],
}

/// Gaussians and the colour changes of `count` groups, borrowed. A group may change a Gaussian more than
/// once, and a Gaussian may be changed by any number of groups.
#[derive(Clone, Copy, Debug)]
pub struct Repaints<'a> {
    splats: Splats<'a>,
    changes: &'a [Change],
    rest: &'a [f32],
    count: usize,
}

impl<'a> Repaints<'a> {
    /// `rest` holds what each change adds to the higher bands, as many values per change as `splats` has
    /// per Gaussian, in the same layout.
    ///
    /// # Errors
    /// `rest` of another length, a Gaussian or group out of range, a coefficient that is not finite.
    pub fn new(
        splats: Splats<'a>,
        changes: &'a [Change],
        rest: &'a [f32],
        count: usize,
    ) -> Result<Self, CounterfactualError> {
        let (each, found) = (splats.sh_degree().rest_len(), rest.len());
        let needed = changes.len() * each;
        if found != needed {
            return Err(CounterfactualError::Rest { found, needed });
        }
        for (change, c) in changes.iter().enumerate() {
            if c.gaussian as usize >= splats.len() {
                let count = splats.len();
                return Err(CounterfactualError::Gaussian { change, gaussian: c.gaussian, count });
            }
            if c.group as usize >= count {
                return Err(CounterfactualError::Group { group: c.group, count });
            }
            let bands = &rest[change * each..(change + 1) * each];
            if !c.sh0.iter().chain(bands).all(|v| v.is_finite()) {
                return Err(CounterfactualError::NonFinite { change });
            }
        }
        Ok(Self { splats, changes, rest, count })
    }

    /// Number of groups.
    pub fn count(&self) -> usize {
        self.count
    }

    /// The Gaussians of one world and their harmonics, to be rendered alone.
    pub fn world(&self, states: &States, world: usize) -> (Vec<Gaussian>, Vec<f32>) {
        let each = self.splats.sh_degree().rest_len();
        let mut gaussians = self.splats.gaussians().to_vec();
        let mut rest: Vec<f32> = (0..gaussians.len()).flat_map(|i| self.splats.rest(i)).copied().collect();
        for (k, change) in self.changes.iter().enumerate() {
            if states.has(world, change.group as usize) {
                let index = change.gaussian as usize;
                (0..3).for_each(|c| gaussians[index].sh0[c] += change.sh0[c]);
                let own = &mut rest[index * each..(index + 1) * each];
                own.iter_mut().zip(&self.rest[k * each..]).for_each(|(v, d)| *v += d);
            }
        }
        (gaussians, rest)
    }
}

/// The quadratic form of one camera and reference image.
#[derive(Clone, Debug, PartialEq)]
pub struct Quadratic {
    groups: usize,
    constant: f64,
    linear: Vec<f64>,
    diagonal: Vec<f64>,
    /// Above the diagonal: row `g` is `entries[starts[g]..starts[g + 1]]`, other group and value.
    starts: Vec<usize>,
    entries: Vec<(u32, f64)>,
    clamp: f64,
}

impl Quadratic {
    /// Makes the form. `settings` are obeyed as in [`crate::render()`], early stop included.
    ///
    /// # Errors
    /// A setting out of range, or a reference of another size than the camera.
    pub fn new(
        repaints: &Repaints,
        camera: &Camera,
        reference: &Image,
        settings: &Settings,
    ) -> Result<Self, CounterfactualError> {
        settings.validate_for_one_tile_side()?;
        let mut film = Image::default();
        film.reset(camera.width(), camera.height())?;
        same_size(&film, reference)?;
        let one = vec![0; repaints.splats.len()];
        let shared = Shared::new(&Variants::new(repaints.splats, &one, 1)?, camera, settings);
        let paint = Paint::new(repaints, camera, settings);
        let reference = cut(reference, settings.parallel);
        let mut parts: Vec<Part> = vec![Part::default(); shared.tiles()];
        parallel::for_each_with(settings.parallel, &mut parts, |room: &mut Room, tile, part| {
            room.tile(&shared, &paint, &reference[tile], settings, tile, part);
        });
        Ok(Self::add_up(repaints.count, &parts))
    }

    /// Adds up the tiles, in order of tiles.
    fn add_up(groups: usize, parts: &[Part]) -> Self {
        let mut out = Self {
            groups,
            constant: 0.0,
            linear: vec![0.0; groups],
            diagonal: vec![0.0; groups],
            starts: vec![0],
            entries: Vec::new(),
            clamp: 0.0,
        };
        // Places of each group: tile and place there.
        let mut places: Vec<Vec<(u32, u32)>> = vec![Vec::new(); groups];
        let mut clamp = 0.0;
        for (tile, part) in parts.iter().enumerate() {
            out.constant += part.constant;
            clamp += part.clamp;
            for (place, (&group, linear)) in part.groups.iter().zip(&part.linear).enumerate() {
                out.linear[group as usize] += linear;
                places[group as usize].push((tile as u32, place as u32));
            }
        }
        out.clamp = clamp.sqrt();
        let mut row: Vec<Option<f64>> = vec![None; groups];
        for (group, places) in places.iter().enumerate() {
            let mut met = Vec::new();
            for &(tile, place) in places {
                let part = &parts[tile as usize];
                let n = part.groups.len();
                let products = &part.gram[place as usize * n..][..n];
                for (&other, product) in part.groups.iter().zip(products) {
                    if other as usize >= group {
                        let sum = &mut row[other as usize];
                        if sum.is_none() {
                            met.push(other);
                        }
                        *sum = Some(sum.unwrap_or(0.0) + product);
                    }
                }
            }
            met.sort_unstable();
            for other in met {
                let value = row[other as usize].take().unwrap_or(0.0);
                if other as usize == group {
                    out.diagonal[group] = value;
                } else {
                    out.entries.push((other, value));
                }
            }
            out.starts.push(out.entries.len());
        }
        out
    }

    /// Number of groups.
    pub fn groups(&self) -> usize {
        self.groups
    }

    /// Pairs of different groups that meet in a tile.
    pub fn pairs(&self) -> usize {
        self.entries.len()
    }

    /// Bound of what clamping colours at 0 changes: for every state, `|√true - √sse| ≤ clamp`. 0 where no
    /// state brings a colour below 0.
    pub fn clamp(&self) -> f64 {
        self.clamp
    }

    /// Squared error of each world, summed over all channels of all pixels, in O(K²) for K groups.
    ///
    /// # Errors
    /// States of another number of groups.
    pub fn sse(&self, states: &States) -> Result<Vec<f64>, CounterfactualError> {
        self.check(states)?;
        let mut on = vec![0.0; self.groups];
        let world = |world: usize| {
            on.iter_mut().enumerate().for_each(|(g, m)| *m = f64::from(u8::from(states.has(world, g))));
            let mut sum = self.constant;
            for g in (0..self.groups).filter(|&g| states.has(world, g)) {
                let above: f64 = self.row(g).iter().map(|&(other, value)| on[other as usize] * value).sum();
                sum += 2.0 * (self.linear[g] + above) + self.diagonal[g];
            }
            sum
        };
        Ok((0..states.len()).map(world).collect())
    }

    /// Δ_g(m) of every group g in every context m, exact, in O(K²) per context for all groups together.
    ///
    /// # Errors
    /// States of another number of groups.
    pub fn utilities(&self, contexts: &States) -> Result<Utilities, CounterfactualError> {
        let sse = self.sse(contexts)?;
        let mut delta = Vec::with_capacity(sse.len() * self.groups);
        let mut pull = Vec::new();
        for context in 0..contexts.len() {
            pull.clone_from(&self.linear);
            for g in 0..self.groups {
                let here = contexts.has(context, g);
                for &(other, value) in self.row(g) {
                    pull[g] += if contexts.has(context, other as usize) { value } else { 0.0 };
                    pull[other as usize] += if here { value } else { 0.0 };
                }
            }
            delta.extend((0..self.groups).map(|g| {
                // Present: sse without minus sse with; the pull then holds the group's own square too.
                let (own, pull) = (self.diagonal[g], pull[g]);
                if contexts.has(context, g) { -2.0 * (pull + own) + own } else { -(2.0 * pull + own) }
            }));
        }
        Ok(Utilities { groups: self.groups, sse, delta })
    }

    fn row(&self, group: usize) -> &[(u32, f64)] {
        &self.entries[self.starts[group]..self.starts[group + 1]]
    }

    fn check(&self, states: &States) -> Result<(), CounterfactualError> {
        let (found, needed) = (states.groups(), self.groups);
        if found == needed { Ok(()) } else { Err(CounterfactualError::States { found, needed }) }
    }
}

/// Colours as the camera sees them, not clamped.
#[derive(Debug)]
struct Paint {
    base: Vec<[f32; 3]>,
    /// How far below 0 some state can bring a colour.
    shortfall: Vec<[f32; 3]>,
    /// Changes of Gaussian `i`: `changes[starts[i]..starts[i + 1]]`, group and colour.
    starts: Vec<usize>,
    changes: Vec<(u32, [f32; 3])>,
    groups: usize,
}

impl Paint {
    fn new(repaints: &Repaints, camera: &Camera, settings: &Settings) -> Self {
        let splats = &repaints.splats;
        let degree = settings.degree(splats.sh_degree());
        let (each, bands) = (splats.sh_degree().rest_len(), 3 * count(degree));
        let centre = camera.centre();
        let direction = |position: [f32; 3]| {
            let d: [f64; 3] = std::array::from_fn(|k| f64::from(position[k]) - centre[k]);
            let length = dot(d, d).sqrt();
            basis(degree, d.map(|v| v / length))
        };
        let colour = |sh0: [f32; 3], rest: &[f32], weights: &[f64; 15]| -> [f64; 3] {
            std::array::from_fn(|c| {
                let bands = rest[..bands].chunks_exact(3).zip(weights);
                C0 * f64::from(sh0[c]) + bands.map(|(triple, w)| w * f64::from(triple[c])).sum::<f64>()
            })
        };
        let n = splats.len();
        let weights: Vec<[f64; 15]> = splats.gaussians().iter().map(|g| direction(g.position)).collect();
        let base: Vec<[f64; 3]> = (0..n)
            .map(|i| colour(splats.gaussians()[i].sh0, splats.rest(i), &weights[i]).map(|v| 0.5 + v))
            .collect();
        let mut starts = vec![0; n + 1];
        repaints.changes.iter().for_each(|c| starts[c.gaussian as usize + 1] += 1);
        (0..n).for_each(|i| starts[i + 1] += starts[i]);
        let (mut slots, mut changes) = (starts.clone(), vec![(0, [0.0; 3]); repaints.changes.len()]);
        // A group's changes of one Gaussian come together or not at all, but a bound may take each alone.
        let mut lowest = base.clone();
        for (k, change) in repaints.changes.iter().enumerate() {
            let index = change.gaussian as usize;
            let added = colour(change.sh0, &repaints.rest[k * each..(k + 1) * each], &weights[index]);
            changes[slots[index]] = (change.group, added.map(|v| v as f32));
            slots[index] += 1;
            (0..3).for_each(|c| lowest[index][c] += added[c].min(0.0));
        }
        let below = |v: [f64; 3]| v.map(|v| (-v).max(0.0) as f32);
        Self {
            base: base.iter().map(|v| v.map(|v| v as f32)).collect(),
            shortfall: lowest.into_iter().map(below).collect(),
            starts,
            changes,
            groups: repaints.count,
        }
    }

    #[inline(always)]
    fn changes(&self, splat: u32) -> &[(u32, [f32; 3])] {
        &self.changes[self.starts[splat as usize]..self.starts[splat as usize + 1]]
    }
}

#[cfg(test)]
mod tests;
