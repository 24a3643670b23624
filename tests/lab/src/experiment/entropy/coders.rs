//! Presents the coders of this repository to the bench.

use anyhow::Result;
use codec_core::internals::rans::{
    lanes::{self, Compact, Decoder, Symbols, TableRun, naive},
    table::{SLOTS, Table},
};
use codec_simd::{Job, Kernel, Tables, decode_many_with};

use super::law::{PACKET_ROOM, Packets};

/// Packets as bytes: each with its own room.
pub struct Arena {
    pub bytes: Vec<u8>,
    /// Start and length of each packet in its room.
    pub place: Vec<(usize, usize)>,
}

impl Arena {
    pub fn new(count: usize) -> Self {
        Self { bytes: vec![0; count * PACKET_ROOM], place: vec![(0, 0); count] }
    }

    pub fn rooms(&mut self) -> impl Iterator<Item = (&mut [u8], &mut (usize, usize))> {
        self.bytes.chunks_exact_mut(PACKET_ROOM).zip(&mut self.place)
    }

    pub fn packets(&self) -> impl Iterator<Item = &[u8]> {
        self.bytes
            .chunks_exact(PACKET_ROOM)
            .zip(&self.place)
            .map(|(room, &(start, len))| &room[start..start + len])
    }
}

/// What a coder decodes into.
pub struct Decoded {
    pub values: Vec<i16>,
    pub tokens: Vec<u8>,
}

/// A coder of packets that share one table.
pub trait Coder {
    fn name(&self) -> String;
    /// Whether it codes whole i16 values; else tokens of one byte, raw low bits left out.
    fn whole(&self) -> bool {
        true
    }
    /// Whether it is written in Rust.
    fn rust(&self) -> bool {
        true
    }
    /// Encodes all packets; `false` if it has no encoder of its own.
    fn encode(&mut self, packets: &Packets, arena: &mut Arena) -> Result<bool>;
    /// Decodes `bodies` into the front of `out`, packet after packet.
    fn decode(&mut self, packets: &Packets, bodies: &[&[u8]], out: &mut Decoded) -> Result<()>;
}

/// Four-lane rANS, scalar.
pub struct Scalar {
    symbols: [Symbols; 1],
    slots: Box<[u32; SLOTS]>,
}

impl Scalar {
    pub fn new(table: &Table) -> Self {
        let mut slots = Box::new([0u32; SLOTS]);
        table.fill_slots(&mut slots);
        Self { symbols: [Symbols::new(table)], slots }
    }
}

impl Coder for Scalar {
    fn name(&self) -> String {
        "scalar".into()
    }

    fn encode(&mut self, packets: &Packets, arena: &mut Arena) -> Result<bool> {
        let run = [TableRun { table: 0, len: packets.len }];
        for (values, (room, place)) in packets.values.chunks_exact(packets.len).zip(arena.rooms()) {
            *place = (0, lanes::encode(values, &run, &self.symbols, room)?.len);
        }
        Ok(true)
    }

    fn decode(&mut self, packets: &Packets, bodies: &[&[u8]], out: &mut Decoded) -> Result<()> {
        let k = packets.table.raw_bits();
        for (body, values) in bodies.iter().copied().zip(out.values.chunks_exact_mut(packets.len)) {
            let mut decoder = Decoder::new(body, values.len(), values.len() * usize::from(k))?;
            decoder.run(&*self.slots, k, values)?;
            decoder.finish()?;
        }
        Ok(())
    }
}

/// Four-lane rANS with the 3 KiB table.
pub struct Small {
    token: Box<[u8; SLOTS]>,
    range: Box<[u32; 256]>,
}

impl Small {
    pub fn new(table: &Table) -> Self {
        let (mut token, mut range) = (Box::new([0u8; SLOTS]), Box::new([0u32; 256]));
        Compact::fill(table, &mut token, &mut range);
        Self { token, range }
    }
}

impl Coder for Small {
    fn name(&self) -> String {
        "compact".into()
    }

    fn encode(&mut self, _: &Packets, _: &mut Arena) -> Result<bool> {
        Ok(false)
    }

    fn decode(&mut self, packets: &Packets, bodies: &[&[u8]], out: &mut Decoded) -> Result<()> {
        let k = packets.table.raw_bits();
        let table = Compact { token: &self.token, range: &self.range };
        for (body, values) in bodies.iter().copied().zip(out.values.chunks_exact_mut(packets.len)) {
            let mut decoder = Decoder::new(body, values.len(), values.len() * usize::from(k))?;
            decoder.run(&table, k, values)?;
            decoder.finish()?;
        }
        Ok(())
    }
}

/// The twin that searches and divides.
pub struct Naive;

impl Coder for Naive {
    fn name(&self) -> String {
        "naive".into()
    }

    fn encode(&mut self, packets: &Packets, arena: &mut Arena) -> Result<bool> {
        let tables = [packets.table];
        let table_of = vec![0u8; packets.len];
        for (values, (room, place)) in packets.values.chunks_exact(packets.len).zip(arena.rooms()) {
            let mut len = 0;
            naive::encode::<PACKET_ROOM>(values, &table_of, &tables, |byte| {
                room[len] = byte;
                len += 1;
            })?;
            *place = (0, len);
        }
        Ok(true)
    }

    fn decode(&mut self, packets: &Packets, bodies: &[&[u8]], out: &mut Decoded) -> Result<()> {
        let tables = [packets.table];
        let table_of = vec![0u8; packets.len];
        for (body, values) in bodies.iter().copied().zip(out.values.chunks_exact_mut(packets.len)) {
            naive::decode(body, &table_of, &tables, values)?;
        }
        Ok(())
    }
}

/// Four-lane rANS, several packets at once.
pub struct Many {
    kernel: Kernel,
    slots: Vec<[u32; SLOTS]>,
}

impl Many {
    /// One for each vector kernel that this machine has.
    pub fn all(table: &Table) -> Vec<Box<dyn Coder>> {
        let kernels = Kernel::ALL.into_iter().filter(|k| *k != Kernel::Scalar && k.is_here());
        kernels
            .map(|kernel| {
                let mut slots = vec![[0u32; SLOTS]];
                table.fill_slots(&mut slots[0]);
                Box::new(Self { kernel, slots }) as Box<dyn Coder>
            })
            .collect()
    }
}

impl Coder for Many {
    fn name(&self) -> String {
        self.kernel.name().into()
    }

    fn encode(&mut self, _: &Packets, _: &mut Arena) -> Result<bool> {
        Ok(false)
    }

    fn decode(&mut self, packets: &Packets, bodies: &[&[u8]], out: &mut Decoded) -> Result<()> {
        let run = [TableRun { table: 0, len: packets.len }];
        let tables = Tables { slots: &self.slots, raw_bits: &[packets.table.raw_bits()] };
        let values = out.values.chunks_exact_mut(packets.len);
        let mut jobs: Vec<Job<'_>> =
            bodies.iter().copied().zip(values).map(|(body, values)| Job::new(body, &run, values)).collect();
        decode_many_with(self.kernel, &tables, &mut jobs);
        Ok(jobs.into_iter().try_for_each(|job| job.result)?)
    }
}
