//! Says how much parity which packets get: most where everything else depends on them.

use std::fmt;

use codec_core::internals::{ids::Level, limits, wire::manifest::Repair};

/// Parity of one kind of packets: any `parity` losses of a set of `set_len` packets, or of its parity, are
/// repaired.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Strength {
    /// Most packets in a set, 2..=64.
    pub set_len: u8,
    /// Parity packets of a full set, 1..=8.
    pub parity: u8,
    /// Independent packet loss at which a smaller set is to be as safe as a full one, 0..=50 percent. With 0
    /// it gets its share of parity instead, at least one.
    #[serde(default)]
    pub loss_percent: u8,
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
    "repair: {found:?} is not known; none, standard, strong, full, or a list of KIND=K+R or KIND=K+R@P% \
     is allowed, with KIND one of base, tracks, 1, 2, 3, K packets in a set 2 to 64, R parity packets 1 to \
     8 and sets of fewer packets as safe at a loss of P (1 to 50) as full ones (base=16+4,tracks=8+2)"
)]
pub struct ProtectionError {
    /// The part at fault.
    pub found: String,
}

/// As it is typed: what [`Protection::parse`] reads.
impl fmt::Display for Protection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = [
            ("none", Self::NONE),
            ("standard", Self::STANDARD),
            ("strong", Self::STRONG),
            ("full", Self::FULL),
        ];
        if let Some((name, _)) = names.iter().find(|(_, named)| named == self) {
            return f.write_str(name);
        }
        let [first, second, third] = self.refinements;
        let kinds = [("base", self.base), ("tracks", self.tracks), ("1", first), ("2", second), ("3", third)];
        let kinds = kinds.iter().filter_map(|(kind, strength)| Some((kind, (*strength)?)));
        for (index, (kind, strength)) in kinds.enumerate() {
            let Strength { set_len, parity, loss_percent } = strength;
            write!(f, "{}{kind}={set_len}+{parity}", if index > 0 { "," } else { "" })?;
            if loss_percent > 0 {
                write!(f, "@{loss_percent}%")?;
            }
        }
        Ok(())
    }
}

impl Protection {
    /// Nothing is protected.
    pub const NONE: Self = Self { base: None, tracks: None, refinements: [None; 3] };

    /// A quarter on top of what everything else stands on, none on refinements. Tracks come in few
    /// packets per window, so their sets are smaller.
    pub const STANDARD: Self = Self {
        base: Some(Strength::share(16, 4)),
        tracks: Some(Strength::share(8, 2)),
        refinements: [None; 3],
    };

    /// For links over which nothing is sent again: half on top of what everything else stands on, a quarter
    /// on the first refinement.
    pub const STRONG: Self = Self {
        base: Some(Strength::share(16, 8)),
        tracks: Some(Strength::share(8, 4)),
        refinements: [Some(Strength::share(16, 4)), None, None],
    };

    /// For links over which nothing is sent again and where one packet in ten may be lost: every level has
    /// parity, the more the more stands on it. A set is beyond repair once in 3,100 (bases) to once in 130
    /// (level 3) at that loss.
    pub const FULL: Self = Self {
        base: Some(Strength { set_len: 16, parity: 8, loss_percent: 10 }),
        tracks: Some(Strength { set_len: 16, parity: 8, loss_percent: 10 }),
        refinements: [
            Some(Strength { set_len: 18, parity: 8, loss_percent: 10 }),
            Some(Strength { set_len: 22, parity: 8, loss_percent: 10 }),
            Some(Strength { set_len: 28, parity: 8, loss_percent: 10 }),
        ],
    };

    /// One XOR parity packet per `set_len` packets of base levels.
    pub const fn xor(set_len: u8) -> Self {
        let strength = Some(Strength::share(set_len, 1));
        Self { base: strength, tracks: strength, refinements: [None; 3] }
    }

    /// Reads `none`, `standard`, `strong`, `full`, or a list as `base=16+4,tracks=8+2,1=20+2`.
    ///
    /// # Errors
    /// Names the part that cannot be read.
    pub fn parse(text: &str) -> Result<Self, ProtectionError> {
        match text {
            "none" => return Ok(Self::NONE),
            "standard" => return Ok(Self::STANDARD),
            "strong" => return Ok(Self::STRONG),
            "full" => return Ok(Self::FULL),
            _ => {}
        }
        let mut this = Self::NONE;
        for part in text.split(',') {
            let read = || {
                let (kind, strength) = part.trim().split_once('=')?;
                let (set_len, parity) = strength.split_once('+')?;
                let (parity, loss_percent) = match parity.split_once('@') {
                    Some((parity, loss)) => {
                        (parity, loss.strip_suffix('%')?.parse().ok().filter(|&p| p > 0)?)
                    }
                    None => (parity, 0),
                };
                let [set_len, parity] = [set_len.parse().ok()?, parity.parse().ok()?];
                let strength = Strength { set_len, parity, loss_percent };
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
    /// Smaller sets than `set_len` get their share of `parity`.
    pub const fn share(set_len: u8, parity: u8) -> Self {
        Self { set_len, parity, loss_percent: 0 }
    }

    /// Whether the format has it.
    pub fn is_allowed(&self) -> bool {
        (2..=limits::MAX_REPAIR_SET).contains(&usize::from(self.set_len))
            && (1..=limits::MAX_REPAIR_PARITY).contains(&usize::from(self.parity))
            && self.loss_percent <= 50
    }

    /// Parity packets of a set of `members`, at most a full one.
    fn parity_of(&self, members: usize) -> u8 {
        if self.loss_percent == 0 {
            let share = usize::from(self.parity) * members;
            let parity = (share + usize::from(self.set_len) / 2) / usize::from(self.set_len);
            return parity.max(1) as u8;
        }
        let loss = f64::from(self.loss_percent) / 100.0;
        let allowed = beyond_repair(self.set_len.into(), self.parity.into(), loss);
        let is_enough = |parity: &u8| beyond_repair(members, (*parity).into(), loss) <= allowed;
        (1..self.parity).find(is_enough).unwrap_or(self.parity)
    }

    /// The repair range over `packets`, which start at id `first_packet`; `None` for no packets.
    /// Where its parity starts is left at 0.
    pub(super) fn range(&self, first_packet: usize, packets: &[Vec<u8>]) -> Option<Repair> {
        let longest = packets.iter().map(Vec::len).max()?;
        let sets = packets.len().div_ceil(usize::from(self.set_len));
        let members = packets.len().div_ceil(sets);
        Some(Repair {
            first_packet: first_packet as u32,
            packets: packets.len() as u32,
            first_parity: 0,
            set_len: self.set_len,
            parity: self.parity_of(members),
            longest: longest as u16,
        })
    }
}

/// The chance that more than `parity` of `members + parity` packets are lost, each with chance `loss`: the
/// upper tail of a binomial distribution.
fn beyond_repair(members: usize, parity: usize, loss: f64) -> f64 {
    let all = members + parity;
    // No powers of a mathematical library: the same bytes on every machine.
    let mut exactly = (0..all).fold(1.0, |product, _| product * (1.0 - loss));
    let mut at_most = 0.0;
    for lost in 0..=parity {
        at_most += exactly;
        exactly = exactly * loss * (all - lost) as f64 / ((1.0 - loss) * (lost + 1) as f64);
    }
    1.0 - at_most
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_printed_is_read_back() {
        for text in
            ["none", "standard", "strong", "full", "base=16+8@10%,1=18+8", "tracks=8+2", "2=64+8,3=4+1"]
        {
            assert_eq!(Protection::parse(text).unwrap().to_string(), text);
        }
        assert_eq!(Protection::parse("tracks=8+2,base=16+4").unwrap().to_string(), "standard");
    }

    #[test]
    fn words_and_lists_are_read_and_anything_else_is_named() {
        assert_eq!(Protection::parse("none"), Ok(Protection::NONE));
        assert_eq!(Protection::parse("standard"), Ok(Protection::STANDARD));
        assert_eq!(Protection::parse("base=16+4,tracks=8+2"), Ok(Protection::STANDARD));
        assert_eq!(Protection::parse("strong"), Ok(Protection::STRONG));
        assert_eq!(Protection::parse("base=16+8,tracks=8+4,1=16+4"), Ok(Protection::STRONG));
        assert_eq!(Protection::parse("full"), Ok(Protection::FULL));
        let list = "base=16+8@10%,tracks=16+8@10%,1=18+8@10%,2=22+8@10%,3=28+8@10%";
        assert_eq!(Protection::parse(list), Ok(Protection::FULL));
        assert!(Protection::FULL.strengths().all(|strength| strength.is_allowed()));
        let one = Protection::parse("2=64+8").unwrap();
        assert_eq!(one.of(true, Level::ALL[2]), Some(Strength::share(64, 8)));
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
            ("base=16+8@0%", "base=16+8@0%"),
            ("base=16+8@51%", "base=16+8@51%"),
            ("base=16+8@10", "base=16+8@10"),
        ] {
            assert_eq!(Protection::parse(text), Err(ProtectionError { found: found.to_owned() }), "{text}");
        }
    }

    #[test]
    fn small_sets_get_their_share_of_parity() {
        let strength = Strength::share(16, 4);
        for (packets, sets, parity) in [(1, 1, 1), (2, 1, 1), (6, 1, 2), (16, 1, 4), (17, 2, 2), (40, 3, 4)] {
            let range = strength.range(9, &vec![vec![0; 50]; packets]).unwrap();
            assert_eq!((range.sets(), range.parity), (sets, parity), "{packets}");
            assert_eq!((range.first_packet, range.longest), (9, 50));
        }
        assert!(strength.range(0, &[]).is_none());
    }

    #[test]
    fn small_sets_are_as_safe_as_full_ones_where_a_loss_is_named() {
        // 1 − Σ C(24, k) 0.1^k 0.9^(24 − k) over k = 0..=8, as a table of the distribution has it.
        assert!((beyond_repair(16, 8, 0.1) - 3.2e-4).abs() < 1e-5);
        assert!((beyond_repair(1, 1, 0.5) - 0.25).abs() < 1e-12);
        let strength = Strength { set_len: 16, parity: 8, loss_percent: 10 };
        let parity: Vec<u8> = (1..=16).map(|members| strength.parity_of(members)).collect();
        assert_eq!(parity, [3, 4, 4, 5, 5, 5, 6, 6, 6, 7, 7, 7, 8, 8, 8, 8]);
        // Shares are not as safe.
        let share = Strength { loss_percent: 0, ..strength };
        assert!(beyond_repair(2, share.parity_of(2).into(), 0.1) > 10.0 * beyond_repair(16, 8, 0.1));
    }
}
