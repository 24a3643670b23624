//! Reads a stream while an encoder writes it: window after window, in bounded memory.

use std::io::{ErrorKind, Read};

use anyhow::{Context, Result, bail};
use codec_core::internals::{
    ids::{PacketId, Span},
    limits::{MAX_MANIFEST_BYTES, MAX_PACKET_BYTES},
    wire::{
        checked::Checked,
        file::{self, Record},
        manifest::Manifest,
        packet::Packet,
    },
};
use codec_simd::crc32;
use emulator_host::PacketGraph;
use trainer_host::{Stream, stream::PacketMap};

use crate::delivery::{Places, graph};

/// Magic and length before the manifest message.
const HEAD_BYTES: usize = 8;
/// Bytes read at once.
const CHUNK_BYTES: usize = 64 << 10;
/// A packet that is not whole yet: its length and the longest packet.
const PACKET_BYTES: usize = 2 + MAX_PACKET_BYTES;
/// Media of windows that ended so long before the newest is forgotten: no viewer shows it any more.
const MEMORY_SECONDS: f64 = 10.0;

/// What a packet must be placed in: kept, since the manifest is long and packets are many.
struct Clip {
    frames: u32,
    /// First frame and frames.
    epochs: Vec<(u32, u32)>,
    windows: Vec<(u32, u32)>,
}

impl Clip {
    fn of(manifest: &Manifest<'_>) -> Self {
        let epochs = manifest.epochs().map(|epoch| (epoch.first_frame, epoch.frames)).collect();
        let windows = manifest.windows().map(|window| (window.first_frame, window.frames.into())).collect();
        Self { frames: manifest.head().frames, epochs, windows }
    }

    /// First frame and frames of a span of the clip.
    fn coverage(&self, span: Span) -> (u32, u32) {
        let found = match span {
            Span::Canonical(id) => self.epochs.get(usize::from(id.0)),
            Span::Motion(id) => self.windows.get(usize::from(id.0)),
        };
        found.copied().unwrap_or_default()
    }
}

/// A stream of which there is more and more.
pub struct LiveReader<R> {
    input: R,
    /// Bytes that were read and are not parsed.
    rest: Vec<u8>,
    stream: Stream,
    /// Per packet that is there, the last frame that it changes.
    until: Vec<(PacketId, u32)>,
    /// First frame of the window of which packets are coming.
    coming: u32,
    newest: u32,
    /// Times that a window was found to be whole.
    whole: u64,
    memory_frames: u32,
    clip: Clip,
    ended: bool,
    damaged: usize,
    /// Whether no packet has come of a window before the one of which packets were coming.
    by_window: bool,
}

impl<R: Read> LiveReader<R> {
    /// Reads the manifest, which an encoder writes first.
    ///
    /// # Errors
    /// What is no stream, or ends inside its manifest.
    pub fn new(mut input: R) -> Result<Self> {
        let mut head = Vec::new();
        input.by_ref().take(HEAD_BYTES as u64).read_to_end(&mut head).context("the input cannot be read")?;
        let len = head.get(4..).and_then(|len| <[u8; 4]>::try_from(len).ok()).map_or(0, u32::from_le_bytes);
        if !head.starts_with(&file::MAGIC) || len as usize > MAX_MANIFEST_BYTES {
            bail!("the input is no .dgs stream: it begins with {head:02x?}");
        }
        // Memory follows what arrives, whatever length is claimed.
        input.by_ref().take(len.into()).read_to_end(&mut head).context("the input cannot be read")?;
        let (stream, _) = Stream::from_bytes(&head).context("the input has no usable manifest")?;
        let manifest = stream.manifest()?;
        let memory_frames = (manifest.frames_per_second() * MEMORY_SECONDS).ceil() as u32;
        let clip = Clip::of(&manifest);
        Ok(Self {
            input,
            rest: Vec::new(),
            stream,
            until: Vec::new(),
            coming: 0,
            newest: 0,
            whole: 0,
            memory_frames,
            clip,
            ended: false,
            damaged: 0,
            by_window: true,
        })
    }

    /// What has come and is not forgotten.
    pub fn stream(&self) -> &Stream {
        &self.stream
    }

    /// First frame of the newest window that is whole, or of the clip.
    pub fn newest(&self) -> u32 {
        self.newest
    }

    /// Runs of bytes that are no packets, and packets that are not of this stream or came twice.
    pub fn damaged(&self) -> usize {
        self.damaged
    }

    /// Whether packets come window by window, as viewers of a stream that grows need them.
    pub fn is_by_window(&self) -> bool {
        self.by_window
    }

    /// What has come, as schedulers see it.
    ///
    /// # Errors
    /// None in practice.
    pub fn graph(&self) -> Result<PacketGraph> {
        let map = PacketMap::of(&self.stream)?;
        // What is forgotten, and what has not come, lies nowhere.
        let frames = self.newest.saturating_sub(self.memory_frames)..self.coming.max(self.newest + 1);
        let places = Places::of(&self.stream.receive()?.content(), frames)?;
        Ok(graph(&self.stream, &self.stream.manifest()?, &map, None, &places)?)
    }

    /// Reads until another window is whole, or to the end; false if there was nothing more.
    ///
    /// # Errors
    /// Input that cannot be read.
    pub fn advance(&mut self) -> Result<bool> {
        let before = self.whole;
        while !self.ended {
            let mut chunk = vec![0; CHUNK_BYTES];
            let len = match self.input.read(&mut chunk) {
                // A signal came; nothing is lost.
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                read => read.context("the input cannot be read")?,
            };
            self.rest.extend_from_slice(&chunk[..len]);
            self.ended = len == 0;
            self.parse();
            if self.ended {
                // The input ends inside a packet.
                self.damaged += usize::from(!self.rest.is_empty());
                // Nothing can be added to the last window.
                self.newest = self.coming;
                self.forget();
                return Ok(true);
            }
            if self.whole > before {
                self.forget();
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Takes in the whole packets of what was read.
    fn parse(&mut self) {
        let rest = std::mem::take(&mut self.rest);
        let mut done = 0;
        for record in file::packets(&rest, 0, crc32) {
            match record {
                Record::Packet(at, packet) => {
                    self.take(&packet);
                    done = at + packet.bytes().len();
                }
                Record::Illegal(at, len, _) => {
                    self.damaged += 1;
                    done = at + len;
                }
                // It may be the begin of a packet; what is too long for one is none.
                Record::Damaged(from, len) if from + len == rest.len() => {
                    self.damaged += usize::from(len > PACKET_BYTES);
                    done = from.max(rest.len().saturating_sub(PACKET_BYTES));
                }
                Record::Damaged(from, len) => {
                    self.damaged += 1;
                    done = from + len;
                }
                Record::End => {
                    self.ended = true;
                    done = rest.len();
                }
            }
        }
        self.rest = rest.get(done..).unwrap_or(&[]).to_vec();
    }

    /// Takes in a packet; the first one of a later window says that those before are whole.
    fn take(&mut self, packet: &Checked<'_>) {
        if !self.stream.insert(packet) {
            self.damaged += 1;
            return;
        }
        let spans: Vec<Span> = match packet.packet() {
            Packet::Slices(slices) => slices.extents.iter().map(|extent| extent.span).collect(),
            Packet::Chunk(_) | Packet::Parity(_) => Vec::new(),
        };
        let frames = spans.iter().map(|span| self.clip.coverage(*span));
        let (first, until) = frames.fold((0, 0), |(first, until), (start, frames)| {
            (first.max(start), until.max(start + frames.max(1) - 1))
        });
        // What has no span of its own may be of use to the end.
        let until = if spans.is_empty() { self.clip.frames } else { until };
        self.until.push((packet.id(), until));
        // Attributes of an epoch may come at any time in it.
        let is_motion = spans.iter().all(|span| matches!(span, Span::Motion(_))) && !spans.is_empty();
        self.by_window &= !is_motion || first >= self.coming;
        if first > self.coming {
            (self.newest, self.coming) = (self.coming, first);
            self.whole += 1;
        }
    }

    /// Forgets what nobody shows any more.
    fn forget(&mut self) {
        let (newest, memory, stream) = (self.newest, self.memory_frames, &mut self.stream);
        self.until.retain(|(id, until)| {
            let stays = until.saturating_add(memory) >= newest;
            if !stays {
                stream.remove(*id);
            }
            stays
        });
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use trainer_host::encode::Protection;

    use super::*;
    use crate::{
        args::{Cli, Verb},
        pipeline::{self, Quiet},
    };

    /// Gives a few bytes at a time, as a pipe may.
    struct Drops<'b>(&'b [u8], usize);

    impl Read for Drops<'_> {
        fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
            self.1 = self.1 * 31 % 1009 + 1;
            let len = self.1.min(self.0.len()).min(out.len());
            out[..len].copy_from_slice(&self.0[..len]);
            self.0 = &self.0[len..];
            Ok(len)
        }
    }

    /// A clip in windows of ten frames.
    fn stream(source: &str) -> Stream {
        let flags = ["dgs", "demo", "--window-frames", "10", "--pictures", "2", "--coarseness", "0.2"];
        let Ok(Cli { verb: Verb::Demo(args), .. }) = Cli::try_parse_from(flags) else { panic!("{flags:?}") };
        let scene = pipeline::import(source, &args.source).unwrap().scene;
        let options = pipeline::encode_options(&args.codec, Protection::STANDARD);
        pipeline::encode(&scene, &options, Quiet(true)).unwrap().stream
    }

    #[test]
    fn windows_come_one_after_the_other_and_all_arrives() {
        let whole = stream("synth:cloth:1000:40");
        let bytes = whole.to_bytes().unwrap();
        let mut reader = LiveReader::new(Drops(&bytes, 1)).unwrap();
        assert!(reader.graph().unwrap().packets().is_empty());
        let (mut newest, mut packets) = (Vec::new(), Vec::new());
        while reader.advance().unwrap() {
            newest.push(reader.newest());
            packets.push(reader.graph().unwrap().packets().len());
        }
        assert_eq!(newest, [0, 10, 20, 30]);
        assert!(packets.is_sorted() && packets[0] > 0 && packets[0] < packets[3], "{packets:?}");
        assert_eq!((reader.stream(), reader.damaged()), (&whole, 0));
        let map = PacketMap::of(&whole).unwrap();
        let mut found = reader.graph().unwrap().parts().clone();
        let mut expected = pipeline::graph(&whole, &map, None).unwrap().parts().clone();
        // Where the middle of a window leads is not known before it is over.
        assert!(found.groups.iter().all(|group| group.place.is_some()));
        for group in found.groups.iter_mut().chain(&mut expected.groups) {
            group.place = None;
        }
        assert_eq!(found, expected);
    }

    #[test]
    fn what_is_over_is_forgotten_and_damage_is_counted() {
        // Longer than what is remembered.
        let whole = stream("synth:cloth:1000:400");
        let mut bytes = whole.to_bytes().unwrap();
        let at = bytes.len() / 2;
        bytes[at] ^= 1;
        bytes.splice(at + 5000..at + 5000, [7; 9000]);
        let mut reader = LiveReader::new(Drops(&bytes, 1)).unwrap();
        let mut most = 0;
        while reader.advance().unwrap() {
            most = most.max(reader.stream().packets().iter().filter(|packet| !packet.is_empty()).count());
        }
        assert!(most < whole.packets().len(), "{most} of {}", whole.packets().len());
        assert!(reader.damaged() > 0 && reader.newest() == 390, "{}", reader.damaged());
    }

    #[test]
    fn input_that_is_no_stream_is_refused_by_name() {
        for (bytes, named) in [
            (&b""[..], "no .dgs stream"),
            (b"ply\n", "no .dgs stream"),
            (b"DGS\x01\xff\xff\xff\xff", "no .dgs stream"),
            (b"DGS\x01\x40\0\0\0DGSM", "no usable manifest"),
        ] {
            let error = LiveReader::new(bytes).err().unwrap().to_string();
            assert!(error.contains(named), "{error}");
        }
    }
}
