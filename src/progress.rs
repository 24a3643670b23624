//! Shows the progress of anything that takes over a second, on standard error, never in the way of `--json`.

use std::{
    io::IsTerminal as _,
    ops::ControlFlow,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use indicatif::{ProgressBar, ProgressStyle};

use crate::output;

/// Between two lines where there is no terminal, as in the log of a cluster.
const LINE_EVERY: Duration = Duration::from_secs(15);

/// The progress of one piece of work: a bar on a terminal, elsewhere now and then a line of what is at hand.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    title: String,
    /// When something was last said; `None` where a bar is shown, or nothing at all.
    said_at: Option<Mutex<Instant>>,
}

impl Progress {
    /// The progress of `what`, or silence.
    pub fn new(what: &str, silent: bool) -> Self {
        let has_lines = !silent && !std::io::stderr().is_terminal();
        let said_at = has_lines.then(|| Mutex::new(Instant::now()));
        let title = what.to_owned();
        if silent || has_lines {
            return Self { bar: ProgressBar::hidden(), title, said_at };
        }
        let bar = ProgressBar::new(1000);
        // The template is a constant; if a library change made it illegal the default would do.
        if let Ok(style) = ProgressStyle::with_template("{msg:32} [{bar:30}] {percent:>3} % {elapsed}") {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(what.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        Self { bar, title, said_at }
    }

    /// `share` of the work is done, 0..=1.
    pub fn at(&self, share: f64) {
        self.bar.set_position((share.clamp(0.0, 1.0) * 1000.0) as u64);
        self.say_now_and_then(&self.title, share);
    }

    /// As [`Progress::stage`], for work that asks whether to go on: it does.
    pub fn heard(&self, stage: &str, share: f64) -> ControlFlow<()> {
        self.stage(stage, share);
        ControlFlow::Continue(())
    }

    /// The stage at hand, and the share of it that is done.
    pub fn stage(&self, stage: &str, share: f64) {
        self.bar.set_message(stage.to_owned());
        self.bar.set_position((share.clamp(0.0, 1.0) * 1000.0) as u64);
        self.say_now_and_then(stage, share);
    }

    /// `done` of `total` pieces of work are done, and the next is at hand: "rendering 3 of 8".
    pub fn step(&self, what: &str, done: usize, total: usize) {
        self.stage(&format!("{what} {} of {total}", done + 1), done as f64 / total.max(1) as f64);
    }

    /// Says `line` at once, above the bar.
    pub fn say(&self, line: &str) {
        self.bar.suspend(|| output::print_status(line));
        if let Some(said_at) = &self.said_at {
            *said_at.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
        }
    }

    fn say_now_and_then(&self, stage: &str, share: f64) {
        let due = |said_at: &Mutex<Instant>| {
            said_at.lock().unwrap_or_else(PoisonError::into_inner).elapsed() >= LINE_EVERY
        };
        if self.said_at.as_ref().is_some_and(due) {
            self.say(&format!("{stage}: {:.0} %", 100.0 * share.clamp(0.0, 1.0)));
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
