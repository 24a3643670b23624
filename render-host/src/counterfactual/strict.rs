//! Worlds exactly as they are rendered alone: per tile, each class of worlds is blended once.
//!
//! A world's list is the shared list without the absent groups: the splats and their order are those of a
//! render of that world, and so is every operation on every pixel.

use super::classes::{members, split};
use super::scaffold::Shared;
use super::squares::{Squares, inside};
use super::states::CHUNK;
use super::{Engine, States};
use crate::image::{Image, ImageError};
use crate::parallel;
use crate::stage::blend::{Tile, Tiles, blend_tile, resolve};

#[derive(Default)]
struct Room {
    list: Vec<u32>,
    held: Vec<bool>,
    classes: Vec<u128>,
}

impl Room {
    /// The list of `tile` without groups for which `holds` says no.
    fn filter(&mut self, shared: &Shared, tile: usize, holds: impl Fn(u32) -> bool) {
        self.held.clear();
        self.held.extend(shared.groups(tile).iter().map(|&group| holds(group)));
        self.list.clear();
        let entries = shared.entries(tile).iter();
        self.list.extend(entries.filter(|e| self.held[e.local as usize]).map(|e| e.splat));
    }
}

/// Sum of squared errors of each world.
pub(super) fn errors(engine: &Engine, states: &States) -> Vec<f64> {
    let Engine { shared, settings, reference, .. } = engine;
    let chunks = states.chunks();
    let mut parts = vec![0.0; shared.tiles() * states.len()];
    let mut tiles: Vec<&mut [f64]> = parts.chunks_mut(states.len().max(1)).collect();
    parallel::for_each_with(settings.parallel, &mut tiles, |room: &mut Room, index, out| {
        let (corner, mut tile) = (shared.corner(index), Tile::EMPTY);
        let (width, height) = inside(corner, shared.size);
        for (chunk, (worlds, columns)) in chunks.iter().enumerate() {
            let of_tile = shared.groups(index).iter().map(|&group| columns[group as usize]);
            let mut classes = std::mem::take(&mut room.classes);
            split(*worlds, of_tile, &mut classes);
            for &class in &classes {
                room.filter(shared, index, |group| columns[group as usize] & class != 0);
                blend_tile(&shared.projected.splats, &room.list, corner, shared.size, settings, &mut tile);
                let mut squares = Squares::default();
                for (y, wanted) in reference[index].iter().enumerate().take(height) {
                    squares.add(&tile.over(y, settings.background), wanted, width);
                }
                let total = squares.total();
                members(class).for_each(|world| out[chunk * CHUNK + world] = total);
            }
            room.classes = classes;
        }
    });
    let mut out = vec![0.0; states.len()];
    for part in parts.chunks(states.len().max(1)) {
        out.iter_mut().zip(part).for_each(|(total, part)| *total += part);
    }
    out
}

/// The picture of `world`.
pub(super) fn image(engine: &Engine, states: &States, world: usize) -> Result<Image, ImageError> {
    let Engine { shared, settings, .. } = engine;
    let [width, height] = shared.size;
    let mut tiles = Tiles { tiles: vec![Tile::EMPTY; shared.tiles()] };
    parallel::for_each_with(settings.parallel, &mut tiles.tiles, |room: &mut Room, index, tile| {
        room.filter(shared, index, |group| states.has(world, group as usize));
        blend_tile(&shared.projected.splats, &room.list, shared.corner(index), shared.size, settings, tile);
    });
    let mut image = Image::default();
    image.reset(width as u32, height as u32)?;
    let mut transmittance = vec![1.0; width * height];
    resolve(&tiles, width, settings, image.rgb_mut(), &mut transmittance);
    Ok(image)
}
