//! Turns delivered levels of clusters into worlds of groups.

use super::States;

/// Groups laid out as `cluster · levels + level`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lattice {
    /// Number of clusters.
    pub clusters: usize,
    /// Levels of each cluster, 0 is the base.
    pub levels: usize,
}

impl Lattice {
    /// Number of groups.
    pub fn groups(&self) -> usize {
        self.clusters * self.levels
    }

    /// Group of `level` of `cluster`.
    pub fn group(&self, cluster: usize, level: usize) -> usize {
        cluster * self.levels + level
    }

    /// Adds a world in which each level adds Gaussians of its own: present is what was delivered together
    /// with everything below it.
    pub fn push_additive(&self, states: &mut States, delivered: impl Fn(usize, usize) -> bool) {
        states.push(|group| {
            let (cluster, level) = (group / self.levels, group % self.levels);
            (0..=level).all(|below| delivered(cluster, below))
        });
    }

    /// Adds a world in which each level replaces the attributes of the one below: variant `l` of a cluster
    /// is what it shows at level `l`, and the one shown is the highest usable, `usable(l) & !usable(l + 1)`.
    pub fn push_replacing(&self, states: &mut States, delivered: impl Fn(usize, usize) -> bool) {
        states.push(|group| {
            let (cluster, level) = (group / self.levels, group % self.levels);
            let usable = (0..=level).all(|below| delivered(cluster, below));
            usable && (level + 1 == self.levels || !delivered(cluster, level + 1))
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_needs_those_below_and_the_highest_one_shows() {
        let lattice = Lattice { clusters: 3, levels: 3 };
        // Cluster 0: nothing. Cluster 1: levels 0 and 1. Cluster 2: levels 0 and 2, so 2 is unusable.
        let delivered = |c: usize, l: usize| matches!((c, l), (1, 0 | 1) | (2, 0 | 2));
        let (mut add, mut replace) = (States::new(lattice.groups()), States::new(lattice.groups()));
        lattice.push_additive(&mut add, delivered);
        lattice.push_replacing(&mut replace, delivered);
        let of = |s: &States| (0..9).filter(|&g| s.has(0, g)).collect::<Vec<_>>();
        assert_eq!((of(&add), of(&replace)), (vec![3, 4, 6], vec![4, 6]));
        assert_eq!(lattice.group(2, 0), 6);
    }
}
