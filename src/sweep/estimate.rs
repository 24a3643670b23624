//! Estimates what a whole sweep costs from the share of it that has been run.

use std::time::Duration;

use crate::figures::Machine;

/// What one batch took.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cost {
    /// Simulations of it.
    pub(crate) simulations: u64,
    /// Bytes written.
    pub(crate) bytes: u64,
    /// Time of one thread, writing aside.
    pub(crate) simulated: Duration,
}

/// What one process has done.
#[derive(Clone, Debug)]
pub(crate) struct Progressed {
    /// The batches that it has run.
    pub(crate) costs: Vec<Cost>,
    /// Wall time of them all.
    pub(crate) wall: Duration,
    /// Batches that were there before.
    pub(crate) found: u64,
    /// Batches of the shard.
    pub(crate) batches: u64,
}

impl Progressed {
    /// Simulations run now.
    pub(crate) fn simulations(&self) -> u64 {
        self.costs.iter().map(|cost| cost.simulations).sum()
    }

    /// What `whole` simulations would take on this machine, in words; `None` if nothing was run.
    pub(crate) fn estimate(&self, whole: u64) -> Option<String> {
        let run = self.simulations();
        if run == 0 {
            return None;
        }
        let factor = whole as f64 / run as f64;
        let bytes: u64 = self.costs.iter().map(|cost| cost.bytes).sum();
        let thread: Duration = self.costs.iter().map(|cost| cost.simulated).sum();
        let memory = Machine::peak_memory_bytes("self");
        let memory = memory.map_or("unknown".to_owned(), |bytes| format!("{:.0} MB", bytes as f64 / 1e6));
        Some(format!(
            "{run} of {whole} simulations took {:.1} s, {:.1} ms of a thread each; all of them: {} on this \
             machine, {:.0} MB of results; peak memory {memory}",
            self.wall.as_secs_f64(),
            1e3 * thread.as_secs_f64() / run as f64,
            duration(self.wall.as_secs_f64() * factor),
            bytes as f64 * factor / 1e6,
        ))
    }
}

fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_is_scaled_to_the_whole() {
        let cost = Cost { simulations: 10, bytes: 1_000_000, simulated: Duration::from_millis(100) };
        let wall = Duration::from_secs(1);
        let progressed = Progressed { costs: vec![cost; 2], wall, found: 0, batches: 2 };
        let words = progressed.estimate(4000).unwrap();
        assert!(words.contains("20 of 4000 simulations took 1.0 s, 10.0 ms of a thread each"), "{words}");
        assert!(words.contains("all of them: 3 min on this machine, 400 MB"), "{words}");
        assert!(Progressed { costs: Vec::new(), wall, found: 2, batches: 2 }.estimate(4000).is_none());
    }
}
