//! Ends the process when a person interrupts it (Ctrl-C), and leaves nothing half written behind.

use std::process;

use crate::files;

/// Exit status of a process that was interrupted: 128 and the number of the signal, as shells have it.
const INTERRUPTED: i32 = 130;

/// From now on Ctrl-C ends the process, without what it has not finished.
pub(super) fn leave_when_interrupted() {
    // Where no handler can be set, an interruption ends the process as it does any other.
    let _ = ctrlc::set_handler(|| leave());
}

/// Ends the process, without what it has not finished.
pub(super) fn leave() -> ! {
    files::remove_unfinished();
    process::exit(INTERRUPTED)
}
