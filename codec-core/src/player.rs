//! Takes the bytes of a stream and gives Gaussians: the front door of this crate.
//!
//! A [`Waiting`] player has memory and bounds, and keeps the packets that come early. The manifest
//! turns it into a [`Player`], which takes packets in any order and decodes any frame from what has
//! arrived. Neither asks for a heap, a socket or a clock: bytes go in, the caller's memory holds
//! everything else.

mod early;

pub use crate::{
    decode::Decoded,
    limits::MAX_RECEIPT_BYTES,
    receiver::{Accepted, Counters, Recovered},
    wire::receipt::ViewerPose,
};

use heapless::Vec;

use self::early::EarlyPackets;
use crate::{
    arena::{Plan, Rest, WORD_BYTES, words_of},
    caps::Caps,
    decode::Decoder,
    error::{Error, Result},
    footprint::Footprint,
    gaussian::{Gaussian, ShDegree},
    ids::{ClusterId, Level, PacketId, Span},
    layout::Shape,
    receiver::{Content, Receiver},
    repair::{Combine, combine},
    up::Up,
    wire::{
        checked::Checked,
        crc::{Crc32, crc32},
        manifest::{Manifest, ManifestHead, Outline},
        receipt::{IdRange, Value},
    },
};

/// A player that has memory and bounds, but no manifest yet.
///
/// Packets that arrive early are kept, up to [`Caps::early_bytes`], and taken when the manifest comes.
///
/// ```
/// use codec_core::{Caps, player::Waiting};
///
/// let mut arena = vec![0u64; 4096]; // or a `static`
/// let mut waiting = Waiting::new(&mut arena, Caps { early_bytes: 4000, ..Caps::SMALL })?;
/// assert!(waiting.push(b"no packet").is_err());
/// assert_eq!(waiting.counters().refused.iter().sum::<u32>(), 1);
/// # Ok::<(), codec_core::Error>(())
/// ```
#[derive(Debug)]
pub struct Waiting<'a> {
    arena: &'a mut [u64],
    early: EarlyPackets<'a>,
    counters: Counters,
    caps: Caps,
    crc: Crc32,
    combine: Combine,
}

impl<'a> Waiting<'a> {
    /// A player that will keep everything in `arena` and accept streams within `caps`.
    ///
    /// [`Caps::arena_words`] are enough for every such stream; a smaller arena takes those that fit.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`](crate::ErrorKind::Capacity) if `arena` does not hold
    /// [`Caps::early_bytes`].
    pub fn new(arena: &'a mut [u64], caps: Caps) -> Result<Self> {
        let have = size_of_val(arena);
        let mut rest = Rest(arena);
        let early = rest.take(caps.early_bytes as usize);
        let bytes = early.ok_or_else(|| Error::too_small("arena", have, caps.early_bytes as usize))?;
        let (arena, early) = (rest.0, EarlyPackets::new(bytes));
        Ok(Self { arena, early, counters: Counters::default(), caps, crc: crc32, combine })
    }

    /// The same player with faster arithmetic of the host's: CRC-32/ISO-HDLC and sums of repair.
    #[must_use]
    pub const fn with_arithmetic(mut self, crc: Crc32, combine: Combine) -> Self {
        (self.crc, self.combine) = (crc, combine);
        self
    }

    /// What happened to packets so far.
    pub const fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Keeps one packet until the manifest comes.
    ///
    /// # Errors
    /// A damaged packet; [`ErrorKind::Capacity`](crate::ErrorKind::Capacity) if [`Caps::early_bytes`]
    /// are full (a packet takes two
    /// bytes more than its length). Refusals are counted by kind.
    pub fn push(&mut self, packet: &[u8]) -> Result<()> {
        let result = Checked::new(packet, self.crc).and_then(|_| self.early.push(packet));
        match &result {
            Ok(()) => self.counters.early += 1,
            Err(error) => self.counters.refuse(error),
        }
        result
    }

    /// How long an arena must be for the stream of the DGSM message `message` and the packets kept
    /// early.
    ///
    /// The arena of this player serves as scratch: it must hold the unpacked manifest.
    ///
    /// # Errors
    /// As [`Waiting::manifest`], but for an arena that holds the manifest and no more.
    pub fn required(&mut self, message: &[u8]) -> Result<Required> {
        let (raw_len, _, plan) = self.open(message)?;
        Ok(Required::of(&plan, raw_len, self.early.room()))
    }

    /// Unpacks and checks `message` at the front of the arena: its length unpacked, the manifest without
    /// its bytes, what its stream needs.
    fn open(&mut self, message: &[u8]) -> Result<(usize, Outline, Plan)> {
        // Before anything of that size is unpacked; the other caps follow once it is.
        let sealed = ManifestHead::parse(message)?.within(&self.caps)?;
        let (have, raw_len) = (size_of_val(self.arena), sealed.raw_len);
        let room = self.arena.get_mut(..words_of::<u8>(raw_len));
        let room = room.ok_or_else(|| Error::too_small("arena", have, raw_len))?;
        let raw = sealed.open(message, self.crc, bytemuck::cast_slice_mut(room))?;
        let manifest = Manifest::parse(raw)?;
        let plan = Plan::of(&manifest, &self.caps)?;
        Ok((raw_len, manifest.outline(), plan))
    }

    /// Takes the whole DGSM message `message`, then the packets that came early.
    ///
    /// # Errors
    /// Why the message is refused, and the player as it was: it goes on waiting.
    /// [`ErrorKind::Capacity`](crate::ErrorKind::Capacity) names the count that exceeds the caps, or
    /// the `arena` that is too small,
    /// with the bytes there are and the bytes needed.
    #[expect(clippy::result_large_err, reason = "the player that goes on waiting is given back")]
    pub fn manifest(mut self, message: &[u8]) -> core::result::Result<Player<'a>, (Self, Error)> {
        match self.open(message) {
            Ok((raw_len, outline, plan)) => self.play(raw_len, outline, &plan),
            Err(error) => Err((self, error)),
        }
    }

    /// As [`Waiting::manifest`], of a manifest that the caller has unpacked: its bytes are copied into
    /// the arena.
    ///
    /// # Errors
    /// As [`Waiting::manifest`].
    #[expect(clippy::result_large_err, reason = "the player that goes on waiting is given back")]
    pub fn unpacked(self, manifest: &Manifest<'_>) -> core::result::Result<Player<'a>, (Self, Error)> {
        let raw = manifest.raw();
        let plan = match Plan::of(manifest, &self.caps) {
            Ok(plan) => plan,
            Err(error) => return Err((self, error)),
        };
        let have = size_of_val(self.arena);
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(self.arena);
        let Some(room) = bytes.get_mut(..raw.len()) else {
            return Err((self, Error::too_small("arena", have, raw.len())));
        };
        room.copy_from_slice(raw);
        self.play(raw.len(), manifest.outline(), &plan)
    }

    /// The player of the manifest whose `raw_len` bytes lie at the front of the arena. Apart from what
    /// unpacks them, which needs the stack.
    #[inline(never)]
    #[expect(clippy::result_large_err, reason = "the player that goes on waiting is given back")]
    fn play(
        self,
        raw_len: usize,
        outline: Outline,
        plan: &Plan,
    ) -> core::result::Result<Player<'a>, (Self, Error)> {
        let needed = Required::of(plan, raw_len, self.early.room()).least_words;
        let have = words_of::<u8>(self.early.room()).saturating_add(self.arena.len());
        if have < needed {
            let bytes = |words: usize| words.saturating_mul(WORD_BYTES);
            return Err((self, Error::too_small("arena", bytes(have), bytes(needed))));
        }
        let Self { arena, early, counters, caps, crc, combine } = self;
        let player = Player::divide(arena, raw_len, outline, plan, caps).and_then(|mut player| {
            player.receiver.set_arithmetic(crc, combine);
            player.receiver.count_from(counters);
            player.take_early(&early)?;
            Ok(player)
        });
        // An arena that is long enough is in order. After any other error nothing is left of it, and the
        // player that waits on refuses every manifest.
        player.map_err(|error| {
            let arena = Default::default();
            (Self { arena, early, counters, caps, crc, combine }, error)
        })
    }
}

/// How long an arena must be for a stream, in 64-bit words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Required {
    /// With entropy tables in the fast form.
    pub words: usize,
    /// With entropy tables in the compact form: five eighths less of them, decoding is slower.
    pub least_words: usize,
}

impl Required {
    /// What the stream of `manifest` takes, [`Caps::early_bytes`] included.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`](crate::ErrorKind::Capacity) naming the count that exceeds `caps`.
    pub fn by(manifest: &Manifest<'_>, caps: &Caps) -> Result<Self> {
        let plan = Plan::of(manifest, caps)?;
        Ok(Self::of(&plan, manifest.raw().len(), caps.early_bytes as usize))
    }

    fn of(plan: &Plan, raw_len: usize, early_bytes: usize) -> Self {
        let before = words_of::<u8>(early_bytes).saturating_add(words_of::<u8>(raw_len));
        Self {
            words: before.saturating_add(plan.words()),
            least_words: before.saturating_add(plan.least_words()),
        }
    }
}

/// A player with its manifest: packets in, frames out.
///
/// ```
/// use codec_core::{Caps, file, player::Waiting};
///
/// # let bytes = include_bytes!("../tests/conformance/one.dgs");
/// let (message, packets) = file::parts(bytes)?;
/// let mut arena = vec![0u64; 1 << 16];
/// let waiting = Waiting::new(&mut arena, Caps::SMALL)?;
/// let mut player = waiting.manifest(message).map_err(|(_, error)| error)?;
/// for packet in packets {
///     let _ = player.push(packet); // a refusal is counted and leaves the player usable
/// }
/// let frame = player.frame(0)?;
/// assert_eq!(frame.gaussians.len(), 1);
/// # Ok::<(), codec_core::Error>(())
/// ```
#[derive(Debug)]
pub struct Player<'a> {
    receiver: Receiver<'a>,
    decoder: Decoder<'a>,
    gaussians: &'a mut [Gaussian],
    sh_rest: &'a mut [f32],
}

/// One decoded frame, in the player's memory until its next call.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'p> {
    /// The Gaussians of the frame's epoch; absent ones have opacity 0.
    pub gaussians: &'p [Gaussian],
    /// Their harmonic coefficients above band 0: Gaussian-major, then coefficient, then channel.
    pub sh_rest: &'p [f32],
    /// Degree of `sh_rest`: [`ShDegree::rest_len`] coefficients per Gaussian.
    pub sh_degree: ShDegree,
    /// What decoding did, and how much of the frame is there.
    pub decoded: Decoded,
}

/// How many blocks of a frame are usable, by level: element `l` counts those usable up to level `l`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usable {
    /// Blocks of the frame's epoch.
    pub blocks: u32,
    /// Blocks whose canonical attributes are usable.
    pub canonical: [u32; Level::COUNT],
    /// Blocks that are present and whose motion in the frame's window is usable (`dgs1`).
    pub motion: [u32; Level::COUNT],
}

/// What a manifest says of its stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamInfo {
    /// Frames.
    pub frames: u32,
    /// Frame rate: as many frames in as many seconds.
    pub frames_per_seconds: (u32, u32),
    /// Packets, parity included.
    pub packets: u32,
    /// Gaussians of the largest epoch: the most that a frame has.
    pub gaussians: u32,
    /// Harmonic degree of the frames.
    pub sh_degree: ShDegree,
    /// How Gaussians are drawn.
    pub footprint: Footprint,
    /// Which way is up.
    pub up: Up,
}

impl<'a> Player<'a> {
    /// The player of the manifest of `outline`, whose `raw_len` bytes lie at the front of `arena`, in
    /// the
    /// rest of that.
    fn divide(
        arena: &'a mut [u64],
        raw_len: usize,
        outline: Outline,
        plan: &Plan,
        caps: Caps,
    ) -> Result<Self> {
        let (have, words) = (size_of_val(arena), words_of::<u8>(raw_len));
        let too_small = || Error::too_small("arena", have, raw_len);
        let (raw, rest) = arena.split_at_mut_checked(words).ok_or_else(too_small)?;
        // Without the bytes that fill the last word up: they are no part of the manifest.
        let raw: &'a [u8] = bytemuck::cast_slice(raw);
        let manifest = outline.over(raw.get(..raw_len).ok_or_else(too_small)?)?;
        let parts = plan.divide(rest)?;
        Ok(Self {
            receiver: Receiver::new(parts.receiver, manifest, caps)?,
            decoder: Decoder::new(parts.decoder),
            gaussians: parts.gaussians,
            sh_rest: parts.sh_rest,
        })
    }
}

impl Player<'_> {
    /// Takes one packet, media or parity.
    ///
    /// # Errors
    /// Why the packet is refused; the player is as it was, but for its counters.
    pub fn push(&mut self, packet: &[u8]) -> Result<Accepted> {
        self.receiver.media(packet)
    }

    /// Decodes frame `frame` from what has arrived, every state being valid: blocks that are not there
    /// are absent or stood in for by a proxy, missing levels leave coarser values.
    ///
    /// # Errors
    /// [`ErrorKind::Illegal`](crate::ErrorKind::Illegal): a frame past the end.
    pub fn frame(&mut self, frame: u32) -> Result<Frame<'_>> {
        let content = self.receiver.content();
        let sh_degree = content.manifest.sh_degree();
        let decoded = self.decoder.frame(&content, frame, self.gaussians, self.sh_rest)?;
        let rest = decoded.gaussians * sh_degree.rest_len();
        let (gaussians, sh_rest) = (self.gaussians.get(..decoded.gaussians), self.sh_rest.get(..rest));
        let (have, need) = (self.gaussians.len(), decoded.gaussians);
        // The decoder has filled as many.
        let too_small = || Error::too_small("decode.out", have, need);
        let (gaussians, sh_rest) = gaussians.zip(sh_rest).ok_or_else(too_small)?;
        Ok(Frame { gaussians, sh_rest, sh_degree, decoded })
    }

    /// How much of frame `frame` can be shown.
    ///
    /// # Errors
    /// [`ErrorKind::Illegal`](crate::ErrorKind::Illegal): a frame past the end.
    pub fn usable(&self, frame: u32) -> Result<Usable> {
        let content = self.receiver.content();
        let manifest = content.manifest;
        let last = u64::from(manifest.head().frames) - 1;
        let past = Error::illegal("frame", 0, frame.into(), (0, last));
        let id = manifest.epoch_at(frame).ok_or(past)?;
        let epoch = manifest.epoch(id).ok_or(past)?;
        let window = manifest.window_at(frame);
        let mut usable = Usable::default();
        for cluster in (0..epoch.clusters).map(|c| ClusterId(c as u16)) {
            let span = Span::Canonical(id);
            let blocks = Shape::in_lattice(manifest, span, cluster)?.blocks();
            let canonical = content.cell_in_lattice(span, cluster)?;
            let motion = match window {
                Some(window) => Some(content.cell_in_lattice(Span::Motion(window), cluster)?),
                None => None,
            };
            for block in 0..blocks {
                let base = content.arrived(canonical, block)?;
                usable.blocks += 1;
                count(&mut usable.canonical, base.usable());
                if let Some(cell) = motion.filter(|_| base.usable() > 0) {
                    count(&mut usable.motion, content.arrived(cell, block)?.usable());
                }
            }
        }
        Ok(usable)
    }

    /// What the manifest says of the stream.
    pub fn info(&self) -> StreamInfo {
        let manifest = self.receiver.manifest();
        let head = manifest.head();
        StreamInfo {
            frames: head.frames,
            frames_per_seconds: (head.rate_frames, head.rate_seconds),
            packets: head.packets,
            gaussians: manifest.largest_epoch(),
            sh_degree: manifest.sh_degree(),
            footprint: manifest.footprint(),
            up: manifest.up(),
        }
    }

    /// The manifest, record by record.
    pub const fn manifest(&self) -> &Manifest<'_> {
        self.receiver.manifest()
    }

    /// What happened to packets so far; refusals by [`ErrorKind::index`](crate::ErrorKind::index).
    pub const fn counters(&self) -> &Counters {
        self.receiver.counters()
    }

    /// Whether packet `id` has been accepted or recovered.
    pub fn has(&self, id: PacketId) -> bool {
        self.receiver.has(id)
    }

    /// Writes a receipt (DGSF) to the front of `out` and returns its length: it acknowledges what has
    /// arrived or was recovered, the newest [`MAX_RECEIPT_RANGES`] ranges of packets of it.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`](crate::ErrorKind::Capacity) if `out` is too small; [`MAX_RECEIPT_BYTES`]
    /// are enough.
    pub fn receipt(
        &self,
        sequence: u32,
        playout_us: u64,
        pose: Option<ViewerPose>,
        out: &mut [u8],
    ) -> Result<usize> {
        // The newest first; what does not fit is old.
        let mut ranges = Vec::<IdRange, MAX_RECEIPT_RANGES>::new();
        let packets = self.manifest().head().packets;
        for id in (0..packets).rev().filter_map(PacketId::new).filter(|&id| self.has(id)) {
            if let Some((low, _)) = ranges.last_mut().filter(|(low, _)| low.get() == id.get() + 1) {
                *low = id;
            } else if ranges.push((id, id)).is_err() {
                break;
            }
        }
        ranges.reverse();
        Value { sequence, playout_us, pose, acknowledged: &ranges, recovered: &[], completed: &[] }.write(out)
    }

    /// Takes the packets that `waiting` kept and goes on counting from its counters: for a player whose
    /// memory was made once its manifest was there.
    ///
    /// # Errors
    /// None: what `waiting` keeps is whole. Refused packets are counted.
    pub fn take_over(&mut self, waiting: &Waiting<'_>) -> Result<()> {
        self.receiver.count_from(waiting.counters);
        self.take_early(&waiting.early)
    }

    /// Takes the packets of `early`.
    fn take_early(&mut self, early: &EarlyPackets<'_>) -> Result<()> {
        let mut packets = early.packets()?;
        while packets.left() > 0 {
            let len = packets.u16("caps.early_bytes")?;
            let packet = packets.bytes("caps.early_bytes", len.into())?;
            // A refusal is counted by the receiver; nobody waits for this packet's answer.
            let _ = self.push(packet);
        }
        Ok(())
    }

    /// The symbols and the state that have arrived, for decoders and tools of the host's own.
    pub fn content(&self) -> Content<'_> {
        self.receiver.content()
    }
}

impl<'a> Player<'a> {
    /// The receiver, for hosts that decode many packets at once.
    pub const fn receiver(&mut self) -> &mut Receiver<'a> {
        &mut self.receiver
    }
}

/// Most ranges of packets that [`Player::receipt`] acknowledges.
pub const MAX_RECEIPT_RANGES: usize = 128;

/// Counts a block that is usable up to `levels` levels.
fn count(counts: &mut [u32; Level::COUNT], levels: usize) {
    for count in counts.iter_mut().take(levels) {
        *count += 1;
    }
}
