//! The manifest's tables against the code: limits, records, their ranges, sections, the envelope.

use std::{collections::BTreeMap, path::Path};

use codec_core::{
    ErrorKind,
    internals::{
        ids::{Level, PacketId, WindowId},
        limits, math,
        quant::{Class, Quantiser},
        rans::{bytes, lanes, table},
        wire::{
            crc::crc32,
            manifest::{
                self, Cluster, Epoch, Head, MAX_TABLE_SET_BITS, Manifest, ManifestHead, Motion, Quant,
                Repair, TableSet, Track, Window, stream,
            },
        },
    },
};

use crate::tables::{Tables, at, contiguous, number, range, same};

pub fn limits_of(tables: &Tables, found: &mut Vec<String>) {
    let code = [
        ("MAX_PAYLOAD_BYTES", limits::MAX_PAYLOAD_BYTES as u64),
        ("DEFAULT_PACKET_BYTES", limits::DEFAULT_PACKET_BYTES as u64),
        ("MAX_PACKET_BYTES", limits::MAX_PACKET_BYTES as u64),
        ("MAX_DEPENDENCIES", limits::MAX_DEPENDENCIES as u64),
        ("MAX_PACKET_VALUES", limits::MAX_PACKET_VALUES.into()),
        ("MAX_PACKET_BLOCKS", limits::MAX_PACKET_BLOCKS.into()),
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
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/internals/limits.rs"))
            .unwrap();
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

pub fn records(tables: &Tables, found: &mut Vec<String>) {
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
                proxies = A, drawing = A, basis_values = C, transform_values = C,
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
                kind = A, track_shift = A, track = A, position = A, scale = A, rotation = A, opacity = A,
                sh0 = A,
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

/// A small whole `dgs1` body by section: one epoch, window, cluster, repair range and table.
pub fn small_body() -> BTreeMap<&'static str, Vec<u8>> {
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

pub fn small_table() -> table::Table {
    let mut frequency = [0u16; 256];
    (frequency[0], frequency[127], frequency[129]) = (8, 1024, 1016);
    table::Table::new(frequency, 2).unwrap()
}

/// The small body in the order of the spec's section table, and where its sections start.
pub fn assembled(tables: &Tables) -> (Vec<u8>, BTreeMap<String, usize>) {
    let (mut body, mut starts) = (Vec::new(), BTreeMap::new());
    let parts = small_body();
    for row in &tables["sections"] {
        starts.insert(row["section"].clone(), body.len());
        body.extend_from_slice(parts.get(row["section"].as_str()).map_or(&[][..], Vec::as_slice));
    }
    (body, starts)
}

pub fn sections(tables: &Tables, found: &mut Vec<String>) {
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
            same(found, "basis", Some(300.0 / 16384.0), manifest.basis(window.basis_first as usize + 2));
            let table =
                manifest.tables().next().and_then(Result::ok).map(|t| (t.frequency(127), t.raw_bits()));
            same(found, "tables", Some((1024, 2)), table);
            same(found, "transforms", Some(1.5), manifest.transform_value(0));
        }
    }
}

/// Pokes a value under and over each `a..=b` into a real manifest: it must be refused by name.
pub fn ranges(tables: &Tables, found: &mut Vec<String>) {
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

pub fn sealed(tables: &Tables, found: &mut Vec<String>) {
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
                ManifestHead::parse(&changed).err().is_some_and(|e| e.field.ends_with(row["field"].as_str()));
            same(found, &format!("sealed.{} = {value} refused", row["field"]), refused, error);
        }
    }
}
