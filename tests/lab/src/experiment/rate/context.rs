//! Codes by uniform quantisation and context-adaptive rANS: a peer. No tables travel: every model starts flat
//! and follows what it has seen.
//!
//! A residual is the bit length of its magnitude, its sign, its two bits after the leading one, and what is
//! left as it is. The context of the length is the attribute, the kind of frame, the length of the Gaussian
//! before it in the same frame, and that of the same Gaussian in the frame before; the sign's are the signs
//! of those two. The whole clip is one stream: the adaptive coder is not charged for packets or for
//! starting anew, so this is what such a coder reaches at best, without tolerance to loss.

use anyhow::{Result, ensure};
use trainer_host::{Scene, encode::QuantiserSteps};

use super::{
    coded::{Coded, Timer},
    lattice::{self, ATTRIBUTES, Grids, HEADER_BYTES},
    rans::{self, Decoder, Port, Sink},
};

/// log2 of the scale of every model.
const BITS: u32 = 15;
/// Lengths: 0 to 14, and one for all that is longer, which travels as 32 raw bits.
const LENGTHS: usize = 16;
const ESCAPE: u32 = LENGTHS as u32 - 1;
/// Lengths told apart as context.
const SEEN: usize = 10;

/// Codes `scene` with the default steps times `coarseness`.
pub fn code(scene: &Scene, coarseness: f32, _: i32, shown: &[u32]) -> Result<Coded> {
    let timer = Timer::start();
    let grids = lattice::grids(scene, &QuantiserSteps::default().scaled(coarseness));
    let mut residuals = grids.clone();
    let mut how = Vec::new();
    let mut models = Models::new();
    let mut streams = Vec::new();
    for epoch in &mut residuals {
        for plane in &mut epoch.planes {
            how.push(plane.predict(epoch.count));
            let mut sink = Sink::default();
            models.walk(&mut sink, plane.attribute, epoch.count, &mut plane.values)?;
            streams.push(rans::encode(&sink.0));
        }
    }
    let bytes = HEADER_BYTES * grids.len() + streams.iter().map(|s| 5 + s.len()).sum::<usize>();
    let encode_s = timer.seconds();

    let timer = Timer::start();
    let mut back: Vec<Grids> = grids.iter().map(Grids::emptied).collect();
    let mut models = Models::new();
    let mut parts = streams.iter().zip(how);
    for epoch in &mut back {
        for plane in &mut epoch.planes {
            let Some((stream, how)) = parts.next() else { break };
            let mut decoder = Decoder::new(stream)?;
            models.walk(&mut decoder, plane.attribute, epoch.count, &mut plane.values)?;
            decoder.finish()?;
            plane.restore(epoch.count, how);
        }
    }
    lattice::reconstruct_all(&back);
    let decode_s = timer.seconds();
    ensure!(back == grids, "what was decoded is not what was coded");
    Ok(Coded { bytes, encode_s, decode_s, shown: lattice::instants(scene, &back, shown)? })
}

/// An adaptive distribution of `N` symbols: the mean of a quick and a slow follower.
///
/// Each symbol keeps [`LEAST`] slots; the rest of the scale follows what is seen.
#[derive(Clone)]
struct Adaptive<const N: usize> {
    /// Starts of the symbols within what follows, and its end. Invariant: rising, not strictly.
    quick: [u16; LENGTHS + 1],
    slow: [u16; LENGTHS + 1],
    seen: u32,
}

/// Slots that no symbol loses.
const LEAST: u32 = 4;

impl<const N: usize> Adaptive<N> {
    const MOVING: i32 = (1 << BITS) - LEAST as i32 * N as i32;

    fn new() -> Self {
        let flat = std::array::from_fn(|i| (i.min(N) * Self::MOVING as usize / N) as u16);
        Self { quick: flat, slow: flat, seen: 0 }
    }

    fn start(&self, symbol: usize) -> u32 {
        (u32::from(self.quick[symbol]) + u32::from(self.slow[symbol])) / 2 + LEAST * symbol as u32
    }

    fn pass<P: Port>(&mut self, port: &mut P, symbol: u32) -> Result<u32> {
        let interval = |s: u32| {
            let start = self.start(s as usize);
            (start, self.start(s as usize + 1) - start)
        };
        let find = |slot: u32| (1..N).take_while(|&s| self.start(s) <= slot).count() as u32;
        let symbol = port.pass(BITS, symbol, interval, find)?;
        // The first few are learned from faster.
        let quick = 2 + (self.seen / 6).min(3);
        let slow = 2 + (self.seen / 8).min(6);
        for (cdf, rate) in [(&mut self.quick, quick), (&mut self.slow, slow)] {
            for (i, boundary) in cdf.iter_mut().enumerate().take(N).skip(1) {
                let target = if i as u32 > symbol { Self::MOVING } else { 0 };
                let now = i32::from(*boundary);
                *boundary = (now + ((target - now) >> rate)) as u16;
            }
        }
        self.seen = (self.seen + 1).min(64);
        Ok(symbol)
    }
}

struct Models {
    length: Vec<Adaptive<LENGTHS>>,
    sign: Vec<Adaptive<2>>,
    mantissa: Vec<Adaptive<4>>,
}

impl Models {
    fn new() -> Self {
        let kinds = 2 * ATTRIBUTES;
        Self {
            length: vec![Adaptive::new(); kinds * SEEN * SEEN],
            sign: vec![Adaptive::new(); kinds * 9],
            mantissa: vec![Adaptive::new(); kinds * LENGTHS],
        }
    }

    fn walk<P: Port>(
        &mut self,
        port: &mut P,
        attribute: usize,
        count: usize,
        values: &mut [i32],
    ) -> Result<()> {
        for i in 0..values.len() {
            let kind = 2 * attribute + usize::from(i >= count);
            let beside = if i % count == 0 { 0 } else { values[i - 1] };
            let before = if i < count { 0 } else { values[i - count] };
            values[i] = self.pass(port, kind, beside, before, values[i])?;
        }
        Ok(())
    }

    fn pass<P: Port>(
        &mut self,
        port: &mut P,
        kind: usize,
        beside: i32,
        before: i32,
        value: i32,
    ) -> Result<i32> {
        let seen = |v: i32| (length(v) as usize).min(SEEN - 1);
        let context = (kind * SEEN + seen(beside)) * SEEN + seen(before);
        let length = self.length[context].pass(port, length(value).min(ESCAPE))?;
        if length == ESCAPE {
            return Ok(port.raw(32, value as u32)? as i32);
        }
        if length == 0 {
            return Ok(0);
        }
        let sign = |v: i32| (v.signum() + 1) as usize;
        let context = kind * 9 + 3 * sign(beside) + sign(before);
        let negative = self.sign[context].pass(port, u32::from(value < 0))?;
        // Below the leading one: two bits modelled (one if there is only one), the rest raw.
        let magnitude = value.unsigned_abs();
        let tail = length - 1;
        let modelled = tail.min(2);
        let mut found = 1u32;
        if modelled > 0 {
            let part = (magnitude >> (tail - modelled)) & ((1 << modelled) - 1);
            let model = &mut self.mantissa[kind * LENGTHS + length as usize];
            found = found << modelled | model.pass(port, part)? & ((1 << modelled) - 1);
        }
        let raw = tail - modelled;
        if raw > 0 {
            found = found << raw | port.raw(raw, magnitude & ((1 << raw) - 1))?;
        }
        Ok(if negative == 1 { -(found as i32) } else { found as i32 })
    }
}

/// Bits of the magnitude of `v`.
fn length(v: i32) -> u32 {
    32 - v.unsigned_abs().leading_zeros()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn coded(values: &[i32], count: usize) -> Vec<u8> {
        let mut sink = Sink::default();
        Models::new().walk(&mut sink, 0, count, &mut values.to_vec()).unwrap();
        rans::encode(&sink.0)
    }

    #[test]
    fn any_value_comes_back() {
        let values: Vec<i32> = (0..5000i32)
            .map(|i| match i % 97 {
                0 => i32::MIN + i,
                1 => i32::MAX,
                2 => 16_383,
                3 => -16_384,
                k => ((i * 7919) >> (k % 20)) % (1 << (k % 14)) - 3,
            })
            .collect();
        let bytes = coded(&values, 500);
        let mut decoder = Decoder::new(&bytes).unwrap();
        let mut back = vec![0; values.len()];
        Models::new().walk(&mut decoder, 0, 500, &mut back).unwrap();
        decoder.finish().unwrap();
        assert_eq!(back, values);
    }

    #[test]
    fn models_follow_what_they_see() {
        let still = coded(&[0; 20_000], 1000);
        assert!(still.len() < 60, "{} bytes for nothing", still.len());
        // Calm and lively Gaussians side by side: the frame before tells them apart.
        let side_by_side: Vec<i32> = (0..20_000i32)
            .map(|i| if (i % 1000) * 7919 % 3 == 0 { ((i * 7919) >> 3) % 256 - 128 } else { 0 })
            .collect();
        let lively = side_by_side.iter().filter(|v| **v != 0).count() as f64;
        let bits = 8.0 * coded(&side_by_side, 1000).len() as f64 / lively;
        assert!(bits < 9.2, "{bits} bits per lively value of 8 bits");
    }
}
