//! A session holds one stream, its clock, its camera and its emulated network, and says what to draw.

mod arrived;
mod framing;
mod network;
mod overlay;
mod quality;
mod thinner;

use std::ops::Range;

use codec_core::{internals::ids::Span, player::MAX_RECEIPT_BYTES};
use dgs_player::{Caps, Damage, ErrorKind, FrameDecoder, Player, Result, Stream, Usable};
use render_host::Splats;

use self::{
    network::{Network, id_of},
    overlay::Painter,
    quality::{blocks_of, quality},
    thinner::Thinner,
};
pub use self::{
    overlay::{LEVEL_COLOURS, Overlay},
    quality::LEVELS,
};
use crate::{
    channel::Conditions,
    orbit::{Orbit, Up},
    playback::{Playback, Step},
    ranges::{RangePlan, Wanted},
};

/// How long the clock waits for a base that a server may still send, seconds.
const BASE_TIMEOUT_S: f64 = 0.5;

/// How many blocks of the frame are shown at what: proxies, base, refinements 1 to 3.
pub type BlocksByLevel = [u32; LEVELS + 1];

/// Gaussians of the frame that is due.
#[derive(Debug)]
pub struct Shown<'s> {
    /// What to draw.
    pub splats: Splats<'s>,
    /// Whether only what moves has changed since the last call: harmonics are as they were.
    pub only_moved: bool,
}

/// A camera that was placed before there was anything to look at.
#[derive(Clone, Copy, Debug)]
struct Unframed {
    /// What it was placed as: another is somebody's choice.
    placed: Orbit,
    /// Packets that were decoded when Gaussians were looked for last.
    decoded: usize,
    /// Whether any have been found since.
    found: bool,
}

/// One stream as a viewer has it open: what has come of it, its clock, its camera, its emulated network, and
/// what to draw of it.
#[derive(Debug)]
pub struct Session {
    message: Vec<u8>,
    /// Every packet that came, in the order in which it came: what the emulated network is given.
    packets: Vec<Vec<u8>>,
    player: Player,
    decoder: FrameDecoder,
    network: Network,
    /// Bytes that it delivered.
    delivered: u64,
    plan: Option<RangePlan>,
    /// Whether a server sends packets.
    live: bool,
    playback: Playback,
    orbit: Orbit,
    /// How the camera was placed where there was nothing to look at yet.
    unframed: Option<Unframed>,
    cap: usize,
    /// What a player that cannot keep up leaves out besides: levels above this, all but a share of Gaussians.
    reduced_cap: usize,
    thinner: Thinner,
    painter: Painter,
    state: Vec<u8>,
    /// Changes with everything that changes harmonics: packets, cap, overlay.
    content: u64,
    /// `content` and epoch of the last frame shown.
    last: Option<(u64, u16)>,
    /// Of the last frame shown.
    quality: f32,
}

impl Session {
    /// The stream of the DGSM message `message`; no packet has come.
    ///
    /// # Errors
    /// A damaged message, or one beyond [`Caps::HOST`].
    pub fn new(message: &[u8]) -> Result<Self> {
        let player = Player::new(message, &Caps::HOST)?;
        let decoder = FrameDecoder::new(player.manifest());
        let playback = Playback::new(player.info().frames, player.manifest().frames_per_second());
        Ok(Self {
            message: message.to_vec(),
            packets: Vec::new(),
            player,
            decoder,
            network: Network::new(Conditions::default()),
            delivered: 0,
            plan: None,
            live: false,
            playback,
            orbit: Orbit::default(),
            unframed: None,
            cap: LEVELS - 1,
            reduced_cap: LEVELS - 1,
            thinner: Thinner::default(),
            painter: Painter::default(),
            state: Vec::new(),
            content: 0,
            last: None,
            quality: 0.0,
        })
    }

    /// The `.dgs` file `file`, as far as it is readable, and what was not.
    ///
    /// # Errors
    /// Its manifest is unreadable.
    pub fn open(file: &[u8]) -> Result<(Self, Damage)> {
        let (stream, damage) = Stream::from_bytes(file)?;
        let mut session = Self::new(stream.message())?;
        session.push_all(stream.packets().iter().filter(|packet| !packet.is_empty()).cloned());
        Ok((session, damage))
    }

    /// Fetches the rest of a file of `len` bytes piece by piece: see [`Session::wanted`].
    pub fn fetch(&mut self, len: u64) {
        self.plan = Some(RangePlan::new(len, self.player.manifest().head().epochs));
    }

    /// Which bytes of the file to ask for next.
    pub fn wanted(&self) -> Wanted {
        self.plan.as_ref().map_or(Wanted::Nothing, |plan| plan.next(self.epoch()))
    }

    /// Takes `bytes` of the file from offset `at` on.
    pub fn take(&mut self, at: u64, bytes: &[u8]) {
        let Some(mut plan) = self.plan.take() else { return };
        let mut packets = Vec::new();
        plan.take(at, bytes, self.player.manifest(), |packet| packets.push(packet.to_vec()));
        self.plan = Some(plan);
        self.push_all(packets);
    }

    /// Takes the whole file after all: what there was of the plan is over.
    ///
    /// # Errors
    /// Its manifest is unreadable.
    pub fn take_whole(&mut self, file: &[u8]) -> Result<Damage> {
        let (stream, damage) = Stream::from_bytes(file)?;
        self.plan = None;
        self.push_all(stream.packets().iter().filter(|packet| !packet.is_empty()).cloned());
        Ok(damage)
    }

    /// Packets of the file that came by pieces and were refused.
    pub fn damaged_packets(&self) -> u32 {
        let refused = self.player.counters().refused;
        let damaged = refused.iter().sum::<u32>() - refused[ErrorKind::Duplicate.index()];
        if self.plan.is_some() { damaged } else { 0 }
    }

    /// Share of the file that is there, 0 to 1.
    pub fn loaded(&self) -> f64 {
        self.plan.as_ref().map_or(1.0, RangePlan::share)
    }

    /// A server sends packets from now on: the clock gives each base a moment to come.
    pub fn set_live(&mut self) {
        self.live = true;
    }

    /// Whether a server sends packets.
    pub fn is_live(&self) -> bool {
        self.live
    }

    /// A receipt for that server: what has arrived, where the camera is, and when the first frame of the
    /// round was shown, microseconds since the round began (0 before).
    ///
    /// # Errors
    /// None in practice.
    pub fn receipt(&mut self, sequence: u32, playout_us: u64) -> Result<Vec<u8>> {
        let mut receipt = vec![0; MAX_RECEIPT_BYTES];
        let pose = self.orbit.pose();
        let length = self.player.with_core(|core| core.receipt(sequence, playout_us, pose, &mut receipt))?;
        receipt.truncate(length);
        Ok(receipt)
    }

    /// When the first frame of the round is due that a server sends for `time_s`: that of its window, or of
    /// its epoch, seconds of the clip.
    pub fn round_start_s(&self, time_s: f64) -> f64 {
        let manifest = self.player.manifest();
        let frame = self.playback.frame_at(time_s);
        let window = manifest.window_at(frame).and_then(|id| manifest.window(id)).map(|w| w.first_frame);
        let epoch = || manifest.epoch_at(frame).and_then(|id| manifest.epoch(id)).map(|e| e.first_frame);
        f64::from(window.or_else(epoch).unwrap_or(0)) / manifest.frames_per_second()
    }

    /// Takes one packet from a network that is none of ours.
    pub fn push(&mut self, packet: &[u8]) {
        self.push_all([packet.to_vec()]);
    }

    fn push_all(&mut self, packets: impl IntoIterator<Item = Vec<u8>>) {
        // A server that repeats its clip sends for hours: what is there already, or on its way, is not stored
        // again.
        let (live, player, network) = (self.live, &self.player, &mut self.network);
        let mut is_known =
            |packet: &[u8]| id_of(packet).is_some_and(|id| player.has(id) || !network.note(id));
        self.packets.extend(packets.into_iter().filter(|packet| !live || !is_known(packet)));
        if self.conditions().is_perfect() {
            self.send_all();
        }
    }

    /// Gives the player everything that came.
    fn send_all(&mut self) {
        let fresh = &self.packets[self.network.through()..];
        if !fresh.is_empty() {
            self.player.push_all(fresh.iter().map(Vec::as_slice));
            self.delivered += fresh.iter().map(|packet| packet.len() as u64).sum::<u64>();
            self.content += 1;
        }
        self.network.skip(&self.packets);
    }

    /// Forgets every packet: the server begins as if nothing had arrived.
    ///
    /// # Errors
    /// None in practice: the manifest was taken before.
    pub fn restart(&mut self) -> Result<()> {
        self.packets.clear();
        self.impair(self.conditions())
    }

    /// Puts a network between what came and the player, from the first packet on.
    ///
    /// # Errors
    /// None in practice: the manifest was taken before.
    pub fn impair(&mut self, conditions: Conditions) -> Result<()> {
        self.player = Player::new(&self.message, &Caps::HOST)?;
        self.network = Network::new(conditions);
        self.delivered = 0;
        if self.live {
            for id in self.packets.iter().filter_map(|packet| id_of(packet)) {
                self.network.note(id);
            }
        }
        self.painter.forget_arrivals();
        self.content += 1;
        if self.conditions().is_perfect() {
            self.send_all();
        }
        Ok(())
    }

    /// The network's conditions.
    pub fn conditions(&self) -> Conditions {
        self.network.conditions()
    }

    /// Lets the network deliver what is through at `now_s`; true while more is on its way, or what has come
    /// is still painted as new.
    pub fn deliver(&mut self, now_s: f64) -> bool {
        self.painter.set_time(now_s);
        let fading = self.fading();
        self.content += u64::from(fading);
        fading | self.deliver_packets(now_s)
    }

    /// Whether what was shown last is painted as new, in colours that change with time.
    pub fn fading(&self) -> bool {
        self.painter.fading()
    }

    fn deliver_packets(&mut self, now_s: f64) -> bool {
        if self.conditions().is_perfect() {
            return false;
        }
        let before = self.network.through();
        let arrived = self.network.deliver(&self.packets, self.live, now_s);
        self.delivered += arrived.iter().map(|packet| packet.len() as u64).sum::<u64>();
        self.player.push_all(arrived);
        self.content += u64::from(self.network.through() > before);
        self.network.through() < self.packets.len()
    }

    /// Lets `dt_s` seconds pass.
    pub fn advance(&mut self, dt_s: f64) -> Step {
        let (player, plan) = (&self.player, &self.plan);
        self.playback.advance(dt_s, base_timeout_s(plan, self.live), |frame| has_base(player, plan, frame))
    }

    /// How long the clock waits for a base level, seconds: for ever where it is on its way.
    pub fn base_timeout_s(&self) -> f64 {
        base_timeout_s(&self.plan, self.live)
    }

    /// Frames whose base the clock waits for.
    pub fn missing(&self) -> Vec<Range<u32>> {
        if self.base_timeout_s() == 0.0 {
            return Vec::new();
        }
        let epochs = self.player.manifest().epochs();
        let frames = epochs.map(|epoch| epoch.first_frame..epoch.first_frame + epoch.frames);
        frames.filter(|frames| !has_base(&self.player, &self.plan, frames.start)).collect()
    }

    /// The clock.
    pub fn playback(&self) -> &Playback {
        &self.playback
    }

    /// The clock, to set it.
    pub fn playback_mut(&mut self) -> &mut Playback {
        &mut self.playback
    }

    /// The camera.
    pub fn orbit(&self) -> &Orbit {
        &self.orbit
    }

    /// The camera, to move it.
    pub fn orbit_mut(&mut self) -> &mut Orbit {
        &mut self.orbit
    }

    /// What the stream is.
    pub fn player(&self) -> &Player {
        &self.player
    }

    /// Which way is up, as the stream says.
    pub fn up_of_stream(&self) -> Up {
        Up::named(self.player.info().up.name()).unwrap_or_default()
    }

    /// The highest level that is shown, 0 to 3.
    pub fn cap(&self) -> usize {
        self.cap
    }

    /// Shows no level above `cap`.
    pub fn set_cap(&mut self, cap: usize) {
        self.cap = cap.min(LEVELS - 1);
        self.content += 1;
    }

    /// Shows no level above `cap` either, and of Gaussians the `share` that can cover most, above 0 and up to
    /// 1: a player that cannot keep up leaves out the rest.
    pub fn reduce(&mut self, cap: usize, share: f32) {
        let cap = cap.min(LEVELS - 1);
        if self.thinner.set_share(share) | (self.reduced_cap != cap) {
            self.reduced_cap = cap;
            self.content += 1;
        }
    }

    /// What blocks are painted by.
    pub fn overlay(&self) -> Overlay {
        self.painter.overlay()
    }

    /// Paints blocks by `overlay`.
    pub fn set_overlay(&mut self, overlay: Overlay) {
        self.painter.set_overlay(overlay);
        self.content += 1;
    }

    /// A number that changes with what [`Session::show`] gives, but for the frame.
    pub fn content(&self) -> u64 {
        self.content
    }

    fn epoch(&self) -> u16 {
        self.player.manifest().epoch_at(self.playback.frame()).map_or(0, |epoch| epoch.0)
    }

    /// Gaussians of the frame that is due.
    ///
    /// # Errors
    /// None in practice: the clock stays within the clip.
    pub fn show(&mut self) -> Result<Shown<'_>> {
        let key = (self.content, self.epoch());
        let only_moved = self.last == Some(key);
        self.last = Some(key);
        let content = self.player.content();
        let cap = self.cap.min(self.reduced_cap);
        let above = !((2u8 << cap) - 1);
        if cap < LEVELS - 1 {
            self.state.clear();
            self.state.extend(content.blocks.iter().map(|mask| mask & !above));
        }
        let capped = if cap < LEVELS - 1 { content.with_state(&self.state) } else { content };
        let frame = self.decoder.frame(&capped, self.playback.frame())?;
        let overlay = self.painter.overlay();
        let epoch = frame.decoded.epoch;
        if !only_moved {
            let blocks = blocks_of(&content, Span::Canonical(epoch), frame.gaussians.len())?;
            self.quality = quality(&blocks, frame.gaussians);
        }
        if overlay == Overlay::None {
            // The decoder gives as many harmonics as Gaussians have.
            let splats = Splats::new(frame.gaussians, frame.sh_rest, frame.sh_degree)
                .unwrap_or_else(|_| Splats::plain(frame.gaussians));
            return Ok(Shown { splats: self.thinner.thinned(splats, only_moved), only_moved });
        }
        // What has come, whatever the cap; but levels as they are shown.
        let shown = if overlay == Overlay::Levels { &capped } else { &content };
        let painted = self.painter.paint(frame.gaussians, epoch.0, Span::Canonical(epoch), shown)?;
        // Colours by what a block covers are of the frame.
        let repainted = overlay == Overlay::Missing;
        let splats = self.thinner.thinned(Splats::plain(painted), only_moved);
        Ok(Shown { splats, only_moved: only_moved && !repainted })
    }

    /// How many blocks of the frame that is due have come to which level, whatever the cap.
    ///
    /// # Errors
    /// None in practice.
    pub fn levels(&self) -> Result<BlocksByLevel> {
        let Usable { blocks, canonical, .. } = self.player.usable(self.playback.frame())?;
        let mut by_level = [blocks.saturating_sub(canonical[0]), 0, 0, 0, 0];
        for level in 0..LEVELS {
            let above = canonical.get(level + 1).copied().unwrap_or(0);
            by_level[level + 1] = canonical[level].saturating_sub(above);
        }
        Ok(by_level)
    }

    /// An estimate of how good the frame last shown is, whatever the cap, from what of it has come: 0,
    /// nothing but stand-ins, to 1, everything there.
    pub fn quality(&self) -> f32 {
        self.quality
    }

    /// Packets that came, and those that were decoded.
    pub fn packets(&self) -> (usize, usize) {
        let counters = self.player.counters();
        (self.packets.len(), (counters.media + counters.parity) as usize)
    }

    /// Bytes of packets that the emulated network has delivered.
    pub fn delivered_bytes(&self) -> u64 {
        self.delivered
    }
}

/// How long a clock waits for a base level, seconds.
fn base_timeout_s(plan: &Option<RangePlan>, live: bool) -> f64 {
    match plan {
        Some(_) => f64::INFINITY,
        None if live => BASE_TIMEOUT_S,
        None => 0.0,
    }
}

/// Whether the base of `frame` is there: as far as a file came, else every block of it.
fn has_base(player: &Player, plan: &Option<RangePlan>, frame: u32) -> bool {
    if let Some(plan) = plan {
        return player.manifest().epoch_at(frame).is_none_or(|epoch| plan.has_base(epoch.0));
    }
    player.usable(frame).is_ok_and(|usable| usable.canonical[0] == usable.blocks)
}

#[cfg(test)]
mod tests;
