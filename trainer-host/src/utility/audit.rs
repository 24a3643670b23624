//! An audit counts, level by level, the groups that do harm: whose utility is negative.

use super::{GroupUtility, Table};

/// Standard normal deviate of a two-sided 95 % interval.
const DEVIATE: f64 = 1.96;

/// Groups of one level, and how many of them make pictures worse (paper, section 5, "The held-out audit").
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct LevelAudit {
    /// The level.
    pub level: u8,
    /// Groups of the level.
    pub groups: usize,
    /// Those whose mean Δ over contexts is negative.
    pub negative_mean: usize,
    /// Those whose 0.10 quantile of Δ over contexts is negative.
    pub negative_tail: usize,
    /// Those whose 95 % interval of the mean (normal approximation) lies below 0.
    pub below_zero: usize,
}

impl Table {
    /// Counts the groups that do harm, from the base level up.
    pub fn audit(&self) -> Vec<LevelAudit> {
        let mut levels: Vec<LevelAudit> = Vec::new();
        for group in &self.groups {
            let level = usize::from(group.level);
            while levels.len() <= level {
                levels.push(LevelAudit { level: levels.len() as u8, ..LevelAudit::default() });
            }
            let audit = &mut levels[level];
            audit.groups += 1;
            audit.negative_mean += usize::from(group.mean < 0.0);
            audit.negative_tail += usize::from(group.tail < 0.0);
            audit.below_zero += usize::from(self.is_below_zero(group));
        }
        levels
    }

    /// Whether the interval of a group's mean lies below 0. Of one context nothing is known.
    fn is_below_zero(&self, group: &GroupUtility) -> bool {
        // The table's deviation divides by the number of contexts: an estimate from a sample divides by one
        // less.
        let degrees = f64::from(self.contexts) - 1.0;
        degrees > 0.0 && group.mean + DEVIATE * group.deviation / degrees.sqrt() < 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(level: u8, mean: f64, tail: f64, deviation: f64) -> GroupUtility {
        GroupUtility { cell: 0, level, mean, tail, deviation, utility: mean, gain: mean, together: None }
    }

    #[test]
    fn groups_that_do_harm_are_counted_by_level() {
        let groups = vec![
            group(0, 1.0, 0.5, 0.1),
            group(2, -0.1, -0.5, 0.05),
            group(2, -0.1, -0.5, 5.0),
            group(2, 0.3, -0.1, 0.1),
        ];
        let table = Table { protocol: String::new(), manifest_crc: 0, contexts: 26, deltas: 0, groups };
        let found = table.audit();
        assert_eq!(found.len(), 3);
        assert_eq!((found[0].groups, found[0].negative_tail), (1, 0));
        assert_eq!(found[1], LevelAudit { level: 1, ..LevelAudit::default() });
        let expected = LevelAudit { level: 2, groups: 3, negative_mean: 2, negative_tail: 3, below_zero: 1 };
        assert_eq!(found[2], expected);
        // One context has no spread that could be estimated.
        let one = Table { contexts: 1, ..table };
        assert_eq!(one.audit()[2].below_zero, 0);
    }
}
