//! Controls are what a viewer holds in hand: the clock, the camera, the background. No stream is behind them.

use wasm_bindgen::prelude::*;

use crate::{
    keep_up::{KeepUp, Reduction},
    orbit::{Orbit, Up},
    playback::Playback,
};

/// Clock, camera and background of a viewer, and what it leaves out to keep up, for JavaScript.
#[wasm_bindgen]
#[derive(Debug)]
pub struct Controls {
    playback: Playback,
    orbit: Orbit,
    background: [f32; 3],
    keep_up: KeepUp,
}

impl Controls {
    /// The camera.
    pub(super) fn orbit(&self) -> &Orbit {
        &self.orbit
    }

    /// The colour behind everything.
    pub(super) fn background(&self) -> [f32; 3] {
        self.background
    }

    /// What is left out now.
    pub(super) fn reduction(&self) -> Reduction {
        self.keep_up.reduction()
    }
}

#[wasm_bindgen]
impl Controls {
    /// For a clip of `frames` frames at `rate` of them a second, standing at its beginning.
    #[wasm_bindgen(constructor)]
    pub fn new(frames: u32, rate: f64) -> Self {
        Self {
            playback: Playback::new(frames, rate),
            orbit: Orbit::default(),
            background: [0.0; 3],
            keep_up: KeepUp::default(),
        }
    }

    /// Length of the clip, seconds.
    #[wasm_bindgen(getter)]
    pub fn duration(&self) -> f64 {
        self.playback.duration_s()
    }

    /// Where the clock is, seconds.
    #[wasm_bindgen(getter)]
    pub fn time(&self) -> f64 {
        self.playback.time_s()
    }

    /// Goes there.
    #[wasm_bindgen(setter)]
    pub fn set_time(&mut self, time_s: f64) {
        self.playback.seek(time_s);
    }

    /// The frame that is due.
    #[wasm_bindgen(getter)]
    pub fn frame(&self) -> u32 {
        self.playback.frame()
    }

    /// Goes `frames` frames on and stands.
    pub fn step(&mut self, frames: i32) {
        self.playback.step(frames);
    }

    /// Whether the clock runs.
    #[wasm_bindgen(getter)]
    pub fn playing(&self) -> bool {
        self.playback.playing()
    }

    /// Lets it run or stand.
    #[wasm_bindgen(setter)]
    pub fn set_playing(&mut self, playing: bool) {
        self.playback.set_playing(playing);
    }

    /// Seconds of the clip per second.
    #[wasm_bindgen(getter)]
    pub fn rate(&self) -> f64 {
        self.playback.rate()
    }

    /// Sets that.
    #[wasm_bindgen(setter)]
    pub fn set_rate(&mut self, rate: f64) {
        self.playback.set_rate(rate);
    }

    /// Whether the clip begins again at its end.
    #[wasm_bindgen(getter)]
    pub fn looping(&self) -> bool {
        self.playback.looping()
    }

    /// Sets that.
    #[wasm_bindgen(setter)]
    pub fn set_looping(&mut self, looping: bool) {
        self.playback.set_looping(looping);
    }

    /// Lets `dt` seconds pass: 1 the clip began again, 2 it ended, 4 it waits for a base level, or nothing of
    /// these. It waits up to `base_timeout` seconds for frames of `missing`: first and past of each range.
    pub fn advance(&mut self, dt_s: f64, base_timeout_s: f64, missing: &[u32]) -> u32 {
        let is_missing = |frame| missing.chunks_exact(2).any(|range| (range[0]..range[1]).contains(&frame));
        let step = self.playback.advance(dt_s, base_timeout_s, |frame| !is_missing(frame));
        u32::from(step.looped) | u32::from(step.ended) << 1 | u32::from(step.stalled) << 2
    }

    /// Whether less is drawn where pictures come late.
    #[wasm_bindgen(getter, js_name = keepsUp)]
    pub fn keeps_up(&self) -> bool {
        self.keep_up.is_on()
    }

    /// Sets that; what was left out is drawn again.
    #[wasm_bindgen(setter, js_name = keepsUp)]
    pub fn set_keeps_up(&mut self, on: bool) {
        if self.keep_up.is_on() != on {
            self.keep_up.set_on(on);
        }
    }

    /// It is `now_s`: true while the clock runs or the camera moves, and less may be drawn. What is drawn at
    /// most: harmonics of this degree, levels up to `cap`, the pixels as they are if they are fixed.
    pub fn look(&mut self, now_s: f64, sh_degree: u8, cap: u32, fixed_pixels: bool) -> bool {
        self.keep_up.set_most(sh_degree, cap as usize, fixed_pixels);
        self.keep_up.look(now_s, self.playback.playing(), self.orbit.numbers())
    }

    /// A picture came at `now_s` that had been due for `waited_s` seconds.
    pub fn came(&mut self, now_s: f64, waited_s: f64) {
        self.keep_up.picture(now_s, waited_s);
    }

    /// Nothing moves: the next picture is whole.
    pub fn rest(&mut self) {
        self.keep_up.rest();
    }

    /// What is left out now, for people; empty for nothing.
    #[wasm_bindgen(getter)]
    pub fn reduced(&self) -> String {
        self.keep_up.sentence()
    }

    /// What is drawn now: share of the pixels of width and of height, degree of harmonics, highest level,
    /// share of the Gaussians.
    #[wasm_bindgen(js_name = drawnNow)]
    pub fn drawn_now(&self) -> Vec<f64> {
        let Reduction { scale, sh_degree, cap, share } = self.reduction();
        vec![scale, f64::from(sh_degree), cap as f64, f64::from(share)]
    }

    /// Sets the colour behind everything, 0 to 1 each.
    #[wasm_bindgen(js_name = setBackground)]
    pub fn set_background(&mut self, red: f32, green: f32, blue: f32) {
        self.background = [red, green, blue].map(|v| if v.is_finite() { v.clamp(0.0, 1.0) } else { 0.0 });
    }

    /// Moves the camera so that what lies within `radius` of a middle is in a picture `aspect` times as wide
    /// as high; `up` is `y`, `minus-z` and so on.
    #[wasm_bindgen(js_name = lookAround)]
    pub fn look_around(&mut self, middle: &[f64], radius: f64, aspect: f64, up: &str) -> Result<(), JsError> {
        let up = Up::named(up)
            .ok_or_else(|| JsError::new(&format!("up is {up:?}; y, minus-z and so on are allowed")))?;
        let middle = <[f64; 3]>::try_from(middle)
            .map_err(|_| JsError::new(&format!("middle has {} numbers, allowed: 3", middle.len())))?;
        self.orbit = Orbit::around(middle, radius, aspect, up);
        Ok(())
    }

    /// Which way is up.
    #[wasm_bindgen(getter)]
    pub fn up(&self) -> String {
        self.orbit.up().name().to_owned()
    }

    /// Takes the way up of this name; false for what is none.
    #[wasm_bindgen(js_name = setUp)]
    pub fn set_up(&mut self, up: &str) -> bool {
        let up = Up::named(up);
        if let Some(up) = up {
            self.orbit = self.orbit.with_up(up);
        }
        up.is_some()
    }

    /// Takes the next way up, and its name.
    #[wasm_bindgen(js_name = nextUp)]
    pub fn next_up(&mut self) -> String {
        self.orbit = self.orbit.with_up(self.orbit.up().next());
        self.up()
    }

    /// Back to the view it began with.
    pub fn home(&mut self, aspect: f64) {
        self.orbit = self.orbit.home(aspect);
    }

    /// Turns by a drag, pixels.
    pub fn turn(&mut self, dx: f64, dy: f64, height: f64) {
        self.orbit.turn(dx, dy, height);
    }

    /// Pans by a drag, pixels.
    pub fn pan(&mut self, dx: f64, dy: f64, height: f64) {
        self.orbit.pan(dx, dy, height);
    }

    /// Comes so many times as near.
    pub fn zoom(&mut self, factor: f64) {
        self.orbit.zoom(factor);
    }

    /// Moves right, up, forward, in shares of the distance.
    pub fn fly(&mut self, right: f64, up: f64, forward: f64) {
        self.orbit.fly(right, up, forward);
    }

    /// The view: azimuth, elevation, distance, target.
    #[wasm_bindgen(getter)]
    pub fn view(&self) -> Vec<f64> {
        self.orbit.numbers().to_vec()
    }

    /// Takes a view; false for numbers that are none.
    #[wasm_bindgen(js_name = setView)]
    pub fn set_view(&mut self, view: &[f64]) -> bool {
        let numbers = <[f64; 6]>::try_from(view).ok();
        let orbit = numbers.and_then(|numbers| self.orbit.at(numbers));
        if let Some(orbit) = orbit {
            self.orbit = orbit;
        }
        orbit.is_some()
    }

    /// The camera of a picture: rotation (9, row by row), translation (3), focal lengths and principal point,
    /// near plane. For tests.
    pub fn camera(&self, width: u32, height: u32) -> Result<Vec<f64>, JsError> {
        let camera = self.orbit.camera(width, height)?;
        let i = camera.intrinsics();
        let (rotation, translation) = (camera.rotation(), camera.translation());
        let rest = [i.fx, i.fy, i.cx, i.cy, camera.near()];
        let numbers = rotation.as_flattened().iter().chain(&translation).chain(&rest);
        Ok(numbers.copied().collect())
    }
}
