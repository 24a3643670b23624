//! `SPEC.md` against the code: its tables are read here and compared with constants, with the
//! bytes the code writes, and with what it refuses. A wrong number in a table fails; the last test
//! shows that it does.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use codec_core::{
    ErrorKind,
    ids::{EpochId, Level, PacketId, Span, WindowId},
    layout, limits, math,
    quant::{Class, Quantiser},
    rans::{bytes, family, lanes, table},
    repair::{Sums, set_bytes},
    wire::{
        crc::crc32,
        file,
        manifest::{
            self, Cluster, Epoch, Head, MAX_TABLE_SET_BITS, Manifest, Motion, Quant, Repair, Sealed,
            TableSet, Track, Window, stream,
        },
        packet::{self, Chunk, Extent, Packet, Parity, Slices},
        receipt::{Value, ViewerPose},
    },
};

type Row = BTreeMap<String, String>;
type Tables = BTreeMap<String, Vec<Row>>;

fn text() -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("SPEC.md")).unwrap()
}

/// All tables that follow a `<!-- table: NAME -->` line: rows by column name.
fn tables(text: &str) -> Tables {
    let mut tables = Tables::new();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let Some(name) = line.strip_prefix("<!-- table: ").and_then(|l| l.strip_suffix(" -->")) else {
            continue;
        };
        let cells = |line: &str| -> Vec<String> {
            line.trim_matches('|').split('|').map(|c| c.trim().to_owned()).collect()
        };
        let columns = cells(lines.next().unwrap());
        lines.next();
        let rows = lines.by_ref().take_while(|l| l.starts_with('|'));
        let rows = rows.map(|l| {
            let cells = cells(l);
            assert_eq!(cells.len(), columns.len(), "{name}: {l}");
            columns.iter().cloned().zip(cells).collect()
        });
        assert!(tables.insert(name.to_owned(), rows.collect()).is_none(), "{name} twice");
    }
    tables
}

/// Everything in which the tables and the code differ.
fn differences(tables: &Tables) -> Vec<String> {
    let mut found = Vec::new();
    for check in [
        limits_of, records, ranges, sealed, sections, packets, classes, coding, floats, parity, receipt, dgs,
        errors,
    ] {
        check(tables, &mut found);
    }
    found
}

fn same<T: PartialEq + std::fmt::Debug>(found: &mut Vec<String>, what: &str, spec: T, code: T) {
    if spec != code {
        found.push(format!("{what}: SPEC.md says {spec:?}, the code {code:?}"));
    }
}

fn number(text: &str) -> u64 {
    let parsed = match text.strip_prefix("0x") {
        Some(hex) => u64::from_str_radix(hex, 16),
        None => match text.strip_prefix("0b") {
            Some(bits) => u64::from_str_radix(bits, 2),
            None => text.parse(),
        },
    };
    parsed.unwrap_or(u64::MAX)
}

/// `a..=b` as numbers, if that is all there is.
fn range(text: &str) -> Option<(u64, u64)> {
    let (low, high) = text.split_once("..=")?;
    let (low, high) = (number(low), number(high));
    (low != u64::MAX && high != u64::MAX).then_some((low, high))
}

fn limits_of(tables: &Tables, found: &mut Vec<String>) {
    let code = [
        ("MAX_PAYLOAD_BYTES", limits::MAX_PAYLOAD_BYTES as u64),
        ("DEFAULT_PACKET_BYTES", limits::DEFAULT_PACKET_BYTES as u64),
        ("MAX_PACKET_BYTES", limits::MAX_PACKET_BYTES as u64),
        ("MAX_DEPENDENCIES", limits::MAX_DEPENDENCIES as u64),
        ("MAX_PACKET_VALUES", limits::MAX_PACKET_VALUES.into()),
        ("MAX_EXTENTS", limits::MAX_EXTENTS as u64),
        ("MAX_TABLE_SET", limits::MAX_TABLE_SET as u64),
        ("MAX_BLOCK_LEN", limits::MAX_BLOCK_LEN as u64),
        ("MAX_CLUSTER_LEN", limits::MAX_CLUSTER_LEN as u64),
        ("MAX_EPOCH_GAUSSIANS", limits::MAX_EPOCH_GAUSSIANS.into()),
        ("MAX_EPOCHS", limits::MAX_EPOCHS as u64),
        ("MAX_WINDOWS", limits::MAX_WINDOWS as u64),
        ("MAX_WINDOW_FRAMES", limits::MAX_WINDOW_FRAMES as u64),
        ("MAX_FRAMES", limits::MAX_FRAMES.into()),
        ("MAX_RANK", limits::MAX_RANK as u64),
        ("MAX_CLUSTERS", limits::MAX_CLUSTERS.into()),
        ("MAX_QUANT_PROFILES", limits::MAX_QUANT_PROFILES as u64),
        ("MAX_TABLES", limits::MAX_TABLES as u64),
        ("MAX_MANIFEST_BYTES", limits::MAX_MANIFEST_BYTES as u64),
        ("MAX_REPAIR_SET", limits::MAX_REPAIR_SET as u64),
        ("MAX_REPAIR_PARITY", limits::MAX_REPAIR_PARITY as u64),
        ("MAX_RECEIPT_BYTES", limits::MAX_RECEIPT_BYTES as u64),
        ("MAX_PACKET_ID", PacketId::MAX.into()),
        ("MAX_TABLE_SET_BITS", MAX_TABLE_SET_BITS.into()),
        ("TURN_STEPS", math::TURN_STEPS as u64),
        ("STREAMS", stream::COUNT as u64),
        ("LANES", lanes::LANES as u64),
        ("LANE_PRECISION", table::PRECISION.into()),
        ("BYTE_PRECISION", bytes::PRECISION.into()),
        ("MAX_RAW_BITS", table::MAX_RAW_BITS.into()),
        ("MAX_SYMBOLS", limits::MAX_SYMBOLS.into()),
    ];
    let spec: Vec<(&str, u64)> =
        tables["limits"].iter().map(|r| (r["name"].as_str(), number(&r["value"]))).collect();
    for row in &spec {
        if !code.contains(row) {
            found.push(format!(
                "limits: SPEC.md says {row:?}, the code {:?}",
                code.iter().find(|c| c.0 == row.0)
            ));
        }
    }
    same(found, "limits: rows", spec.len(), code.len());
    // Every public constant of `limits.rs` has its row.
    let source =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/limits.rs")).unwrap();
    for name in source.lines().filter_map(|l| l.strip_prefix("pub const ")?.split(':').next()) {
        same(found, &format!("limits: a row for {name}"), true, spec.iter().any(|r| r.0 == name));
    }
}

/// Bytes of a record, and per field a record in which only that field is set.
type Probes = (usize, Vec<(&'static str, Vec<u8>)>);

/// A record with one field set to a value whose bytes are all non-zero.
macro_rules! probes {
    ($type:ident { $($field:ident = $value:expr),* $(,)? }) => {
        ($type::BYTES, vec![$((
            stringify!($field),
            $type { $field: $value, ..$type::default() }.to_bytes().to_vec(),
        )),*])
    };
}

fn records(tables: &Tables, found: &mut Vec<String>) {
    const A: u8 = 0x5a;
    const B: u16 = 0x5a5b;
    const C: u32 = 0x5a5b_5c5d;
    let f = f32::from_bits(C);
    let i = 0x5a5bi16;
    let records: [(&str, Probes); 6] = [
        (
            "head",
            probes!(Head {
                profile = A, sh_degree = A, block_len = B, frames = C, rate_frames = C, rate_seconds = C,
                packets = C, epochs = B, windows = B, clusters = C, quants = B, tables = B, repairs = B,
                proxies = B, basis_values = C, transform_values = C,
            }),
        ),
        (
            "epoch",
            probes!(Epoch {
                first_frame = C, frames = C, gaussians = C, first_cluster = C, clusters = C, first_window = C,
                windows = C, origin_x = f, origin_y = f, origin_z = f, basis_first = C, transform_first = C,
                rank = A,
            }),
        ),
        (
            "window",
            probes!(Window {
                epoch = B, frames = B, first_frame = C, first_cell = C, basis_first = C, rank = A,
            }),
        ),
        (
            "cluster",
            probes!(Cluster {
                gaussians = B, quant = A, kind = A, centre_x = i, centre_y = i, centre_z = i, radius = B,
            }),
        ),
        (
            "motion",
            probes!(Motion {
                kind = A, track_shift = A, track = A, position = A, scale = A, rotation = A, opacity = A, sh0 = A,
            }),
        ),
        (
            "repair",
            probes!(Repair {
                first_packet = C, packets = C, first_parity = C, set_len = A, parity = A, longest = B,
            }),
        ),
    ];
    for (name, (bytes, fields)) in &records {
        let end = contiguous(&tables[*name], name, found);
        same(found, &format!("{name}: bytes"), end, *bytes);
        let named: Vec<&str> = tables[*name].iter().map(|r| r["field"].as_str()).collect();
        for (field, written) in fields {
            same(found, &format!("{name}: a row for {field}"), named.contains(field), true);
            let set: Vec<usize> = (0..*bytes).filter(|&b| written[b] != 0).collect();
            let row = tables[*name].iter().find(|r| r["field"] == *field);
            let spec = row.map(|r| (number(&r["offset"]) as usize, number(&r["width"]) as usize));
            same(found, &format!("{name}.{field}"), spec, Some((set[0], set.len())));
        }
        for field in named {
            let known = fields.iter().any(|f| f.0 == field) || field == "reserved";
            same(found, &format!("{name}: {field} in the code"), true, known);
        }
    }
    let f = f32::from_bits(0x3f5b_5c5d);
    let quantiser = Quantiser::new(f, [0x11, 0x33, 0x55], true).unwrap().with_decorrelated(true).to_bytes();
    let end = contiguous(&tables["quantiser"], "quantiser", found);
    same(found, "quantiser: bytes", end, Quantiser::BYTES);
    for (field, wanted) in
        [("step", f.to_le_bytes().to_vec()), ("ratio", vec![0x11, 0x33, 0x55]), ("flags", vec![3])]
    {
        let bytes = at(&tables["quantiser"], field, &quantiser);
        same(found, &format!("quantiser.{field}"), bytes, Some(wanted));
    }
}

/// Checks that rows follow each other without gaps and that widths fit types; returns the end.
fn contiguous(rows: &[Row], name: &str, found: &mut Vec<String>) -> usize {
    let mut end = 0;
    for row in rows {
        let field = &row["field"];
        same(found, &format!("{name}.{field}: offset"), number(&row["offset"]), end as u64);
        let width = number(&row["width"]) as usize;
        let by_type = match row.get("type").map_or("", String::as_str) {
            "u8" => Some(1),
            "u16" | "i16" => Some(2),
            "u24" | "3 × u8" => Some(3),
            "u32" | "f32" => Some(4),
            _ => None,
        };
        same(found, &format!("{name}.{field}: width"), width, by_type.unwrap_or(width));
        end += width;
    }
    end
}

/// The bytes that `field`'s row names.
fn at(rows: &[Row], field: &str, bytes: &[u8]) -> Option<Vec<u8>> {
    let row = rows.iter().find(|r| r["field"] == field)?;
    let offset = number(&row["offset"]) as usize;
    bytes.get(offset..offset + number(&row["width"]) as usize).map(<[u8]>::to_vec)
}

/// A small whole `dgs1` body by section: one epoch, window, cluster, repair range and table.
fn small_body() -> BTreeMap<&'static str, Vec<u8>> {
    let head = Head {
        profile: 1,
        block_len: 4,
        frames: 6,
        rate_frames: 30,
        rate_seconds: 1,
        packets: 9,
        epochs: 1,
        windows: 1,
        clusters: 1,
        quants: 1,
        tables: 1,
        repairs: 1,
        basis_values: 6,
        transform_values: 1,
        ..Head::default()
    };
    let epoch = Epoch { frames: 6, gaussians: 5, clusters: 1, windows: 1, origin_x: 2.5, ..Epoch::default() };
    let window = Window { frames: 6, rank: 1, ..Window::default() };
    let cluster = Cluster { gaussians: 5, centre_x: -3, radius: 7, ..Cluster::default() };
    let kind = Motion::kind_of(Track::Affine, Level::ALL[3]);
    let motion = Motion { kind, track: 1, position: 1, ..Motion::default() };
    let repair = Repair { first_packet: 0, packets: 6, first_parity: 6, set_len: 3, parity: 1, longest: 99 };
    let quantiser = Quantiser::new(0.125, [3, 1, 5], true).unwrap();
    let quant = Quant { canonical: [quantiser; Class::COUNT], motion: [quantiser; Class::MOVING] };
    let mut quants = Vec::new();
    quant.write(|b| quants.extend_from_slice(b));
    let mut table = Vec::new();
    small_table().write(|b| table.extend_from_slice(b));
    BTreeMap::from([
        ("head", head.to_bytes().to_vec()),
        ("epochs", epoch.to_bytes().to_vec()),
        ("windows", window.to_bytes().to_vec()),
        ("clusters", cluster.to_bytes().to_vec()),
        ("motions", motion.to_bytes().to_vec()),
        ("quants", quants),
        ("streams", vec![TableSet::new(&[(0, 0)]).unwrap().to_bytes(); stream::COUNT].concat()),
        ("repairs", repair.to_bytes().to_vec()),
        ("basis", [100i16, -200, 300, 0, 5, 16_384].iter().flat_map(|v| v.to_le_bytes()).collect()),
        ("transforms", 1.5f32.to_le_bytes().to_vec()),
        ("byte_tables", Vec::new()),
        ("tables", table),
    ])
}

fn small_table() -> table::Table {
    let mut frequency = [0u16; 256];
    (frequency[0], frequency[127], frequency[129]) = (8, 1024, 1016);
    table::Table::new(frequency, 2).unwrap()
}

/// The small body in the order of the spec's section table, and where its sections start.
fn assembled(tables: &Tables) -> (Vec<u8>, BTreeMap<String, usize>) {
    let (mut body, mut starts) = (Vec::new(), BTreeMap::new());
    let parts = small_body();
    for row in &tables["sections"] {
        starts.insert(row["section"].clone(), body.len());
        body.extend_from_slice(parts.get(row["section"].as_str()).map_or(&[][..], Vec::as_slice));
    }
    (body, starts)
}

fn sections(tables: &Tables, found: &mut Vec<String>) {
    for (section, bytes) in [
        ("head", Head::BYTES),
        ("epochs", Epoch::BYTES),
        ("windows", Window::BYTES),
        ("clusters", Cluster::BYTES),
        ("motions", Motion::BYTES),
        ("quants", Quant::BYTES),
        ("streams", TableSet::BYTES),
        ("repairs", Repair::BYTES),
        ("transforms", 4),
        ("byte_tables", bytes::TABLE_BYTES),
    ] {
        let row = tables["sections"].iter().find(|r| r["section"] == section);
        same(found, section, row.map(|r| number(&r["record bytes"]) as usize), Some(bytes));
    }
    let (body, _) = assembled(tables);
    match Manifest::parse(&body) {
        Err(error) => found.push(format!("sections: {error}")),
        Ok(manifest) => {
            let window = manifest.window(WindowId(0)).unwrap();
            same(found, "basis", 300.0 / 16384.0, manifest.basis(window.basis_first as usize + 2));
            let table = manifest.tables().next().map(|t| (t.frequency(127), t.raw_bits()));
            same(found, "tables", Some((1024, 2)), table);
            same(found, "transforms", 1.5, manifest.transform_value(0));
        }
    }
}

/// Pokes a value under and over each `a..=b` into a real manifest: it must be refused by name.
fn ranges(tables: &Tables, found: &mut Vec<String>) {
    let (body, starts) = assembled(tables);
    for (table, section, prefix) in [
        ("head", "head", "manifest"),
        ("window", "windows", "window"),
        ("cluster", "clusters", "cluster"),
        ("motion", "motions", "motion"),
        ("repair", "repairs", "repair"),
        ("quantiser", "quants", "quantiser"),
    ] {
        for row in &tables[table] {
            let Some((low, high)) = range(&row["allowed"]) else { continue };
            let (offset, width) = (number(&row["offset"]) as usize, number(&row["width"]) as usize);
            // Of the quantisers that of Scale, the second, which may have every flag.
            let place = starts[section] + offset + usize::from(table == "quantiser") * Quantiser::BYTES;
            let field = format!("{prefix}.{}", row["field"]);
            let refused = |value: u64| {
                let mut body = body.clone();
                let target = body.get_mut(place..place + width.min(8)).unwrap();
                target.copy_from_slice(&value.to_le_bytes()[..width.min(8)]);
                let error = Manifest::parse(&body).err()?;
                let own =
                    error.field == field && matches!(error.kind, ErrorKind::Illegal | ErrorKind::Unknown);
                own.then_some(())
            };
            let most = if width >= 8 { u64::MAX } else { (1 << (8 * width)) - 1 };
            for outside in [low.checked_sub(1), (high < most).then_some(high + 1)].into_iter().flatten() {
                same(found, &format!("{field} = {outside} is refused"), true, refused(outside).is_some());
            }
            for inside in [low, high] {
                same(found, &format!("{field} = {inside} is refused"), false, refused(inside).is_some());
            }
        }
    }
    for index in 0..Class::COUNT + Class::MOVING {
        let mut body = body.clone();
        body[starts["quants"] + index * Quantiser::BYTES + 7] = 2;
        let refused = Manifest::parse(&body).is_err_and(|e| e.field == "quantiser.flags");
        let mixes = Class::ALL.get(index).is_some_and(|class| class.decorrelates());
        same(found, &format!("quantiser {index} is refused if decorrelated"), !mixes, refused);
    }
}

fn sealed(tables: &Tables, found: &mut Vec<String>) {
    let rows = &tables["sealed"];
    let raw = [7u8; 1000];
    let mut message = vec![0u8; 9000];
    let len = manifest::seal(&raw, &mut message).unwrap();
    message.truncate(len);
    let packed = (len - 20) as u32;
    for (field, wanted) in [
        ("magic", b"DGSM".to_vec()),
        ("version", vec![manifest::VERSION]),
        ("reserved", vec![0; 3]),
        ("raw_len", 1000u32.to_le_bytes().to_vec()),
        ("packed_len", packed.to_le_bytes().to_vec()),
    ] {
        same(found, &format!("sealed.{field}"), at(rows, field, &message), Some(wanted));
    }
    let body = rows.iter().find(|r| r["field"] == "body").map(|r| number(&r["offset"]) as usize);
    same(found, "sealed.body", body, Some(manifest::HEADER_BYTES));
    same(found, "sealed.crc", crc32(&message[..len - 4]).to_le_bytes().to_vec(), message[len - 4..].to_vec());
    for row in rows {
        let Some((low, high)) = range(&row["allowed"]) else { continue };
        let (offset, width) = (number(&row["offset"]) as usize, number(&row["width"]) as usize);
        for (value, refused) in [(low.wrapping_sub(1), true), (high + 1, true), (low, false), (high, false)] {
            let mut changed = message.clone();
            changed[offset..offset + width].copy_from_slice(&value.to_le_bytes()[..width]);
            let error =
                Sealed::parse(&changed).err().is_some_and(|e| e.field.ends_with(row["field"].as_str()));
            same(found, &format!("sealed.{} = {value} refused", row["field"]), refused, error);
        }
    }
}

fn packets(tables: &Tables, found: &mut Vec<String>) {
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
fn poke(rows: &[Row], prefix: &str, content: &[u8], shifts: &[&str], found: &mut Vec<String>) {
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

fn classes(tables: &Tables, found: &mut Vec<String>) {
    same(found, "classes", tables["classes"].len(), Class::COUNT);
    for (class, row) in Class::ALL.into_iter().zip(&tables["classes"]) {
        let spec = (
            row["class"].clone(),
            number(&row["index"]) as usize,
            number(&row["components"]) as usize,
            number(&row["first level"]) as u8,
            number(&row["harmonic degree"]) as u8,
            row["moves"] == "yes",
        );
        let code = (
            format!("{class:?}"),
            class.index(),
            class.components(),
            class.first_level().get(),
            class.sh_degree(),
            class.index() < Class::MOVING,
        );
        same(found, "class", spec, code);
    }
    let row = |name: &str| {
        let row = tables["streams"].iter().find(|r| r["stream"] == name).unwrap();
        let first = number(&row["first"]) as usize;
        (first, (first..first + number(&row["count"]) as usize).collect::<BTreeSet<_>>())
    };
    let levels = || Level::ALL.into_iter();
    let canonical: BTreeSet<usize> =
        Class::ALL.into_iter().flat_map(|c| levels().map(move |l| stream::canonical(c, l))).collect();
    same(found, "canonical streams", row("canonical").1, canonical);
    let starts: BTreeSet<usize> = Class::ALL.into_iter().map(stream::start).collect();
    same(found, "start streams", row("start").1, starts);
    let kinds = [None, Some(Track::Rigid), Some(Track::Affine)];
    for (k, kind) in kinds.into_iter().enumerate() {
        for band in 0..4 {
            same(found, "track stream", row("track").0 + k * 4 + band, stream::track(kind, band));
        }
    }
    same(found, "track streams", row("track").1.len(), 3 * (stream::TRACK_BANDS.len() - 1));
    let moving = || Class::ALL.into_iter().take(Class::MOVING);
    let coefficients: BTreeSet<usize> = moving()
        .flat_map(|c| levels().skip(1).flat_map(move |l| (0..3).map(move |k| stream::coefficient(c, l, k))))
        .collect();
    same(found, "coefficient streams", row("coefficient").1, coefficients);
    for class in Class::ALL {
        for level in Level::ALL {
            let (c, l) = (class.index(), level.index());
            same(found, "canonical stream", row("canonical").0 + c * 4 + l, stream::canonical(class, level));
            if c < Class::MOVING && l > 0 {
                for k in [0usize, 1, 5] {
                    let wanted = row("coefficient").0 + (c * 3 + l - 1) * 2 + usize::from(k > 0);
                    same(found, "coefficient stream", wanted, stream::coefficient(class, level, k));
                }
            }
        }
    }
    let starts: BTreeSet<usize> = moving().map(stream::coefficient_start).collect();
    same(found, "coefficient starts", row("coefficient start").1, starts);
    let (n, t, r, h) = (5, 7, 3, layout::rest_len(2));
    for (row, code) in tables["paper symbols"].iter().zip(layout::paper::symbols(n, t, r, h)) {
        let value: usize = row["symbols per Gaussian"]
            .split('+')
            .map(|term| {
                let term = term.trim();
                let (factor, variable) = match term.chars().last() {
                    Some('T') => (&term[..term.len() - 1], t),
                    Some('R') => (&term[..term.len() - 1], r),
                    Some('H') => (&term[..term.len() - 1], h),
                    _ => (term, 1),
                };
                variable * if factor.is_empty() { 1 } else { number(factor) as usize }
            })
            .sum();
        same(found, &format!("paper level {}", row["level"]), n * value, code);
    }
}

fn coding(tables: &Tables, found: &mut Vec<String>) {
    let mut written = Vec::new();
    small_table().write(|b| written.extend_from_slice(b));
    for (field, wanted) in
        [("raw_bits", vec![2]), ("first", vec![127]), ("count", vec![3]), ("escape", vec![8, 0])]
    {
        same(found, &format!("table.{field}"), at(&tables["table"], field, &written), Some(wanted));
    }
    let mut named = Vec::new();
    table::Table::named(7).unwrap().write(|b| named.extend_from_slice(b));
    let first = tables["named table"].iter().map(|r| (number(&r["offset"]), number(&r["width"])));
    same(found, "named table", first.collect::<Vec<_>>(), vec![(0, 1), (1, 1)]);
    same(found, "named table", number(&tables["named table"][0]["allowed"]), named[0].into());
    same(found, "named table", named[1], 7);
    let ratios: Vec<u64> = tables["ratios"].iter().map(|r| number(&r["ratio"])).collect();
    same(found, "ratios", ratios, family::RATIOS.iter().map(|&r| r.into()).collect());
    for (kind, first, count) in [
        ("geometric", 0, family::SCALES),
        ("heavy", family::HEAVY, family::SCALES),
        ("three", family::THREE, family::THREES),
    ] {
        let row = tables["family"].iter().find(|r| r["kind"] == kind).unwrap();
        same(found, kind, (number(&row["first"]), number(&row["count"])), (first.into(), count.into()));
    }
    let frequency = tables["table"].iter().find(|r| r["field"] == "frequency").unwrap();
    same(found, "table.frequency", number(&frequency["offset"]) as usize, table::TABLE_HEADER_BYTES);
    same(found, "table.frequency", vec![0, 4, 0, 0, 0xf8, 3], written[table::TABLE_HEADER_BYTES..].to_vec());
    for kind in [
        ErrorKind::Short,
        ErrorKind::Illegal,
        ErrorKind::Unknown,
        ErrorKind::Checksum,
        ErrorKind::Contradiction,
        ErrorKind::Duplicate,
        ErrorKind::Capacity,
    ] {
        let row = tables["error kinds"].iter().find(|r| r["kind"] == kind.name());
        same(found, kind.name(), row.map(|r| number(&r["index"]) as usize), Some(kind.index()));
    }
    same(found, "error kinds", tables["error kinds"].len(), ErrorKind::COUNT);
}

/// The two functions from the spec's words and coefficients, bit for bit.
fn floats(tables: &Tables, found: &mut Vec<String>) {
    let coefficients: Vec<f32> = tables["exp"].iter().map(|r| r["coefficient"].parse().unwrap()).collect();
    let exp = |x: f32| {
        let x = x.clamp(-80.0, 80.0);
        let scaled = x * std::f32::consts::LOG2_E;
        let n = (scaled + if scaled < 0.0 { -0.5 } else { 0.5 }) as i32;
        let r = (x - n as f32 * 0.693_359_4) + n as f32 * 2.121_944_4e-4;
        let p = coefficients.iter().skip(1).fold(coefficients[0], |p, c| p * r + c);
        p * f32::from_bits(((n + 127) as u32) << 23)
    };
    let powers: Vec<f64> = tables["cos"].iter().map(|r| r["coefficient"].parse().unwrap()).collect();
    let cos = |a: u32, b: u32| {
        let (a, b) = (u64::from(a % (2 * b)), u64::from(b));
        let a = if a > b { 2 * b - a } else { a };
        let (a, sign) = if 2 * a > b { (b - a, -1.0) } else { (a, 1.0) };
        if 2 * a == b {
            return 0.0;
        }
        let x = std::f64::consts::PI * a as f64 / b as f64;
        let s = x * x;
        (sign * powers.iter().skip(1).fold(powers[0], |p, c| p * s + c)) as f32
    };
    for i in -1000i16..=1000 {
        let x = f32::from(i) * 0.0837;
        same(found, &format!("exp({x})"), exp(x).to_bits(), math::exp(x).to_bits());
    }
    for b in 1..130u32 {
        for a in 0..4 * b {
            same(found, &format!("cospi({a}, {b})"), cos(a, b).to_bits(), math::cos_pi(a, b).to_bits());
        }
    }
}

/// Row i of one set of packets that hold a single 1 at position j: its first byte is c(i, j).
fn parity(tables: &Tables, found: &mut Vec<String>) {
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

fn receipt(tables: &Tables, found: &mut Vec<String>) {
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

fn dgs(tables: &Tables, found: &mut Vec<String>) {
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
    lane_body(tables, found);
}

/// A body of three values, one escaped, with two raw bits each: the spec's order and widths.
fn lane_body(tables: &Tables, found: &mut Vec<String>) {
    let mut frequency = [0u16; 256];
    (frequency[0], frequency[128]) = (1, 2047);
    let symbols = [lanes::Symbols::new(&table::Table::new(frequency, 2).unwrap())];
    let mut out = [0u8; 64];
    let run = [lanes::Run { table: 0, len: 3 }];
    let len = lanes::encode(&[1, 0x1234, 3], &run, &symbols, &mut out).unwrap().len;
    let parts = lanes::Parts::of(&out[..len], 3, 6).unwrap();
    same(found, "body: raw bits", parts.plane()[0] & 0x3f, 0b11_00_01);
    let expected = BTreeMap::from([
        ("tail", vec![1]),
        ("lengths", {
            let lengths = parts.state.iter().rev().fold(0, |l, x| l << 4 | (x.ilog2() - 15));
            (lengths as u16).to_le_bytes().to_vec()
        }),
        ("words", vec![]),
        ("escapes", vec![0x34, 0x12]),
        ("plane", parts.plane().to_vec()),
    ]);
    in_order(&tables["body"], "body", &expected, &out[..len], found);
}

/// The spec's rows, in its order and with its fixed widths, give exactly the written bytes.
fn in_order(
    rows: &[Row],
    name: &str,
    expected: &BTreeMap<&str, Vec<u8>>,
    written: &[u8],
    found: &mut Vec<String>,
) {
    let mut bytes = Vec::new();
    for (i, row) in rows.iter().enumerate() {
        let field = row["field"].as_str();
        same(found, &format!("{name}: order"), number(&row["order"]), i as u64);
        let part = expected.get(field).cloned().unwrap_or_default();
        let width = number(&row["width"]);
        if width != u64::MAX {
            same(found, &format!("{name}.{field}: width"), width, part.len() as u64);
        }
        bytes.extend(part);
    }
    same(found, name, bytes, written.to_vec());
    same(found, &format!("{name}: rows"), rows.len(), expected.len());
}

/// Fields that the sources name in errors, and fields that the error table names.
fn errors(tables: &Tables, found: &mut Vec<String>) {
    let mut code = BTreeSet::new();
    sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut code);
    for (table, prefix) in [
        ("head", "manifest"),
        ("epoch", "epoch"),
        ("window", "window"),
        ("cluster", "cluster"),
        ("motion", "motion"),
        ("repair", "repair"),
    ] {
        code.extend(tables[table].iter().map(|r| format!("{prefix}.{}", r["field"])));
        if !matches!(table, "head" | "motion") {
            code.insert(format!("{prefix}.reserved"));
        }
    }
    let spec: Vec<&str> = tables["errors"].iter().flat_map(|r| r["fields"].split(' ')).collect();
    let once: BTreeSet<String> = spec.iter().map(|&f| f.to_owned()).collect();
    same(found, "errors: each field once", spec.len(), once.len());
    for field in code.difference(&once) {
        found.push(format!("errors: {field} is in the code and not in SPEC.md"));
    }
    for field in once.difference(&code) {
        found.push(format!("errors: {field} is in SPEC.md and not in the code"));
    }
    for row in &tables["errors"] {
        for kind in row["kinds"].split(", ").filter(|k| !k.is_empty()) {
            let known = tables["error kinds"].iter().any(|r| r["kind"] == kind);
            same(found, &format!("errors: kind {kind}"), true, known);
        }
    }
}

/// String literals outside tests and comments that look like field names.
fn sources(folder: &Path, fields: &mut BTreeSet<String>) {
    const WHOLE: [&str; 10] =
        ["manifest", "packet", "slice", "extent", "chunk", "body", "pack", "receipt", "frame", "buffer"];
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, fields);
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let text = text.split("#[cfg(test)]").next().unwrap();
        for line in text.lines().filter(|l| !l.trim_start().starts_with("//")) {
            for literal in line.split('"').skip(1).step_by(2) {
                let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
                let dotted = literal.split_once('.').is_some_and(|(a, b)| {
                    !a.is_empty() && !b.is_empty() && a.chars().all(plain) && b.chars().all(plain)
                });
                if dotted || WHOLE.contains(&literal) {
                    fields.insert(literal.to_owned());
                }
            }
        }
    }
}

#[test]
fn tables_and_code_agree() {
    let found = differences(&tables(&text()));
    assert!(found.is_empty(), "{} differences:\n{}", found.len(), found.join("\n"));
}

#[test]
fn the_example_packet_is_what_it_says() {
    let text = text();
    let line = text.lines().find(|l| l.starts_with("    a2 ")).unwrap();
    let bytes: Vec<u8> = line.split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap()).collect();
    let Ok(Packet::Slices(packet)) = Packet::parse(&bytes) else { panic!("slices") };
    let extent = Extent { span: Span::Canonical(EpochId(0)), level: Level::ALL[2], first: 300, blocks: 4 };
    assert_eq!(packet.extents.as_slice(), [extent]);
    assert_eq!((packet.id.get(), packet.body), (0x01_02_03, &[0xaa, 0xbb][..]));
}

/// Each of these is wrong in one place, and is found there.
#[test]
fn a_wrong_table_is_found() {
    let text = text();
    for (right, wrong, named) in [
        ("| MAX_EXTENTS | 16 |", "| MAX_EXTENTS | 17 |", "MAX_EXTENTS"),
        ("| 16 | 4 | packets | u32 |", "| 20 | 4 | packets | u32 |", "head.packets"),
        ("| 2 | 2 | frames | u16 | 1..=64,", "| 2 | 4 | frames | u16 | 1..=64,", "window.frames"),
        ("| 1 | 1 | sh_degree | u8 | 0..=3 |", "| 1 | 1 | sh_degree | u8 | 0..=4 |", "manifest.sh_degree"),
        ("| track_shift | u8 | 0..=24 |", "| track_shift | u8 | 0..=23 |", "motion.track_shift"),
        ("| 8 | 4 | raw_len |", "| 8 | 2 | raw_len |", "sealed.raw_len"),
        (
            "| 12 | 2 | payload_len | u16 | 1..=1200 |",
            "| 12 | 2 | payload_len | u16 | 1..=1201 |",
            "chunk.payload_len",
        ),
        ("| 2 | 1 | motion |", "| 3 | 1 | motion |", "extent flag motion"),
        ("| Sh2 | 6 | 15 | 2 |", "| Sh2 | 6 | 15 | 1 |", "class"),
        ("| track | 40 | 12 |", "| track | 40 | 11 |", "track stream"),
        ("| 1 | 3R + 11T + H |", "| 1 | 3R + 10T + H |", "paper level 1"),
        ("| 3 | 2 | escape |", "| 4 | 2 | escape |", "table.escape"),
        ("1.6666667e-1", "1.6666666e-1", "exp("),
        ("-1.388888888888889e-3", "-1.388898888888889e-3", "cospi("),
        ("| 2 | 8 | playout_us |", "| 2 | 4 | playout_us |", "receipt.playout_us"),
        ("| 9 | 4 | index_len |", "| 9 | 2 | index_len |", "file.index_len"),
        ("| 1 | 0x", "| 2 | 0x", "coefficient(2, "),
        ("| checksum | 3 |", "| checksum | 4 |", "checksum"),
        ("| manifest.magic manifest.version", "| manifest.version", "manifest.magic"),
        ("| parity | 0b110 |", "| parity | 0b111 |", "kind parity"),
    ] {
        assert!(text.contains(right), "{right}");
        let found = differences(&tables(&text.replacen(right, wrong, 1)));
        assert!(found.iter().any(|f| f.contains(named)), "{wrong}: {found:?}");
    }
    let lines: Vec<&str> = text.lines().collect();
    let at = lines.iter().position(|l| l.starts_with("| quants | quants |")).unwrap();
    let mut swapped = lines.clone();
    swapped.swap(at, at - 1);
    let found = differences(&tables(&swapped.join("\n")));
    assert!(found.iter().any(|f| f.contains("sections")), "{found:?}");
}
