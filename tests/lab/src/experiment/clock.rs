//! The clock of benches on one core.

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
