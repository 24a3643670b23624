//! Leaves out the Gaussians that can cover least of a picture, where all of them take too long.

use render_host::{Gaussian, Splats};

use super::quality::coverage_of;

/// Keeps a share of the Gaussians of a frame.
#[derive(Debug)]
pub(super) struct Thinner {
    share: f32,
    /// Which Gaussians stay, in their order: chosen where colours change, the same while they only move.
    chosen: Vec<u32>,
    gaussians: Vec<Gaussian>,
    sh_rest: Vec<f32>,
}

impl Default for Thinner {
    fn default() -> Self {
        Self { share: 1.0, chosen: Vec::new(), gaussians: Vec::new(), sh_rest: Vec::new() }
    }
}

impl Thinner {
    /// Keeps `share` of the Gaussians from now on, above 0 and up to 1; true if that is another share.
    pub fn set_share(&mut self, share: f32) -> bool {
        let share = if share > 0.0 && share < 1.0 { share } else { 1.0 };
        let differs = self.share != share;
        self.share = share;
        differs
    }

    /// The Gaussians of `splats` that stay: those of the last call where they have `only_moved` since.
    pub fn thinned<'s>(&'s mut self, splats: Splats<'s>, only_moved: bool) -> Splats<'s> {
        if self.share >= 1.0 {
            return splats;
        }
        let all = splats.gaussians();
        if !only_moved {
            self.choose(all);
            self.sh_rest.clear();
            self.chosen.iter().for_each(|&index| self.sh_rest.extend_from_slice(splats.rest(index as usize)));
        }
        self.gaussians.clear();
        self.gaussians.extend(self.chosen.iter().filter_map(|&index| all.get(index as usize)));
        Splats::new(&self.gaussians, &self.sh_rest, splats.sh_degree())
            .unwrap_or_else(|_| Splats::plain(&self.gaussians))
    }

    /// Chooses those that can cover most; of equals the first.
    fn choose(&mut self, all: &[Gaussian]) {
        self.chosen.clear();
        self.chosen.extend(0..u32::try_from(all.len()).unwrap_or(u32::MAX));
        let count = (self.share * all.len() as f32).ceil() as usize;
        if count == 0 || count >= all.len() {
            return;
        }
        let coverage = |index: u32| coverage_of(&all[index as usize]);
        let order = |a: &u32, b: &u32| coverage(*b).total_cmp(&coverage(*a)).then(a.cmp(b));
        self.chosen.select_nth_unstable_by(count, order);
        self.chosen.truncate(count);
        self.chosen.sort_unstable();
    }
}

#[cfg(test)]
mod tests {
    use render_host::ShDegree;

    use super::*;

    /// Gaussians of these opacities; harmonics of degree 1 that say which one it is.
    fn cloud(opacities: &[f32]) -> (Vec<Gaussian>, Vec<f32>) {
        let gaussians =
            opacities.iter().map(|&opacity| Gaussian { scale: [0.1; 3], opacity, ..Gaussian::ABSENT });
        let rest = (0..opacities.len()).flat_map(|index| [index as f32; 9]);
        (gaussians.collect(), rest.collect())
    }

    #[test]
    fn those_that_cover_most_stay_in_their_order_and_while_they_move() {
        let (gaussians, rest) = cloud(&[0.1, 0.9, f32::NAN, 0.5, 0.9, 0.2]);
        let splats = Splats::new(&gaussians, &rest, ShDegree::new(1).unwrap()).unwrap();
        let mut thinner = Thinner::default();
        assert!(!thinner.set_share(1.0));
        assert_eq!(thinner.thinned(splats, false).len(), 6);
        assert!(thinner.set_share(0.5) && !thinner.set_share(0.5));
        let chosen =
            |splats: Splats<'_>| -> Vec<f32> { (0..splats.len()).map(|i| splats.rest(i)[0]).collect() };
        // A NaN is above every number; whoever draws skips it.
        assert_eq!(chosen(thinner.thinned(splats, false)), [1.0, 2.0, 4.0]);
        // Others would be chosen now, but these have only moved.
        let (mut moved, _) = cloud(&[0.9, 0.1, 0.1, 0.1, 0.1, 0.8]);
        moved[4].position = [7.0; 3];
        let moved = Splats::new(&moved, &rest, ShDegree::new(1).unwrap()).unwrap();
        let shown = thinner.thinned(moved, true);
        assert_eq!((shown.gaussians()[2].position, shown.sh_degree().get()), ([7.0; 3], 1));
        assert_eq!(chosen(shown), [1.0, 2.0, 4.0]);
        assert_eq!(chosen(thinner.thinned(moved, false)), [0.0, 1.0, 5.0]);
        for share in [f32::NAN, 0.0, -1.0, 2.0] {
            thinner.set_share(share);
            assert_eq!(thinner.thinned(splats, false).len(), 6, "{share}");
        }
        thinner.set_share(0.01);
        assert_eq!(thinner.thinned(splats, false).len(), 1);
        assert_eq!(thinner.thinned(Splats::plain(&[]), false).len(), 0);
    }
}
