//! Holds worlds as sets of groups.

/// Worlds of one call: per world, a bit per group.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct States {
    groups: usize,
    worlds: usize,
    /// `groups.div_ceil(64)` words per world.
    bits: Vec<u64>,
}

/// Worlds that one word of the class finder holds.
pub(super) const CHUNK: usize = u128::BITS as usize;

impl States {
    /// No worlds yet, of `groups` groups.
    pub fn new(groups: usize) -> Self {
        Self { groups, worlds: 0, bits: Vec::new() }
    }

    /// One world with every group.
    pub fn full(groups: usize) -> Self {
        let mut states = Self::new(groups);
        states.push(|_| true);
        states
    }

    /// One world with no group.
    pub fn empty(groups: usize) -> Self {
        let mut states = Self::new(groups);
        states.push(|_| false);
        states
    }

    /// Adds a world that holds the groups for which `present` says so.
    pub fn push(&mut self, mut present: impl FnMut(usize) -> bool) {
        let first = self.bits.len();
        self.bits.resize(first + self.groups.div_ceil(64), 0);
        for group in 0..self.groups {
            self.bits[first + group / 64] |= u64::from(present(group)) << (group % 64);
        }
        self.worlds += 1;
    }

    /// Number of groups.
    pub fn groups(&self) -> usize {
        self.groups
    }

    /// Number of worlds.
    pub fn len(&self) -> usize {
        self.worlds
    }

    /// True without worlds.
    pub fn is_empty(&self) -> bool {
        self.worlds == 0
    }

    /// Whether `world` holds `group`; false out of range.
    pub fn has(&self, world: usize, group: usize) -> bool {
        if world >= self.worlds || group >= self.groups {
            return false;
        }
        let word = self.bits.get(world * self.groups.div_ceil(64) + group / 64);
        word.is_some_and(|w| w >> (group % 64) & 1 == 1)
    }

    /// World `world` alone; no world when out of range.
    pub fn one(&self, world: usize) -> Self {
        let mut out = Self::new(self.groups);
        if world < self.worlds {
            out.push(|group| self.has(world, group));
        }
        out
    }

    /// The worlds of `range` that there are.
    pub fn range(&self, range: std::ops::Range<usize>) -> Self {
        let words = self.groups.div_ceil(64);
        let end = range.end.min(self.worlds);
        let start = range.start.min(end);
        let bits = self.bits[start * words..end * words].to_vec();
        Self { groups: self.groups, worlds: end - start, bits }
    }

    /// Worlds `CHUNK · chunk ..` turned by 90 degrees: per group, the set of worlds that hold it.
    pub(super) fn columns(&self, chunk: usize) -> Vec<u128> {
        let worlds = chunk * CHUNK..self.worlds.min((chunk + 1) * CHUNK);
        let mut out = vec![0u128; self.groups];
        for (bit, world) in worlds.enumerate() {
            for (group, column) in out.iter_mut().enumerate() {
                *column |= u128::from(self.has(world, group)) << bit;
            }
        }
        out
    }

    /// All chunks of [`States::columns`], each with the set of its worlds.
    pub(super) fn chunks(&self) -> Vec<(u128, Vec<u128>)> {
        let chunk = |i: usize| {
            let worlds = (self.worlds - i * CHUNK).min(CHUNK) as u32;
            (u128::MAX >> (u128::BITS - worlds), self.columns(i))
        };
        (0..self.worlds.div_ceil(CHUNK)).map(chunk).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_come_back_and_columns_are_the_transpose() {
        let present = |world: usize, group: usize| (world * 7 + group * 13).is_multiple_of(5);
        let mut states = States::new(70);
        (0..131).for_each(|world| states.push(|group| present(world, group)));
        let chunks = states.chunks();
        assert_eq!((chunks.len(), chunks[0].0, chunks[1].0), (2, u128::MAX, 7));
        for world in 0..131 {
            for group in 0..70 {
                assert_eq!(states.has(world, group), present(world, group));
                let column = chunks[world / CHUNK].1[group];
                assert_eq!(column >> (world % CHUNK) & 1 == 1, present(world, group));
            }
        }
        assert!(!states.has(131, 0) && !states.has(0, 70));
        assert!(!states.has(usize::MAX, 0) && !states.has(0, usize::MAX));
        let some = states.range(127..500);
        assert!(some.len() == 4 && (0..70).all(|g| some.has(1, g) == states.has(128, g)));
        assert!(states.range(500..600).is_empty() && states.range(7..7).is_empty());
        assert!(states.one(3).has(0, 9) == present(3, 9) && states.one(500).is_empty());
    }
}
