//! Profile `paper` with both of its coders, from `SPEC.md` sections 5.3, 6.1 and 10: reads and writes
//! chunks, and writes the golden streams that several epochs and short chunks make.

use crate::{
    body as body_of, crc, golden, is_dgs1, made::TestRng, pack::pack, read_file, session, u16_at, u32_at,
};

/// Which Gaussians a stream has, and how its chunks are coded.
pub struct Paper {
    pub is_context: bool,
    pub epochs: Vec<Epoch>,
    /// The byte tables of the manifest, in order; none for the context coder.
    tables: Vec<[usize; 256]>,
}

pub struct Epoch {
    pub frames: usize,
    pub rank: usize,
    /// Gaussians and harmonic degree of each cluster.
    pub clusters: Vec<(usize, usize)>,
}

/// A chunk, decoded.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk {
    pub id: usize,
    pub cluster: usize,
    pub level: usize,
    pub first: usize,
    pub values: Vec<i16>,
}

impl Paper {
    /// Section 5.3.
    pub fn read(body: &[u8]) -> Self {
        let is_context = body[0] == 2;
        let (epochs, clusters) = (u16_at(body, 20), u32_at(body, 24));
        let first_cluster = 44 + 52 * epochs;
        let cluster = |c: usize| {
            let record = &body[first_cluster + 12 * c..];
            (u16_at(record, 0), usize::from(record[3] & 3))
        };
        let epoch = |e: usize| {
            let record = &body[44 + 52 * e..];
            let (first, n) = (u32_at(record, 12), u32_at(record, 16));
            let clusters = (first..first + n).map(cluster).collect();
            Epoch { frames: u32_at(record, 4), rank: record[48].into(), clusters }
        };
        let values = u32_at(body, 36) + u32_at(body, 40);
        let at = first_cluster + 12 * clusters + 104 * u16_at(body, 28) + 16 * u16_at(body, 32) + 4 * values;
        let count = if is_context { 0 } else { 8 * clusters };
        let table = |t: usize| std::array::from_fn(|b| u16_at(body, at + 512 * t + 2 * b));
        Self { is_context, epochs: (0..epochs).map(epoch).collect(), tables: (0..count).map(table).collect() }
    }

    /// Section 10.2: symbols of each level of cluster `cluster`, counted over all epochs.
    pub fn sizes(&self, cluster: usize) -> [usize; 4] {
        let (epoch, (n, degree), _) = self.find(cluster);
        let (frames, bands) = (epoch.frames, 3 * ((degree + 1) * (degree + 1) - 1));
        [14 * n, n * (3 * epoch.rank + 11 * frames + bands), 14 * n * frames, 14 * n * frames]
    }

    /// The epoch of a cluster, its Gaussians and degree, and the epoch's first frame.
    fn find(&self, cluster: usize) -> (&Epoch, (usize, usize), usize) {
        let (mut before, mut frame) = (0, 0);
        for epoch in &self.epochs {
            if let Some(&found) = epoch.clusters.get(cluster - before) {
                return (epoch, found, frame);
            }
            before += epoch.clusters.len();
            frame += epoch.frames;
        }
        panic!("no cluster {cluster}");
    }

    /// Section 6.1, then 10.3 or 10.5.
    pub fn read_chunk(&self, bytes: &[u8]) -> Chunk {
        let (level, cluster) = (usize::from(bytes[0] & 3), u16_at(bytes, 4));
        let (words, first) = (usize::from(bytes[11]), u32_at(bytes, 14));
        assert_eq!(words, usize::from(level > 0));
        let payload = &bytes[22 + 4 * words..bytes.len() - 4];
        assert_eq!(payload.len(), u16_at(bytes, 12));
        let mut chunk = Chunk {
            id: u32_at(bytes, 1) & 0xff_ffff,
            cluster,
            level,
            first,
            values: vec![0; u16_at(bytes, 18)],
        };
        let mut coder = Coder::Reads { x: u32_at(payload, 0) as u64, rest: &payload[4..] };
        self.walk(&mut chunk, &mut coder);
        let Coder::Reads { x, rest } = coder else { panic!("a reader stays one") };
        assert!(x == 1 << 23 && rest.is_empty(), "a whole body");
        chunk
    }

    pub fn write_chunk(&self, chunk: &Chunk) -> Vec<u8> {
        let mut coder = Coder::Writes(Vec::new());
        self.walk(&mut chunk.clone(), &mut coder);
        let Coder::Writes(intervals) = coder else { panic!("a writer stays one") };
        let (mut x, mut backwards) = (1u64 << 23, Vec::new());
        for (start, slots) in intervals.into_iter().rev() {
            while x >= slots << 19 {
                backwards.push(x as u8);
                x >>= 8;
            }
            x = (x / slots) * 4096 + x % slots + start;
        }
        let mut payload = (x as u32).to_le_bytes().to_vec();
        payload.extend(backwards.iter().rev());
        assert!(payload.len() <= 1200);
        let (epoch, _, first_frame) = self.find(chunk.cluster);
        let mut out = vec![0x80 | chunk.level as u8];
        out.extend(&(chunk.id as u32).to_le_bytes()[..3]);
        for field in [chunk.cluster, first_frame, epoch.frames] {
            out.extend((field as u16).to_le_bytes());
        }
        out.extend([0, u8::from(chunk.level > 0)]);
        out.extend((payload.len() as u16).to_le_bytes());
        out.extend((chunk.first as u32).to_le_bytes());
        out.extend((chunk.values.len() as u16).to_le_bytes());
        out.extend([0, 0]);
        if chunk.level > 0 {
            out.extend((4 * chunk.cluster as u32 + chunk.level as u32 - 1).to_le_bytes());
        }
        out.extend(payload);
        out.extend(crc(&out).to_le_bytes());
        out
    }

    fn walk(&self, chunk: &mut Chunk, coder: &mut Coder<'_>) {
        if self.is_context {
            self.walk_decisions(chunk, coder);
            return;
        }
        for value in &mut chunk.values {
            let mut bytes = value.to_le_bytes();
            for (b, byte) in bytes.iter_mut().enumerate() {
                let table = &self.tables[(4 * chunk.cluster + chunk.level) * 2 + b];
                let below = |byte: usize| table[..byte].iter().sum::<usize>() as u64;
                let holds = |slot: u64| (0..256).rev().find(|&b| table[b] > 0 && below(b) <= slot).unwrap();
                let of = |byte: usize| (below(byte), table[byte] as u64);
                *byte = coder.pass(usize::from(*byte), holds, of) as u8;
            }
            *value = i16::from_le_bytes(bytes);
        }
    }

    /// Section 10.5.
    fn walk_decisions(&self, chunk: &mut Chunk, coder: &mut Coder<'_>) {
        let (epoch, (n, _), _) = self.find(chunk.cluster);
        let mut p = Probabilities { all: vec![(32_768, 0); 5 * 2 + 5 * 12 * 16 + 5 * 9 + 17 * 4] };
        let period = n * if chunk.level == 1 { 11 } else { 14 };
        for i in 0..chunk.values.len() {
            let component = (chunk.first + i) / n;
            let of_base = |c: usize| [0, 0, 0, 1, 1, 1, 2, 2, 2, 2, 3, 4, 4, 4][c % 14];
            let attribute = match chunk.level {
                1 if component < 3 * epoch.rank => 0,
                1 if component < 3 * epoch.rank + 11 * epoch.frames => {
                    of_base(3 + (component - 3 * epoch.rank) % 11)
                }
                1 => 4,
                _ => of_base(component),
            };
            let s = &chunk.values;
            let back = |d: usize| (i >= d).then(|| s[i - d]);
            let left = back(1).filter(|_| !(chunk.first + i).is_multiple_of(n));
            let before = back(period);
            let above = before.or(back(n));
            let repeats = left.is_some() && left == back(period + 1);
            let bits =
                |v: Option<i16>| v.map_or(0, |v| 32 - u32::from(v.unsigned_abs()).leading_zeros()) as usize;
            let sign = |v: Option<i16>| (v.unwrap_or(0).signum() + 1) as usize;
            let size = (bits(left) + bits(above)).min(11);
            let value = i32::from(s[i]);
            if let Some(before) = before {
                let which = 2 * attribute + usize::from(repeats);
                if !p.decide(which, coder, value != i32::from(before)) {
                    chunk.values[i] = before;
                    continue;
                }
            }
            let (longer, negative, below) = (10 + (12 * attribute + size) * 16, 970 + 9 * attribute, 1015);
            let wanted = bits(Some(value as i16));
            let mut length = 0;
            while length < 16 && p.decide(longer + length, coder, wanted > length) {
                length += 1;
            }
            if length == 0 {
                chunk.values[i] = 0;
                continue;
            }
            let minus = p.decide(negative + 3 * sign(left) + sign(above), coder, value < 0);
            let mut magnitude = 1usize;
            for bit in (0..length - 1).rev() {
                let wanted = value.unsigned_abs() >> bit & 1 == 1;
                let one = if magnitude < 4 {
                    p.decide(below + 4 * length + magnitude, coder, wanted)
                } else {
                    coder.bit(2048, wanted)
                };
                magnitude = 2 * magnitude + usize::from(one);
            }
            let found = magnitude as i32 * if minus { -1 } else { 1 };
            chunk.values[i] = i16::try_from(found).unwrap();
        }
    }
}

/// `no` and `seen` of each decision.
struct Probabilities {
    all: Vec<(u32, u32)>,
}

impl Probabilities {
    fn decide(&mut self, which: usize, coder: &mut Coder<'_>, wanted: bool) -> bool {
        let (no, seen) = &mut self.all[which];
        let bit = coder.bit(u64::from(*no / 16).clamp(1, 4095), wanted);
        let rate = [1, 2, 2, 3, 3, 3, 3, 4][(*seen).min(7) as usize];
        *no = if bit { *no - (*no >> rate) } else { *no + ((65_535 - *no) >> rate) };
        *seen += 1;
        bit
    }
}

/// One side of 10.3: a state and bytes, or the intervals that make them.
enum Coder<'b> {
    Reads { x: u64, rest: &'b [u8] },
    Writes(Vec<(u64, u64)>),
}

impl Coder<'_> {
    /// One symbol: `holds` finds it by its slot, `of` gives its start and slots.
    fn pass(
        &mut self,
        wanted: usize,
        holds: impl Fn(u64) -> usize,
        of: impl Fn(usize) -> (u64, u64),
    ) -> usize {
        match self {
            Self::Writes(intervals) => {
                intervals.push(of(wanted));
                wanted
            }
            Self::Reads { x, rest } => {
                let slot = *x % 4096;
                let symbol = holds(slot);
                let (start, slots) = of(symbol);
                *x = slots * (*x >> 12) + slot - start;
                while *x < 1 << 23 {
                    *x = *x << 8 | u64::from(rest[0]);
                    *rest = &rest[1..];
                }
                symbol
            }
        }
    }

    fn bit(&mut self, slots: u64, wanted: bool) -> bool {
        let of = |bit: usize| if bit == 1 { (slots, 4096 - slots) } else { (0, slots) };
        self.pass(wanted.into(), |slot| usize::from(slot >= slots), of) == 1
    }
}

/// A file of two epochs: clusters of several degrees, one epoch without a basis, groups in many short
/// chunks of which neighbours are far apart in the file.
pub fn made(is_context: bool) -> Vec<u8> {
    let epochs = vec![
        Epoch { frames: 5, rank: 2, clusters: vec![(7, 1), (19, 0)] },
        Epoch { frames: 3, rank: 0, clusters: vec![(1, 2), (12, 1), (5, 0)] },
    ];
    let mut paper = Paper { is_context, epochs, tables: Vec::new() };
    let mut rng = TestRng(9);
    let clusters: usize = paper.epochs.iter().map(|e| e.clusters.len()).sum();
    let mut groups: Vec<Vec<i16>> = Vec::new();
    for cluster in 0..clusters {
        for (level, len) in paper.sizes(cluster).into_iter().enumerate() {
            let most = [3000, 60, 25, 400][level];
            let value = |i: usize, rng: &mut TestRng| match (i % 7, rng.next() % 41) {
                (_, 0) if level == 1 => i16::MIN,
                (0..3, _) if level > 1 => 0,
                _ => rng.within(most) as i16,
            };
            groups.push((0..len).map(|i| value(i, &mut rng)).collect());
        }
    }
    if !is_context {
        paper.tables = groups.iter().flat_map(|values| [0, 1].map(|b| table(values, b))).collect();
    }
    let mut chunks = Vec::new();
    for (g, values) in groups.iter().enumerate() {
        let mut first = 0;
        while first < values.len() {
            let take = (1 + rng.next() as usize % 97).min(values.len() - first);
            let values = values[first..first + take].to_vec();
            chunks.push(Chunk { id: 0, cluster: g / 4, level: g % 4, first, values });
            first += take;
        }
    }
    // Neighbours apart: every fifth, then the next of each five.
    let order: Vec<usize> = (0..5).flat_map(|k| (k..chunks.len()).step_by(5)).collect();
    let mut packets = Vec::new();
    for at in order {
        chunks[at].id = packets.len();
        packets.push(paper.write_chunk(&chunks[at]));
    }
    crate::made::file_of(&body(&paper, packets.len()), &packets)
}

/// Frequencies for byte `b` of `values`: every byte has one, those that occur share what is left.
fn table(values: &[i16], b: usize) -> [usize; 256] {
    let mut table = [1; 256];
    let seen: Vec<usize> = values.iter().map(|v| v.to_le_bytes()[b].into()).collect();
    for (i, &byte) in (0..4096 - 256).zip(seen.iter().cycle()) {
        // Rare bytes near each other get something, too.
        table[if i % 9 == 0 { (byte + i) % 256 } else { byte }] += 1;
    }
    table
}

fn body(paper: &Paper, packets: usize) -> Vec<u8> {
    let clusters: usize = paper.epochs.iter().map(|e| e.clusters.len()).sum();
    let frames: usize = paper.epochs.iter().map(|e| e.frames).sum();
    let basis: usize = paper.epochs.iter().map(|e| e.frames * e.rank).sum();
    let transforms: usize = paper.epochs.iter().map(|e| e.frames * e.clusters.len() * 12).sum();
    let mut out = vec![if paper.is_context { 2 } else { 0 }, 2, 64, 0];
    let long = |out: &mut Vec<u8>, value: usize| out.extend((value as u32).to_le_bytes());
    let short = |out: &mut Vec<u8>, value: usize| out.extend((value as u16).to_le_bytes());
    for value in [frames, 30, 1, packets] {
        long(&mut out, value);
    }
    short(&mut out, paper.epochs.len());
    short(&mut out, 0);
    long(&mut out, clusters);
    for value in [1, 0, 0, 0] {
        short(&mut out, value);
    }
    long(&mut out, basis);
    long(&mut out, transforms);
    let (mut frame, mut cluster, mut basis_first, mut transform_first) = (0, 0, 0, 0);
    for epoch in &paper.epochs {
        let gaussians = epoch.clusters.iter().map(|c| c.0).sum();
        for value in [frame, epoch.frames, gaussians, cluster, epoch.clusters.len(), 0, 0] {
            long(&mut out, value);
        }
        [0.5f32, -1.0, 2.0].iter().for_each(|v| out.extend(v.to_le_bytes()));
        long(&mut out, basis_first);
        long(&mut out, transform_first);
        out.extend([epoch.rank as u8, 0, 0, 0]);
        frame += epoch.frames;
        cluster += epoch.clusters.len();
        basis_first += epoch.frames * epoch.rank;
        transform_first += epoch.frames * epoch.clusters.len() * 12;
    }
    for (gaussians, degree) in paper.epochs.iter().flat_map(|e| &e.clusters) {
        short(&mut out, *gaussians);
        out.extend([0, *degree as u8, 0, 0, 0, 0, 0, 0, 1, 0]);
    }
    for step in [0.0002f32, 0.002, 0.001, 0.001, 0.003, 0.01, 0.01, 0.01, 0.0004, 0.002, 0.002, 0.001, 0.003]
    {
        out.extend(step.to_le_bytes());
        out.extend([2, 4, 3, 0]);
    }
    let mut rng = TestRng(13);
    for _ in 0..basis {
        out.extend((rng.within(1000) as f32 / 1000.0).to_le_bytes());
    }
    for i in 0..transforms {
        let unit = if i % 12 < 11 && i % 5 == 0 { 1.0 } else { 0.0 };
        out.extend((unit + rng.within(1000) as f32 / 8000.0).to_le_bytes());
    }
    paper.tables.iter().flatten().for_each(|&f| short(&mut out, f));
    out
}

/// The manifest message of a body.
pub fn message(raw: &[u8]) -> Vec<u8> {
    let packed = pack(raw);
    let mut message = b"DGSM\x02\0\0\0".to_vec();
    message.extend((raw.len() as u32).to_le_bytes());
    message.extend((packed.len() as u32).to_le_bytes());
    message.extend(packed);
    message.extend(crc(&message).to_le_bytes());
    message
}

/// Chunks are read to the crate's symbols, with either coder, and written again to the bytes they came from.
#[test]
fn every_golden_chunk_is_read_and_written_again() {
    let mut chunks = [0; 2];
    for (name, bytes) in golden().into_iter().filter(|(_, bytes)| !is_dgs1(bytes)) {
        let (message, packets) = read_file(&bytes);
        let paper = Paper::read(&body_of(message));
        let clusters: usize = paper.epochs.iter().map(|e| e.clusters.len()).sum();
        let (mut starts, mut end) = (Vec::new(), 0);
        for size in (0..clusters).flat_map(|c| paper.sizes(c)) {
            starts.push(end);
            end += size;
        }
        let mut symbols = vec![0i16; end];
        for bytes in packets.iter().filter(|packet| packet[0] >> 5 == 0b100) {
            let chunk = paper.read_chunk(bytes);
            let at = starts[4 * chunk.cluster + chunk.level] + chunk.first;
            symbols[at..at + chunk.values.len()].copy_from_slice(&chunk.values);
            assert!(paper.write_chunk(&chunk) == *bytes, "{name}: packet {}", chunk.id);
            chunks[usize::from(paper.is_context)] += 1;
        }
        let received = session::Session::open(message).after(&packets);
        assert!(received.symbols[..end] == symbols, "{name}");
    }
    assert!(chunks[0] > 50 && chunks[1] > 50, "{chunks:?}");
}
