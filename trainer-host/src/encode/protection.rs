//! Says how much parity which packets get: most where everything else depends on them.

use codec_core::internals::{ids::Level, limits, wire::manifest::Repair};

/// Parity of one kind of packets: any `parity` losses of a set of `set_len` packets are repaired.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Strength {
    /// Most packets in a set, 2..=64.
    pub set_len: u8,
    /// Parity packets of a full set, 1..=8; smaller sets get their share, at least one.
    pub parity: u8,
}

/// Parity per kind of packets; `None` sends none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Protection {
    /// Canonical base levels.
    pub base: Option<Strength>,
    /// Motion base levels: cluster tracks.
    pub tracks: Option<Strength>,
    /// Levels 1 to 3 of both.
    pub refinements: [Option<Strength>; 3],
}

/// Why a protection cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "repair: {found:?} is not known; none, standard, strong, or a list of KIND=K+R is allowed, with KIND one \
     of base, tracks, 1, 2, 3, K packets in a set 2 to 64 and R parity packets 1 to 8 (base=16+4,tracks=8+2)"
)]
pub struct ProtectionError {
    /// The part at fault.
    pub found: String,
}

impl Protection {
    /// Nothing is protected.
    pub const NONE: Self = Self { base: None, tracks: None, refinements: [None; 3] };

    /// A quarter on top of what everything else stands on, none on refinements. Tracks come in few
    /// packets per window, so their sets are smaller.
    pub const STANDARD: Self = Self {
        base: Some(Strength { set_len: 16, parity: 4 }),
        tracks: Some(Strength { set_len: 8, parity: 2 }),
        refinements: [None; 3],
    };

    /// For links over which nothing is sent again: half on top of what everything else stands on, a quarter
    /// on the first refinement.
    pub const STRONG: Self = Self {
        base: Some(Strength { set_len: 16, parity: 8 }),
        tracks: Some(Strength { set_len: 8, parity: 4 }),
        refinements: [Some(Strength { set_len: 16, parity: 4 }), None, None],
    };

    /// One XOR parity packet per `set_len` packets of base levels.
    pub const fn xor(set_len: u8) -> Self {
        let strength = Some(Strength { set_len, parity: 1 });
        Self { base: strength, tracks: strength, refinements: [None; 3] }
    }

    /// Reads `none`, `standard`, `strong`, or a list as `base=16+4,tracks=8+2,1=20+2`.
    ///
    /// # Errors
    /// Names the part that cannot be read.
    pub fn parse(text: &str) -> Result<Self, ProtectionError> {
        match text {
            "none" => return Ok(Self::NONE),
            "standard" => return Ok(Self::STANDARD),
            "strong" => return Ok(Self::STRONG),
            _ => {}
        }
        let mut this = Self::NONE;
        for part in text.split(',') {
            let read = || {
                let (kind, strength) = part.trim().split_once('=')?;
                let (set_len, parity) = strength.split_once('+')?;
                let strength = Strength { set_len: set_len.parse().ok()?, parity: parity.parse().ok()? };
                strength.is_allowed().then_some((kind, Some(strength)))
            };
            match read() {
                Some(("base", strength)) => this.base = strength,
                Some(("tracks", strength)) => this.tracks = strength,
                Some(("1", strength)) => this.refinements[0] = strength,
                Some(("2", strength)) => this.refinements[1] = strength,
                Some(("3", strength)) => this.refinements[2] = strength,
                _ => return Err(ProtectionError { found: part.to_owned() }),
            }
        }
        Ok(this)
    }

    /// What packets of this level get, of motion or canonical.
    pub const fn of(&self, motion: bool, level: Level) -> Option<Strength> {
        match (level.index(), motion) {
            (0, false) => self.base,
            (0, true) => self.tracks,
            (level, _) => self.refinements[level - 1],
        }
    }

    /// All strengths in use.
    pub(super) fn strengths(&self) -> impl Iterator<Item = Strength> {
        [self.base, self.tracks].into_iter().chain(self.refinements).flatten()
    }
}

impl Strength {
    /// Whether the format has it.
    pub fn is_allowed(&self) -> bool {
        (2..=limits::MAX_REPAIR_SET).contains(&usize::from(self.set_len))
            && (1..=limits::MAX_REPAIR_PARITY).contains(&usize::from(self.parity))
    }

    /// The repair range over `packets`, which start at id `first_packet`; `None` for no packets.
    /// Where its parity starts is left at 0.
    pub(super) fn range(&self, first_packet: usize, packets: &[Vec<u8>]) -> Option<Repair> {
        let longest = packets.iter().map(Vec::len).max()?;
        let sets = packets.len().div_ceil(usize::from(self.set_len));
        let members = packets.len().div_ceil(sets);
        let share = usize::from(self.parity) * members;
        let parity = (share + usize::from(self.set_len) / 2) / usize::from(self.set_len);
        Some(Repair {
            first_packet: first_packet as u32,
            packets: packets.len() as u32,
            first_parity: 0,
            set_len: self.set_len,
            parity: parity.max(1) as u8,
            longest: longest as u16,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_and_lists_are_read_and_anything_else_is_named() {
        assert_eq!(Protection::parse("none"), Ok(Protection::NONE));
        assert_eq!(Protection::parse("standard"), Ok(Protection::STANDARD));
        assert_eq!(Protection::parse("base=16+4,tracks=8+2"), Ok(Protection::STANDARD));
        assert_eq!(Protection::parse("strong"), Ok(Protection::STRONG));
        assert_eq!(Protection::parse("base=16+8,tracks=8+4,1=16+4"), Ok(Protection::STRONG));
        let one = Protection::parse("2=64+8").unwrap();
        assert_eq!(one.of(true, Level::ALL[2]), Some(Strength { set_len: 64, parity: 8 }));
        assert_eq!(one.of(false, Level::BASE), None);
        for (text, found) in [
            ("", ""),
            ("base", "base"),
            ("base=4", "base=4"),
            ("base=4+1,4=4+1", "4=4+1"),
            ("base=1+1", "base=1+1"),
            ("base=65+1", "base=65+1"),
            ("base=4+9", "base=4+9"),
            ("tracks=8+0", "tracks=8+0"),
        ] {
            assert_eq!(Protection::parse(text), Err(ProtectionError { found: found.to_owned() }), "{text}");
        }
    }

    #[test]
    fn small_sets_get_their_share_of_parity() {
        let strength = Strength { set_len: 16, parity: 4 };
        for (packets, sets, parity) in [(1, 1, 1), (2, 1, 1), (6, 1, 2), (16, 1, 4), (17, 2, 2), (40, 3, 4)] {
            let range = strength.range(9, &vec![vec![0; 50]; packets]).unwrap();
            assert_eq!((range.sets(), range.parity), (sets, parity), "{packets}");
            assert_eq!((range.first_packet, range.longest), (9, 50));
        }
        assert!(strength.range(0, &[]).is_none());
    }
}
