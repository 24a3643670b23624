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
    fn FSE_readNCount_bmi2(
        norm: *mut i16,
        max_symbol: *mut c_uint,
        log: *mut c_uint,
        from: *const u8,
        len: usize,
        bmi2: c_int,
    ) -> usize;
    fn FSE_buildDTable_wksp(
        table: *mut u32,
        norm: *const i16,
        max_symbol: c_uint,
        log: c_uint,
        scratch: *mut u64,
        scratch_bytes: usize,
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
/// `FSE_DTABLE_SIZE_U32`.
const FSE_DECODE: usize = 1 + (1 << FSE_LOG);
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
/// anew; [`Coder::tables`] does that alone.
struct Fse {
    encode: Vec<u32>,
    decode: Vec<u32>,
    header: Vec<u8>,
    /// A header and a packet behind it.
    input: Vec<u8>,
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
        let decode = vec![0; FSE_DECODE];
        Ok(Self { encode, decode, input: header.clone(), header, scratch, room: Room::new(packets.len) })
    }

    /// The header and `body` in one piece.
    fn joined(&mut self, body: &[u8]) {
        self.input.truncate(self.header.len());
        self.input.extend_from_slice(body);
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
        self.room.fill(packets, arena, |room, tokens| {
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
        })
    }

    fn decode(&mut self, packets: &Packets, bodies: &[&[u8]], out: &mut Output) -> Result<()> {
        let bmi2 = bmi2();
        for (body, tokens) in bodies.iter().copied().zip(out.tokens.chunks_exact_mut(packets.len)) {
            self.joined(body);
            // SAFETY: slices with their lengths.
            let len = unsafe {
                FSE_decompress_wksp_bmi2(
                    tokens.as_mut_ptr(),
                    tokens.len(),
                    self.input.as_ptr(),
                    self.input.len(),
                    FSE_LOG,
                    self.scratch.as_mut_ptr(),
                    8 * self.scratch.len(),
                    bmi2,
                )
            };
            let len = fse(len, "decode")?;
            ensure!(len == tokens.len(), "FSE gives {len} of {} tokens", tokens.len());
        }
        Ok(())
    }

    fn tables(&mut self, bodies: &[&[u8]]) -> Result<()> {
        let bmi2 = bmi2();
        for body in bodies {
            self.joined(body);
            let mut norm = [0i16; SYMBOLS];
            let (mut last, mut log) = (SYMBOLS as c_uint - 1, 0);
            // SAFETY: slices with their lengths; `norm` has a place for every token up to `last`, and
            // the table is as large as the library says for `FSE_LOG`, which is the header's log.
            unsafe {
                let (input, len) = (self.input.as_ptr(), self.input.len());
                fse(FSE_readNCount_bmi2(norm.as_mut_ptr(), &mut last, &mut log, input, len, bmi2), "header")?;
                ensure!(log == FSE_LOG, "FSE reads a table of {log} bits");
                let built = FSE_buildDTable_wksp(
                    self.decode.as_mut_ptr(),
                    norm.as_ptr(),
                    last,
                    log,
                    self.scratch.as_mut_ptr(),
                    8 * self.scratch.len(),
                );
                fse(built, "table")?;
            }
        }
        Ok(())
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
