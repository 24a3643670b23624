//! Receives a stream in memory of its own and decodes its frames.

use std::{fmt, path::Path};

use codec_core::{
    Caps, Error, Result,
    internals::{
        ids::PacketId,
        receiver::Content,
        wire::manifest::{Manifest, ManifestHead},
    },
    player::{self as core, Accepted, Counters, Frame, Required, StreamInfo, Usable},
};
use codec_simd::BatchReceiver;
use self_cell::{MutBorrow, self_cell};

use crate::stream::{Damage, Stream};

type Arena = MutBorrow<Box<[u64]>>;

type CorePlayer<'a> = core::Player<'a>;
type CoreWaiting<'a> = core::Waiting<'a>;

self_cell!(
    struct PlayerInArena {
        owner: Arena,
        #[covariant]
        dependent: CorePlayer,
    }
);

self_cell!(
    struct WaitingInArena {
        owner: Arena,
        #[covariant]
        dependent: CoreWaiting,
    }
);

/// An arena that is just enough for the stream of the DGSM message `message` and for
/// [`Caps::early_bytes`], for players of codec-core.
///
/// # Errors
/// As [`Player::new`].
pub fn arena(message: &[u8], caps: &Caps) -> Result<Vec<u64>> {
    arena_of(&Manifest::parse(&unpacked(message, caps)?)?, caps)
}

/// The same for a manifest that is unpacked.
fn arena_of(manifest: &Manifest<'_>, caps: &Caps) -> Result<Vec<u64>> {
    Ok(vec![0; Required::by(manifest, caps)?.words])
}

/// The body of the DGSM message `message`, if `caps` allow its length.
fn unpacked(message: &[u8], caps: &Caps) -> Result<Vec<u8>> {
    let sealed = ManifestHead::parse(message)?.within(caps)?;
    let mut raw = vec![0u8; sealed.raw_len];
    sealed.open(message, codec_simd::crc32, &mut raw)?;
    Ok(raw)
}

/// A player that has no manifest yet and keeps the packets that come early.
///
/// ```
/// # let file = include_bytes!("../../tests/conformance/one.dgs");
/// # let (stream, _) = dgs_player::Stream::from_bytes(file)?;
/// use dgs_player::{Caps, Waiting};
///
/// let mut waiting = Waiting::new(Caps::HOST)?;
/// waiting.push(&stream.packets()[0])?;
/// let player = waiting.manifest(stream.message()).map_err(|(_, error)| error)?;
/// assert_eq!(player.counters().media, 1);
/// # Ok::<(), codec_core::Error>(())
/// ```
pub struct Waiting {
    waiting: WaitingInArena,
    caps: Caps,
}

impl Waiting {
    /// A player that will accept streams within `caps`.
    ///
    /// # Errors
    /// None in practice: the memory is made as large as [`Caps::early_bytes`] says.
    pub fn new(caps: Caps) -> Result<Self> {
        let early = vec![0u64; (caps.early_bytes as usize).div_ceil(size_of::<u64>())];
        let arena = MutBorrow::new(early.into_boxed_slice());
        let waiting = WaitingInArena::try_new(arena, |arena| fast(arena.borrow_mut(), caps))?;
        Ok(Self { waiting, caps })
    }

    /// Keeps one packet until the manifest comes.
    ///
    /// # Errors
    /// A damaged packet, or one too many for [`Caps::early_bytes`]; both are counted.
    pub fn push(&mut self, packet: &[u8]) -> Result<()> {
        self.waiting.with_dependent_mut(|_, waiting| waiting.push(packet))
    }

    /// What happened to packets so far.
    pub fn counters(&self) -> &Counters {
        self.waiting.borrow_dependent().counters()
    }

    /// Takes the whole DGSM message `message`, then the packets that came early.
    ///
    /// # Errors
    /// Why the message is refused, and the player as it was: it goes on waiting.
    pub fn manifest(self, message: &[u8]) -> std::result::Result<Player, (Self, Error)> {
        match Player::new(message, &self.caps) {
            Ok(mut player) => {
                let waiting = self.waiting.borrow_dependent();
                match player.player.with_dependent_mut(|_, player| player.take_over(waiting)) {
                    Ok(()) => Ok(player),
                    Err(error) => Err((self, error)),
                }
            }
            Err(error) => Err((self, error)),
        }
    }
}

/// A waiting player with the arithmetic of this machine.
fn fast(arena: &mut [u64], caps: Caps) -> Result<core::Waiting<'_>> {
    Ok(core::Waiting::new(arena, caps)?.with_arithmetic(codec_simd::crc32, codec_simd::combine()))
}

/// A stream in memory of its own: packets in, frames out.
///
/// ```
/// # let file = include_bytes!("../../tests/conformance/one.dgs");
/// let (mut player, damage) = dgs_player::Player::open(file)?;
/// assert!(damage.is_none());
/// let frame = player.frame(0)?;
/// println!("{} Gaussians", frame.gaussians.len());
/// # Ok::<(), codec_core::Error>(())
/// ```
pub struct Player {
    player: PlayerInArena,
    batches: BatchReceiver,
}

/// Why a file cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] std::io::Error),
    /// It is no `.dgs` file, or one whose manifest is damaged or exceeds the caps.
    #[error(transparent)]
    Format(#[from] Error),
}

impl Player {
    /// Plays the stream of the DGSM message `message`; no packet has arrived.
    ///
    /// # Errors
    /// A damaged message; [`ErrorKind::Capacity`](codec_core::ErrorKind::Capacity) naming the count
    /// that exceeds `caps`.
    pub fn new(message: &[u8], caps: &Caps) -> Result<Self> {
        Self::of(&Manifest::parse(&unpacked(message, caps)?)?, caps)
    }

    /// Plays the stream of a manifest that is unpacked.
    pub(crate) fn of(manifest: &Manifest<'_>, caps: &Caps) -> Result<Self> {
        let caps = Caps { early_bytes: 0, ..*caps };
        let arena = MutBorrow::new(arena_of(manifest, &caps)?.into_boxed_slice());
        let player = PlayerInArena::try_new(arena, |arena| {
            fast(arena.borrow_mut(), caps)?.unpacked(manifest).map_err(|(_, error)| error)
        })?;
        Ok(Self { player, batches: BatchReceiver::default() })
    }

    /// Plays the `.dgs` file `file`, all of whose packets have arrived; the
    /// [`Damage`] says what of a damaged one could not be used.
    ///
    /// # Errors
    /// If the manifest is unreadable or exceeds [`Caps::HOST`]; refused packets are counted.
    pub fn open(file: &[u8]) -> Result<(Self, Damage)> {
        Self::open_within(file, &Caps::HOST)
    }

    /// As [`Player::open`], of files within `caps`.
    ///
    /// ```
    /// use dgs_player::{Caps, ErrorKind, Player};
    ///
    /// # let file = include_bytes!("../../tests/conformance/one.dgs");
    /// let caps = Caps { gaussians_per_epoch: 1000, ..Caps::HOST };
    /// assert!(Player::open_within(file, &caps).is_ok());
    /// let error = Player::open_within(file, &Caps { frames: 0, ..caps }).unwrap_err();
    /// assert_eq!(error.kind, ErrorKind::Capacity);
    /// ```
    ///
    /// # Errors
    /// If the manifest is unreadable or exceeds `caps`; refused packets are counted.
    pub fn open_within(file: &[u8], caps: &Caps) -> Result<(Self, Damage)> {
        let (stream, damage) = Stream::from_bytes_within(file, caps)?;
        Ok((stream.receive_within(caps)?, damage))
    }

    /// As [`Player::open`], of the file at `path`.
    ///
    /// # Errors
    /// If the file cannot be read, and as [`Player::open`].
    pub fn open_file(path: impl AsRef<Path>) -> std::result::Result<(Self, Damage), OpenError> {
        Self::open_file_within(path, &Caps::HOST)
    }

    /// As [`Player::open_within`], of the file at `path`, which is read as a whole.
    ///
    /// # Errors
    /// If the file cannot be read, and as [`Player::open_within`].
    pub fn open_file_within(
        path: impl AsRef<Path>,
        caps: &Caps,
    ) -> std::result::Result<(Self, Damage), OpenError> {
        Ok(Self::open_within(&std::fs::read(path)?, caps)?)
    }

    /// Takes one packet, media or parity, in any order.
    ///
    /// # Errors
    /// Why the packet is refused; it is counted, and the player is as it was.
    pub fn push(&mut self, packet: &[u8]) -> Result<Accepted> {
        self.player.with_dependent_mut(|_, player| player.push(packet))
    }

    /// Takes many packets, decoding several at once: as [`Player::push`] of each in turn, faster.
    pub fn push_all<'p>(&mut self, packets: impl IntoIterator<Item = &'p [u8]>) {
        let batches = &mut self.batches;
        self.player.with_dependent_mut(|_, player| {
            // Refusals are counted by kind.
            batches.receive(player.receiver(), packets, |_| ());
        });
    }

    /// Decodes frame `frame` from what has arrived.
    ///
    /// # Errors
    /// A frame past the end.
    pub fn frame(&mut self, frame: u32) -> Result<Frame<'_>> {
        self.player.with_dependent_mut(|_, player| player.frame(frame))
    }

    /// How much of frame `frame` can be shown.
    ///
    /// # Errors
    /// A frame past the end.
    pub fn usable(&self, frame: u32) -> Result<Usable> {
        self.player.borrow_dependent().usable(frame)
    }

    /// Whether packet `id` has been accepted or recovered.
    pub fn has(&self, id: PacketId) -> bool {
        self.player.borrow_dependent().has(id)
    }

    /// What happened to packets so far.
    pub fn counters(&self) -> &Counters {
        self.player.borrow_dependent().counters()
    }

    /// What the manifest says of the stream.
    pub fn info(&self) -> StreamInfo {
        self.player.borrow_dependent().info()
    }

    /// The manifest, record by record.
    pub fn manifest(&self) -> &Manifest<'_> {
        self.player.borrow_dependent().manifest()
    }

    /// The symbols and the state that have arrived, for [`FrameDecoder`](crate::FrameDecoder)s and tools.
    pub fn content(&self) -> Content<'_> {
        self.player.borrow_dependent().content()
    }

    /// The player over its arena: receipts, single packets, the receiver itself.
    pub fn with_core<R>(&mut self, work: impl for<'a> FnOnce(&mut core::Player<'a>) -> R) -> R {
        self.player.with_dependent_mut(|_, player| work(player))
    }
}

impl Stream {
    /// A player that has taken the manifest and every packet.
    ///
    /// # Errors
    /// If the manifest is refused, by [`Caps::HOST`] perhaps; refused packets are counted, not errors.
    pub fn receive(&self) -> Result<Player> {
        self.receive_within(&Caps::HOST)
    }

    /// As [`Stream::receive`], of streams within `caps`.
    ///
    /// # Errors
    /// If the manifest is refused, by `caps` perhaps; refused packets are counted, not errors.
    pub fn receive_within(&self, caps: &Caps) -> Result<Player> {
        let mut player = Player::of(&self.manifest()?, caps)?;
        player.push_all(self.packets().iter().filter(|p| !p.is_empty()).map(Vec::as_slice));
        Ok(player)
    }
}

impl fmt::Debug for Waiting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Waiting").field("counters", self.counters()).finish_non_exhaustive()
    }
}

impl fmt::Debug for Player {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Player").field("counters", self.counters()).finish_non_exhaustive()
    }
}
