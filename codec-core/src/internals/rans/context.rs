//! The `paper-context` chunk body: binary rANS whose probabilities follow what the chunk has brought so far.
//!
//! No tables travel. Every chunk starts from the same probabilities, so that it decodes alone. A symbol is a
//! run of yes-or-no decisions: how many bits its magnitude has, its sign, then the bits behind the
//! leading one. Each decision has a probability of its own per *context*: the attribute that the
//! symbol belongs to, and how large the symbols nearest to it were. A first decision says whether the symbol
//! is that of the frame before. Layout, as in [`bytes`](super::bytes):
//! `[state: u32][bytes …]`. A body is whole only if the state ends at 2^23 and every byte is used.

use core::num::NonZero;

use super::bytes::{PRECISION, SCALE, STATE_BYTES};
use crate::{
    error::{Error, ErrorKind, Result},
    ids::Level,
};

/// The least state between two decisions.
const LOW: u32 = 1 << 23;
/// Attributes told apart: position, log-scale, quaternion, opacity, harmonics.
const ATTRIBUTES: usize = 5;
/// The attribute of each of the 14 components of a Gaussian at one frame.
const ATTRIBUTE_OF: [u8; 14] = [0, 0, 0, 1, 1, 1, 2, 2, 2, 2, 3, 4, 4, 4];
/// Components with a refinement per frame at level 1: all but the position.
const REFINEMENTS: usize = 11;
/// Sizes of neighbours told apart.
const SIZES: usize = 12;
/// Most bits of a magnitude: that of −32768.
const MAX_LENGTH: usize = 16;
/// Bits behind the leading one that have probabilities; the rest are even.
const MODELLED_BITS: u32 = 2;
/// The slowest rate at which a probability follows what is seen: 1/16 of the way.
const SLOWEST: u32 = 4;

/// Which symbols of its group a chunk holds, and how the group's symbols lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Level of the group.
    pub level: Level,
    /// First symbol of the group in the chunk.
    pub first: usize,
    /// Gaussians of the cluster: symbols of one component lie together.
    pub gaussians: NonZero<usize>,
    /// Vectors of the epoch's basis.
    pub rank: usize,
    /// Frames of the epoch.
    pub frames: usize,
}

impl Place {
    /// Symbols from a symbol to that of the same Gaussian and component in the frame after.
    fn frame(&self) -> usize {
        let components = if self.level.get() == 1 { REFINEMENTS } else { ATTRIBUTE_OF.len() };
        components * self.gaussians.get()
    }

    /// The attribute of component `component` of the group, 0 to 4.
    fn attribute(&self, component: usize) -> usize {
        let lead = 3 * self.rank;
        let own = match self.level.get() {
            1 if component < lead => 0,
            1 if component < lead + REFINEMENTS * self.frames => 3 + (component - lead) % REFINEMENTS,
            1 => ATTRIBUTE_OF.len() - 1,
            _ => component % ATTRIBUTE_OF.len(),
        };
        usize::from(ATTRIBUTE_OF[own])
    }
}

/// The probability that a decision is "no", of 65536, and how often it was made.
#[derive(Clone, Copy)]
struct Probability {
    no: u16,
    seen: u16,
}

impl Probability {
    const EVEN: Self = Self { no: 1 << 15, seen: 0 };

    /// Slots of "no", of 4096.
    fn slots(self) -> u32 {
        u32::from(self.no >> 4).clamp(1, SCALE - 1)
    }

    /// Follows a decision; the first ones are learned from faster.
    fn follow(&mut self, yes: bool) {
        let rate = (u32::from(self.seen) + 1).ilog2() + 1;
        let rate = rate.min(SLOWEST);
        if yes {
            self.no -= self.no >> rate;
        } else {
            self.no += (u16::MAX - self.no) >> rate;
        }
        self.seen = (self.seen + 1).min(1 << SLOWEST);
    }
}

/// What is known of a symbol before it is decoded.
#[derive(Clone, Copy)]
struct Context {
    attribute: usize,
    /// Of the sizes of the neighbours, 0 to 11.
    size: usize,
    /// Of their signs, 0 to 8.
    sign: usize,
    /// The symbol of the same Gaussian and component in the frame before, if the chunk has it.
    before: Option<i16>,
    /// Whether the symbol to the left was as in the frame before it.
    left_repeats: bool,
}

/// All probabilities of a chunk.
struct Model {
    /// "The symbol is not that of the frame before."
    changes: [[Probability; 2]; ATTRIBUTES],
    /// "The magnitude has more than so many bits."
    longer: [[[Probability; MAX_LENGTH]; SIZES]; ATTRIBUTES],
    negative: [[Probability; 9]; ATTRIBUTES],
    /// Bits behind the leading one, as a binary tree per length.
    below: [[Probability; 1 << MODELLED_BITS]; MAX_LENGTH + 1],
}

/// One side of the coder: takes decisions from bytes, or hands them to an encoder.
trait Decisions {
    /// Says that the decisions to come are those of symbol `index` of the chunk.
    fn begin(&mut self, _index: usize) {}

    /// Passes one decision, "no" having `slots` of 4096. `yes` is what an encoder has decided.
    fn pass(&mut self, slots: u32, yes: bool) -> Result<bool>;
}

impl Model {
    const NEW: Self = Self {
        changes: [[Probability::EVEN; 2]; ATTRIBUTES],
        longer: [[[Probability::EVEN; MAX_LENGTH]; SIZES]; ATTRIBUTES],
        negative: [[Probability::EVEN; 9]; ATTRIBUTES],
        below: [[Probability::EVEN; 1 << MODELLED_BITS]; MAX_LENGTH + 1],
    };

    /// Passes one symbol.
    fn symbol(&mut self, side: &mut impl Decisions, context: Context, value: i16) -> Result<i16> {
        let magnitude = u32::from(value.unsigned_abs());
        let wanted = u32::BITS - magnitude.leading_zeros();
        let too_small = Error::illegal("chunk.symbol", 0, context.attribute as u64, (0, 4));
        if let Some(before) = context.before {
            let changes = self.changes.get_mut(context.attribute).ok_or(too_small)?;
            let changes = changes.get_mut(usize::from(context.left_repeats)).ok_or(too_small)?;
            let yes = side.pass(changes.slots(), value != before)?;
            changes.follow(yes);
            if !yes {
                return Ok(before);
            }
        }
        let longer = self.longer.get_mut(context.attribute).and_then(|a| a.get_mut(context.size));
        let mut length = 0u32;
        for probability in longer.ok_or(too_small)? {
            let yes = side.pass(probability.slots(), wanted > length)?;
            probability.follow(yes);
            if !yes {
                break;
            }
            length += 1;
        }
        if length == 0 {
            return Ok(0);
        }
        let negative = self.negative.get_mut(context.attribute).and_then(|a| a.get_mut(context.sign));
        let negative = negative.ok_or(too_small)?;
        let minus = side.pass(negative.slots(), value < 0)?;
        negative.follow(minus);
        let below = self.below.get_mut(length as usize).ok_or(too_small)?;
        let mut found = 1u32;
        for bit in (0..length - 1).rev() {
            let wanted = magnitude >> bit & 1 == 1;
            // `found` numbers the nodes of the tree as long as it is below 4.
            let yes = match below.get_mut(found as usize) {
                Some(probability) => {
                    let yes = side.pass(probability.slots(), wanted)?;
                    probability.follow(yes);
                    yes
                }
                None => side.pass(SCALE / 2, wanted)?,
            };
            found = found << 1 | u32::from(yes);
        }
        let value = if minus { -(i64::from(found)) } else { i64::from(found) };
        i16::try_from(value).map_err(|_| Error::illegal("chunk.symbol", 0, found.into(), (0, 32_767)))
    }
}

/// Walks the symbols of a chunk in order; `values` are written where `side` decodes, read where it encodes.
fn walk(side: &mut impl Decisions, place: Place, values: &mut [i16]) -> Result<()> {
    let mut model = Model::NEW;
    let gaussians = place.gaussians.get();
    for i in 0..values.len() {
        let at = place.first + i;
        let earlier = |distance: usize| i.checked_sub(distance).and_then(|j| values.get(j)).copied();
        let left = if at.is_multiple_of(gaussians) { None } else { earlier(1) };
        let before = earlier(place.frame());
        let above = before.or(earlier(gaussians));
        let left_before = earlier(place.frame() + 1);
        // Neighbours outside the chunk count as zeros.
        let size = |v: Option<i16>| v.map_or(0, |v| u32::BITS - u32::from(v.unsigned_abs()).leading_zeros());
        let sign = |v: Option<i16>| (v.unwrap_or(0).signum() + 1) as usize;
        let context = Context {
            attribute: place.attribute(at / place.gaussians),
            size: ((size(left) + size(above)) as usize).min(SIZES - 1),
            sign: 3 * sign(left) + sign(above),
            before,
            left_repeats: left.is_some() && left == left_before,
        };
        side.begin(i);
        values[i] = model.symbol(side, context, values[i])?;
    }
    Ok(())
}

/// Takes decisions from the bytes of a body.
struct Decoder<'a> {
    state: u32,
    rest: &'a [u8],
    len: usize,
}

impl Decisions for Decoder<'_> {
    fn pass(&mut self, slots: u32, _: bool) -> Result<bool> {
        let slot = self.state & (SCALE - 1);
        let yes = slot >= slots;
        let (start, frequency) = if yes { (slots, SCALE - slots) } else { (0, slots) };
        self.state = frequency * (self.state >> PRECISION) + slot - start;
        while self.state < LOW {
            let short = Error::short("chunk.bytes", self.len, 0, 1);
            let (&next, rest) = self.rest.split_first().ok_or(short)?;
            self.state = self.state << 8 | u32::from(next);
            self.rest = rest;
        }
        Ok(yes)
    }
}

/// Decodes `out.len()` symbols of `body`.
///
/// # Errors
/// [`ErrorKind::Short`] if bytes run out, [`ErrorKind::Illegal`] for a state out of range, a symbol beyond
/// 16 bits, a wrong end state, or bytes left over.
pub fn decode(body: &[u8], place: Place, out: &mut [i16]) -> Result<()> {
    let Some((state, rest)) = body.split_first_chunk::<STATE_BYTES>() else {
        return Err(Error::short("chunk.state", 0, body.len(), STATE_BYTES));
    };
    let state = u32::from_le_bytes(*state);
    if !(LOW..LOW << 8).contains(&state) {
        let allowed = (u64::from(LOW), u64::from((LOW << 8) - 1));
        return Err(Error::illegal("chunk.state", 0, u64::from(state), allowed));
    }
    let mut decoder = Decoder { state, rest, len: body.len() };
    walk(&mut decoder, place, out)?;
    if decoder.state != LOW {
        return Err(Error::illegal("chunk.state", 0, u64::from(decoder.state), (LOW.into(), LOW.into())));
    }
    if !decoder.rest.is_empty() {
        let left = decoder.rest.len();
        return Err(Error::illegal("chunk.bytes", body.len() - left, left as u64, (0, 0)));
    }
    Ok(())
}

/// One decision as an encoder needs it: where its slots start, and how many of 4096 it has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Decision {
    start: u16,
    slots: NonZero<u16>,
}

impl Decision {
    /// What the decision costs, bits.
    pub fn bits(self) -> f64 {
        libm::log2(f64::from(SCALE) / f64::from(self.slots.get()))
    }
}

/// Hands decisions to an encoder, each with the symbol that it belongs to.
struct Visitor<F> {
    index: usize,
    /// Whether `visit` wants no more.
    stopped: bool,
    visit: F,
}

impl<F: FnMut(usize, Decision) -> bool> Decisions for Visitor<F> {
    fn begin(&mut self, index: usize) {
        self.index = index;
    }

    fn pass(&mut self, slots: u32, yes: bool) -> Result<bool> {
        let (start, slots) = if yes { (slots, SCALE - slots) } else { (0, slots) };
        let stop = Error::illegal("encode.decision", 0, 0, (0, 0)).kind(ErrorKind::Capacity);
        let decision = Decision { start: start as u16, slots: NonZero::new(slots as u16).ok_or(stop)? };
        self.stopped = !(self.visit)(self.index, decision);
        if self.stopped { Err(stop) } else { Ok(yes) }
    }
}

/// Calls `visit` with the decisions that code `values` and the symbol that each belongs to, in the order of
/// a decoder, until it returns false. `values` stay as they are.
///
/// # Errors
/// A `place` that `values` do not fit.
pub fn decisions(values: &mut [i16], place: Place, visit: impl FnMut(usize, Decision) -> bool) -> Result<()> {
    let mut visitor = Visitor { index: 0, stopped: false, visit };
    let walked = walk(&mut visitor, place, values);
    if visitor.stopped { Ok(()) } else { walked }
}

/// Encodes `decisions` at the END of `out` and returns where the body starts.
///
/// # Errors
/// [`ErrorKind::Capacity`] if `out` is too small.
pub fn encode(decisions: impl DoubleEndedIterator<Item = Decision>, out: &mut [u8]) -> Result<usize> {
    let room = out.len();
    let full = Error::short("chunk", 0, room, room + 1).kind(ErrorKind::Capacity);
    let (mut at, mut state) = (room, LOW);
    for decision in decisions.rev() {
        let slots = NonZero::<u32>::from(decision.slots);
        while u64::from(state) >= u64::from(slots.get()) << (31 - PRECISION) {
            at = at.checked_sub(1).ok_or(full)?;
            *out.get_mut(at).ok_or(full)? = state as u8;
            state >>= 8;
        }
        state = ((state / slots) << PRECISION) + state % slots + u32::from(decision.start);
    }
    at = at.checked_sub(STATE_BYTES).ok_or(full)?;
    out.get_mut(at..at + STATE_BYTES).ok_or(full)?.copy_from_slice(&state.to_le_bytes());
    Ok(at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    extern crate std;
    use std::{vec, vec::Vec};

    fn encoded(values: &[i16], place: Place) -> Vec<u8> {
        let mut all = Vec::new();
        decisions(&mut values.to_vec(), place, |_, decision| {
            all.push(decision);
            true
        })
        .unwrap();
        let mut out = vec![0u8; values.len() * 5 + 16];
        let at = encode(all.into_iter(), &mut out).unwrap();
        out.split_off(at)
    }

    const FORTY: NonZero<usize> = NonZero::new(40).unwrap();
    const PLACE: Place = Place { level: Level::BASE, first: 0, gaussians: FORTY, rank: 2, frames: 3 };

    proptest! {
        #[test]
        fn round_trip_and_damage(
            values in proptest::collection::vec(any::<(i16, u8)>(), 0..if cfg!(miri) { 12 } else { 600 }),
            level in 0u8..4, first in 0usize..5000, gaussians in 1usize..300, flip: usize,
        ) {
            let values: Vec<i16> = values.into_iter().map(|(v, shift)| v >> (shift % 16)).collect();
            let gaussians = NonZero::new(gaussians).unwrap();
            let place = Place { level: Level::from_bits(level), first, gaussians, rank: 4, frames: 9 };
            let mut body = encoded(&values, place);
            let mut back = vec![0i16; values.len()];
            decode(&body, place, &mut back).unwrap();
            prop_assert_eq!(&back, &values);
            let flip = flip % (body.len() * 8);
            body[flip / 8] ^= 1 << (flip % 8);
            prop_assert!(decode(&body, place, &mut back).is_err() || back != values);
        }
    }

    #[test]
    fn extremes_come_back() {
        let values = [i16::MIN, i16::MAX, 0, 1, -1, i16::MIN, -32_767];
        let mut back = [0i16; 7];
        decode(&encoded(&values, PLACE), PLACE, &mut back).unwrap();
        assert_eq!(back, values);
    }

    #[test]
    fn probabilities_follow_what_they_see() {
        let still = encoded(&[0; 20_000], PLACE);
        assert!(still.len() < 120, "{} bytes for nothing", still.len());
        // Calm and lively Gaussians side by side: the component before tells them apart.
        let varied: Vec<i16> = (0..12_000i32)
            .map(|i| if (i % 40) * 7919 % 3 == 0 { (((i * 7919) >> 3) % 256 - 128) as i16 } else { 0 })
            .collect();
        let place = Place { level: Level::from_bits(2), ..PLACE };
        let shuffled = Place { gaussians: NonZero::new(7).unwrap(), ..place };
        assert!(encoded(&varied, place).len() < encoded(&varied, shuffled).len());
    }

    #[test]
    fn a_full_buffer_and_a_cut_body_are_refused() {
        let body = encoded(&[5; 100], PLACE);
        let mut back = [0i16; 100];
        for len in 0..body.len() {
            let error = decode(body.get(..len).unwrap(), PLACE, &mut back).unwrap_err();
            assert!(matches!(error.kind, ErrorKind::Short | ErrorKind::Illegal), "{len}: {error:?}");
        }
        let all = vec![Decision { start: 0, slots: NonZero::new(1).unwrap() }; 9];
        assert_eq!(encode(all.into_iter(), &mut [0; 8]).unwrap_err().kind, ErrorKind::Capacity);
    }
}
