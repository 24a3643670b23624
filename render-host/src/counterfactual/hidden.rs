//! Leaves out of long tile lists the splats that no world can see.
//!
//! A world that holds a splat holds its whole group, so what the group itself has taken from a pixel is a
//! bound for every such world. Where that is below the stop, and below 1e-10, the splat is blended in no
//! world, or too faint for a sum of squares to show. Without this, a million splats in one spot are a
//! million runs per pixel.

use crate::{
    settings::Settings,
    stage::{
        Splat, TILE,
        reach::{LANE, Lanes, Local, Rules, for_each_row},
    },
};

/// Splats in a list from which on it is looked through.
const LONG: usize = 4096;
/// Transmittance below which nothing shows in a sum of squares without early stop.
const FAINTEST: f32 = 1e-10;

/// What each group has left of the pixels of a tile.
#[derive(Debug, Default)]
pub(super) struct HiddenInGroup {
    /// Per group of the tile, 16 rows.
    left: Vec<[Lanes; TILE]>,
    active: bool,
}

impl HiddenInGroup {
    /// Starts the list of a tile.
    pub(super) fn open(&mut self, length: usize, settings: &Settings) {
        self.left.clear();
        self.active = length >= LONG && settings.stop() > 0.0;
    }

    /// Whether any world can see `splat`, of the tile's group `local`, behind those asked about before.
    pub(super) fn shows(
        &mut self,
        splat: &Splat,
        local: u32,
        corner: [usize; 2],
        settings: &Settings,
    ) -> bool {
        if !self.active {
            return true;
        }
        let rules = Rules::new(settings);
        // Half the stop: a world's own product is rounded otherwise.
        let least = (0.5 * rules.stop).min(FAINTEST);
        if self.left.len() <= local as usize {
            self.left.resize(local as usize + 1, [[1.0; TILE]; TILE]);
        }
        let (left, local) = (&mut self.left[local as usize], Local::new(splat, corner, &rules));
        let mut shows = false;
        let reached = local.rows();
        for_each_row(reached.rows, |y| {
            let (u, v) = (reached.u[y], reached.v[y]);
            let exponent = splat.log2_alpha - v * v;
            for (left, lane) in left[y].iter_mut().zip(LANE) {
                let q = u + local.root[0] * lane;
                let alpha = rules.alpha(exponent - q * q, 1.0);
                shows |= alpha > 0.0 && *left >= least;
                *left -= alpha * *left;
            }
        });
        shows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_hides_its_own_and_no_other() {
        let splat = Splat {
            mean: [8.0; 2],
            root: [0.5, 0.0, 0.5],
            colour: [1.0; 3],
            log2_alpha: -0.5,
            pixels: [0, 16, 0, 16],
        };
        let (settings, corner) = (Settings::default(), [0, 0]);
        let mut hidden = HiddenInGroup::default();
        hidden.open(LONG, &settings);
        let shown = (0..LONG).filter(|_| hidden.shows(&splat, 0, corner, &settings)).count();
        // The faintest pixels, just above the cut-off, need ln(1e-10) / ln(1 - 1/255) or fewer.
        assert!((100..5900).contains(&shown), "{shown}");
        assert!(hidden.shows(&splat, 1, corner, &settings));
        let wider = Splat { root: [0.4, 0.0, 0.4], ..splat };
        assert!(hidden.shows(&wider, 0, corner, &settings), "it reaches pixels that the others did not");
        hidden.open(LONG - 1, &settings);
        assert!((0..2 * LONG).all(|_| hidden.shows(&splat, 0, corner, &settings)));
        hidden.open(LONG, &Settings::exact());
        assert!((0..2 * LONG).all(|_| hidden.shows(&splat, 0, corner, &settings)));
    }
}
