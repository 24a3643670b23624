//! A player that cannot keep up leaves something out, step by step, and gives it back once there is time.
//!
//! Nothing here asks a clock: the same times give the same steps. What is still, a picture that neither plays
//! nor is moved, is always drawn whole.

use std::fmt;

use crate::session::LEVELS;

/// A picture that was due for longer than this, seconds, came late; one for less than that, in time.
const LATE_S: f64 = 1.0 / 18.0;
const IN_TIME_S: f64 = 1.0 / 24.0;
/// Pictures in a row that come late until less is drawn: this many, or fewer that took a second.
const LATE_IN_A_ROW: u32 = 8;
const FEWEST_LATE: u32 = 3;
const LATE_FOR_S: f64 = 1.0;
/// Pictures this many times later than that skip a step.
const FAR_TOO_LATE: f64 = 4.0;
/// How long pictures come in time until more is drawn, seconds; twice as long for each time that that was
/// too much before.
const PATIENCE_S: f64 = 5.0;
/// Longest time between two pictures that counts as time in which they came, seconds.
const LONGEST_GAP_S: f64 = 0.25;
/// A camera that has not moved for this long is still, seconds.
const STILL_S: f64 = 0.3;

/// What is left out of pictures so that they come in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reduction {
    /// Pixels drawn, as a share of those of width and of height, above 0 and up to 1.
    pub scale: f64,
    /// Bands of harmonics above this degree, 0 to 3, are not drawn.
    pub sh_degree: u8,
    /// Levels above this, 0 to 3, are not decoded.
    pub cap: usize,
    /// Share of Gaussians drawn, above 0 and up to 1: those that can cover most.
    pub share: f32,
}

impl Reduction {
    /// Nothing is left out.
    pub const NONE: Self = Self { scale: 1.0, sh_degree: 3, cap: LEVELS - 1, share: 1.0 };

    /// All steps, from nothing left out on; each leaves out what the one before does.
    pub const STEPS: [Self; 8] = [
        Self::NONE,
        Self { scale: 0.75, ..Self::NONE },
        Self { scale: 0.5, ..Self::NONE },
        Self { scale: 0.5, sh_degree: 1, ..Self::NONE },
        Self { scale: 0.5, sh_degree: 0, ..Self::NONE },
        Self { scale: 0.5, sh_degree: 0, cap: 1, ..Self::NONE },
        Self { scale: 0.5, sh_degree: 0, cap: 1, share: 0.5 },
        Self { scale: 0.5, sh_degree: 0, cap: 1, share: 0.25 },
    ];

    /// The same where no more than `most` is drawn anyway.
    fn within(self, most: &Self) -> Self {
        Self {
            scale: self.scale.min(most.scale),
            sh_degree: self.sh_degree.min(most.sh_degree),
            cap: self.cap.min(most.cap),
            share: self.share.min(most.share),
        }
    }
}

/// What is left out, for people; empty for nothing.
impl fmt::Display for Reduction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parts = Vec::new();
        if self.scale < 1.0 {
            parts.push(format!("{:.0} % of the pixels", 100.0 * self.scale * self.scale));
        }
        match self.sh_degree {
            0 => parts.push("one colour from all sides".to_owned()),
            1 | 2 => parts.push(format!("harmonics of degree {}", self.sh_degree)),
            _ => {}
        }
        match self.cap {
            0 => parts.push("base level".to_owned()),
            cap if cap < LEVELS - 1 => parts.push(format!("levels up to {cap}")),
            _ => {}
        }
        if self.share < 1.0 {
            parts.push(format!("{:.0} % of the Gaussians", 100.0 * self.share));
        }
        f.write_str(&parts.join(", "))
    }
}

/// Says what to leave out by how late pictures come: down fast, up slowly, and each time that up was too much
/// twice as slowly, so that a player does not go back and forth.
#[derive(Clone, Debug)]
pub struct KeepUp {
    on: bool,
    /// The most that is drawn: the stream's harmonics, and the levels that are asked for.
    most: Reduction,
    /// Whether the number of pixels stays.
    fixed_pixels: bool,
    /// Which of [`Reduction::STEPS`], and of each how often pictures were too late after going up to it.
    at: usize,
    failures: [u32; Reduction::STEPS.len()],
    /// Whether it was gone up to.
    risen: bool,
    late: u32,
    late_s: f64,
    in_time_s: f64,
    /// When the last picture came, seconds.
    last_s: Option<f64>,
    view: Option<[f64; 6]>,
    moved_s: f64,
    moving: bool,
}

impl Default for KeepUp {
    fn default() -> Self {
        Self {
            on: true,
            most: Reduction::NONE,
            fixed_pixels: false,
            at: 0,
            failures: [0; Reduction::STEPS.len()],
            risen: false,
            late: 0,
            late_s: 0.0,
            in_time_s: 0.0,
            last_s: None,
            view: None,
            moved_s: f64::NEG_INFINITY,
            moving: false,
        }
    }
}

impl KeepUp {
    /// Whether anything is ever left out.
    pub fn is_on(&self) -> bool {
        self.on
    }

    /// Switches that, and begins anew.
    pub fn set_on(&mut self, on: bool) {
        self.on = on;
        self.restart();
    }

    /// Leaves nothing out until pictures come late again: how late those of another stream come is not known.
    pub fn restart(&mut self) {
        *self = Self {
            on: self.on,
            most: self.most,
            fixed_pixels: self.fixed_pixels,
            view: self.view,
            moving: self.moving,
            ..Self::default()
        };
    }

    /// No more than this is drawn anyway, as harmonics that a stream does not have or levels that nobody asks
    /// for: steps that would change nothing are skipped. With `fixed_pixels` their number stays.
    pub fn set_most(&mut self, sh_degree: u8, cap: usize, fixed_pixels: bool) {
        self.most = Reduction { sh_degree, cap, ..Reduction::NONE };
        self.fixed_pixels = fixed_pixels;
    }

    /// It is `now_s`, the clock runs or not, and this is the view: true while anything moves.
    pub fn look(&mut self, now_s: f64, playing: bool, view: [f64; 6]) -> bool {
        if self.view.is_some_and(|before| before != view) {
            self.moved_s = now_s;
        }
        self.view = Some(view);
        self.moving = playing || now_s - self.moved_s < STILL_S;
        if !self.moving {
            self.last_s = None;
        }
        self.moving
    }

    /// Nothing moves, whatever was seen of late: the next picture is whole.
    pub fn rest(&mut self) {
        (self.moving, self.moved_s, self.last_s) = (false, f64::NEG_INFINITY, None);
    }

    /// A picture came at `now_s` that had been due for `waited_s` seconds; true if another step is taken.
    pub fn picture(&mut self, now_s: f64, waited_s: f64) -> bool {
        if !self.on || !self.moving || !waited_s.is_finite() {
            return false;
        }
        let gap_s = self.last_s.map_or(0.0, |last| (now_s - last).clamp(0.0, LONGEST_GAP_S));
        self.last_s = Some(now_s);
        if waited_s > LATE_S {
            self.late += 1;
            self.late_s += waited_s;
            self.in_time_s = 0.0;
            return self.is_too_late() && self.go_down();
        }
        (self.late, self.late_s) = (0, 0.0);
        // What is neither late nor early leaves everything as it is.
        if waited_s < IN_TIME_S {
            self.in_time_s += gap_s;
        }
        self.in_time_s >= self.patience_s() && self.go_up()
    }

    fn is_too_late(&self) -> bool {
        self.late >= LATE_IN_A_ROW || (self.late >= FEWEST_LATE && self.late_s >= LATE_FOR_S)
    }

    /// What is drawn at step `at`.
    fn drawn_at(&self, at: usize) -> Reduction {
        let step = Reduction::STEPS[at.min(Reduction::STEPS.len() - 1)].within(&self.most);
        let scale = if self.fixed_pixels { 1.0 } else { step.scale };
        Reduction { scale, ..step }
    }

    /// The first step beyond `at`, by `way` of them, at which something else is drawn.
    fn beyond(&self, at: usize, way: isize) -> Option<usize> {
        let mut next = at;
        loop {
            next = next.checked_add_signed(way).filter(|&next| next < Reduction::STEPS.len())?;
            if self.drawn_at(next) != self.drawn_at(at) {
                return Some(next);
            }
        }
    }

    /// How long pictures must come in time before the next step up.
    fn patience_s(&self) -> f64 {
        let failures = self.beyond(self.at, -1).map_or(0, |above| self.failures[above]);
        PATIENCE_S * 2f64.powi(failures.min(64).cast_signed())
    }

    fn go_down(&mut self) -> bool {
        let mean_s = self.late_s / f64::from(self.late.max(1));
        let steps = if mean_s > FAR_TOO_LATE * LATE_S { 2 } else { 1 };
        let from = self.at;
        for _ in 0..steps {
            self.at = self.beyond(self.at, 1).unwrap_or(self.at);
        }
        if self.risen && self.at != from {
            self.failures[from] = self.failures[from].saturating_add(1);
        }
        self.took_a_step(false);
        self.at != from
    }

    fn go_up(&mut self) -> bool {
        let Some(above) = self.beyond(self.at, -1) else { return false };
        self.at = above;
        self.took_a_step(true);
        true
    }

    fn took_a_step(&mut self, risen: bool) {
        (self.risen, self.late, self.late_s, self.in_time_s) = (risen, 0, 0.0, 0.0);
    }

    /// What to leave out now.
    pub fn reduction(&self) -> Reduction {
        if self.on && self.moving { self.drawn_at(self.at) } else { Reduction::NONE }
    }

    /// What is left out now that would be drawn otherwise, for people; empty for nothing.
    pub fn sentence(&self) -> String {
        let (drawn, none) = (self.reduction(), Reduction::NONE);
        let sh_degree = if drawn.sh_degree < self.most.sh_degree { drawn.sh_degree } else { none.sh_degree };
        let cap = if drawn.cap < self.most.cap { drawn.cap } else { none.cap };
        Reduction { sh_degree, cap, ..drawn }.to_string()
    }
}

#[cfg(test)]
mod tests;
