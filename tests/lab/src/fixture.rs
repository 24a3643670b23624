//! Makes the stream that decoders on other machines are given, and the answer expected of them.
//!
//! A fixture is a small real stream as it arrives over a bad link: packets out of order, two lost that
//! repair brings back, one lost for good, one twice, one damaged. Microcontroller, browser and C
//! programs are fed the same bytes and must print the digest that this host computes from them.
//! Nothing of it is committed: every format change makes its own fixture.

use std::{fmt::Write as _, io, path::Path};

use codec_core::{
    Caps, Gaussian,
    internals::{
        digest::Digest,
        rans::{lanes, table::Table},
        receiver::{Cell, Requirements},
        wire::manifest::ManifestHead,
    },
    player::{Counters, Waiting},
};
use trainer_host::{
    Stream, cluster,
    encode::{self, EncodeError, EncodeOptions, Protection},
    import::{ImportError, Limits, synth},
    stream::PacketMap,
};

/// Why there is no fixture.
#[derive(Debug, thiserror::Error)]
pub enum FixtureError {
    /// The scene could not be made.
    #[error(transparent)]
    Scene(#[from] ImportError),
    /// It could not be encoded.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// The receiver refused what must be fine.
    #[error(transparent)]
    Format(#[from] codec_core::Error),
    /// No packet of the stream is repaired when it is lost, or none is not.
    #[error("no packet of the fixture's stream is {0}")]
    NoPacket(&'static str),
}

/// What a decoder must report after a fixture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Answer {
    /// Of all Gaussians of all frames of [`Fixture::frames`], in order.
    pub digest: u64,
    /// Of the receiver.
    pub counters: Counters,
}

/// Symbols of one law as one lane body, for counting the coder's instructions alone.
#[derive(Clone, Debug)]
pub struct Body {
    /// Laplace-like law: its entropy, bits per symbol, about.
    pub name: &'static str,
    /// The one table of all symbols.
    pub table: Table,
    /// The symbols.
    pub symbols: Vec<i16>,
    /// The body.
    pub bytes: Vec<u8>,
    /// What the encoder says of it.
    pub encoded: lanes::Encoded,
}

impl Body {
    fn constants(&self) -> (&'static str, usize, usize) {
        (self.name, self.symbols.len(), self.encoded.raw_bits)
    }
}

/// One list that a receiver without a heap sets aside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// What it holds.
    pub doc: &'static str,
    /// Its constant.
    pub name: &'static str,
    /// Elements.
    pub count: usize,
    /// Bytes of all lists of this size together.
    pub bytes: usize,
}

/// A stream, the order in which its packets arrive, and the frames to show.
#[derive(Clone, Debug)]
pub struct Fixture {
    stream: Stream,
    /// Packets as they arrive, damaged and doubled ones included.
    pub arrivals: Vec<Vec<u8>>,
    /// Frames to decode, in this order.
    pub frames: Vec<u32>,
    /// Lane bodies.
    pub bodies: Vec<Body>,
    /// What a decoder must report.
    pub answer: Answer,
}

impl Fixture {
    /// The fixture: a walking figure of 1,000 Gaussians over 24 frames.
    ///
    /// # Errors
    /// None in practice.
    pub fn make() -> Result<Self, FixtureError> {
        let options = synth::SynthOptions {
            kind: synth::SynthKind::Figure,
            gaussians: 1000,
            frames: 24,
            frames_per_second: 24.0,
            seed: 1,
        };
        let scene = synth::make(&options, &Limits::default())?;
        let options = EncodeOptions {
            cluster: cluster::ClusterOptions { max_gaussians: 128, ..cluster::ClusterOptions::default() },
            window_frames: Some(12),
            repair: Protection::STANDARD,
            packet_bytes: 600,
            ..EncodeOptions::default()
        };
        Self::of(encode::encode(&scene, &options, &trainer_host::encode::no_progress)?.stream)
    }

    /// The fixture of `stream`.
    ///
    /// # Errors
    /// A stream without parity, or with nothing but.
    pub fn of(stream: Stream) -> Result<Self, FixtureError> {
        let count = stream.packets().len();
        let last = stream.manifest()?.head().frames.saturating_sub(1);
        let frames = vec![0, last / 3, last / 2, last, last / 4];
        // A stride that shares no factor with the count visits every packet once.
        let gcd = |mut a: usize, mut b: usize| {
            while b > 0 {
                (a, b) = (b, a % b);
            }
            a
        };
        let stride = (count / 3..).find(|&s| s > 0 && gcd(s, count) == 1).unwrap_or(1);
        let mut order: Vec<usize> = (0..count).map(|i| i * stride % count).collect();
        // Parity comes last, or it would repair what is merely late.
        let map = PacketMap::of(&stream)?;
        order.sort_by_key(|&id| map.is_parity(id));
        let without = |lost: &[usize]| -> Vec<Vec<u8>> {
            order.iter().filter(|i| !lost.contains(i)).map(|&i| stream.packets()[i].clone()).collect()
        };
        let answer = |packets: &[Vec<u8>]| answer(&stream, packets, &frames);
        let mut repaired = None;
        for id in 0..count {
            if answer(&without(&[id]))?.counters.recovered == 1 {
                repaired = Some(id);
                break;
            }
        }
        let repaired = repaired.ok_or(FixtureError::NoPacket("repaired when lost"))?;
        let mut gone = vec![repaired];
        // A second loss of the same set takes more than XOR; where there is only that, one is all.
        for id in repaired + 1..count {
            if answer(&without(&[repaired, id]))?.counters.recovered == 2 {
                gone.push(id);
                break;
            }
        }
        let recovered = gone.len() as u32;
        let whole = answer(&without(&[]))?.digest;
        let mut lost = None;
        for id in (0..count).rev().filter(|id| !gone.contains(id)) {
            let without = answer(&without(&[&gone[..], &[id]].concat()))?;
            // One that repair cannot bring back, and whose absence shows.
            if without.counters.recovered == recovered && without.digest != whole {
                lost = Some(id);
                break;
            }
        }
        gone.push(lost.ok_or(FixtureError::NoPacket("missed when lost"))?);
        let mut arrivals = without(&gone);
        let mut damaged = arrivals[0].clone();
        let middle = damaged.len() / 2;
        damaged[middle] ^= 0x10;
        arrivals.insert(arrivals.len() / 2, damaged);
        arrivals.push(arrivals[0].clone());
        let answer = answer(&arrivals)?;
        Ok(Self { arrivals, frames, bodies: bodies()?, answer, stream })
    }

    /// The DGSM message.
    pub fn message(&self) -> &[u8] {
        self.stream.message()
    }

    /// Packets in one piece: length (u16, little-endian) and bytes, one after the other.
    pub fn packets(&self) -> Vec<u8> {
        let mut out = Vec::new();
        for packet in &self.arrivals {
            out.extend_from_slice(&(packet.len() as u16).to_le_bytes());
            out.extend_from_slice(packet);
        }
        out
    }

    /// Everything a receiver without a heap sets aside for the stream.
    ///
    /// # Errors
    /// None in practice.
    pub fn sizes(&self) -> Result<[Size; 11], FixtureError> {
        let manifest = self.stream.manifest()?;
        let Requirements { cells, symbols, blocks, seen, least_slots, progress, parity, .. } =
            Requirements::of(&manifest, &Caps::HOST)?;
        let raw = ManifestHead::parse(self.message())?.raw_len;
        let gaussians = manifest.epochs().map(|e| e.gaussians as usize).max().unwrap_or(0);
        let sh_rest = gaussians * manifest.sh_degree().rest_len();
        Ok([
            ("Bytes of the unpacked manifest.", "MANIFEST", raw, 1),
            ("Cells, and one.", "CELLS", cells, size_of::<Cell>()),
            ("Symbols.", "SYMBOLS", symbols, 2),
            ("Blocks of all cells.", "BLOCKS", blocks, 2),
            ("Words of the packet bitmap.", "SEEN", seen, 4),
            ("Words of decode tables, compact form.", "SLOTS", least_slots, 4),
            ("Groups counted (`paper`).", "PROGRESS", progress, 4),
            ("Bytes of repair.", "PARITY", parity, 1),
            ("Gaussians of the largest epoch.", "GAUSSIANS", gaussians, 2 * size_of::<Gaussian>()),
            ("Higher harmonic coefficients of the largest epoch.", "SH_REST", sh_rest, 4),
            ("Bytes for media before the manifest.", "EARLY", self.early_bytes(), 1),
        ]
        .map(|(doc, name, count, bytes)| Size { doc, name, count, bytes: count * bytes }))
    }

    /// Bytes that keep the largest packet until the manifest comes.
    fn early_bytes(&self) -> usize {
        self.arrivals.iter().map(Vec::len).max().unwrap_or(0) + 2
    }

    /// Sizes and expectations as Rust constants, for firmware without a heap.
    ///
    /// # Errors
    /// None in practice.
    pub fn constants(&self) -> Result<String, FixtureError> {
        let mut out = String::from("// Written from a manifest; see `dgs_lab::fixture`.\n");
        let mut constant = |doc: &str, name: &str, kind: &str, value: &dyn std::fmt::Debug| {
            let borrow = if kind.starts_with('&') { "&" } else { "" };
            // Writing to a string cannot fail.
            let _ = writeln!(out, "/// {doc}\npub const {name}: {kind} = {borrow}{value:?};");
        };
        let early_bytes = self.early_bytes();
        let caps = Caps { early_bytes: early_bytes as u32, ..Caps::HOST };
        let mut scratch = dgs_player::arena(self.message(), &caps)?;
        let least_words = Waiting::new(&mut scratch, caps)?.required(self.message())?.least_words;
        constant("64-bit words of the player's arena.", "ARENA_WORDS", "usize", &least_words);
        constant("Bytes for media before the manifest: one packet.", "EARLY_BYTES", "u32", &early_bytes);
        constant("Frames to decode, in this order.", "FRAMES", "&[u32]", &self.frames);
        constant("What the host computed.", "DIGEST", "u64", &self.answer.digest);
        let laws: Vec<_> = self.bodies.iter().map(Body::constants).collect();
        constant("Lane bodies: name, symbols, raw bits.", "LAWS", "&[(&str, usize, usize)]", &laws);
        Ok(out)
    }

    /// Writes the fixture's files to `folder`.
    ///
    /// # Errors
    /// What the system says.
    pub fn write(&self, folder: &Path) -> Result<(), io::Error> {
        std::fs::create_dir_all(folder)?;
        let constants = self.constants().map_err(io::Error::other)?;
        let mut files: Vec<(String, Vec<u8>)> = vec![
            ("manifest.dgsm".into(), self.message().to_vec()),
            ("packets.bin".into(), self.packets()),
            ("fixture.rs".into(), constants.into_bytes()),
        ];
        for (i, body) in self.bodies.iter().enumerate() {
            let mut table = Vec::new();
            body.table.write(|bytes| table.extend_from_slice(bytes));
            files.push((format!("law-{i}.table"), table));
            files.push((format!("law-{i}.body"), body.bytes.clone()));
            files.push((
                format!("law-{i}.digest"),
                symbols_digest(&body.symbols).get().to_le_bytes().to_vec(),
            ));
        }
        for (name, bytes) in files {
            let path = folder.join(name);
            // Left alone when equal, so that nothing is built again for nothing.
            if std::fs::read(&path).is_ok_and(|old| old == bytes) {
                continue;
            }
            std::fs::write(path, bytes)?;
        }
        Ok(())
    }
}

/// Of symbols, little-endian.
fn symbols_digest(symbols: &[i16]) -> Digest {
    symbols.iter().fold(Digest::new(), |digest, s| digest.bytes(&s.to_le_bytes()))
}

/// What the host's receiver and decoder make of `packets`.
fn answer(stream: &Stream, packets: &[Vec<u8>], frames: &[u32]) -> Result<Answer, FixtureError> {
    let caps = Caps { early_bytes: 0, ..Caps::HOST };
    let mut arena = dgs_player::arena(stream.message(), &caps)?;
    let waiting = Waiting::new(&mut arena, caps)?;
    let mut player = waiting.manifest(stream.message()).map_err(|(_, error)| error)?;
    for packet in packets {
        // Counted by kind in the player's counters.
        let _ = player.push(packet);
    }
    let counters = *player.counters();
    let mut digest = Digest::new();
    for &frame in frames {
        let shown = player.frame(frame)?;
        digest = digest.frame(shown.gaussians, shown.sh_rest);
    }
    Ok(Answer { digest: digest.get(), counters })
}

/// Laplace-like symbols at about 1.5, 4 and 8 bits each, one body per law.
fn bodies() -> Result<Vec<Body>, FixtureError> {
    const SYMBOLS: usize = 2048;
    let laws = [("laplace_1.5_bit", 0.47f64, 0u8), ("laplace_4_bit", 2.94, 0), ("laplace_8_bit", 47.0, 2)];
    let mut out = Vec::new();
    for (name, spread, raw_bits) in laws {
        let mut state = 0x9e37_79b9_7f4a_7c15u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 11) as f64 + 0.5) / (1u64 << 53) as f64
        };
        let symbols: Vec<i16> = (0..SYMBOLS)
            .map(|_| {
                let size = -uniform().ln() * spread;
                (if uniform() < 0.5 { -size } else { size }).round() as i16
            })
            .collect();
        let mut counts = [0u64; 256];
        for &symbol in &symbols {
            counts[usize::from(Table::token(symbol, raw_bits))] += 1;
        }
        let table = Table::from_counts(&counts, raw_bits)?;
        let mut bytes = vec![0u8; 4 * SYMBOLS];
        let runs = [lanes::TableRun { table: 0, len: SYMBOLS }];
        let encoded = lanes::encode(&symbols, &runs, &[lanes::Symbols::new(&table)], &mut bytes)?;
        bytes.truncate(encoded.len);
        out.push(Body { name, table, symbols, bytes, encoded });
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fixture_exercises_every_fate_of_a_packet_and_is_made_twice_the_same() {
        let fixture = Fixture::make().unwrap();
        let Counters { media, parity, recovered, repair_failed, refused, .. } = fixture.answer.counters;
        assert!(media > 10 && parity > 0, "{:?}", fixture.answer);
        assert_eq!((recovered, repair_failed), (2, 0));
        assert_eq!(refused.iter().sum::<u32>(), 2, "one damaged, one doubled");
        let again = Fixture::make().unwrap();
        assert_eq!((fixture.packets(), fixture.answer), (again.packets(), again.answer));
        assert_eq!(fixture.constants().unwrap(), again.constants().unwrap());
        // The digest tells a state with everything from this one.
        let whole = answer(&fixture.stream, fixture.stream.packets(), &fixture.frames).unwrap();
        assert_ne!(whole.digest, fixture.answer.digest);
    }

    #[test]
    fn a_stream_without_parity_makes_no_fixture() {
        let options = synth::SynthOptions { gaussians: 1000, frames: 2, ..synth::SynthOptions::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let stream = encode::encode(
            &scene,
            &EncodeOptions { repair: Protection::NONE, ..EncodeOptions::default() },
            &trainer_host::encode::no_progress,
        )
        .unwrap()
        .stream;
        assert!(matches!(Fixture::of(stream), Err(FixtureError::NoPacket(_))));
    }
}
