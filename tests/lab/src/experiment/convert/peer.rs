//! Measures what peers take, processes of their own: splat-transform, and the ply_to_spz of Niantic's spz.

use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use crate::figures::Machine;

/// Bytes of a mebibyte.
pub(super) const MIB: f64 = 1048576.0;
/// How often it is looked how much memory the peer takes.
const WATCH: Duration = Duration::from_millis(5);

/// Lets the largest resident set of this process begin anew; false where the system cannot.
pub(super) fn forget_peak() -> bool {
    fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// What the peer took: time, and its largest resident set, bytes.
pub(super) struct Taken {
    pub(super) seconds: f64,
    pub(super) peak: u64,
}

/// What the peer takes to read `from`, do `actions` to it and write `to`, if it can do it.
pub(super) fn timed_peer(peer: &str, from: &Path, actions: &[&str], to: &Path) -> Option<Taken> {
    let mut command = Command::new(peer);
    command.args(["-q", "-w", "-g", "cpu"]).arg(from).args(actions).arg(to);
    timed(command, to)
}

/// What Niantic's program takes to read the PLY `from` and write the SPZ `to`, if there is one.
pub(super) fn timed_ply_to_spz(program: &str, from: &Path, to: &Path) -> Option<Taken> {
    let mut command = Command::new(program);
    command.arg(from).arg(to);
    timed(command, to)
}

/// What `command` takes to write `to`, if it can.
fn timed(mut command: Command, to: &Path) -> Option<Taken> {
    let start = Instant::now();
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().ok()?;
    let mut peak = 0;
    let status = loop {
        // Its counter only grows, so that the last look has all but the last moment.
        peak = peak.max(Machine::peak_memory_bytes(&child.id().to_string()).unwrap_or(0));
        if let Some(status) = child.try_wait().ok()? {
            break status;
        }
        thread::sleep(WATCH);
    };
    (status.success() && to.is_file()).then(|| Taken { seconds: start.elapsed().as_secs_f64(), peak })
}
