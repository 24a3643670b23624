//! Runs sweeps of the emulator: a configuration becomes blocks, blocks become files, files become a summary.
//!
//! A folder of results holds `sweep.toml` (the configuration), `traces.txt` (a digest of each trace file
//! that it names), and per batch of blocks `runs/NNNNN.jsonl` (a
//! line per simulation) and `trajectories/NNNNN.parquet` (a row per frame). A batch is written whole, so a
//! process that is killed loses the batches that it was at and nothing else; whoever runs the same
//! configuration into the same folder does what is missing. A batch with a line that lacks a quantity counts
//! as cut: it is made again, and `merge` refuses it. A shard takes one batch of every n. Once all
//! batches are there, `runs.jsonl` and `summary.json` follow from them, byte by byte the same however they
//! were made. A folder that holds either of these two and no `sweep.toml` is another program's, and refused.

mod config;
mod digests;
mod estimate;
mod folder;
mod trajectory;

pub(crate) use self::{
    config::{Config, Outline},
    digests::Digests,
    estimate::{Cost, Progressed},
    folder::{Finished, Folder, Origin},
};

use std::time::Instant;

use anyhow::{Context, Result};
use emulator_host::sweep::Sweep;
use rayon::prelude::*;

use crate::progress::Progress;

/// Variables in which launchers tell a process its number, from 0, and how many there are: Open MPI; MPICH
/// and Intel MPI; Slurm. Nothing else of MPI is needed, and so no MPI library: shares exchange no messages.
const LAUNCHERS: [[&str; 2]; 3] = [
    ["OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"],
    ["PMI_RANK", "PMI_SIZE"],
    ["SLURM_PROCID", "SLURM_NTASKS"],
];

/// Which share of the batches a process runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// From 1.
    index: u64,
    count: u64,
}

impl Shard {
    /// All of it.
    pub(crate) const WHOLE: Self = Self { index: 1, count: 1 };

    /// Parses `i/n`, or `mpi` for the share of this process among those that `mpirun` or `srun` started.
    ///
    /// # Errors
    /// What is allowed, in words.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        if text == "mpi" {
            return Self::launched(|name| std::env::var(name).ok());
        }
        let numbers = text.split_once('/').and_then(|(i, n)| i.parse().ok().zip(n.parse().ok()));
        match numbers {
            Some((index, count)) if (1..=count).contains(&index) && count <= 1_000_000 => {
                Ok(Self { index, count })
            }
            _ => Err("i/n with i from 1 to n and n up to 1000000 is allowed, such as 3/8; or mpi".to_owned()),
        }
    }

    /// The share of a process with `variable`s of its environment.
    fn launched(variable: impl Fn(&str) -> Option<String>) -> Result<Self, String> {
        let found = LAUNCHERS.map(|[rank, size]| variable(rank).zip(variable(size)));
        let Some((rank, size)) = found.into_iter().flatten().next() else {
            let ranks = LAUNCHERS.map(|[rank, _]| rank).join(", ");
            return Err(format!("mpirun or srun has to start the processes; none of {ranks} is set"));
        };
        match rank.parse::<u64>().ok().and_then(|rank| rank.checked_add(1)) {
            Some(index) => Self::parse(&format!("{index}/{size}")),
            None => Err(format!("the launcher says that this is process {rank} of {size}")),
        }
    }

    /// Every round of `count` batches gives each shard one, each time at another place: a shard is to see all
    /// conditions, which repeat from trace to trace.
    fn has(self, batch: u64) -> bool {
        let step = self.count * 618 / 1000;
        let (round, place) = (batch / self.count, batch % self.count);
        (place + round * step) % self.count == self.index - 1
    }
}

/// Runs what `shard` lacks in `folder` or has damaged there, batches in parallel on the threads of the
/// caller's pool.
///
/// # Errors
/// A simulation that is refused, or a file that cannot be written; what was finished stays.
pub(crate) fn run(sweep: &Sweep, folder: &Folder, shard: Shard, progress: &Progress) -> Result<Progressed> {
    let own: Vec<u64> = (0..folder.batches()).filter(|batch| shard.has(*batch)).collect();
    let missing: Vec<u64> = own.par_iter().copied().filter(|batch| !folder.has_whole(*batch)).collect();
    let start = Instant::now();
    let done = std::sync::atomic::AtomicUsize::new(0);
    let cost: Result<Vec<Cost>> = missing
        .par_iter()
        .map(|batch| {
            let start = Instant::now();
            let mut trials = Vec::new();
            for block in folder.blocks_of(*batch) {
                trials.extend(sweep.run_block(block).with_context(|| format!("block {block}"))?);
            }
            let simulated = start.elapsed();
            let bytes = folder.write(*batch, &trials)?;
            let done = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            progress.at(done as f64 / missing.len() as f64);
            Ok(Cost { simulations: trials.len() as u64, bytes, simulated })
        })
        .collect();
    Ok(Progressed {
        costs: cost?,
        wall: start.elapsed(),
        found: (own.len() - missing.len()) as u64,
        batches: own.len() as u64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_take_every_batch_once() {
        for count in 1..7 {
            let shards: Vec<Shard> =
                (1..=count).map(|index| Shard::parse(&format!("{index}/{count}")).unwrap()).collect();
            for batch in 0..40 {
                assert_eq!(shards.iter().filter(|shard| shard.has(batch)).count(), 1);
            }
        }
        for text in ["", "3", "0/4", "5/4", "1/0", "-1/4", "1/1000001", "a/b"] {
            assert!(Shard::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn launched_processes_have_a_shard_each() {
        let launched = |rank: &'static str, size: &'static str| {
            move |name: &str| match name {
                "PMI_RANK" => Some(rank.to_owned()),
                "PMI_SIZE" => Some(size.to_owned()),
                _ => None,
            }
        };
        assert_eq!(Shard::launched(launched("2", "3")), Shard::parse("3/3"));
        for (rank, size) in [("3", "3"), ("-1", "3"), ("18446744073709551615", "3"), ("a", "3"), ("0", "")] {
            assert!(Shard::launched(launched(rank, size)).is_err(), "{rank} of {size}");
        }
        assert!(Shard::launched(|_| None).unwrap_err().contains("SLURM_PROCID"));
    }
}
