//! Names the tracks of a broadcast, and ranks them.

use codec_core::internals::ids::Level;

/// What a track carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Track {
    /// The manifest, one frame in a group.
    Manifest,
    /// Attributes of one level, an epoch in a group.
    Canonical(usize),
    /// Motion of one level, a window in a group.
    Motion(usize),
}

/// Levels there are.
pub(super) const LEVELS: usize = Level::COUNT;

impl Track {
    /// All tracks, most urgent first.
    pub(super) fn all() -> impl Iterator<Item = Self> {
        let of_level = |level| [Self::Canonical(level), Self::Motion(level)];
        [Self::Manifest].into_iter().chain((0..LEVELS).flat_map(of_level))
    }

    /// As it is called in a broadcast.
    pub(super) fn name(self) -> String {
        match self {
            Self::Manifest => "manifest".to_owned(),
            Self::Canonical(level) => format!("canonical.{level}"),
            Self::Motion(level) => format!("motion.{level}"),
        }
    }

    /// What is higher goes first where not all fits: a level before all above it, and attributes before the
    /// motion that stands on them. Utility has no say here: the protocol ranks tracks, and no groups of one,
    /// so that it orders packets inside groups alone (`units`).
    pub(super) fn priority(self) -> u8 {
        let below = |level: usize, part: u8| 254 - 8 * (level.min(LEVELS) as u8) - part;
        match self {
            Self::Manifest => 255,
            Self::Canonical(level) => below(level, 0),
            Self::Motion(level) => below(level, 1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tracks_have_names_of_their_own_and_stand_in_order_of_rank() {
        let tracks: Vec<Track> = Track::all().collect();
        assert_eq!(tracks.len(), 1 + 2 * LEVELS);
        assert!(tracks.is_sorted_by(|a, b| a.priority() > b.priority()));
        let names: std::collections::BTreeSet<String> = tracks.iter().map(|track| track.name()).collect();
        assert_eq!(names.len(), tracks.len());
    }
}
