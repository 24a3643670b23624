//! Packets, receipts and files: their tables against the bytes that the code writes and refuses.

use std::collections::BTreeMap;

use codec_core::{
    ErrorKind,
    internals::{
        ids::{EpochId, Level, PacketId, Span, WindowId},
        limits,
        repair::{Sums, set_bytes},
        wire::{
            crc::crc32,
            file, manifest,
            packet::{self, Chunk, Extent, Packet, Parity, Slices},
            receipt::{Value, ViewerPose},
        },
    },
};

use crate::tables::{TableRow, Tables, at, contiguous, in_order, number, range, same};

pub fn packets(tables: &Tables, found: &mut Vec<String>) {
    for (kind, bits) in [
        ("chunk", packet::KIND_CHUNK),
        ("slices", packet::KIND_SLICES),
        ("parity", packet::KIND_PARITY),
        ("receipt", packet::KIND_RECEIPT),
    ] {
        let row = tables["kinds"].iter().find(|r| r["kind"] == kind);
        same(found, &format!("kind {kind}"), row.map(|r| number(&r["bits"])), Some(bits.into()));
    }
    let chunk = Chunk {
        level: Level::ALL[2],
        id: PacketId::new(0x03_02_01).unwrap(),
        cluster: 0x1122,
        first_frame: 0x3344,
        frames: 0x5566,
        quant: 0x77,
        first_symbol: 0x8899_aabb,
        symbols: 0xccdd,
        dependencies: [9].into_iter().collect(),
        payload: &[1, 2, 3],
    };
    let mut out = [0u8; 64];
    let len = chunk.write(&mut out).unwrap();
    let rows = &tables["chunk"];
    let end = contiguous(rows, "chunk", found);
    same(found, "chunk: header", end, packet::CHUNK_HEADER_BYTES);
    for (field, wanted) in [
        ("kind", vec![0x82]),
        ("id", vec![1, 2, 3]),
        ("cluster", vec![0x22, 0x11]),
        ("first_frame", vec![0x44, 0x33]),
        ("frames", vec![0x66, 0x55]),
        ("quant", vec![0x77]),
        ("dependencies", vec![1]),
        ("payload_len", vec![3, 0]),
        ("first_symbol", vec![0xbb, 0xaa, 0x99, 0x88]),
        ("symbols", vec![0xdd, 0xcc]),
        ("reserved", vec![0, 0]),
    ] {
        same(found, &format!("chunk.{field}"), at(rows, field, &out), Some(wanted));
    }
    poke(rows, "chunk", &out[..len - 4], &["payload_len", "dependencies"], found);

    let parity = Parity { id: chunk.id, length: 0x4455, content: &[6; 5] };
    let len = parity.write(&mut out).unwrap();
    for (field, wanted) in [("kind", vec![0xc0]), ("id", vec![1, 2, 3]), ("length", vec![0x55, 0x44])] {
        same(found, &format!("parity.{field}"), at(&tables["parity"], field, &out), Some(wanted));
    }
    let content = tables["parity"].iter().find(|r| r["field"] == "content").unwrap();
    same(found, "parity.content", number(&content["offset"]), (len - 4 - 5) as u64);
    same(found, "parity.content", range(&content["width"]), Some((1, limits::MAX_PACKET_BYTES as u64)));
    poke(&tables["parity"], "parity", &out[..len - 4], &[], found);

    let extent = |level: u8, motion| Extent {
        span: if motion { Span::Motion(WindowId(1)) } else { Span::Canonical(EpochId(1)) },
        level: Level::from_bits(level),
        first: 0,
        blocks: 1,
    };
    let first_byte = |list: &[Extent]| {
        let extents = list.iter().copied().collect();
        let packet = Slices { id: chunk.id, extents, body: &[] };
        let mut out = [0u8; 64];
        packet.write(&mut out).unwrap();
        u64::from(out[0])
    };
    let plain = first_byte(&[extent(0, false)]);
    for (field, ones, written) in [
        ("level", 3, first_byte(&[extent(3, false)])),
        ("motion", 1, first_byte(&[extent(0, true)])),
        ("more", 1, first_byte(&[extent(0, false); 2])),
    ] {
        let row = tables["extent flags"].iter().find(|r| r["field"] == field).unwrap();
        same(found, &format!("extent flag {field}"), ones << number(&row["bit"]), written ^ plain);
    }
    let kind = tables["extent flags"].iter().find(|r| r["field"] == "kind").unwrap();
    same(found, "extent flag kind", u64::from(packet::KIND_SLICES) << number(&kind["bit"]), plain);
}

/// Values outside a packet header's ranges are refused by name.
pub fn poke(rows: &[TableRow], prefix: &str, content: &[u8], shifts: &[&str], found: &mut Vec<String>) {
    assert!(Packet::parse(content).is_ok());
    for row in rows {
        let Some((low, high)) = range(&row["allowed"]) else { continue };
        let (offset, width) = (number(&row["offset"]) as usize, number(&row["width"]) as usize);
        let field = format!("{prefix}.{}", row["field"]);
        for (value, wanted) in
            [(low.checked_sub(1), true), (Some(high + 1), true), (Some(low), false), (Some(high), false)]
        {
            let Some(value) = value.filter(|v| *v < 1 << (8 * width)) else { continue };
            let mut changed = content.to_vec();
            changed[offset..offset + width].copy_from_slice(&value.to_le_bytes()[..width]);
            let error = Packet::parse(&changed).err();
            // Another kind of packet is refused, or read, as that kind.
            if row["field"] == "kind" && value >> 5 != low >> 5 {
                continue;
            }
            let refused = error.is_some_and(|e| e.field == field && e.kind == ErrorKind::Illegal);
            same(found, &format!("{field} = {value} refused"), wanted, refused);
            if !wanted && !shifts.contains(&row["field"].as_str()) && value == low {
                same(found, &format!("{field} = {value}"), None, error);
            }
        }
    }
}

/// Row i of one set of packets that hold a single 1 at position j: its first byte is c(i, j).
pub fn parity(tables: &Tables, found: &mut Vec<String>) {
    let rows = &tables["coefficients"];
    same(found, "coefficients: rows", rows.len(), limits::MAX_REPAIR_PARITY);
    for row in rows {
        let i = number(&row["row"]) as u32;
        for (position, wanted) in row.iter().filter(|(column, _)| *column != "row") {
            let mut memory = vec![0u8; set_bytes(limits::MAX_REPAIR_PARITY, 1)];
            let mut sums = Sums::over(&mut memory, limits::MAX_REPAIR_PARITY, 1).unwrap();
            sums.add(number(position) as u32, &[1]);
            let coded = sums.parity(i, 1).unwrap();
            let c = number(wanted);
            let what = format!("coefficient({i}, {position})");
            same(found, &what, (c as u16, &[c as u8][..]), coded);
        }
    }
}

pub fn receipt(tables: &Tables, found: &mut Vec<String>) {
    let id = |i| PacketId::new(i).unwrap();
    let value = Value {
        sequence: 300,
        playout_us: 0x0102_0304_0506_0708,
        pose: Some(ViewerPose { position: [1.0, 2.0, 3.0], rotation: [1.0, 0.0, 0.0, 0.0] }),
        acknowledged: &[(id(2), id(5)), (id(9), id(9))],
        recovered: &[id(4)],
        completed: &[],
    };
    let mut out = [0u8; 200];
    let len = value.write(&mut out).unwrap();
    let mut expected: BTreeMap<&str, Vec<u8>> = BTreeMap::new();
    expected.insert("kind", vec![0xe1]);
    expected.insert("sequence", vec![0xac, 0x02]);
    expected.insert("playout_us", vec![8, 7, 6, 5, 4, 3, 2, 1]);
    expected.insert("pose", [1.0f32, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0].map(f32::to_le_bytes).concat());
    expected.insert("ranges", vec![2, 2, 3, 2, 0]);
    expected.insert("recovered", vec![1, 4]);
    expected.insert("completed", vec![0]);
    in_order(&tables["receipt"], "receipt", &expected, &out[..len - 4], found);
}

pub fn dgs(tables: &Tables, found: &mut Vec<String>) {
    let mut message = [0u8; 64];
    let len = manifest::seal(&[1, 2, 3], &mut message).unwrap();
    let mut packet = [0u8; 20];
    let n = Parity { id: PacketId::default(), length: 1, content: &[9; 4] }.write(&mut packet).unwrap();
    let mut out = Vec::new();
    let mut index = file::Index::begin(&message[..len], |b| out.extend_from_slice(b));
    let entry = index.packet(&packet[..n], |b| out.extend_from_slice(b)).unwrap();
    index.end(&[entry], |b| out.extend_from_slice(b));
    let head = [&b"DGSX"[..], &[1, 0, 0, 0], &entry.to_le_bytes()].concat();
    let expected = BTreeMap::from([
        ("magic", b"DGS\x01".to_vec()),
        ("manifest_len", (len as u32).to_le_bytes().to_vec()),
        ("manifest", message[..len].to_vec()),
        ("packets", [&(n as u16).to_le_bytes()[..], &packet[..n]].concat()),
        ("end", vec![0, 0]),
        ("index_magic", b"DGSX".to_vec()),
        ("index_packets", vec![1, 0, 0, 0]),
        ("index", entry.to_le_bytes().to_vec()),
        ("index_crc", crc32(&head).to_le_bytes().to_vec()),
        ("index_len", 20u32.to_le_bytes().to_vec()),
    ]);
    in_order(&tables["file"], "file", &expected, &out, found);
}
