//! Another reader of files, repair sets and receipts, written from `SPEC.md` alone: nothing of the
//! crate decides here. The crate's own writers and golden streams are its input; only the repair
//! ranges are asked of the crate's manifest.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

use std::path::Path;

use codec_core::{
    ids::{ClusterId, EpochId, Group, Level, PacketId, Span, WindowId},
    wire::{
        manifest::{Manifest, Repair, Sealed, open},
        receipt::{Value, ViewerPose},
    },
};

/// CRC-32/ISO-HDLC, a bit at a time.
fn crc(bytes: &[u8]) -> u32 {
    let mut state = 0xffff_ffffu32;
    for byte in bytes {
        state ^= u32::from(*byte);
        for _ in 0..8 {
            state = if state & 1 == 1 { state >> 1 ^ 0xedb8_8320 } else { state >> 1 };
        }
    }
    !state
}

fn u16_at(bytes: &[u8], at: usize) -> usize {
    usize::from(bytes[at]) | usize::from(bytes[at + 1]) << 8
}

fn u32_at(bytes: &[u8], at: usize) -> usize {
    u16_at(bytes, at) | u16_at(bytes, at + 2) << 16
}

fn fits(bytes: &[u8]) -> bool {
    bytes.len() >= 4 && crc(&bytes[..bytes.len() - 4]) as usize == u32_at(bytes, bytes.len() - 4)
}

/// Section 12, for whole files: the manifest message and the packets, with the index checked.
fn read_file(bytes: &[u8]) -> (&[u8], Vec<&[u8]>) {
    assert_eq!(&bytes[..4], b"DGS\x01");
    let mut at = 8 + u32_at(bytes, 4);
    let message = &bytes[8..at];
    assert!(fits(message) && &message[..4] == b"DGSM");
    let (mut packets, mut offsets) = (Vec::new(), Vec::new());
    loop {
        let len = u16_at(bytes, at);
        if len == 0 {
            break;
        }
        assert!((9..=1280).contains(&len));
        offsets.push(at);
        packets.push(&bytes[at + 2..at + 2 + len]);
        at += 2 + len;
    }
    let index = &bytes[at + 2..];
    assert_eq!(&index[..4], b"DGSX");
    assert_eq!(u32_at(index, 4), packets.len());
    for (i, offset) in offsets.iter().enumerate() {
        assert_eq!(u32_at(index, 8 + 4 * i), *offset);
    }
    let end = 8 + 4 * packets.len();
    assert!(fits(&index[..end + 4]));
    assert_eq!(u32_at(index, end + 4), 16 + 4 * packets.len());
    assert_eq!(index.len(), end + 8);
    (message, packets)
}

/// Products and quotients of section 10, by logarithms to base 2.
struct Field {
    log: [usize; 256],
    power: [u8; 255],
}

impl Field {
    fn new() -> Self {
        let mut field = Self { log: [0; 256], power: [0; 255] };
        let mut value = 1u16;
        for exponent in 0..255 {
            field.power[exponent] = value as u8;
            field.log[usize::from(value)] = exponent;
            value <<= 1;
            if value > 255 {
                value ^= 0x11d;
            }
        }
        field
    }

    fn times(&self, a: u8, b: u8) -> u8 {
        if a == 0 || b == 0 {
            return 0;
        }
        self.power[(self.log[usize::from(a)] + self.log[usize::from(b)]) % 255]
    }

    fn over(&self, a: u8, b: u8) -> u8 {
        if a == 0 { 0 } else { self.power[(self.log[usize::from(a)] + 255 - self.log[usize::from(b)]) % 255] }
    }

    fn c(&self, i: usize, j: usize) -> u8 {
        let y = 8 + j as u8;
        self.over(y, y ^ i as u8)
    }
}

/// Packets of one set with holes, and its parity rows with holes: the holes among the packets.
fn repair(field: &Field, members: &[Option<&[u8]>], rows: &[Option<&[u8]>], longest: usize) -> Vec<Vec<u8>> {
    let coded = |packet: &[u8]| {
        let mut coded = (packet.len() as u16).to_le_bytes().to_vec();
        coded.extend_from_slice(packet);
        coded.resize(2 + longest, 0);
        coded
    };
    let missing: Vec<usize> = (0..members.len()).filter(|&j| members[j].is_none()).collect();
    // From the last row back, unlike the crate: any rows will do.
    let mut equations: Vec<(Vec<u8>, Vec<u8>)> = Vec::new();
    for (i, row) in rows.iter().enumerate().rev().filter_map(|(i, row)| Some((i, (*row)?))) {
        let mut right = row[4..row.len() - 4].to_vec();
        right.resize(2 + longest, 0);
        for (j, member) in members.iter().enumerate() {
            if let Some(packet) = member {
                for (r, b) in right.iter_mut().zip(coded(packet)) {
                    *r ^= field.times(field.c(i, j), b);
                }
            }
        }
        equations.push((missing.iter().map(|&j| field.c(i, j)).collect(), right));
    }
    equations.truncate(missing.len());
    assert_eq!(equations.len(), missing.len(), "enough rows");
    for at in 0..missing.len() {
        let pivot = (at..missing.len()).find(|&e| equations[e].0[at] != 0).expect("invertible");
        equations.swap(at, pivot);
        let (left, right) = equations[at].clone();
        for (e, (l, r)) in equations.iter_mut().enumerate() {
            let factor = if e == at { 0 } else { field.over(l[at], left[at]) };
            l.iter_mut()
                .zip(&left)
                .chain(r.iter_mut().zip(&right))
                .for_each(|(x, p)| *x ^= field.times(*p, factor));
        }
    }
    let finish = |(at, (left, right)): (usize, (Vec<u8>, Vec<u8>))| {
        let solved: Vec<u8> = right.iter().map(|&b| field.over(b, left[at])).collect();
        solved[2..2 + u16_at(&solved, 0)].to_vec()
    };
    equations.into_iter().enumerate().map(finish).collect()
}

#[test]
fn every_set_of_the_golden_streams_gives_back_as_many_packets_as_it_has_parity() {
    let field = Field::new();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conformance");
    let mut solved = 0;
    let index = std::fs::read_to_string(folder.join("index.txt")).unwrap();
    for name in index.lines().map(|l| l.split(" | ").next().unwrap()) {
        let bytes = std::fs::read(folder.join(format!("{name}.dgs"))).unwrap();
        let (message, packets) = read_file(&bytes);
        assert!(packets.iter().all(|p| fits(p)), "{name}");
        let mut raw = vec![0u8; Sealed::parse(message).unwrap().raw_len];
        open(message, crc, &mut raw).unwrap();
        let ranges: Vec<Repair> = Manifest::parse(&raw).unwrap().repairs().collect();
        for range in ranges {
            let (n, k) = (range.packets as usize, usize::from(range.set_len));
            let sets = n.div_ceil(k);
            for set in 0..sets {
                let ids: Vec<usize> =
                    (0..n).filter(|j| j % sets == set).map(|j| j + range.first_packet as usize).collect();
                let rows = usize::from(range.parity);
                let parity = |i: usize| packets[range.first_parity as usize + i * sets + set];
                let drop = rows.min(ids.len());
                let members: Vec<Option<&[u8]>> = ids
                    .iter()
                    .enumerate()
                    .map(|(j, &id)| (j % 2 == 1 || j / 2 >= drop).then_some(packets[id]))
                    .collect();
                let lost: Vec<&[u8]> = ids
                    .iter()
                    .zip(&members)
                    .filter(|(_, m)| m.is_none())
                    .map(|(&id, _)| packets[id])
                    .collect();
                let rows: Vec<Option<&[u8]>> = (0..rows).map(|i| Some(parity(i))).collect();
                assert!(rows.iter().flatten().all(|row| row[0] == 0xc0));
                let found = repair(&field, &members, &rows, range.longest.into());
                assert_eq!(found, lost, "{name}, set {set}");
                assert!(ids.iter().map(|&id| packets[id].len()).max().unwrap() <= usize::from(range.longest));
                solved += lost.len();
            }
        }
    }
    assert!(solved > 15, "{solved}");
}

/// Section 11.
struct Receipt<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Receipt<'_> {
    fn byte(&mut self) -> u8 {
        self.at += 1;
        self.bytes[self.at - 1]
    }

    fn varint(&mut self) -> u32 {
        let (mut value, mut shift) = (0u32, 0);
        loop {
            let byte = self.byte();
            value |= u32::from(byte & 0x7f) << shift;
            shift += 7;
            if byte & 0x80 == 0 {
                return value;
            }
        }
    }

    /// What the receipt says, as text.
    fn text(mut self) -> String {
        assert!(fits(self.bytes) && self.bytes.len() <= 1200);
        self.bytes = &self.bytes[..self.bytes.len() - 4];
        let kind = self.byte();
        assert_eq!(kind & !1, 0xe0);
        let mut text = format!("{}", self.varint());
        let playout = (0..8).fold(0u64, |sum, i| sum | u64::from(self.byte()) << (8 * i));
        text += &format!(" at {playout}");
        if kind & 1 == 1 {
            for _ in 0..7 {
                let bits = (0..4).fold(0u32, |sum, i| sum | u32::from(self.byte()) << (8 * i));
                text += &format!(" {}", f32::from_bits(bits));
            }
        }
        text += "; ranges";
        let mut next = 0;
        for i in 0..self.varint() {
            let first = next + self.varint() + if i == 0 { 0 } else { 2 };
            let last = first + self.varint();
            next = last;
            text += &format!(" {first}-{last}");
        }
        text += "; recovered";
        (0..self.varint()).for_each(|_| text += &format!(" {}", self.varint()));
        text += "; completed";
        for _ in 0..self.varint() {
            let flags = self.byte();
            assert_eq!(flags & !7, 0);
            let span = if flags & 4 == 0 { "epoch" } else { "window" };
            text += &format!(" level {} {span} {} cluster {}", flags & 3, self.varint(), self.varint());
        }
        assert_eq!(self.at, self.bytes.len(), "nothing is left");
        text
    }
}

#[test]
fn receipts_say_what_was_put_in() {
    let id = |i| PacketId::new(i).unwrap();
    let value = Value {
        sequence: 70_000,
        playout_us: 0x0102_0304_0506_0708,
        pose: Some(ViewerPose { position: [0.5, -2.0, 3.25], rotation: [1.0, 0.0, 0.0, -0.5] }),
        acknowledged: &[(id(2), id(5)), (id(9), id(9)), (id(300), id(70_000))],
        recovered: &[id(4), id(16_000_000)],
        completed: &[
            Group { span: Span::Canonical(EpochId(0)), cluster: ClusterId(7), level: Level::BASE },
            Group { span: Span::Motion(WindowId(300)), cluster: ClusterId(700), level: Level::ALL[3] },
        ],
    };
    let mut out = [0u8; 1300];
    let len = value.write(&mut out).unwrap();
    assert_eq!(
        Receipt { bytes: &out[..len], at: 0 }.text(),
        "70000 at 72623859790382856 0.5 -2 3.25 1 0 0 -0.5; ranges 2-5 9-9 300-70000; recovered 4 16000000; \
         completed level 0 epoch 0 cluster 7 level 3 window 300 cluster 700"
    );
    let empty =
        Value { sequence: 0, playout_us: 1, pose: None, acknowledged: &[], recovered: &[], completed: &[] };
    let len = empty.write(&mut out).unwrap();
    assert_eq!(Receipt { bytes: &out[..len], at: 0 }.text(), "0 at 1; ranges; recovered; completed");
}
