//! Golden streams that the encoder does not write, made of what no other stream has: packets of many
//! extents, levels left out, full table sets, long tracks, unpredicted classes, `paper` in short chunks.

use crate::{
    crc,
    model::{Cluster, Epoch, Model, Motion, Quantiser, Window},
    packet::{self, Extent, Packet},
    paper,
    table::Table,
};

/// Name, what it exercises, bytes of the file.
pub fn all() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    vec![
        ("made-extents", "up to sixteen extents in a packet, two epochs, levels and spans mixed", extents()),
        ("made-levels-left-out", "levels left out of clusters and motion cells, no proxies", left_out()),
        ("made-table-sets", "sets of up to eight tables, up to eight raw bits, escapes", table_sets()),
        (
            "made-long-tracks",
            "tracks of up to 24 coefficients in every band, held and static ones",
            long_tracks(),
        ),
        (
            "made-unpredicted",
            "no class predicted, ratios of 1, 5 and 9, centres away from the origin",
            unpredicted(),
        ),
        (
            "made-paper",
            "profile paper: two epochs, several degrees, groups in many short chunks that are apart",
            paper::made(false),
        ),
        ("made-paper-context", "the same with the context coder", paper::made(true)),
    ]
}

/// A sequence of numbers that look random (splitmix64).
pub struct TestRng(pub u64);

impl TestRng {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// A number in `-most..=most`.
    pub fn within(&mut self, most: i64) -> i64 {
        (self.next() % (2 * most as u64 + 1)) as i64 - most
    }
}

/// Quantisers whose steps suit a scene of a few units; `flags` of canonical and of moving classes.
fn quant(ratio: [u8; 3], canonical: [u8; 8], moving: u8) -> [Quantiser; 13] {
    const STEPS: [f32; 8] = [0.01, 0.02, 0.02, 0.01, 0.03, 0.02, 0.02, 0.02];
    std::array::from_fn(|i| {
        let (class, flags) = if i < 8 { (i, canonical[i]) } else { (i - 8, moving) };
        // One refinement of moving classes is left away: a level without symbols between two with.
        let ratio = if i < 8 { ratio } else { [ratio[0], 1, ratio[2]] };
        Quantiser { step: STEPS[class], ratio, flags }
    })
}

/// One table for symbols around zero and one for wide ones, in every stream.
fn two_tables(model: &mut Model) {
    model.tables = vec![Table::named(18), Table::named(100)];
    model.table_sets = vec![vec![(0, 1), (1, 1)]; 87];
}

/// A cluster of `gaussians` of harmonic degree `degree`.
fn cluster(gaussians: u16, degree: u8) -> Cluster {
    Cluster { gaussians, degree, radius: 12, ..Cluster::default() }
}

/// The learned basis of a window: `rank` waves.
fn window(frames: u16, rank: u8, motions: Vec<Motion>) -> Window {
    let wave = |r: u8, t: u16| ((i32::from(t) * 37 * (i32::from(r) + 1)) % 97 - 48) * 200;
    let basis = (0..rank).flat_map(|r| (0..frames).map(move |t| wave(r, t) as i16)).collect();
    Window { frames, rank, basis, motions }
}

/// A model without content.
fn empty(block_len: u16, sh_degree: u8) -> Model {
    let mut model = Model { block_len, sh_degree, rate: (25, 1), ..Model::default() };
    two_tables(&mut model);
    model
}

fn extents() -> Vec<u8> {
    let mut model = empty(4, 1);
    model.quants = vec![quant([3; 3], [1, 2, 0, 1, 3, 0, 0, 0], 1)];
    let rigid = Motion {
        track: 1,
        shift: 3,
        track_coefficients: 2,
        coefficients: [1, 0, 0, 1, 0],
        ..Motion::default()
    };
    let still = Motion::default();
    let waves = Motion { coefficients: [2, 1, 1, 0, 1], ..Motion::default() };
    for (frames, degree) in [(6, 1), (5, 0)] {
        let clusters = vec![cluster(13, degree), cluster(9, 0), cluster(6, degree)];
        let windows =
            vec![window(3, 2, vec![rigid, still, waves]), window(frames - 3, 1, vec![rigid, still, still])];
        model.epochs.push(Epoch { frames: frames.into(), origin: [0.5, -1.0, 2.0], clusters, windows });
    }
    proxies(&mut model);
    file(model, 16, 3)
}

fn left_out() -> Vec<u8> {
    let mut model = empty(8, 3);
    model.quants = vec![quant([3, 5, 3], [1, 0, 1, 0, 0, 2, 0, 2], 0)];
    let clusters = (0..4).map(|left_out| Cluster { left_out, ..cluster(17, 3) }).collect();
    let motions = (0..4)
        .map(|left_out| Motion {
            track: left_out % 3,
            track_coefficients: u8::from(left_out % 3 > 0),
            left_out: 3 - left_out,
            shift: 2,
            coefficients: [1, 0, 1, 1, 0],
        })
        .collect();
    model.epochs =
        vec![Epoch { frames: 4, origin: [0.0; 3], clusters, windows: vec![window(4, 1, motions)] }];
    file(model, 1, 4)
}

fn table_sets() -> Vec<u8> {
    let mut model = empty(5, 2);
    model.quants = vec![quant([7, 3, 3], [1, 0, 0, 0, 3, 0, 0, 0], 1)];
    // Flat tables of 4, 2 and 8 tokens around zero with 8, 7 and 6 raw bits: wide values without escapes.
    let flat = |raw_bits: u8, tokens: u8| {
        let each = 2040 / u16::from(tokens);
        Table::own(raw_bits, 128 - tokens / 2, 2048 - each * u16::from(tokens), &vec![each; tokens.into()])
    };
    // The last has frequencies of its own and no escape: it codes 0 in next to no bits and ±1.
    let sure = Table::own(0, 127, 0, &[1, 2046, 1]);
    let named = [5, 30, 53, 90, 117, 128, 150, 172].map(Table::named);
    model.tables = [vec![flat(8, 4), flat(7, 2), flat(6, 8), sure], named.to_vec()].concat();
    let lengths: [&[u8]; 5] = [&[0], &[1, 1], &[2, 2, 2, 2], &[1, 2, 3, 4, 5, 6, 7, 7], &[3; 8]];
    let set = |stream: usize| {
        let lengths = lengths[stream % 5].iter().enumerate();
        // Every set has a table that codes all values.
        lengths.map(|(i, &length)| (if i == 0 { 2 } else { (stream + 5 * i) as u8 % 12 }, length)).collect()
    };
    model.table_sets = (0..87).map(set).collect();
    let motions = vec![
        Motion {
            track: 2,
            shift: 1,
            track_coefficients: 3,
            coefficients: [2, 0, 0, 2, 1],
            ..Motion::default()
        };
        2
    ];
    let clusters = vec![cluster(33, 2), cluster(17, 1)];
    model.epochs =
        vec![Epoch { frames: 6, origin: [1.0; 3], clusters, windows: vec![window(6, 3, motions)] }];
    proxies(&mut model);
    file(model, 2, 5)
}

fn long_tracks() -> Vec<u8> {
    let mut model = empty(32, 0);
    model.quants = vec![quant([3; 3], [1, 2, 0, 0, 3, 0, 0, 0], 1)];
    let track =
        |track, track_coefficients, shift| Motion { track, track_coefficients, shift, ..Motion::default() };
    let windows = vec![
        window(24, 0, vec![track(1, 24, 4), track(2, 12, 5), track(2, 8, 3), track(0, 0, 0)]),
        window(24, 0, vec![track(1, 7, 5), track(0, 0, 0), track(2, 5, 4), track(1, 4, 6)]),
        window(9, 0, vec![track(2, 9, 4), track(1, 1, 5), track(1, 3, 4), track(1, 9, 24)]),
    ];
    let clusters = vec![cluster(9, 0), cluster(9, 0), cluster(9, 0), cluster(3, 0)];
    model.epochs = vec![Epoch { frames: 57, origin: [-3.0, 0.0, 1.5], clusters, windows }];
    proxies(&mut model);
    file(model, 1, 6)
}

fn unpredicted() -> Vec<u8> {
    let mut model = empty(10, 1);
    model.quants = vec![quant([5, 1, 9], [0; 8], 0), quant([1, 9, 3], [0; 8], 0)];
    let moving = Motion {
        track: 1,
        track_coefficients: 2,
        shift: 4,
        coefficients: [2, 2, 2, 2, 2],
        ..Motion::default()
    };
    let at = |centre, quant| Cluster { centre, quant, radius: 300, ..cluster(25, 1) };
    let clusters = vec![at([-40, 7, 90], 0), at([32, -700, 3], 1)];
    let windows = vec![window(7, 2, vec![moving; 2])];
    model.epochs = vec![Epoch { frames: 7, origin: [10.0, 20.0, -30.0], clusters, windows }];
    proxies(&mut model);
    file(model, 2, 7)
}

/// Gives every canonical block a proxy, among them sizes and opacities beyond what counts.
fn proxies(model: &mut Model) {
    let block_len = model.block_len;
    let blocks: usize = model
        .epochs
        .iter()
        .flat_map(|e| &e.clusters)
        .map(|c| usize::from(c.gaussians.div_ceil(block_len)))
        .sum();
    let mut rng = TestRng(11);
    let byte = |i: usize, number: u64| match i / blocks {
        3..6 | 12 => number as u8 % 70,
        _ => number as u8,
    };
    model.drawing = 2;
    model.proxies = Some((0..13 * blocks).map(|i| byte(i, rng.next())).collect());
}

/// The whole file: symbols from `seed`, packets of at most `most` extents.
fn file(mut model: Model, most: usize, seed: u64) -> Vec<u8> {
    let mut rng = TestRng(seed);
    let packets = packets(&model, most, &mut rng);
    model.packets = packets.len() as u32;
    let packets: Vec<Vec<u8>> = packets.iter().map(|packet| packet.write(&model)).collect();
    file_of(&model.body(), &packets)
}

/// The whole file of a manifest body and packets.
pub fn file_of(raw: &[u8], packets: &[Vec<u8>]) -> Vec<u8> {
    let message = paper::message(raw);
    let mut out = b"DGS\x01".to_vec();
    out.extend((message.len() as u32).to_le_bytes());
    out.extend(message);
    let mut index = b"DGSX".to_vec();
    index.extend((packets.len() as u32).to_le_bytes());
    for bytes in packets {
        index.extend((out.len() as u32).to_le_bytes());
        assert!(bytes.len() <= 1280);
        out.extend((bytes.len() as u16).to_le_bytes());
        out.extend(bytes);
    }
    index.extend(crc(&index).to_le_bytes());
    index.extend((index.len() as u32 + 4).to_le_bytes());
    out.extend([0, 0]);
    out.extend(index);
    out
}

/// All symbols of `model` in packets: bases first, tracks next, refinements behind.
fn packets(model: &Model, most: usize, rng: &mut TestRng) -> Vec<Packet> {
    let mut pieces: Vec<Extent> =
        model.spans().into_iter().flat_map(|span| pieces(model, span, 16 / most)).collect();
    pieces.sort_by_key(|extent| extent.level);
    // Neighbours go to different packets, so that the extents of one are apart.
    let count = pieces.len().div_ceil(most);
    let mut packets = Vec::new();
    for id in 0..count {
        let extents: Vec<Extent> = pieces.iter().copied().skip(id).step_by(count).collect();
        packets.push(packet(model, id as u32, extents, rng));
    }
    packets
}

/// The blocks of a span at all levels, at most `most` or three in each extent; extents of tracks hold whole
/// clusters.
fn pieces(model: &Model, (motion, span): (bool, usize), most: usize) -> Vec<Extent> {
    let mut pieces = Vec::new();
    for level in 0..4 {
        let mut first = 0;
        for cell in model.cells(motion, span) {
            let step = if cell.is_track(level) { cell.blocks() } else { most.min(3) };
            for start in (0..cell.blocks()).step_by(step) {
                let blocks = step.min(cell.blocks() - start);
                if cell.symbols(level, start..start + blocks) > 0 {
                    pieces.push(Extent { motion, span, level, first: first + start, blocks });
                }
            }
            first += cell.blocks();
        }
    }
    pieces
}

/// A packet of symbols whose size suits their level, with every choice of table that codes them.
fn packet(model: &Model, id: u32, extents: Vec<Extent>, rng: &mut TestRng) -> Packet {
    let (mut choices, mut values) = (Vec::new(), Vec::new());
    for extent in &extents {
        for (stream, n) in packet::runs(model, std::slice::from_ref(extent)) {
            let most = match (extent.motion, extent.level) {
                (false, 0) => 30,
                (true, 0) => 100,
                _ => 2,
            };
            // Now and then a symbol far out, which few tables code without an escape.
            let far = |rng: &mut TestRng| if rng.next().is_multiple_of(61) { 20 } else { 1 };
            let own: Vec<i16> = (0..n).map(|_| (rng.within(most) * far(rng)) as i16).collect();
            let set = &model.table_sets[stream];
            let codes = |choice: &usize| {
                let table = &model.tables[usize::from(set[*choice].0)];
                own.iter().all(|&value| table.codes(value))
            };
            let able: Vec<usize> = (0..set.len()).filter(codes).collect();
            choices.push(able[rng.next() as usize % able.len()]);
            values.extend(own);
        }
    }
    Packet { id, extents, choices, values }
}
