//! Shows the progress of anything that takes over a second, on standard error, never in the way of `--json`.

use std::{ops::ControlFlow, time::Duration};

use indicatif::{ProgressBar, ProgressStyle};

/// A bar for one piece of work, shown only on a terminal.
#[derive(Debug)]
pub struct Progress(ProgressBar);

impl Progress {
    /// A bar titled `what`, or a silent one.
    pub fn new(what: &str, silent: bool) -> Self {
        if silent {
            return Self(ProgressBar::hidden());
        }
        let bar = ProgressBar::new(1000);
        // The template is a constant; if a library change made it illegal the default would do.
        if let Ok(style) = ProgressStyle::with_template("{msg:32} [{bar:30}] {percent:>3} % {elapsed}") {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(what.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        Self(bar)
    }

    /// `share` of the work is done, 0..=1.
    pub fn at(&self, share: f64) {
        self.0.set_position((share.clamp(0.0, 1.0) * 1000.0) as u64);
    }

    /// As [`Progress::stage`], for work that asks whether to go on: it does.
    pub fn heard(&self, stage: &str, share: f64) -> ControlFlow<()> {
        self.stage(stage, share);
        ControlFlow::Continue(())
    }

    /// The stage at hand, and the share of it that is done.
    pub fn stage(&self, stage: &str, share: f64) {
        self.0.set_message(stage.to_owned());
        self.at(share);
    }
}

impl Progress {
    /// `done` of `total` pieces of work are done, and the next is at hand: "rendering 3 of 8".
    pub fn step(&self, what: &str, done: usize, total: usize) {
        self.stage(&format!("{what} {} of {total}", done + 1), done as f64 / total.max(1) as f64);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
