//! A range plan fetches a `.dgs` file piece by piece: manifest, index, then base levels before refinements.
//!
//! Sans-I/O: it says which bytes to ask a server for next and takes what came. Packets lie in a file epoch by
//! epoch, in an epoch first those of the base level, then the others by utility per byte; where an epoch's
//! base and refinements begin is found by looking at heads of packets half-way between known ones, until so
//! little lies between that it is fetched at once. A file in another order still comes whole, only not base
//! first.

use std::ops::Range;

use codec_core::internals::{
    cursor::Reader,
    ids::WindowId,
    wire::{
        file,
        manifest::Manifest,
        packet::{Head, KIND_CHUNK, KIND_SLICES},
    },
};
use dgs_player::{ErrorKind, Result};

/// Bytes to ask for first: the manifest of most streams, and their first packets.
pub const FIRST_BYTES: u64 = 16 << 10;
/// Bytes asked for at the end, where the index is.
const TAIL_BYTES: u64 = 16 << 10;
/// Enough of a packet to say whose it is.
const HEAD_BYTES: u64 = 32;
/// Most bytes asked for at once: of base levels, so that a picture comes soon, and of refinements.
const BASE_BYTES: u64 = 64 << 10;
const REFINEMENT_BYTES: u64 = 256 << 10;
/// What lies between two known packets is fetched without looking further if it is no more than this: about
/// what a slow link carries in the time of the requests that are saved.
const GAP_BYTES: u64 = 32 << 10;
/// Bytes of a magic and a length before the manifest.
const FRONT_BYTES: u64 = 8;

/// Refinements of an epoch come in so many parts, a part of every epoch before the next: those that add most
/// to pictures of all epochs before the rest of one.
const PARTS: usize = 3;

/// What a packet is for, in the order in which files have them: its epoch, and whether it refines.
type Place = (u16, bool);
/// Parity, and what is no packet: after all others.
const LAST: Place = (u16::MAX, true);

/// What to do next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// Ask for these bytes.
    Range(Range<u64>),
    /// The index is unusable: ask for the whole file.
    Whole,
    /// Everything is there.
    Nothing,
}

/// The manifest of a file whose first bytes are `first`: its message, or how many bytes are needed.
///
/// # Errors
/// No `.dgs` file.
pub fn message(first: &[u8]) -> Result<std::result::Result<&[u8], u64>> {
    match file::manifest(first) {
        Ok((message, _)) => Ok(Ok(message)),
        Err(error) if error.kind == ErrorKind::Short && first.len() as u64 >= FRONT_BYTES => {
            let [_, _, _, _, a, b, c, d, ..] = *first else { return Err(error) };
            Ok(Err(FRONT_BYTES + u64::from(u32::from_le_bytes([a, b, c, d]))))
        }
        Err(error) => Err(error),
    }
}

/// A plan of the byte ranges of a `.dgs` file that are fetched next.
#[derive(Debug)]
pub struct RangePlan {
    len: u64,
    /// Where the packets' length fields are, and one past the last packet. Empty before the index came.
    offsets: Vec<u64>,
    fetched: Vec<bool>,
    places: Vec<Option<Place>>,
    /// The packets whose places are known, ascending.
    known: Vec<usize>,
    /// Whether the known places are in the order that files have.
    ordered: bool,
    epochs: u16,
    /// Bytes at the end that the index needs.
    tail: u64,
    unusable: bool,
}

impl RangePlan {
    /// A plan for a file of `len` bytes with `epochs` epochs, of which nothing but the manifest is known.
    pub fn new(len: u64, epochs: u16) -> Self {
        let (offsets, fetched, places, known) = Default::default();
        let tail = TAIL_BYTES.min(len);
        Self { len, offsets, fetched, places, known, ordered: true, epochs, tail, unusable: false }
    }

    /// What to ask for, shown epoch first.
    pub fn next(&self, epoch: u16) -> Wanted {
        if self.unusable {
            return Wanted::Whole;
        }
        if self.offsets.is_empty() {
            return Wanted::Range(self.len - self.tail..self.len);
        }
        let epochs = || (epoch..self.epochs).chain(0..epoch.min(self.epochs));
        let bases = epochs().map(|e| (e, None));
        let refinements = (0..PARTS).flat_map(|part| epochs().map(move |e| (e, Some(part))));
        for (e, part) in bases.chain(refinements) {
            match self.bounds(e, part) {
                Err(gap) => return Wanted::Range(self.look_into(gap)),
                Ok(packets) => {
                    let most = if part.is_none() { BASE_BYTES } else { REFINEMENT_BYTES };
                    if let Some(range) = self.unfetched(packets, most) {
                        return Wanted::Range(range);
                    }
                }
            }
        }
        self.unfetched(0..self.fetched.len(), REFINEMENT_BYTES).map_or(Wanted::Nothing, Wanted::Range)
    }

    /// Whether the base of `epoch` is there, or no more of it will come.
    pub fn has_base(&self, epoch: u16) -> bool {
        if self.unusable || self.offsets.is_empty() {
            return false;
        }
        let packets = match self.first_of((epoch, false)) {
            Ok(first) => first..self.known_end((epoch, false)),
            Err(_) => return false,
        };
        let known = self.known.iter().map(|&known| self.place_of(known)).filter(|known| *known != LAST);
        if packets.is_empty() || !(self.ordered || known.is_sorted()) {
            // In another order than files have, a base may lie anywhere.
            return self.fetched.iter().all(|&fetched| fetched);
        }
        self.unfetched(packets, u64::MAX).is_none()
    }

    /// Share of the packets that are there.
    pub fn share(&self) -> f64 {
        if self.fetched.is_empty() {
            return 0.0;
        }
        self.fetched.iter().filter(|&&fetched| fetched).count() as f64 / self.fetched.len() as f64
    }

    /// Takes `bytes` of the file from offset `at` on, calls `packet` with each packet that is whole in them.
    pub fn take(&mut self, at: u64, bytes: &[u8], manifest: &Manifest<'_>, mut packet: impl FnMut(&[u8])) {
        let end = at.saturating_add(bytes.len() as u64);
        if self.offsets.is_empty() && end >= self.len {
            self.read_index(bytes);
        }
        // Offsets grow: the first packet at or after `at`.
        let from = self.offsets.partition_point(|&offset| offset < at);
        for k in from..self.fetched.len() {
            let (start, past) = (self.offsets[k], self.offsets[k + 1]);
            if start >= end {
                break;
            }
            let Some(found) = bytes.get((start - at) as usize..) else { break };
            let Some((length, content)) = found.split_first_chunk::<2>() else { break };
            let length = usize::from(u16::from_le_bytes(*length));
            let content = &content[..content.len().min(length)];
            if self.places[k].is_none() {
                self.learn(k, place(content, manifest).unwrap_or(LAST));
            }
            if past <= end && !self.fetched[k] {
                self.fetched[k] = true;
                // A damaged length gives a damaged packet, which its CRC shows.
                packet(content);
            }
        }
    }

    fn read_index(&mut self, tail: &[u8]) {
        let Some((_, length)) = tail.split_last_chunk::<4>() else {
            self.unusable = true;
            return;
        };
        let needed = u64::from(u32::from_le_bytes(*length));
        if needed > tail.len() as u64 && needed <= self.len && self.tail < needed {
            self.tail = needed;
            return;
        }
        let Ok(entries) = file::index(tail, codec_core::internals::wire::crc::crc32) else {
            self.unusable = true;
            return;
        };
        // Two bytes of the end mark lie between the last packet and the index.
        let past = self.len.saturating_sub(needed + 2);
        self.offsets = entries.map(u64::from).chain([past]).collect();
        let legal = self.offsets.len() > 1 && self.offsets.windows(2).all(|pair| pair[0] + 2 < pair[1]);
        if !legal || self.offsets[0] < FRONT_BYTES {
            self.unusable = true;
            return;
        }
        self.fetched = vec![false; self.offsets.len() - 1];
        self.places = vec![None; self.offsets.len() - 1];
    }

    /// What to ask for to learn more of the packets `gap`, of which nothing is known: all of them, or the
    /// head of the middle one. Of epochs that are small, more comes at once: there is little to put off.
    fn look_into(&self, gap: Range<usize>) -> Range<u64> {
        let all = self.offsets[gap.start]..self.offsets[gap.end];
        let is_small = self.len / u64::from(self.epochs.max(1)) < BASE_BYTES;
        if all.end - all.start <= if is_small { REFINEMENT_BYTES } else { GAP_BYTES } {
            return all;
        }
        let middle = middle(&gap);
        let at = self.offsets[middle];
        at..(at + HEAD_BYTES).min(self.offsets[middle + 1])
    }

    /// The packets of the base of epoch `e`, or of a part of its refinements; or those among which the border
    /// is to be found.
    fn bounds(&self, e: u16, part: Option<usize>) -> std::result::Result<Range<usize>, Range<usize>> {
        let Some(part) = part else {
            return Ok(self.first_of((e, false))?..self.known_end((e, false)));
        };
        let first = self.first_of((e, true))?;
        // The base of the next epoch is there by now.
        let past = self.known_end((e, true)).max(first);
        let cut = |part: usize| first + (past - first) * part / PARTS;
        Ok(cut(part)..cut(part + 1))
    }

    /// Notes the place of packet `k`, which was not known.
    fn learn(&mut self, k: usize, place: Place) {
        let at = self.known.partition_point(|&known| known < k);
        let follows = at == 0 || self.place_of(self.known[at - 1]) <= place;
        let precedes = self.known.get(at).is_none_or(|&next| place <= self.place_of(next));
        self.ordered &= follows && precedes;
        self.places[k] = Some(place);
        self.known.insert(at, k);
    }

    fn place_of(&self, known: usize) -> Place {
        self.places[known].unwrap_or(LAST)
    }

    /// The first packet at or past `place`; or those of which nothing is known that it is among, or after.
    fn first_of(&self, place: Place) -> std::result::Result<usize, Range<usize>> {
        if place == (0, false) {
            return Ok(0);
        }
        let (low, high) = if self.ordered {
            let at = self.known.partition_point(|&known| self.place_of(known) < place);
            let low = at.checked_sub(1).map_or(0, |before| self.known[before] + 1);
            (low, self.known.get(at).copied())
        } else {
            let before = self.known.iter().rev().find(|&&known| self.place_of(known) < place);
            let low = before.map_or(0, |known| known + 1);
            (low, self.known.iter().copied().find(|&known| known >= low))
        };
        let high = high.unwrap_or(self.places.len());
        if low == high { Ok(low) } else { Err(low..high) }
    }

    /// The first packet that is known to be past `place`.
    fn known_end(&self, place: Place) -> usize {
        let past = if self.ordered {
            self.known.get(self.known.partition_point(|&known| self.place_of(known) <= place))
        } else {
            self.known.iter().find(|&&known| self.place_of(known) > place)
        };
        past.copied().unwrap_or(self.places.len())
    }

    /// The bytes of the first packets among `packets` that were not fetched: one at least, `most` at most.
    fn unfetched(&self, packets: Range<usize>, most: u64) -> Option<Range<u64>> {
        let first = packets.clone().find(|&k| !self.fetched[k])?;
        let at = self.offsets[first];
        let fits = |&k: &usize| !self.fetched[k] && self.offsets[k + 1] - at <= most;
        let last = (first..packets.end).take_while(fits).last().unwrap_or(first);
        Some(at..self.offsets[last + 1])
    }
}

/// The packet half-way through `gap`.
fn middle(gap: &Range<usize>) -> usize {
    gap.start + (gap.end - gap.start) / 2
}

/// Whose the packet is whose first bytes are `content`.
fn place(content: &[u8], manifest: &Manifest<'_>) -> Option<Place> {
    let head = Head::parse(content).ok()?;
    let refines = head.flags & 3 > 0;
    match head.kind {
        KIND_SLICES => {
            let mut reader = Reader::new(content.get(head.len..)?);
            let span = reader.varint("slices.span", u32::from(u16::MAX)).ok()? as u16;
            let epoch = if head.flags & 4 == 0 { span } else { manifest.window(WindowId(span))?.epoch };
            Some((epoch, refines))
        }
        KIND_CHUNK => {
            let frame = u16::from_le_bytes([*content.get(6)?, *content.get(7)?]);
            Some((manifest.epoch_at(frame.into())?.0, refines))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use dgs_player::{Caps, Player};

    use super::*;

    const FILE: &[u8] = include_bytes!("../../../codec-core/tests/conformance/everything.dgs");

    /// What a player has after the plan has fetched everything, and the ranges in order.
    fn fetched(file: &[u8]) -> (Player, Vec<Range<u64>>, Wanted) {
        let message = message(file).unwrap().unwrap();
        let mut player = Player::new(message, &Caps::HOST).unwrap();
        let mut plan = RangePlan::new(file.len() as u64, player.manifest().head().epochs);
        let mut ranges = Vec::new();
        loop {
            let Wanted::Range(range) = plan.next(0) else { return (player, ranges, plan.next(0)) };
            let bytes = &file[range.start as usize..range.end as usize];
            let mut packets = Vec::new();
            plan.take(range.start, bytes, player.manifest(), |packet| packets.push(packet.to_vec()));
            player.push_all(packets.iter().map(Vec::as_slice));
            assert!(!ranges.contains(&range), "{range:?} twice");
            ranges.push(range);
        }
    }

    #[test]
    fn a_file_that_came_in_pieces_is_the_file_that_came_whole() {
        for name in ["everything", "made-paper", "made-extents", "xor", "one", "still"] {
            let path =
                format!("{}/../../codec-core/tests/conformance/{name}.dgs", env!("CARGO_MANIFEST_DIR"));
            let file = std::fs::read(path).unwrap();
            let (mut pieces, _, end) = fetched(&file);
            assert_eq!(end, Wanted::Nothing, "{name}");
            let (mut whole, _) = Player::open(&file).unwrap();
            for frame in 0..whole.info().frames {
                assert_eq!(
                    pieces.frame(frame).unwrap().gaussians,
                    whole.frame(frame).unwrap().gaussians,
                    "{name}"
                );
            }
        }
    }

    /// A file of 4 epochs of 250 packets of 898 bytes, of which 63 are base, and 20 of parity after them.
    fn long_file() -> (RangePlan, Vec<Place>) {
        let mut plan = RangePlan::new(1_000_000, 4);
        plan.offsets = (0..=1020).map(|k| 100 + 900 * k).collect();
        (plan.fetched, plan.places) = (vec![false; 1020], vec![None; 1020]);
        let of = |k: u16| if k < 1000 { (k / 250, k % 250 >= 63) } else { LAST };
        (plan, (0..1020).map(of).collect())
    }

    #[test]
    fn base_levels_of_all_epochs_come_before_refinements_and_these_a_part_of_every_epoch_at_a_time() {
        let (mut plan, truth) = long_file();
        let mut came = Vec::new();
        while let Wanted::Range(range) = plan.next(2) {
            for (k, place) in truth.iter().enumerate() {
                if range.contains(&plan.offsets[k]) {
                    if plan.places[k].is_none() {
                        plan.learn(k, *place);
                    }
                    if plan.offsets[k + 1] <= range.end && !plan.fetched[k] {
                        plan.fetched[k] = true;
                        came.push(k);
                    }
                }
            }
        }
        assert_eq!(came.len(), 1020);
        let epochs = |packets: &[usize]| {
            let mut epochs: Vec<u16> = packets.iter().map(|&k| truth[k].0).collect();
            epochs.dedup();
            epochs
        };
        let bases: Vec<usize> = came.iter().copied().filter(|&k| !truth[k].1).collect();
        assert_eq!(epochs(&bases), [2, 3, 0, 1], "the shown epoch first");
        // A range of bases may reach beyond them: where they end is known when it has come.
        let last = came.iter().rposition(|&k| !truth[k].1).unwrap();
        assert!(last + 1 - bases.len() <= 4 * (BASE_BYTES / 900) as usize, "bases first");
        let refinements: Vec<usize> =
            came[last + 1..].iter().copied().filter(|&k| truth[k] != LAST).collect();
        assert!(epochs(&refinements).ends_with(&[2, 3, 0, 1].repeat(PARTS)));
        assert!(came[..=last].iter().all(|&k| truth[k] != LAST), "parity is no base");
        let of_one: Vec<usize> = refinements.iter().copied().filter(|&k| truth[k].0 == 2).collect();
        assert!(of_one.is_sorted(), "in the order of the file");
    }

    /// A packet of epoch 0 at the end: bisection would take every base for found.
    #[test]
    fn of_a_file_in_another_order_no_base_is_there_before_everything_is() {
        let (mut plan, truth) = long_file();
        plan.learn(0, truth[0]);
        plan.learn(1019, (0, false));
        (plan.fetched[0], plan.fetched[1019]) = (true, true);
        assert!((0..4).all(|epoch| !plan.has_base(epoch)));
        plan.learn(500, truth[500]);
        plan.fetched[500] = true;
        assert!((0..4).all(|epoch| !plan.has_base(epoch)));
        plan.fetched.fill(true);
        assert!((0..4).all(|epoch| plan.has_base(epoch)));
    }

    /// A file of many packets with many epochs: what is asked for by bisection.
    #[test]
    fn where_a_level_begins_is_found_in_few_steps() {
        let (mut plan, truth) = long_file();
        for (place, wanted) in
            [((1, false), 250), ((3, false), 750), ((2, true), 563), ((0, true), 63), ((4, false), 1000)]
        {
            let mut steps = 0;
            let found = loop {
                match plan.first_of(place) {
                    Ok(found) => break found,
                    Err(gap) => plan.learn(middle(&gap), truth[middle(&gap)]),
                }
                steps += 1;
            };
            assert!(found == wanted && steps <= 11, "{place:?}: {found} after {steps}");
        }
    }

    /// Binary search against linear search.
    #[test]
    fn of_known_places_in_order_a_search_finds_what_a_look_at_all_finds() {
        let mut differs = false;
        for stride in [3, 7, 53, 241] {
            for of in [(0, false), (1, true), (2, false), (3, true), (4, false), LAST] {
                let (mut plan, truth) = long_file();
                (0..1020).step_by(stride).for_each(|k| plan.learn(k * 7 % 1020, truth[k * 7 % 1020]));
                assert!(plan.ordered);
                let quick = (plan.first_of(of), plan.known_end(of));
                plan.ordered = false;
                assert_eq!(quick, (plan.first_of(of), plan.known_end(of)), "{of:?}, every {stride}");
                // With one packet out of order a search would be wrong.
                let astray = plan.places.iter().rposition(Option::is_none).unwrap();
                plan.learn(astray, (0, false));
                let all = (plan.first_of(of), plan.known_end(of));
                plan.ordered = true;
                differs |= all != (plan.first_of(of), plan.known_end(of));
            }
        }
        assert!(differs);
    }

    #[test]
    fn damage_asks_for_the_whole_file_and_never_for_ever() {
        for at in [FILE.len() - 1, FILE.len() - 9, FILE.len() - 30] {
            let mut damaged = FILE.to_vec();
            damaged[at] ^= 0x55;
            assert_eq!(fetched(&damaged).2, Wanted::Whole, "{at}");
        }
        assert!(message(b"PLY and no stream").is_err());
        assert!(message(&FILE[..6]).is_err());
        let needed = message(&FILE[..40]).unwrap().unwrap_err();
        assert!(message(&FILE[..needed as usize]).unwrap().is_ok());
    }
}
