//! Two C coders that `zstd` is built from, with one table for all packets: FSE (tANS) and Huff0.
//!
//! `zstd` has no public way to them, but its static library does not hide them from a program that
//! links it. The declarations are those of its `fse.h` and `huf.h`, sizes of tables and scratch too;
//! the library's version of FSE is checked, and every round trip.
#![expect(unsafe_code, reason = "functions of a C library")]

use std::ffi::{c_int, c_uint};

use anyhow::{Context, Result, ensure};
use zstd_sys as _;

use super::{
    coders::{Arena, Coder, Output},
    law::Packets,
};

// SAFETY: as the library declares them.
unsafe extern "C" {
    fn FSE_versionNumber() -> c_uint;
    fn FSE_isError(code: usize) -> c_uint;
    fn FSE_buildCTable_wksp(
        table: *mut u32,
        norm: *const i16,
        max_symbol: c_uint,
        log: c_uint,
        scratch: *mut u64,
        scratch_bytes: usize,
    ) -> usize;
    fn FSE_writeNCount(to: *mut u8, room: usize, norm: *const i16, max_symbol: c_uint, log: c_uint) -> usize;
    fn FSE_compress_usingCTable(
        to: *mut u8,
        room: usize,
        from: *const u8,
        len: usize,
        table: *const u32,
    ) -> usize;
    fn FSE_decompress_wksp_bmi2(
        to: *mut u8,
        room: usize,
        from: *const u8,
        len: usize,
        most_log: c_uint,
        scratch: *mut u64,
        scratch_bytes: usize,
        bmi2: c_int,
    ) -> usize;
    fn HUF_isError(code: usize) -> c_uint;
    fn HUF_buildCTable_wksp(
        table: *mut usize,
        count: *const c_uint,
        max_symbol: c_uint,
        most_bits: c_uint,
        scratch: *mut u64,
        scratch_bytes: usize,
    ) -> usize;
    fn HUF_writeCTable_wksp(
        to: *mut u8,
        room: usize,
        table: *const usize,
        max_symbol: c_uint,
        log: c_uint,
        scratch: *mut u64,
        scratch_bytes: usize,
    ) -> usize;
    fn HUF_compress4X_usingCTable(
        to: *mut u8,
        room: usize,
        from: *const u8,
        len: usize,
        table: *const usize,
        flags: c_int,
    ) -> usize;
    fn HUF_readDTableX2_wksp(
        table: *mut u32,
        from: *const u8,
        len: usize,
        scratch: *mut u64,
        scratch_bytes: usize,
        flags: c_int,
    ) -> usize;
    fn HUF_decompress4X_usingDTable(
        to: *mut u8,
        room: usize,
        from: *const u8,
        len: usize,
        table: *const u32,
        flags: c_int,
    ) -> usize;
}

/// Version of FSE whose declarations these are: 0.9.0.
const FSE_VERSION: u32 = 900;
/// Bits of FSE's probabilities: the most that the library is built for.
const FSE_LOG: u32 = 12;
/// Bits of Huff0's longest code, as `zstd` uses it.
const HUFF_LOG: u32 = 11;
/// Largest log of a Huff0 table.
const HUFF_MOST_LOG: u32 = 12;
/// Tokens.
const SYMBOLS: usize = 256;
/// `FSE_CTABLE_SIZE_U32`, and one more.
const FSE_ENCODE: usize = 2 + (1 << (FSE_LOG - 1)) + 2 * SYMBOLS;
/// `FSE_DTABLE_SIZE_U32`, in the scratch of the decoder.
const FSE_DECODE: usize = 1 + (1 << FSE_LOG);
/// Tokens of a packet that is decoded for its table: next to none.
const FEW: usize = 8;
/// `HUF_CTABLE_SIZE_ST`.
const HUFF_ENCODE: usize = SYMBOLS + 1;
/// `HUF_DTABLE_SIZE`.
const HUFF_DECODE: usize = 1 + (1 << HUFF_MOST_LOG);
/// Scratch, words of 8 bytes: more than any of `FSE_BUILD_CTABLE_WORKSPACE_SIZE`,
/// `FSE_DECOMPRESS_WKSP_SIZE` and `HUF_WORKSPACE_SIZE` at these logs, the second being the largest.
const SCRATCH: usize = (4 * FSE_DECODE + 4 * SYMBOLS + (1 << FSE_LOG) + 1024) / 8;
/// Bytes of a table's header, at most: `FSE_NCOUNTBOUND`, `HUF_CTABLEBOUND`.
const HEADER: usize = 512;

/// Both coders of one law's tokens.
pub fn both(packets: &Packets) -> Result<Vec<Box<dyn Coder>>> {
    Ok(vec![Box::new(Fse::new(packets)?), Box::new(Huff0::new(packets)?)])
}

/// 1 if this machine has BMI2, as the library's flags want it.
fn bmi2() -> c_int {
    #[cfg(target_arch = "x86_64")]
    return is_x86_feature_detected!("bmi2").into();
    #[cfg(not(target_arch = "x86_64"))]
    0
}

/// A result of FSE, if it is none of its errors.
fn fse(result: usize, what: &str) -> Result<usize> {
    // SAFETY: a function of a number.
    ensure!(unsafe { FSE_isError(result) } == 0, "FSE, {what}: error {}", result.wrapping_neg());
    Ok(result)
}

/// A result of Huff0, if it is none of its errors.
fn huff0(result: usize, what: &str) -> Result<usize> {
    // SAFETY: a function of a number.
    ensure!(unsafe { HUF_isError(result) } == 0, "Huff0, {what}: error {}", result.wrapping_neg());
    Ok(result)
}

/// The last token that occurs.
fn last(frequencies: &[u32; SYMBOLS]) -> Result<u32> {
    Ok(frequencies.iter().rposition(|&f| f > 0).context("a law without tokens")? as u32)
}

/// A packet's bytes: room for what either coder may write at once.
struct Room(Vec<u8>);

impl Room {
    /// For packets of `len` tokens: `FSE_BLOCKBOUND` and `HUF_BLOCKBOUND` are less.
    fn new(len: usize) -> Self {
        Self(vec![0; len + len / 64 + 64])
    }

    /// Encodes all packets by `encode`, each here and then into its room.
    fn fill(
        &mut self,
        packets: &Packets,
        arena: &mut Arena,
        encode: impl Fn(&mut [u8], &[u8]) -> Result<usize>,
    ) -> Result<bool> {
        for (tokens, (room, place)) in packets.tokens.chunks_exact(packets.len).zip(arena.rooms()) {
            let len = encode(&mut self.0, tokens)?;
            ensure!(len > 0 && len <= room.len(), "{} tokens take {len} bytes", tokens.len());
            room[..len].copy_from_slice(&self.0[..len]);
            *place = (0, len);
        }
        Ok(true)
    }
}

/// FSE: two states in turn, 12 bits.
///
/// Its one exported decoder takes a table's header in front of every packet and builds the table
/// anew. How long that takes, the same decoder says of a packet of [`FEW`] tokens.
struct Fse {
    encode: Vec<u32>,
    /// Bytes of a table's header.
    header: usize,
    /// A header and a packet behind it.
    input: Vec<u8>,
    /// The same, the packet of few tokens.
    few: Vec<u8>,
    scratch: Vec<u64>,
    room: Room,
}

impl Fse {
    fn new(packets: &Packets) -> Result<Self> {
        // SAFETY: a constant.
        let version = unsafe { FSE_versionNumber() };
        ensure!(version == FSE_VERSION, "FSE is of version {version}; {FSE_VERSION} is known");
        let frequencies = packets.frequencies(FSE_LOG);
        let norm = frequencies.map(|f| f as i16);
        let last = last(&frequencies)?;
        let (mut encode, mut scratch) = (vec![0u32; FSE_ENCODE], vec![0u64; SCRATCH]);
        let mut header = vec![0u8; HEADER];
        // SAFETY: a probability for each of 256 tokens, which add up to `1 << FSE_LOG`; the table, the
        // scratch and the header are as large as the library says, and it is told how large.
        let len = unsafe {
            let built = FSE_buildCTable_wksp(
                encode.as_mut_ptr(),
                norm.as_ptr(),
                last,
                FSE_LOG,
                scratch.as_mut_ptr(),
                8 * scratch.len(),
            );
            fse(built, "table")?;
            FSE_writeNCount(header.as_mut_ptr(), header.len(), norm.as_ptr(), last, FSE_LOG)
        };
        header.truncate(fse(len, "header")?);
        let mut room = Room::new(packets.len);
        let tokens = packets.tokens.get(..FEW).context("packets of hardly a token")?;
        let len = Self::put(&encode, &mut room.0, tokens)?;
        let few = [&header, &room.0[..len]].concat();
        Ok(Self { encode, header: header.len(), input: header, few, scratch, room })
    }

    /// Encodes `tokens` to the front of `room`; how many bytes that takes.
    fn put(table: &[u32], room: &mut [u8], tokens: &[u8]) -> Result<usize> {
        // SAFETY: slices with their lengths; the table is this library's and has every token.
        let len = unsafe {
            FSE_compress_usingCTable(
                room.as_mut_ptr(),
                room.len(),
                tokens.as_ptr(),
                tokens.len(),
                table.as_ptr(),
            )
        };
        fse(len, "encode")
    }

    /// Decodes a header and a packet of as many tokens.
    fn get(scratch: &mut [u64], input: &[u8], tokens: &mut [u8], bmi2: c_int) -> Result<()> {
        // SAFETY: slices with their lengths.
        let len = unsafe {
            FSE_decompress_wksp_bmi2(
                tokens.as_mut_ptr(),
                tokens.len(),
                input.as_ptr(),
                input.len(),
                FSE_LOG,
                scratch.as_mut_ptr(),
                8 * scratch.len(),
                bmi2,
            )
        };
        let len = fse(len, "decode")?;
        ensure!(len == tokens.len(), "FSE gives {len} of {} tokens", tokens.len());
        Ok(())
    }
}

impl Coder for Fse {
    fn name(&self) -> String {
        "fse-c".into()
    }

    fn whole(&self) -> bool {
        false
    }

    fn rust(&self) -> bool {
        false
    }

    fn encode(&mut self, packets: &Packets, arena: &mut Arena) -> Result<bool> {
        let table = &self.encode;
        self.room.fill(packets, arena, |room, tokens| Self::put(table, room, tokens))
    }

    fn decode(&mut self, packets: &Packets, bodies: &[&[u8]], out: &mut Output) -> Result<()> {
        let bmi2 = bmi2();
        for (body, tokens) in bodies.iter().copied().zip(out.tokens.chunks_exact_mut(packets.len)) {
            self.input.truncate(self.header);
            self.input.extend_from_slice(body);
            Self::get(&mut self.scratch, &self.input, tokens, bmi2)?;
        }
        Ok(())
    }

    fn tables(&mut self, bodies: &[&[u8]]) -> Result<()> {
        let bmi2 = bmi2();
        bodies.iter().try_for_each(|_| Self::get(&mut self.scratch, &self.few, &mut [0; FEW], bmi2))
    }
}

/// Huff0: four streams, one or two tokens per look-up.
struct Huff0 {
    encode: Vec<usize>,
    decode: Vec<u32>,
    room: Room,
}

impl Huff0 {
    fn new(packets: &Packets) -> Result<Self> {
        let frequencies = packets.frequencies(20);
        let last = last(&frequencies)?;
        let (mut encode, mut scratch) = (vec![0usize; HUFF_ENCODE], vec![0u64; SCRATCH]);
        let mut decode = vec![0u32; HUFF_DECODE];
        // `HUF_CREATE_STATIC_DTABLEX2`.
        decode[0] = HUFF_MOST_LOG * 0x0100_0001;
        let mut header = [0u8; HEADER];
        // SAFETY: a count for each of 256 tokens; tables, scratch and header are as large as the library
        // says, and it is told how large.
        unsafe {
            let (place, bytes) = (scratch.as_mut_ptr(), 8 * scratch.len());
            let counts = frequencies.as_ptr();
            let log = HUF_buildCTable_wksp(encode.as_mut_ptr(), counts, last, HUFF_LOG, place, bytes);
            let log = huff0(log, "table")? as c_uint;
            let table = encode.as_ptr();
            let len = HUF_writeCTable_wksp(header.as_mut_ptr(), header.len(), table, last, log, place, bytes);
            let len = huff0(len, "header")?.min(header.len());
            let read = HUF_readDTableX2_wksp(decode.as_mut_ptr(), header.as_ptr(), len, place, bytes, bmi2());
            huff0(read, "decode table")?;
        }
        Ok(Self { encode, decode, room: Room::new(packets.len) })
    }
}

impl Coder for Huff0 {
    fn name(&self) -> String {
        "huff0-4x2-c".into()
    }

    fn whole(&self) -> bool {
        false
    }

    fn rust(&self) -> bool {
        false
    }

    fn encode(&mut self, packets: &Packets, arena: &mut Arena) -> Result<bool> {
        let (table, bmi2) = (&self.encode, bmi2());
        self.room.fill(packets, arena, |room, tokens| {
            // SAFETY: slices with their lengths; the table is this library's and has every token.
            let len = unsafe {
                HUF_compress4X_usingCTable(
                    room.as_mut_ptr(),
                    room.len(),
                    tokens.as_ptr(),
                    tokens.len(),
                    table.as_ptr(),
                    bmi2,
                )
            };
            huff0(len, "encode")
        })
    }

    fn decode(&mut self, packets: &Packets, bodies: &[&[u8]], out: &mut Output) -> Result<()> {
        let bmi2 = bmi2();
        for (body, tokens) in bodies.iter().copied().zip(out.tokens.chunks_exact_mut(packets.len)) {
            // SAFETY: slices with their lengths; the table is this library's.
            let len = unsafe {
                HUF_decompress4X_usingDTable(
                    tokens.as_mut_ptr(),
                    tokens.len(),
                    body.as_ptr(),
                    body.len(),
                    self.decode.as_ptr(),
                    bmi2,
                )
            };
            let len = huff0(len, "decode")?;
            ensure!(len == tokens.len(), "Huff0 gives {len} of {} tokens", tokens.len());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::{super::law::Law, *};

    #[test]
    fn tokens_come_back_and_damage_is_seen() {
        for law in Law::all() {
            let packets = Packets::draw(law, 3, 400, 7).unwrap();
            for mut coder in both(&packets).unwrap() {
                let mut arena = Arena::new(packets.count);
                assert!(coder.encode(&packets, &mut arena).unwrap());
                let mut out = Output { values: Vec::new(), tokens: vec![0; packets.tokens.len()] };
                let bodies: Vec<&[u8]> = arena.packets().collect();
                coder.decode(&packets, &bodies, &mut out).unwrap();
                assert!(out.tokens == packets.tokens, "{} {}", coder.name(), packets.law.name);
                coder.tables(&bodies).unwrap();
                let mut damaged = bodies[1].to_vec();
                damaged[bodies[1].len() / 2] ^= 0x24;
                let bodies = [bodies[0], &damaged, bodies[2]];
                let decoded = coder.decode(&packets, &bodies, &mut out);
                assert!(decoded.is_err() || out.tokens != packets.tokens, "{}", coder.name());
            }
        }
    }
}
