//! Clocks time what benches run: processor time on one core, wall time elsewhere.

use std::{hint::black_box, time::Instant};

/// Seconds of processor time that this thread has used: it does not grow with what else runs.
#[cfg(unix)]
pub(super) fn seconds() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    t.tv_sec as f64 + 1e-9 * t.tv_nsec as f64
}

/// Where no such clock is known: wall time.
#[cfg(not(unix))]
pub(super) fn seconds() -> f64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    START.get_or_init(std::time::Instant::now).elapsed().as_secs_f64()
}

/// Adds the seconds of wall time that `work` takes to `times`.
pub(super) fn seconds_of<T, E>(times: &mut Vec<f64>, work: impl FnOnce() -> Result<T, E>) -> Result<(), E> {
    let start = Instant::now();
    black_box(work()?);
    times.push(start.elapsed().as_secs_f64());
    Ok(())
}

/// Adds the milliseconds of wall time that `work` takes to `times`.
pub(super) fn milliseconds_of(
    times: &mut Vec<f64>,
    work: impl FnOnce() -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let start = Instant::now();
    work()?;
    times.push(1000.0 * start.elapsed().as_secs_f64());
    Ok(())
}
