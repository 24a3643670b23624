//! Slices packets of `SPEC.md` section 6.2: read to symbols and written from them.

use std::ops::Range;

use crate::{
    crc,
    lanes::{self, Bits},
    model::{Cell, Model, Reader},
    table::Table,
};

/// Consecutive blocks of a span at a level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    pub motion: bool,
    pub span: usize,
    pub level: usize,
    pub first: usize,
    pub blocks: usize,
}

/// A slice: number of its cluster, the cell, its blocks.
pub type Slice<'m> = (usize, Cell<'m>, Range<usize>);

/// The slices of `extent` that have symbols.
pub fn slices<'m>(model: &'m Model, extent: &Extent) -> Vec<Slice<'m>> {
    let (mut before, mut slices) = (0, Vec::new());
    for (c, cell) in model.cells(extent.motion, extent.span).into_iter().enumerate() {
        let local = |block: usize| block.saturating_sub(before).min(cell.blocks());
        let blocks = local(extent.first)..local(extent.first + extent.blocks);
        before += cell.blocks();
        if !blocks.is_empty() && cell.symbols(extent.level, blocks.clone()) > 0 {
            slices.push((c, cell, blocks));
        }
    }
    slices
}

/// Symbol runs of all extents: stream and length.
pub fn runs(model: &Model, extents: &[Extent]) -> Vec<(usize, usize)> {
    let slices = |extent: &Extent| -> Vec<(usize, usize)> {
        slices(model, extent)
            .into_iter()
            .flat_map(|(_, cell, blocks)| cell.runs(extent.level, blocks))
            .collect()
    };
    extents.iter().flat_map(slices).collect()
}

/// A slices packet that has been read.
pub struct Packet {
    pub id: u32,
    pub extents: Vec<Extent>,
    /// Choice of each symbol run in its table set.
    pub choices: Vec<usize>,
    pub values: Vec<i16>,
}

/// Code words of the choices of a table set: value and length.
fn codes(set: &[(u8, u8)]) -> Vec<(u32, u8)> {
    let (mut code, mut length, mut codes) = (0, 0, Vec::new());
    for &(_, own) in set {
        code <<= own - length;
        length = own;
        codes.push((code, own));
        code += 1;
    }
    codes
}

/// Reads a whole packet, CRC included.
pub fn read(model: &Model, packet: &[u8]) -> Packet {
    let mut reader = Reader { bytes: &packet[..packet.len() - 4], at: 0 };
    let mut flags = reader.u8();
    assert_eq!(flags >> 5, 0b101);
    let id = reader.varint();
    let mut extents = Vec::new();
    loop {
        let [span, first, blocks] = [(); 3].map(|()| reader.varint() as usize);
        let (motion, level) = (flags >> 2 & 1 == 1, usize::from(flags & 3));
        extents.push(Extent { motion, span, level, first, blocks });
        if flags >> 3 & 1 == 0 {
            break;
        }
        flags = reader.u8();
    }
    let body = &reader.bytes[reader.at..];
    let runs = runs(model, &extents);
    let mut bits = Bits { bytes: body, at: 0 };
    let mut choices = Vec::new();
    for (stream, _) in &runs {
        let codes = codes(&model.table_sets[*stream]);
        let (mut code, mut length) = (0, 0);
        let choice = loop {
            if let Some(choice) = codes.iter().position(|&c| c == (code, length)) {
                break choice;
            }
            code = code << 1 | bits.take(1) as u32;
            length += 1;
        };
        choices.push(choice);
    }
    let tables = tables(model, &runs, &choices);
    let values = lanes::decode(&body[bits.at.div_ceil(8)..], &tables);
    Packet { id, extents, choices, values }
}

/// The table of each value.
fn tables<'m>(model: &'m Model, runs: &[(usize, usize)], choices: &[usize]) -> Vec<&'m Table> {
    let table = |(&(stream, n), &choice): (&(usize, usize), &usize)| {
        let index = model.table_sets[stream][choice].0;
        std::iter::repeat_n(&model.tables[usize::from(index)], n)
    };
    runs.iter().zip(choices).flat_map(table).collect()
}

fn varint(mut value: usize, out: &mut Vec<u8>) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

impl Packet {
    /// Whether the encoder of the body gave up groups of its tail to a lane that started anew.
    pub fn has_shortened_tail(&self, model: &Model) -> bool {
        lanes::has_shortened_tail(&self.values, &tables(model, &runs(model, &self.extents), &self.choices))
    }

    /// The whole packet, CRC included.
    pub fn write(&self, model: &Model) -> Vec<u8> {
        let mut out = Vec::new();
        for (i, extent) in self.extents.iter().enumerate() {
            let more = u8::from(i + 1 < self.extents.len());
            let kind = if i == 0 { 0b101 << 5 } else { 0 };
            out.push(kind | more << 3 | u8::from(extent.motion) << 2 | extent.level as u8);
            if i == 0 {
                varint(self.id as usize, &mut out);
            }
            [extent.span, extent.first, extent.blocks].iter().for_each(|&value| varint(value, &mut out));
        }
        let runs = runs(model, &self.extents);
        let mut indices = lanes::Writer::default();
        for ((stream, _), &choice) in runs.iter().zip(&self.choices) {
            let (code, length) = codes(&model.table_sets[*stream])[choice];
            (0..length).rev().for_each(|place| indices.put(u64::from(code >> place & 1), 1));
        }
        out.extend(indices.bytes);
        out.extend(lanes::encode(&self.values, &tables(model, &runs, &self.choices)));
        out.extend(crc(&out).to_le_bytes());
        out
    }
}
