//! Plays a golden stream, and makes the line of the index that says what came of it.

use std::fmt::Write as _;

use codec_core::{
    Caps, Gaussian,
    internals::{
        closure::Arrived,
        ids::Span,
        receiver::{Content, for_each_cell},
        wire::{
            crc::crc32,
            file,
            manifest::{Manifest, ManifestHead, open},
        },
    },
    player::{Counters, Waiting},
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
        file::Record::Packet(_, packet) => Some(packet.bytes()),
        _ => None,
    });
    (message, packets.collect())
}

/// The unpacked manifest body of a message.
pub fn unpacked(message: &[u8]) -> Vec<u8> {
    let mut raw = vec![0u8; ManifestHead::parse(message).unwrap().raw_len];
    open(message, crc32, &mut raw).unwrap();
    raw
}

/// A stream to receive.
pub struct Session {
    message: Vec<u8>,
    raw: Vec<u8>,
}

/// One decoded frame: Gaussians, then their higher bands.
pub type Shown = (Vec<Gaussian>, Vec<f32>);

/// What a player made of some packets.
pub struct Received {
    /// Arrival masks.
    pub state: Vec<u8>,
    /// Symbols.
    pub symbols: Vec<i16>,
    /// Every frame.
    pub frames: Vec<Shown>,
    /// Per epoch and Gaussian, the masks of its blocks in all cells that it takes values from.
    pub masks: Vec<Vec<Vec<u8>>>,
    /// What happened to the packets.
    pub counters: Counters,
}

impl Session {
    /// Nothing has arrived.
    pub fn open(message: &[u8]) -> Self {
        Self { raw: unpacked(message), message: message.to_vec() }
    }

    /// The manifest.
    pub fn manifest(&self) -> Manifest<'_> {
        Manifest::parse(&self.raw).unwrap()
    }

    /// What is there after `packets` have arrived in this order.
    pub fn after(self, packets: &[impl AsRef<[u8]>]) -> Received {
        let caps = Caps { early_bytes: 0, ..Caps::HOST };
        // Garbage at first: the player must not depend on it.
        let mut scratch = vec![0x7799_aabb_ccdd_eeff; self.raw.len().div_ceil(8)];
        let need = Waiting::new(&mut scratch, caps).unwrap().required(&self.message).unwrap();
        let mut arena = vec![0xfedc_ba98_7654_3210; need.words];
        let waiting = Waiting::new(&mut arena, caps).unwrap();
        let mut player = waiting.manifest(&self.message).map_err(|(_, error)| error).unwrap();
        for packet in packets {
            // Refusals are counted by kind.
            let _ = player.push(packet.as_ref());
        }
        let mut frames = Vec::new();
        for frame in 0..self.manifest().head().frames {
            let shown = player.frame(frame).unwrap();
            frames.push((shown.gaussians.to_vec(), shown.sh_rest.to_vec()));
        }
        let content = player.content();
        Received {
            state: content.blocks.to_vec(),
            symbols: content.symbols.to_vec(),
            frames,
            masks: masks(&content),
            counters: *player.counters(),
        }
    }
}

impl Received {
    /// Usable levels over all blocks.
    pub fn usable(&self) -> u32 {
        self.state.iter().map(|&mask| Arrived(mask).usable() as u32).sum()
    }

    /// FNV-1a over the bits of all frames.
    pub fn digest(&self) -> u64 {
        let mut digest = 0xcbf2_9ce4_8422_2325u64;
        let mut take = |value: f32| {
            for byte in value.to_bits().to_le_bytes() {
                digest = (digest ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
            }
        };
        for (gaussians, sh_rest) in &self.frames {
            for g in gaussians {
                g.position.iter().chain(&g.scale).chain(&g.rotation).for_each(|&v| take(v));
                take(g.opacity);
                g.sh0.iter().for_each(|&v| take(v));
            }
            sh_rest.iter().copied().for_each(&mut take);
        }
        digest
    }
}

/// Per epoch and Gaussian, the masks of its blocks in all cells that it takes values from.
fn masks(content: &Content<'_>) -> Vec<Vec<Vec<u8>>> {
    let mut masks: Vec<Vec<Vec<u8>>> =
        content.manifest.epochs().map(|e| vec![Vec::new(); e.gaussians as usize]).collect();
    let mut at = 0;
    for_each_cell(content.manifest, |span, cluster, shape| {
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
                masks[epoch][at].push(content.arrived(cell, block)?.0);
                at += 1;
            }
        }
        Ok(())
    })
    .unwrap();
    masks
}
