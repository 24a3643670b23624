//! A decoder takes packets and gives Gaussians of a frame, packed for the device: in a worker, or where the
//! page is.

use dgs_player::Damage;
use js_sys::Float32Array;
use render_host::gpu::Packed;
use wasm_bindgen::prelude::*;

use crate::{
    channel::Conditions,
    orbit::{Orbit, Up},
    ranges::{Wanted, message},
    session::{Overlay, Session},
};

/// One stream; its clock and camera are [`Controls`](super::Controls).
#[wasm_bindgen]
#[derive(Debug)]
pub struct Decoder {
    session: Session,
    damage: String,
    /// Content and frame of the last picture that was packed.
    packed: Option<(u64, u32)>,
    values: Vec<f32>,
}

impl Decoder {
    fn of(session: Session, damage: String) -> Self {
        Self { session, damage, packed: None, values: Vec::new() }
    }
}

/// What of a file could not be used, for people: packets that somebody left out are no damage (SPEC.md,
/// section 12).
fn sentence(damage: &Damage) -> String {
    if damage.is_none() { String::new() } else { damage.to_string() }
}

/// Gaussians of a frame, packed.
#[wasm_bindgen]
#[derive(Debug)]
pub struct Picture {
    /// Number of Gaussians.
    #[wasm_bindgen(readonly)]
    pub count: u32,
    /// Degree of their harmonics.
    #[wasm_bindgen(readonly)]
    pub degree: u8,
    /// Whether harmonics are left out, being those of the picture before.
    #[wasm_bindgen(readonly, js_name = onlyMoved)]
    pub only_moved: bool,
    /// Bytes of all.
    #[wasm_bindgen(readonly)]
    pub bytes: u32,
}

#[wasm_bindgen]
impl Decoder {
    /// The `.dgs` file of these bytes.
    pub fn open(file: &[u8]) -> Result<Decoder, JsError> {
        let (session, damage) = Session::open(file)?;
        Ok(Self::of(session, sentence(&damage)))
    }

    /// A file of `length` bytes that begins with `first`, which hold its manifest; the rest is `wanted`.
    pub fn fetch(first: &[u8], length: f64) -> Result<Decoder, JsError> {
        let message = match message(first)? {
            Ok(message) => message,
            Err(needed) => {
                let there = first.len();
                return Err(JsError::new(&format!(
                    "file.manifest: {there} bytes are there, {needed} are needed"
                )));
            }
        };
        let mut session = Session::new(message)?;
        session.fetch(length as u64);
        session.take(0, first);
        Ok(Self::of(session, String::new()))
    }

    /// A stream that a server sends: its DGSM message.
    pub fn receive(message: &[u8]) -> Result<Decoder, JsError> {
        let mut session = Session::new(message)?;
        session.set_live();
        Ok(Self::of(session, String::new()))
    }

    /// A receipt for the server: its number, and when the first frame of the round was shown, microseconds
    /// since the round began; 0 before.
    pub fn receipt(&mut self, sequence: u32, playout_us: f64) -> Result<Vec<u8>, JsError> {
        Ok(self.session.receipt(sequence, playout_us as u64)?)
    }

    /// Looks from where the controls do, which receipts may tell: their view, and which way is up. What is no
    /// view changes nothing.
    pub fn look(&mut self, view: &[f64], up: &str) {
        let orbit = self.session.orbit_mut();
        let view = <[f64; 6]>::try_from(view).ok().zip(Up::named(up));
        if let Some(seen) = view.and_then(|(view, up)| orbit.with_up(up).at(view)) {
            *orbit = seen;
        }
    }

    /// When the first frame is due of the round that the server sends for `time`, seconds.
    #[wasm_bindgen(js_name = roundStart)]
    pub fn round_start(&self, time_s: f64) -> f64 {
        self.session.round_start_s(time_s)
    }

    /// Takes a packet that a server sent.
    pub fn push(&mut self, packet: &[u8]) {
        self.session.push(packet);
    }

    /// Which bytes to ask for next: first and past; one number for the whole file; none when all is there.
    pub fn wanted(&self) -> Vec<f64> {
        match self.session.wanted() {
            Wanted::Range(range) => vec![range.start as f64, range.end as f64],
            Wanted::Whole => vec![0.0],
            Wanted::Nothing => Vec::new(),
        }
    }

    /// Takes bytes of the file from offset `at` on.
    pub fn take(&mut self, at: f64, bytes: &[u8]) {
        self.session.take(at as u64, bytes);
    }

    /// Takes the whole file after all.
    #[wasm_bindgen(js_name = takeWhole)]
    pub fn take_whole(&mut self, file: &[u8]) -> Result<(), JsError> {
        self.damage = sentence(&self.session.take_whole(file)?);
        Ok(())
    }

    /// Share of the file that is there.
    #[wasm_bindgen(getter)]
    pub fn loaded(&self) -> f64 {
        self.session.loaded()
    }

    /// What of the file, as far as it is there, could not be used; empty for a whole one.
    #[wasm_bindgen(getter)]
    pub fn damage(&self) -> String {
        match self.session.damaged_packets() {
            0 => self.damage.clone(),
            1 => "1 packet is damaged".to_owned(),
            count => format!("{count} packets are damaged"),
        }
    }

    /// Which way is up: `y`, `minus-z` and so on.
    #[wasm_bindgen(getter)]
    pub fn up(&self) -> String {
        self.session.up_of_stream().name().to_owned()
    }

    /// The number of the footprint that Gaussians are drawn with.
    #[wasm_bindgen(getter)]
    pub fn footprint(&self) -> u8 {
        self.session.player().info().footprint as u8
    }

    /// Degree of the harmonics of its Gaussians.
    #[wasm_bindgen(getter)]
    pub fn degree(&self) -> u8 {
        self.session.player().info().sh_degree.get()
    }

    /// Frames, frames per second, most Gaussians of a frame, packets of the stream.
    pub fn info(&self) -> Vec<f64> {
        let (player, info) = (self.session.player(), self.session.player().info());
        let rate = player.manifest().frames_per_second();
        vec![f64::from(info.frames), rate, f64::from(info.gaussians), f64::from(info.packets)]
    }

    /// How long a clock waits for a base level, seconds.
    #[wasm_bindgen(getter)]
    pub fn base_timeout(&self) -> f64 {
        self.session.base_timeout_s()
    }

    /// Whether anything has come of what is shown at the frame.
    #[wasm_bindgen(getter, js_name = hasCome)]
    pub fn has_come(&self) -> bool {
        self.session.has_come()
    }

    /// Frames whose base a clock waits for: first and past of each range.
    pub fn missing(&self) -> Vec<u32> {
        self.session.missing().iter().flat_map(|frames| [frames.start, frames.end]).collect()
    }

    /// Goes to frame `frame`.
    #[wasm_bindgen(js_name = goTo)]
    pub fn go_to(&mut self, frame: u32) {
        let rate = self.session.player().manifest().frames_per_second();
        self.session.playback_mut().seek((f64::from(frame) + 0.5) / rate);
    }

    /// Sets the highest level shown, 0 to 3, and what blocks are painted by: the place of an [`Overlay`]
    /// among all of them.
    pub fn choose(&mut self, cap: u32, overlay: u32) {
        if self.session.cap() != cap as usize {
            self.session.set_cap(cap as usize);
        }
        let overlay = Overlay::ALL.get(overlay as usize).copied().unwrap_or_default();
        if self.session.overlay() != overlay {
            self.session.set_overlay(overlay);
        }
    }

    /// Decodes no level above `cap`, and gives the `share` of Gaussians that can cover most, above 0 and up
    /// to 1.
    pub fn reduce(&mut self, cap: u32, share: f32) {
        self.session.reduce(cap as usize, share);
    }

    /// Puts an emulated network before the player: share lost, mean run of losses, bits per second (0 for all
    /// at once), seconds of delay, seed.
    pub fn impair(
        &mut self,
        loss: f64,
        burst: f64,
        rate_bps: f64,
        delay_s: f64,
        seed: u32,
    ) -> Result<(), JsError> {
        let rate_bps = (rate_bps > 0.0).then_some(rate_bps);
        Ok(self.session.impair(Conditions { loss, burst, rate_bps, delay_s, seed: seed.into() })?)
    }

    /// Forgets every packet: the server begins as if nothing had arrived.
    pub fn restart(&mut self) -> Result<(), JsError> {
        Ok(self.session.restart()?)
    }

    /// An estimate of how good the frame last packed is, from what of it has come: 0 to 1.
    pub fn quality(&self) -> f32 {
        self.session.quality()
    }

    /// Lets the emulated network deliver; true while packets are on their way.
    pub fn deliver(&mut self, now_s: f64) -> bool {
        self.session.deliver(now_s)
    }

    /// Whether something was packed in a colour that changes with time.
    #[wasm_bindgen(getter)]
    pub fn fading(&self) -> bool {
        self.session.fading()
    }

    /// Blocks of the frame by level: proxies, base, refinements 1 to 3.
    pub fn levels(&self) -> Result<Vec<u32>, JsError> {
        Ok(self.session.levels()?.to_vec())
    }

    /// Packets that came, those that were decoded, and bytes that the emulated network has delivered.
    pub fn packets(&self) -> Vec<f64> {
        let (came, decoded) = self.session.packets();
        vec![came as f64, decoded as f64, self.session.delivered_bytes() as f64]
    }

    /// Where the Gaussians of the frame are: their middle (3), and a radius; nothing if none of them is seen.
    pub fn bounds(&mut self) -> Result<Vec<f64>, JsError> {
        self.packed = None;
        let Some((middle, radius)) = self.session.bounds()? else { return Ok(Vec::new()) };
        *self.session.orbit_mut() = Orbit::around(middle, radius, 1.0, Up::default());
        let [x, y, z] = middle;
        Ok(vec![x, y, z, radius])
    }

    /// Decodes and packs the Gaussians of the frame; nothing where they are those that were packed last, and
    /// not wanted `anew`.
    pub fn pack(&mut self, anew: bool) -> Result<Option<Picture>, JsError> {
        let fresh = (self.session.content(), self.session.playback().frame());
        if !anew && self.packed == Some(fresh) {
            return Ok(None);
        }
        let shown = self.session.show()?;
        let only_moved = shown.only_moved && !anew && self.packed.is_some();
        let packed = Packed::of(&shown.splats, only_moved, &mut self.values);
        let (count, degree, bytes) = (packed.count, packed.degree.get(), packed.bytes.len() as u32);
        self.packed = Some(fresh);
        Ok(Some(Picture { count, degree, only_moved, bytes }))
    }

    /// Copies what was packed to `into`, which is as long.
    #[wasm_bindgen(js_name = copyPacked)]
    pub fn copy_packed(&self, into: &Float32Array) -> Result<(), JsError> {
        let (found, needed) = (into.length() as usize, self.values.len());
        if found != needed {
            return Err(JsError::new(&format!("packed: room for {found} numbers, needed: {needed}")));
        }
        into.copy_from(&self.values);
        Ok(())
    }
}
