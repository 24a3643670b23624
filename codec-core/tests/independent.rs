//! Another reader and writer of streams, repair sets and receipts, written from `SPEC.md` alone: nothing
//! of the crate decides here. The crate's own writers and golden streams are its input. It also makes
//! the golden streams named `made-…`, of what the encoder never writes.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

#[path = "independent/lanes.rs"]
mod lanes;
#[path = "independent/made.rs"]
mod made;
#[path = "independent/model.rs"]
mod model;
#[path = "independent/pack.rs"]
mod pack;
#[path = "independent/packet.rs"]
mod packet;
#[path = "independent/paper.rs"]
mod paper;
#[allow(dead_code, reason = "the tests of golden streams use the rest")]
#[path = "conformance/session.rs"]
mod session;
#[path = "independent/table.rs"]
mod table;

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use codec_core::internals::{
    ids::{ClusterId, EpochId, Group, Level, PacketId, Span, WindowId},
    wire::receipt::{Value, ViewerPose},
};

use model::Model;

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

/// Products and quotients of section 11.2, by logarithms to base 2.
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

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conformance")
}

/// Names and bytes of all golden streams.
fn golden() -> Vec<(String, Vec<u8>)> {
    let index = std::fs::read_to_string(folder().join("index.txt")).unwrap();
    let names = index.lines().map(|line| line.split(" | ").next().unwrap().to_owned());
    names.map(|name| (name.clone(), std::fs::read(folder().join(format!("{name}.dgs"))).unwrap())).collect()
}

/// The unpacked body of a manifest message.
fn body(message: &[u8]) -> Vec<u8> {
    assert_eq!(&message[4..8], [2, 0, 0, 0]);
    let (raw, packed) = (u32_at(message, 8), u32_at(message, 12));
    assert_eq!(message.len(), 16 + packed + 4);
    pack::unpack(&message[16..16 + packed], raw)
}

/// The repair ranges of a body: section 5.3, either profile.
fn repairs(body: &[u8]) -> Vec<[usize; 6]> {
    let head = &body[..44];
    let is_dgs1 = head[0] == 1;
    let (epochs, windows, clusters) = (u16_at(head, 20), u16_at(head, 22), u32_at(head, 24));
    let window_epoch = |w: usize| u16_at(body, 44 + 52 * epochs + 20 * w);
    let cells: usize = (0..windows).map(|w| u32_at(body, 44 + 52 * window_epoch(w) + 16)).sum();
    let streams = if is_dgs1 { 87 * 13 } else { 0 };
    let at = 44 + 52 * epochs + 20 * windows + 12 * clusters + 8 * cells + 104 * u16_at(head, 28) + streams;
    let range = |r: &[u8]| {
        [u32_at(r, 0), u32_at(r, 4), u32_at(r, 8), usize::from(r[12]), usize::from(r[13]), u16_at(r, 14)]
    };
    body[at..at + 16 * u16_at(head, 32)].chunks(16).map(range).collect()
}

/// Manifests and bodies are read, and written again to the bytes they came from; symbols are the crate's.
#[test]
fn every_golden_manifest_and_packet_is_read_and_written_again() {
    let (mut bodies, mut shortened) = (0, 0);
    for (name, bytes) in golden() {
        let (message, packets) = read_file(&bytes);
        let raw = body(message);
        assert_eq!(pack::pack(&raw), &message[16..message.len() - 4], "{name}");
        if raw[0] != 1 {
            continue;
        }
        let model = Model::read(&raw);
        assert_eq!(model.body(), raw, "{name}");
        let mut store = Store::new(&model);
        for bytes in packets.iter().filter(|packet| packet[0] >> 5 == 0b101) {
            let packet = packet::read(&model, bytes);
            assert!(packet.write(&model) == *bytes, "{name}: packet {}", packet.id);
            shortened += usize::from(packet.has_shortened_tail(&model));
            store.keep(&model, &packet);
            bodies += 1;
        }
        let received = session::Session::open(message).after(&packets);
        assert!(received.symbols[..store.symbols.len()] == store.symbols, "{name}");
    }
    // A lane that starts anew may fill up inside the tail and shorten it: rare, so it is counted.
    assert!(bodies > 200 && shortened > 0, "{bodies} bodies, {shortened} with a shortened tail");
}

/// All symbols of a stream, in the order of section 7.4.
struct Store {
    symbols: Vec<i16>,
    /// Where each span's cells begin.
    starts: Vec<Vec<usize>>,
}

impl Store {
    fn new(model: &Model) -> Self {
        let (mut starts, mut end) = (Vec::new(), 0);
        for (motion, span) in model.spans() {
            let mut own = Vec::new();
            for cell in model.cells(motion, span) {
                own.push(end);
                end += (0..4).map(|level| cell.symbols(level, 0..cell.blocks())).sum::<usize>();
            }
            starts.push(own);
        }
        Self { symbols: vec![0; end], starts }
    }

    fn keep(&mut self, model: &Model, packet: &packet::Packet) {
        let mut values = packet.values.iter();
        for extent in &packet.extents {
            let wanted = (extent.motion, extent.span);
            let span = model.spans().into_iter().position(|span| span == wanted).unwrap();
            for (c, cell, blocks) in packet::slices(model, extent) {
                let below: usize = (0..extent.level).map(|level| cell.symbols(level, 0..cell.blocks())).sum();
                let before =
                    if cell.is_track(extent.level) { 0 } else { cell.symbols(extent.level, 0..blocks.start) };
                let at = self.starts[span][c] + below + before;
                let n = cell.symbols(extent.level, blocks);
                self.symbols[at..at + n].iter_mut().zip(&mut values).for_each(|(to, from)| *to = *from);
            }
        }
        assert!(values.next().is_none());
    }
}

#[test]
fn made_streams_are_the_committed_files_and_have_what_no_other_has() {
    let made = made::all();
    for (name, exercises, bytes) in &made {
        let committed = std::fs::read(folder().join(format!("{name}.dgs"))).unwrap();
        assert!(committed == *bytes, "{name}");
        let index = std::fs::read_to_string(folder().join("index.txt")).unwrap();
        assert!(index.contains(&format!("{name} | {exercises} | ")), "{name}");
    }
    let mut features = BTreeSet::new();
    for (_, _, bytes) in made.iter().filter(|(_, _, bytes)| is_dgs1(bytes)) {
        features.extend(features_of(bytes));
    }
    for (name, bytes) in golden().into_iter().filter(|(name, _)| !name.starts_with("made-")) {
        let others: BTreeSet<_> = if is_dgs1(&bytes) { features_of(&bytes) } else { BTreeSet::new() };
        let both: Vec<_> = features.intersection(&others).collect();
        assert!(both.is_empty(), "{name} has {both:?} too");
    }
    let wanted = [
        "bands above 3 of a track",
        "levels left out of a cluster",
        "levels left out of a motion cell",
        "more than 3 table choices",
        "more than 5 raw bits",
        "no proxies",
        "several extents",
        "unpredicted Opacity",
        "unpredicted Position",
        "unpredicted moving class",
    ];
    assert_eq!(features, wanted.into_iter().collect());
}

fn is_dgs1(file: &[u8]) -> bool {
    body(read_file(file).0)[0] == 1
}

/// What of the rare features a `dgs1` file uses in a packet.
fn features_of(bytes: &[u8]) -> BTreeSet<&'static str> {
    let (message, packets) = read_file(bytes);
    let model = Model::read(&body(message));
    let mut features = BTreeSet::new();
    features.extend(model.proxies.is_none().then_some("no proxies"));
    for bytes in packets.iter().filter(|packet| packet[0] >> 5 == 0b101) {
        let packet = packet::read(&model, bytes);
        features.extend((packet.extents.len() > 1).then_some("several extents"));
        for ((stream, _), choice) in packet::runs(&model, &packet.extents).iter().zip(&packet.choices) {
            let table = &model.tables[usize::from(model.table_sets[*stream][*choice].0)];
            features.extend((*choice > 2).then_some("more than 3 table choices"));
            features.extend((table.raw_bits > 5).then_some("more than 5 raw bits"));
            features
                .extend(((40..52).contains(stream) && stream % 4 > 1).then_some("bands above 3 of a track"));
        }
        for extent in &packet.extents {
            for (_, cell, _) in packet::slices(&model, extent) {
                match cell.motion {
                    Some(motion) => {
                        features.extend((motion.left_out > 0).then_some("levels left out of a motion cell"));
                        let plain =
                            (0..5).any(|c| motion.coefficients[c] > 0 && cell.quant[8 + c].flags & 1 == 0);
                        features.extend(plain.then_some("unpredicted moving class"));
                    }
                    None => {
                        features
                            .extend((cell.cluster.left_out > 0).then_some("levels left out of a cluster"));
                        // A block of one Gaussian has nothing to predict from.
                        let many = cell.gaussians(0) > 1;
                        let plain = |class: usize| many && cell.quant[class].flags & 1 == 0;
                        features.extend(plain(0).then_some("unpredicted Position"));
                        features.extend(plain(3).then_some("unpredicted Opacity"));
                    }
                }
            }
        }
    }
    features
}

#[test]
#[ignore = "writes committed files"]
fn write_made_streams() {
    let index = std::fs::read_to_string(folder().join("index.txt")).unwrap();
    let others = index.lines().filter(|line| !line.starts_with("made-"));
    let mut lines: Vec<String> = others.map(str::to_owned).collect();
    for (name, exercises, bytes) in made::all() {
        std::fs::write(folder().join(format!("{name}.dgs")), &bytes).unwrap();
        lines.push(session::Line::of(name, exercises, &bytes).text());
    }
    std::fs::write(folder().join("index.txt"), lines.join("\n") + "\n").unwrap();
}

#[test]
fn every_set_of_the_golden_streams_gives_back_as_many_packets_as_it_has_parity() {
    let field = Field::new();
    let mut solved = 0;
    for (name, bytes) in golden() {
        let (message, packets) = read_file(&bytes);
        assert!(packets.iter().all(|p| fits(p)), "{name}");
        for [first, n, first_parity, set_len, rows, longest] in repairs(&body(message)) {
            let sets = n.div_ceil(set_len);
            for set in 0..sets {
                let ids: Vec<usize> = (0..n).filter(|j| j % sets == set).map(|j| j + first).collect();
                let parity = |i: usize| packets[first_parity + i * sets + set];
                let drop = rows.min(ids.len());
                let missing = |j: usize| j.is_multiple_of(2) && j / 2 < drop;
                let member = |(j, &id): (usize, &usize)| (!missing(j)).then_some(packets[id]);
                let members: Vec<Option<&[u8]>> = ids.iter().enumerate().map(member).collect();
                let lost: Vec<&[u8]> =
                    ids.iter().enumerate().filter(|(j, _)| missing(*j)).map(|(_, &id)| packets[id]).collect();
                let rows: Vec<Option<&[u8]>> = (0..rows).map(|i| Some(parity(i))).collect();
                assert!(rows.iter().flatten().all(|row| row[0] == 0xc0));
                let found = repair(&field, &members, &rows, longest);
                assert_eq!(found, lost, "{name}, set {set}");
                assert!(ids.iter().map(|&id| packets[id].len()).max().unwrap() <= longest);
                solved += lost.len();
            }
        }
    }
    assert!(solved > 15, "{solved}");
}

/// Section 13.
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
