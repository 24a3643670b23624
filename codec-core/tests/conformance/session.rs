//! A receiver with its own memory, and what a golden stream's index line is made of.

use std::fmt::Write as _;

use codec_core::{
    Caps, Gaussian,
    closure::Arrived,
    decode::{Decoder, Memory as Decoding},
    ids::Span,
    receiver::{Arrival, Cell, Content, Counters, Memory, Receiver, Requirements, for_each_cell},
    wire::{
        crc::crc32,
        file,
        manifest::{Manifest, Sealed, open},
    },
};

/// One line of `index.txt`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// File name without `.dgs`.
    pub name: String,
    /// What the stream exercises.
    pub exercises: String,
    /// Packets, parity included.
    pub packets: usize,
    /// Bytes of the file.
    pub bytes: usize,
    /// Digest of every frame once everything has arrived.
    pub digest: u64,
    /// After a quarter, half and three quarters of the bytes: usable levels of blocks, digest.
    pub checkpoints: [(u32, u64); 3],
}

impl Line {
    /// The line of a file.
    pub fn of(name: &str, exercises: &str, bytes: &[u8]) -> Self {
        let (message, packets) = parts(bytes);
        let whole = Session::open(message).after(&packets);
        let checkpoint = |quarter: usize| {
            let (_, part) = parts(&bytes[..bytes.len() * quarter / 4]);
            let state = Session::open(message).after(&part);
            (state.usable(), state.digest())
        };
        Self {
            name: name.to_owned(),
            exercises: exercises.to_owned(),
            packets: packets.len(),
            bytes: bytes.len(),
            digest: whole.digest(),
            checkpoints: [1, 2, 3].map(checkpoint),
        }
    }

    /// As in `index.txt`.
    pub fn text(&self) -> String {
        let mut text = format!(
            "{} | {} | {} packets | {} bytes | {:016x}",
            self.name, self.exercises, self.packets, self.bytes, self.digest
        );
        for (usable, digest) in self.checkpoints {
            write!(text, " | {usable} {digest:016x}").unwrap();
        }
        text
    }
}

/// The manifest message and the packets of a file, as far as they are there.
pub fn parts(bytes: &[u8]) -> (&[u8], Vec<&[u8]>) {
    let Ok((message, start)) = file::manifest(bytes) else { return (&[], Vec::new()) };
    let packets = file::packets(bytes, start, crc32).filter_map(|record| match record {
        file::Record::Packet(_, packet) => Some(packet),
        _ => None,
    });
    (message, packets.collect())
}

/// The unpacked manifest body of a message.
pub fn unpacked(message: &[u8]) -> Vec<u8> {
    let mut raw = vec![0u8; Sealed::parse(message).unwrap().raw_len];
    open(message, crc32, &mut raw).unwrap();
    raw
}

/// What is to be received, and what was.
pub struct Session {
    message: Vec<u8>,
    raw: Vec<u8>,
    cells: Vec<Cell>,
    symbols: Vec<i16>,
    blocks: Vec<u8>,
    parity: Vec<u8>,
    /// Counters of the last [`Session::after`].
    pub counters: Counters,
}

impl Session {
    /// Nothing has arrived.
    pub fn open(message: &[u8]) -> Self {
        Self {
            raw: unpacked(message),
            message: message.to_vec(),
            cells: Vec::new(),
            symbols: Vec::new(),
            blocks: Vec::new(),
            parity: Vec::new(),
            counters: Counters::default(),
        }
    }

    /// The manifest.
    pub fn manifest(&self) -> Manifest<'_> {
        Manifest::parse(&self.raw).unwrap()
    }

    /// The state after `packets` have arrived in this order.
    pub fn after(mut self, packets: &[impl AsRef<[u8]>]) -> Self {
        let need = Requirements::of(&self.manifest(), &Caps::HOST).unwrap();
        // Garbage at first: the receiver must not depend on it.
        self.cells = vec![Cell { symbols: 7, blocks: 9 }; need.cells];
        self.symbols = vec![-77; need.symbols];
        self.blocks = vec![0xff; need.blocks];
        self.parity = vec![0xff; need.parity];
        let mut raw = vec![0xee; self.raw.len()];
        let mut seen = vec![u32::MAX; need.seen];
        let mut slots = vec![u32::MAX; need.slots];
        let mut progress = vec![u32::MAX; need.progress];
        let mut receiver = Receiver::new(Memory {
            manifest: &mut raw,
            cells: &mut self.cells,
            symbols: &mut self.symbols,
            blocks: &mut self.blocks,
            seen: &mut seen,
            slots: &mut slots,
            progress: &mut progress,
            parity: &mut self.parity,
            early: &mut [],
        });
        receiver.control(&self.message).unwrap();
        for packet in packets {
            let arrival = receiver.media(packet.as_ref());
            assert!(!matches!(arrival, Ok(Arrival::Buffered)));
        }
        self.counters = *receiver.counters();
        self
    }

    /// What has arrived.
    pub fn content(&self) -> Content<'_> {
        Content {
            manifest: self.manifest(),
            cells: &self.cells,
            symbols: &self.symbols,
            blocks: &self.blocks,
        }
    }

    /// Usable levels over all blocks.
    pub fn usable(&self) -> u32 {
        self.blocks.iter().map(|&mask| Arrived(mask).usable() as u32).sum()
    }

    /// Every frame: Gaussians, then their higher bands.
    pub fn frames(&self) -> Vec<(Vec<Gaussian>, Vec<f32>)> {
        let manifest = self.manifest();
        let most = manifest.epochs().map(|e| e.gaussians as usize).max().unwrap_or(0);
        let mut blocks = 0;
        for_each_cell(&manifest, |_, _, shape| blocks += shape.blocks());
        let rest = manifest.sh_degree().rest_len();
        let (mut canonical, mut known) = (vec![Gaussian::ABSENT; most], vec![0u8; blocks]);
        let mut decoder = Decoder::new(Decoding { canonical: &mut canonical, known: &mut known });
        let (mut out, mut sh_rest) = (vec![Gaussian::ABSENT; most], vec![0f32; most * rest]);
        let one = |frame| {
            let n = decoder.frame(&self.content(), frame, &mut out, &mut sh_rest).unwrap().gaussians;
            (out[..n].to_vec(), sh_rest[..n * rest].to_vec())
        };
        (0..manifest.head().frames).map(one).collect()
    }

    /// FNV-1a over the bits of all frames.
    pub fn digest(&self) -> u64 {
        let mut digest = 0xcbf2_9ce4_8422_2325u64;
        let mut take = |value: f32| {
            for byte in value.to_bits().to_le_bytes() {
                digest = (digest ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
            }
        };
        for (gaussians, sh_rest) in self.frames() {
            for g in gaussians {
                g.position.iter().chain(&g.scale).chain(&g.rotation).for_each(|&v| take(v));
                take(g.opacity);
                g.sh0.iter().for_each(|&v| take(v));
            }
            sh_rest.into_iter().for_each(&mut take);
        }
        digest
    }

    /// Per epoch and Gaussian, the masks of its blocks in all cells that it takes values from.
    pub fn masks(&self) -> Vec<Vec<Vec<u8>>> {
        let content = self.content();
        let mut masks: Vec<Vec<Vec<u8>>> =
            content.manifest.epochs().map(|e| vec![Vec::new(); e.gaussians as usize]).collect();
        let mut at = 0;
        for_each_cell(&content.manifest, |span, cluster, shape| {
            let epoch = match span {
                Span::Canonical(id) => id.index(),
                Span::Motion(id) => usize::from(content.manifest.window(id).unwrap().epoch),
            };
            if cluster.0 == 0 {
                at = 0;
            }
            let cell = content.cell(span, cluster).unwrap();
            for block in 0..shape.blocks() {
                for _ in 0..shape.block_gaussians(block) {
                    masks[epoch][at].push(content.arrived(cell, block).0);
                    at += 1;
                }
            }
        });
        masks
    }
}
