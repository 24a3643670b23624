//! A playback clock says which frame is due: it follows time and waits for nothing but base levels.

/// Longest step of the clock, seconds: what a page slept through is not caught up with.
const LONGEST_STEP_S: f64 = 0.5;

/// What a step of the clock did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Step {
    /// The clip began again.
    pub looped: bool,
    /// The clip ended, and the clock stands.
    pub ended: bool,
    /// The base of the next frame is not there yet, and the clock waits for it.
    pub stalled: bool,
}

/// Time of a clip, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Playback {
    frames: u32,
    frames_per_second: f64,
    time_s: f64,
    rate: f64,
    playing: bool,
    looping: bool,
    /// How long it has waited for a base level, seconds.
    waited_s: f64,
}

impl Playback {
    /// A clip of `frames` frames at `frames_per_second`, standing at its beginning.
    pub fn new(frames: u32, frames_per_second: f64) -> Self {
        let legal = frames_per_second.is_finite() && frames_per_second > 0.0;
        let frames_per_second = if legal { frames_per_second } else { 1.0 };
        Self {
            frames: frames.max(1),
            frames_per_second,
            time_s: 0.0,
            rate: 1.0,
            playing: false,
            looping: true,
            waited_s: 0.0,
        }
    }

    /// Length of the clip.
    pub fn duration_s(&self) -> f64 {
        f64::from(self.frames) / self.frames_per_second
    }

    /// Where the clock is.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Whether it runs.
    pub fn playing(&self) -> bool {
        self.playing
    }

    /// Runs or stands. A clip that has ended, at its start if it runs backwards, begins again.
    pub fn set_playing(&mut self, playing: bool) {
        let (duration, backwards) = (self.duration_s(), self.rate < 0.0);
        if playing && backwards && self.time_s <= 0.0 {
            self.time_s = duration;
        } else if playing && !backwards && self.time_s >= duration {
            self.time_s = 0.0;
        }
        self.playing = playing;
    }

    /// Whether the clip begins again at its end.
    pub fn looping(&self) -> bool {
        self.looping
    }

    /// Sets that.
    pub fn set_looping(&mut self, looping: bool) {
        self.looping = looping;
    }

    /// Seconds of the clip per second, -4 to 4; below 0 it runs backwards.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Sets that, within its bounds.
    pub fn set_rate(&mut self, rate: f64) {
        if rate.is_finite() {
            self.rate = rate.clamp(-4.0, 4.0);
        }
    }

    /// Goes to `time_s`, within the clip.
    pub fn seek(&mut self, time_s: f64) {
        if time_s.is_finite() {
            self.time_s = time_s.clamp(0.0, self.duration_s());
        }
    }

    /// Goes `frames` frames on, or back, and stands at the middle of one.
    pub fn step(&mut self, frames: i32) {
        self.playing = false;
        let to = (i64::from(self.frame()) + i64::from(frames)).rem_euclid(i64::from(self.frames));
        self.time_s = (to as f64 + 0.5) / self.frames_per_second;
    }

    /// The frame that is due.
    pub fn frame(&self) -> u32 {
        self.frame_at(self.time_s)
    }

    /// The frame that is due at `time_s`.
    pub fn frame_at(&self, time_s: f64) -> u32 {
        // A whisker more, so that the start of a frame is not rounded into the one before.
        ((time_s * self.frames_per_second + 1e-6) as u32).min(self.frames - 1)
    }

    /// `dt_s` seconds have passed. `ready` says whether the base of a frame is there; the clock waits for it
    /// up to `base_timeout_s`.
    pub fn advance(&mut self, dt_s: f64, base_timeout_s: f64, ready: impl Fn(u32) -> bool) -> Step {
        if !self.playing || !dt_s.is_finite() || dt_s <= 0.0 || self.rate == 0.0 {
            return Step::default();
        }
        let duration = self.duration_s();
        let mut to = self.time_s + dt_s.min(LONGEST_STEP_S) * self.rate;
        let mut looped = false;
        if !(0.0..duration).contains(&to) {
            if !self.looping {
                (self.time_s, self.playing) = (to.clamp(0.0, duration), false);
                return Step { ended: true, ..Step::default() };
            }
            to = to.rem_euclid(duration);
            // Nothing of a still picture begins again.
            looped = self.frames > 1;
        }
        let is_ready = base_timeout_s == 0.0 || ready(self.frame_at(to));
        if !is_ready && self.waited_s < base_timeout_s {
            self.waited_s += dt_s;
            return Step { stalled: true, ..Step::default() };
        }
        if is_ready {
            self.waited_s = 0.0;
        }
        self.time_s = to;
        Step { looped, ..Step::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn playing() -> Playback {
        let mut playback = Playback::new(30, 10.0);
        playback.set_playing(true);
        playback
    }

    #[test]
    fn frames_follow_time() {
        let mut playback = playing();
        assert_eq!(playback.duration_s(), 3.0);
        assert_eq!(playback.advance(0.25, 0.0, |_| false), Step::default());
        assert_eq!(playback.frame(), 2);
        playback.set_rate(2.0);
        playback.advance(0.25, 0.0, |_| false);
        assert_eq!(playback.frame(), 7);
        playback.set_rate(-1.0);
        playback.advance(0.5, 0.0, |_| false);
        assert_eq!(playback.frame(), 2);
        playback.set_rate(f64::NAN);
        assert_eq!(playback.rate(), -1.0);
    }

    #[test]
    fn a_clip_begins_again_or_ends() {
        let mut playback = playing();
        playback.seek(2.9);
        assert!(playback.advance(0.2, 0.0, |_| false).looped);
        assert!((playback.time_s() - 0.1).abs() < 1e-9);
        playback.set_looping(false);
        playback.seek(2.9);
        assert!(playback.advance(0.2, 0.0, |_| false).ended);
        assert_eq!((playback.playing(), playback.frame()), (false, 29));
        playback.set_playing(true);
        assert_eq!(playback.frame(), 0, "an ended clip begins again");
        // Backwards it ends at its start, and goes on from where it is elsewhere.
        playback.seek(3.0);
        playback.set_rate(-1.0);
        playback.set_playing(true);
        assert_eq!(playback.time_s(), 3.0);
        playback.seek(0.1);
        assert!(playback.advance(0.2, 0.0, |_| false).ended);
        assert_eq!((playback.playing(), playback.time_s()), (false, 0.0));
        playback.set_playing(true);
        assert_eq!(playback.time_s(), 3.0);
        let mut still = Playback::new(1, 10.0);
        still.set_playing(true);
        assert_eq!(still.advance(0.3, 0.0, |_| true), Step::default());
        assert!(still.playing());
    }

    #[test]
    fn only_a_missing_base_holds_the_clock() {
        let mut playback = playing();
        assert!(playback.advance(0.3, f64::INFINITY, |frame| frame < 3).stalled);
        assert_eq!(playback.time_s(), 0.0);
        assert!(!playback.advance(0.3, f64::INFINITY, |frame| frame <= 3).stalled);
        assert_eq!(playback.frame(), 3);
        // And no longer than the timeout, until one comes again.
        assert!(
            playback.advance(0.3, 0.5, |_| false).stalled && playback.advance(0.3, 0.5, |_| false).stalled
        );
        assert_eq!(playback.advance(0.3, 0.5, |_| false), Step::default());
        assert_eq!(playback.advance(0.3, 0.5, |_| false), Step::default());
        assert!(!playback.advance(0.1, 0.5, |_| true).stalled);
        assert!(playback.advance(0.3, 0.5, |_| false).stalled);
    }

    #[test]
    fn what_was_slept_through_is_not_caught_up_with() {
        let mut playback = playing();
        playback.advance(1e9, 0.0, |_| false);
        assert_eq!(playback.time_s(), LONGEST_STEP_S);
    }

    #[test]
    fn steps_go_round_and_frames_start_at_their_time() {
        let mut playback = Playback::new(30, 10.0);
        playback.step(-1);
        assert_eq!((playback.frame(), playback.playing()), (29, false));
        playback.step(1);
        assert_eq!(playback.frame(), 0);
        for frame in 0..30 {
            playback.seek(f64::from(frame) / 10.0);
            assert_eq!(playback.frame(), frame);
        }
        // A clip that says nothing of use still has a clock.
        assert_eq!(Playback::new(0, f64::NAN).duration_s(), 1.0);
    }
}
