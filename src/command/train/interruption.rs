//! An interruption is a person's wish to stop (Ctrl-C): work leaves at its next step; asked twice, at once.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use crate::command::interruption::leave;

/// How soon it is noticed that a person asks to stop where work does not look.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Whether a person has asked to stop.
#[derive(Clone, Debug, Default)]
pub(super) struct Interruption(Arc<AtomicBool>);

impl Interruption {
    /// From now on asking to stop ends the process only if it was asked before and nothing was done about it.
    pub(super) fn watch() -> Self {
        let interruption = Self::default();
        let requested = Arc::clone(&interruption.0);
        // Where no handler can be set, an interruption ends the process as it does any other.
        let _ = ctrlc::set_handler(move || {
            if requested.swap(true, Ordering::Relaxed) {
                leave();
            }
        });
        interruption
    }

    /// Whether stopping was asked for since the last time: whoever takes this does something about it.
    pub(super) fn take(&self) -> bool {
        self.0.swap(false, Ordering::Relaxed)
    }

    /// From now on asking to stop ends the process at once, with a line about what is left: for work that
    /// does not look whether somebody asks, while nothing is half written.
    pub(super) fn leave_at_once(&self, what_is_left: &'static str) {
        let interruption = self.clone();
        let watch = move || {
            loop {
                interruption.leave(what_is_left);
                thread::sleep(POLL_INTERVAL);
            }
        };
        // Without a thread, asking twice still ends it.
        let _ = thread::Builder::new().name("dgs-interruption".to_owned()).spawn(watch);
    }

    /// Ends the process if stopping was asked for, with a line about what is left. To be called where nothing
    /// is half written.
    pub(super) fn leave(&self, what_is_left: &str) {
        self.leave_after(what_is_left, || ());
    }

    /// The same, with something to do before.
    pub(super) fn leave_after(&self, what_is_left: &str, last: impl FnOnce()) {
        if self.take() {
            last();
            eprintln!("interrupted: {what_is_left}");
            leave();
        }
    }
}
