//! The shell gives a page session and screen as JavaScript classes: arguments in, numbers out, no logic.

use render_host::gpu::wgpu;
use wasm_bindgen::prelude::*;
use web_sys::HtmlCanvasElement;

use crate::{
    channel::Conditions,
    orbit::{Orbit, Up},
    ranges::{FIRST_BYTES, Wanted, message},
    screen::{Drawn, Look, Screen, ScreenError},
    session::{LEVEL_COLOURS, LEVELS, Session},
};

/// A canvas with a device.
#[wasm_bindgen(js_name = Screen)]
pub struct ScreenShell(Screen);

#[wasm_bindgen(js_class = Screen)]
impl ScreenShell {
    /// Opens a device that can draw on `canvas`.
    pub async fn open(canvas: HtmlCanvasElement) -> Result<ScreenShell, JsError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::BROWSER_WEBGPU;
        let instance = wgpu::Instance::new(descriptor);
        let surface = instance.create_surface(wgpu::SurfaceTarget::Canvas(canvas))?;
        Ok(Self(Screen::open(&instance, surface).await?))
    }

    /// Name of the adapter; empty where the browser keeps it to itself.
    #[wasm_bindgen(getter)]
    pub fn adapter(&self) -> String {
        self.0.adapter()
    }

    /// Whether the device is gone: open another screen on the canvas.
    #[wasm_bindgen(getter)]
    pub fn lost(&self) -> bool {
        self.0.is_lost()
    }

    /// Frames that the device has finished.
    #[wasm_bindgen(getter)]
    pub fn finished(&self) -> u32 {
        self.0.finished()
    }

    /// Frames that it still draws.
    #[wasm_bindgen(getter)]
    pub fn pending(&self) -> u32 {
        self.0.pending()
    }

    /// Whether the last picture was not whole: draw again.
    #[wasm_bindgen(getter)]
    pub fn stale(&self) -> bool {
        self.0.must_draw_again()
    }

    /// Bytes on the device.
    #[wasm_bindgen(getter)]
    pub fn bytes(&self) -> f64 {
        self.0.bytes() as f64
    }

    /// Gives the device up, as a browser may at any time: for tests.
    pub fn destroy(&self) {
        self.0.destroy();
    }
}

/// One stream and how it is shown.
#[wasm_bindgen(js_name = Session)]
pub struct SessionShell {
    session: Session,
    damage: String,
    background: [f32; 3],
    /// What is on the screen.
    drawn: Drawn,
}

/// Bytes to ask for first when a file is fetched in pieces.
#[wasm_bindgen(js_name = firstBytes)]
pub fn first_bytes() -> f64 {
    FIRST_BYTES as f64
}

/// Bytes of WebAssembly memory.
#[wasm_bindgen(js_name = memoryBytes)]
pub fn memory_bytes() -> f64 {
    let memory: js_sys::WebAssembly::Memory = wasm_bindgen::memory().unchecked_into();
    let buffer: js_sys::ArrayBuffer = memory.buffer().unchecked_into();
    f64::from(buffer.byte_length())
}

/// Colours of levels, r g b of 0 to 1 each: proxies, base, refinements.
#[wasm_bindgen(js_name = levelColours)]
pub fn level_colours() -> Vec<f32> {
    LEVEL_COLOURS.as_flattened().to_vec()
}

/// How many bytes of a file are needed for its manifest, which begins with `first`; 0 when they are there.
#[wasm_bindgen(js_name = manifestBytes)]
pub fn manifest_bytes(first: &[u8]) -> Result<f64, JsError> {
    Ok(message(first)?.err().map_or(0.0, |needed| needed as f64))
}

impl SessionShell {
    fn of(session: Session, damage: String) -> Self {
        Self { session, damage, background: [0.0; 3], drawn: None }
    }
}

#[wasm_bindgen(js_class = Session)]
impl SessionShell {
    /// The `.dgs` file of these bytes.
    pub fn open(file: &[u8]) -> Result<SessionShell, JsError> {
        let (session, damage) = Session::open(file)?;
        Ok(Self::of(session, damage.to_string()))
    }

    /// A file of `length` bytes that begins with `first`, which hold its manifest; the rest is `wanted`.
    pub fn fetch(first: &[u8], length: f64) -> Result<SessionShell, JsError> {
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
    pub fn receive(message: &[u8]) -> Result<SessionShell, JsError> {
        let mut session = Session::new(message)?;
        session.set_live();
        Ok(Self::of(session, String::new()))
    }

    /// A receipt for the server: its number, and when the first frame of the round was shown, microseconds
    /// since the round began; 0 before.
    pub fn receipt(&mut self, sequence: u32, playout_us: f64) -> Result<Vec<u8>, JsError> {
        Ok(self.session.receipt(sequence, playout_us as u64)?)
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
        Ok(self.session.take_whole(file)?)
    }

    /// Share of the file that is there.
    #[wasm_bindgen(getter)]
    pub fn loaded(&self) -> f64 {
        self.session.loaded()
    }

    /// What of the file could not be used; empty for a whole one.
    #[wasm_bindgen(getter)]
    pub fn damage(&self) -> String {
        self.damage.clone()
    }

    /// Frames, frames per second, most Gaussians of a frame, packets of the stream.
    pub fn info(&self) -> Vec<f64> {
        let (player, info) = (self.session.player(), self.session.player().info());
        let rate = player.manifest().frames_per_second();
        vec![f64::from(info.frames), rate, f64::from(info.gaussians), f64::from(info.packets)]
    }

    /// Length of the clip, seconds.
    #[wasm_bindgen(getter)]
    pub fn duration(&self) -> f64 {
        self.session.playback().duration_s()
    }

    /// Where the clock is, seconds.
    #[wasm_bindgen(getter)]
    pub fn time(&self) -> f64 {
        self.session.playback().time_s()
    }

    /// Goes there.
    #[wasm_bindgen(setter)]
    pub fn set_time(&mut self, time_s: f64) {
        self.session.playback_mut().seek(time_s);
    }

    /// The frame that is due.
    #[wasm_bindgen(getter)]
    pub fn frame(&self) -> u32 {
        self.session.playback().frame()
    }

    /// Goes `frames` frames on and stands.
    pub fn step(&mut self, frames: i32) {
        self.session.playback_mut().step(frames);
    }

    /// Whether the clock runs.
    #[wasm_bindgen(getter)]
    pub fn playing(&self) -> bool {
        self.session.playback().playing()
    }

    /// Lets it run or stand.
    #[wasm_bindgen(setter)]
    pub fn set_playing(&mut self, playing: bool) {
        self.session.playback_mut().set_playing(playing);
    }

    /// Seconds of the clip per second.
    #[wasm_bindgen(getter)]
    pub fn rate(&self) -> f64 {
        self.session.playback().rate()
    }

    /// Sets that.
    #[wasm_bindgen(setter)]
    pub fn set_rate(&mut self, rate: f64) {
        self.session.playback_mut().set_rate(rate);
    }

    /// Whether the clip begins again at its end.
    #[wasm_bindgen(getter)]
    pub fn looping(&self) -> bool {
        self.session.playback().looping()
    }

    /// Sets that.
    #[wasm_bindgen(setter)]
    pub fn set_looping(&mut self, looping: bool) {
        self.session.playback_mut().set_looping(looping);
    }

    /// Lets `dt` seconds pass: 1 the clip began again, 2 it ended, 4 it waits for a base level, or nothing of
    /// these.
    pub fn advance(&mut self, dt_s: f64) -> u32 {
        let step = self.session.advance(dt_s);
        u32::from(step.looped) | u32::from(step.ended) << 1 | u32::from(step.stalled) << 2
    }

    /// Highest level shown, 0 to 3.
    #[wasm_bindgen(getter)]
    pub fn cap(&self) -> u32 {
        self.session.cap() as u32
    }

    /// Sets that.
    #[wasm_bindgen(setter)]
    pub fn set_cap(&mut self, cap: u32) {
        self.session.set_cap(cap as usize);
    }

    /// Whether blocks are painted by level.
    #[wasm_bindgen(getter)]
    pub fn overlay(&self) -> bool {
        self.session.overlay()
    }

    /// Sets that.
    #[wasm_bindgen(setter)]
    pub fn set_overlay(&mut self, overlay: bool) {
        self.session.set_overlay(overlay);
    }

    /// Sets the colour behind everything, 0 to 1 each.
    #[wasm_bindgen(js_name = setBackground)]
    pub fn set_background(&mut self, red: f32, green: f32, blue: f32) {
        self.background = [red, green, blue].map(|v| if v.is_finite() { v.clamp(0.0, 1.0) } else { 0.0 });
        self.drawn = None;
    }

    /// Puts an emulated network before the player: share lost, mean run of losses, bits per second (0 for all
    /// at once), seed.
    pub fn impair(&mut self, loss: f64, burst: f64, rate_bps: f64, seed: u32) -> Result<(), JsError> {
        let rate_bps = (rate_bps > 0.0).then_some(rate_bps);
        Ok(self.session.impair(Conditions { loss, burst, rate_bps, seed: seed.into() })?)
    }

    /// Lets the emulated network deliver; true while packets are on their way.
    pub fn deliver(&mut self, now_s: f64) -> bool {
        self.session.deliver(now_s)
    }

    /// Blocks of the frame by level: proxies, base, refinements 1 to 3.
    pub fn levels(&self) -> Result<Vec<u32>, JsError> {
        Ok(self.session.levels()?.to_vec())
    }

    /// Packets that came, and those that were decoded.
    pub fn packets(&self) -> Vec<u32> {
        let (came, decoded) = self.session.packets();
        vec![came as u32, decoded as u32]
    }

    /// Moves the camera so that every Gaussian is in the picture; `up` is `y`, `minus-z` and so on.
    #[wasm_bindgen(js_name = lookAtAll)]
    pub fn look_at_all(&mut self, aspect: f64, up: &str) -> Result<(), JsError> {
        let up = Up::named(up)
            .ok_or_else(|| JsError::new(&format!("up is {up:?}; y, minus-z and so on are allowed")))?;
        Ok(self.session.look_at_all(aspect, up)?)
    }

    /// Which way is up.
    #[wasm_bindgen(getter)]
    pub fn up(&self) -> String {
        self.session.orbit().up().name().to_owned()
    }

    /// Takes the next way up, and its name.
    #[wasm_bindgen(js_name = nextUp)]
    pub fn next_up(&mut self) -> String {
        let orbit = self.session.orbit_mut();
        *orbit = orbit.with_up(orbit.up().next());
        self.up()
    }

    /// Back to the view it began with.
    pub fn home(&mut self, aspect: f64) {
        let orbit = self.session.orbit_mut();
        *orbit = orbit.home(aspect);
    }

    /// Turns by a drag, pixels.
    pub fn turn(&mut self, dx: f64, dy: f64, height: f64) {
        self.session.orbit_mut().turn(dx, dy, height);
    }

    /// Pans by a drag, pixels.
    pub fn pan(&mut self, dx: f64, dy: f64, height: f64) {
        self.session.orbit_mut().pan(dx, dy, height);
    }

    /// Comes so many times as near.
    pub fn zoom(&mut self, factor: f64) {
        self.session.orbit_mut().zoom(factor);
    }

    /// Moves right, up, forward, in shares of the distance.
    pub fn fly(&mut self, right: f64, up: f64, forward: f64) {
        self.session.orbit_mut().fly(right, up, forward);
    }

    /// The view: azimuth, elevation, distance, target.
    #[wasm_bindgen(getter)]
    pub fn view(&self) -> Vec<f64> {
        self.session.orbit().numbers().to_vec()
    }

    /// Takes a view; false for numbers that are none.
    #[wasm_bindgen(js_name = setView)]
    pub fn set_view(&mut self, view: &[f64]) -> bool {
        let numbers = <[f64; 6]>::try_from(view).ok();
        let orbit: Option<Orbit> = numbers.and_then(|numbers| self.session.orbit().at(numbers));
        orbit.is_some_and(|orbit| {
            *self.session.orbit_mut() = orbit;
            true
        })
    }

    /// What another screen must be given anew.
    pub fn forget(&mut self) {
        self.drawn = None;
    }

    /// Draws the frame that is due on `width` × `height` pixels.
    pub fn draw(&mut self, screen: &mut ScreenShell, width: u32, height: u32) -> Result<(), JsError> {
        let size = [width, height];
        let look = Look { size, shown: size, background: self.background };
        screen.0.draw(&mut self.session, &mut self.drawn, &look).map_err(|error: ScreenError| error.into())
    }

    /// A number that changes with what is shown, but for camera and frame.
    #[wasm_bindgen(getter)]
    pub fn content(&self) -> f64 {
        self.session.content() as f64
    }

    /// The camera of a picture: rotation (9, row by row), translation (3), focal lengths and principal point,
    /// near plane. For tests.
    pub fn camera(&self, width: u32, height: u32) -> Result<Vec<f64>, JsError> {
        let camera = self.session.orbit().camera(width, height)?;
        let i = camera.intrinsics();
        let (rotation, translation) = (camera.rotation(), camera.translation());
        let rest = [i.fx, i.fy, i.cx, i.cy, camera.near()];
        let numbers = rotation.as_flattened().iter().chain(&translation).chain(&rest);
        Ok(numbers.copied().collect())
    }
}

/// Number of levels, base included.
#[wasm_bindgen(js_name = levelCount)]
pub fn level_count() -> u32 {
    LEVELS as u32
}
