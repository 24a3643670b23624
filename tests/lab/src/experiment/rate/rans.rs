//! Codes with one rANS state over intervals of any power-of-two scale: the coder under the order-0 and the
//! adaptive peer. 64-bit state, 32-bit words, no lanes and no packets: as small as a coder of its kind gets,
//! so that the peers are not charged for what only `dgs1` needs.

use anyhow::{Result, ensure};

const LOW: u64 = 1 << 31;

/// What a symbol takes of the scale: `start..start + frequency` of `1 << bits`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interval {
    /// First slot.
    pub start: u32,
    /// Number of slots, at least 1.
    pub frequency: u32,
    /// log2 of the scale, at most 16.
    pub bits: u32,
}

/// The bytes in which [`Decoder`] finds `intervals`, in order.
pub fn encode(intervals: &[Interval]) -> Vec<u8> {
    let mut state = LOW;
    let mut words: Vec<u32> = Vec::new();
    for i in intervals.iter().rev() {
        let f = u64::from(i.frequency);
        if state >= f << (63 - i.bits) {
            words.push(state as u32);
            state >>= 32;
        }
        state = ((state / f) << i.bits) + state % f + u64::from(i.start);
    }
    words.extend([state as u32, (state >> 32) as u32]);
    words.iter().rev().flat_map(|w| w.to_le_bytes()).collect()
}

/// Reads what [`encode`] wrote.
#[derive(Debug)]
pub struct Decoder<'b> {
    state: u64,
    rest: &'b [u8],
}

impl<'b> Decoder<'b> {
    /// A decoder of `bytes`.
    ///
    /// # Errors
    /// Fewer than the eight bytes of a state.
    pub fn new(bytes: &'b [u8]) -> Result<Self> {
        let mut decoder = Self { state: 0, rest: bytes };
        decoder.state = decoder.word()? << 32;
        decoder.state |= decoder.word()?;
        Ok(decoder)
    }

    fn word(&mut self) -> Result<u64> {
        let Some((head, tail)) = self.rest.split_first_chunk::<4>() else {
            anyhow::bail!("the rANS stream ends early");
        };
        self.rest = tail;
        Ok(u64::from(u32::from_le_bytes(*head)))
    }

    /// The slot, of `1 << bits`, that the next symbol's interval holds.
    pub fn slot(&self, bits: u32) -> u32 {
        (self.state & ((1 << bits) - 1)) as u32
    }

    /// Moves past a symbol whose interval holds [`Decoder::slot`].
    ///
    /// # Errors
    /// If the stream ends early.
    pub fn pass(&mut self, i: Interval) -> Result<()> {
        let slot = u64::from(self.slot(i.bits));
        self.state = u64::from(i.frequency) * (self.state >> i.bits) + slot - u64::from(i.start);
        if self.state < LOW {
            self.state = self.state << 32 | self.word()?;
        }
        Ok(())
    }

    /// Accepts a stream that is used up and ends where encoding began.
    ///
    /// # Errors
    /// Anything else.
    pub fn finish(self) -> Result<()> {
        ensure!(self.state == LOW && self.rest.is_empty(), "the rANS stream does not end where it should");
        Ok(())
    }
}

/// Either end of a stream: a walk over symbols written once serves both.
pub trait Port {
    /// Passes one symbol: the encoder takes `symbol` and returns it, the decoder ignores it and returns the
    /// one it finds. `interval` gives a symbol's interval, `find` the symbol of a slot.
    ///
    /// # Errors
    /// A stream that ends early.
    fn pass(
        &mut self,
        bits: u32,
        symbol: u32,
        interval: impl Fn(u32) -> (u32, u32),
        find: impl Fn(u32) -> u32,
    ) -> Result<u32>;

    /// Passes the lowest `count` bits of `value` as they are; `count` is at most 32.
    ///
    /// # Errors
    /// As [`Port::pass`].
    fn raw(&mut self, count: u32, value: u32) -> Result<u32> {
        let mut out = 0;
        let mut at = 0;
        while at < count {
            let bits = (count - at).min(16);
            let part = (value >> at) & ((1 << bits) - 1);
            out |= self.pass(bits, part, |s| (s, 1), |slot| slot)? << at;
            at += bits;
        }
        Ok(out)
    }
}

/// The encoding end: what was passed, in order.
#[derive(Clone, Debug, Default)]
pub struct Sink(pub Vec<Interval>);

impl Port for Sink {
    fn pass(
        &mut self,
        bits: u32,
        symbol: u32,
        interval: impl Fn(u32) -> (u32, u32),
        _: impl Fn(u32) -> u32,
    ) -> Result<u32> {
        let (start, frequency) = interval(symbol);
        self.0.push(Interval { start, frequency, bits });
        Ok(symbol)
    }
}

impl Port for Decoder<'_> {
    fn pass(
        &mut self,
        bits: u32,
        _: u32,
        interval: impl Fn(u32) -> (u32, u32),
        find: impl Fn(u32) -> u32,
    ) -> Result<u32> {
        let symbol = find(self.slot(bits));
        let (start, frequency) = interval(symbol);
        self.pass(Interval { start, frequency, bits })?;
        Ok(symbol)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Symbols 0, 1, 2 at 5/8, 2/8, 1/8.
    const SKEWED: [(u32, u32); 3] = [(0, 5), (5, 2), (7, 1)];

    fn walk<P: Port>(port: &mut P, symbols: &mut [u32]) -> Result<()> {
        for (i, symbol) in symbols.iter_mut().enumerate() {
            *symbol = if i % 7 == 6 {
                port.raw(27, *symbol)?
            } else {
                port.pass(3, *symbol, |s| SKEWED[s as usize], |slot| (slot >= 5) as u32 + (slot >= 7) as u32)?
            };
        }
        Ok(())
    }

    #[test]
    fn what_goes_in_comes_out_and_costs_its_entropy() {
        let mut symbols: Vec<u32> =
            (0..7000u32).map(|i| [0, 1, 0, 2, 0, 0, i * 7919 % (1 << 27)][i as usize % 7]).collect();
        let mut sink = Sink::default();
        walk(&mut sink, &mut symbols).unwrap();
        let bytes = encode(&sink.0);
        let bits = 1000.0 * (27.0 + 4.0 * 1.6f64.log2() + 2.0 + 3.0);
        assert!((bytes.len() as f64 - bits / 8.0).abs() < 12.0, "{} against {}", bytes.len(), bits / 8.0);
        let mut back = vec![0; symbols.len()];
        let mut decoder = Decoder::new(&bytes).unwrap();
        walk(&mut decoder, &mut back).unwrap();
        decoder.finish().unwrap();
        assert_eq!(back, symbols);
    }

    #[test]
    fn short_and_long_streams_are_refused() {
        let mut symbols = vec![1u32; 700];
        let mut sink = Sink::default();
        walk(&mut sink, &mut symbols).unwrap();
        let bytes = encode(&sink.0);
        let decode = |bytes: &[u8]| {
            let mut decoder = Decoder::new(bytes)?;
            walk(&mut decoder, &mut vec![0; 700])?;
            decoder.finish()
        };
        decode(&bytes).unwrap();
        assert!(decode(&bytes[..bytes.len() - 4]).is_err());
        assert!(decode(&[bytes.clone(), vec![0; 4]].concat()).is_err());
    }
}
