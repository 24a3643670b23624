//! Names the machine, formats numbers and averages them: what reports and benches both need.

use serde::Serialize;
use trainer_host::utility::LevelAudit;

/// The machine a figure was measured on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Machine {
    /// Processor, as the system names it.
    pub cpu: String,
    /// Cores this process may use.
    pub cores: usize,
    /// Graphics device, if one was used.
    pub device: Option<String>,
}

impl Machine {
    /// This machine, no graphics device.
    pub fn this() -> Self {
        let cpu = std::fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
            let line = text.lines().find(|l| l.starts_with("model name"))?;
            Some(line.split_once(':')?.1.trim().to_owned())
        });
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self { cpu: cpu.unwrap_or_else(|| std::env::consts::ARCH.to_owned()), cores, device: None }
    }

    /// Largest resident set of a process so far, bytes: of `process`, its number or `self`. None where the
    /// system does not tell, or has no such process (`VmHWM` of proc_pid_status(5)).
    pub fn peak_memory_bytes(process: &str) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
        line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
    }
}

/// How often what was shown stood still, and for how many frames in all.
pub fn frozen(freezes: u64, frames: u64) -> String {
    match freezes {
        0 => "no freeze".to_owned(),
        1 => format!("1 freeze of {frames} frames"),
        _ => format!("{freezes} freezes of {frames} frames in all"),
    }
}

/// When playout started, `ms` milliseconds after the begin; `is_reached` says whether it did for enough was
/// there, and not because the wait was over.
pub(crate) fn startup(ms: Option<f64>, is_reached: bool) -> String {
    match ms {
        None => "never".to_owned(),
        Some(ms) if is_reached => format!("{ms:.0} ms"),
        Some(ms) => format!("not reached in {ms:.0} ms"),
    }
}

/// A number with as many digits as it deserves.
pub fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        v if !(1e-3..1e7).contains(&v) => format!("{value:.3e}"),
        v if v >= 1000.0 => format!("{value:.0}"),
        v if v >= 10.0 => format!("{value:.2}"),
        _ => format!("{value:.4}"),
    }
}

/// So many of a `thing`, for people: "1 frame", "2 frames".
pub(crate) fn counted(count: usize, thing: &str) -> String {
    format!("{count} {thing}{}", if count == 1 { "" } else { "s" })
}

/// The mean of `values`; NaN if there are none.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// How many groups of each level make pictures worse, a line per level.
pub(crate) fn audit_lines(levels: &[LevelAudit]) -> String {
    let line = |audit: &LevelAudit| {
        format!(
            "  level {}: {} groups; negative: mean {}, lower tenth {}, 95 % interval of the mean {}\n",
            audit.level, audit.groups, audit.negative_mean, audit.negative_tail, audit.below_zero
        )
    };
    levels.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wait_that_was_over_is_no_startup() {
        assert_eq!(startup(None, false), "never");
        assert_eq!(startup(Some(76.4), true), "76 ms");
        assert_eq!(startup(Some(5005.2), false), "not reached in 5005 ms");
    }

    #[test]
    fn peak_memory_grows_with_what_was_used_and_is_of_processes_that_are_there() {
        let tells = std::fs::read_to_string("/proc/self/status").is_ok_and(|text| text.contains("VmHWM:"));
        let before = Machine::peak_memory_bytes("self");
        assert_eq!(before.is_some(), tells);
        let block = std::hint::black_box(vec![1u8; 64 << 20]);
        let after = Machine::peak_memory_bytes("self");
        if let (Some(before), Some(after)) = (before, after) {
            assert!(after >= 64 << 20 && after >= before, "{before} {after}");
        }
        assert!(block.iter().all(|&byte| byte == 1));
        assert_eq!(Machine::peak_memory_bytes("none"), None);
    }
}
