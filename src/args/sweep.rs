//! Parses what sweeps take.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::number::whole;
use crate::sweep::Shard;

/// `dgs sweep`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct SweepArgs {
    /// What to do with results instead of making them.
    #[command(subcommand)]
    pub action: Option<SweepAction>,
    /// Configuration (TOML): controllers, schedulers, conditions, traces, replicates.
    #[arg(required = true, value_name = "CONFIG.toml")]
    pub config: Option<PathBuf>,
    /// Folder for the results. Run again with the same configuration and the same traces, it does what is
    /// missing there. A folder with a runs.jsonl or summary.json that is not of a sweep is refused.
    #[arg(short, long, required = true, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
    /// Folder in which the files of traces lie [default: that of the configuration].
    #[arg(long, value_name = "FOLDER")]
    pub traces: Option<PathBuf>,
    /// Run only the i-th of n shares of whole batches, and estimate the whole from it; mpi: that of this
    /// process among those that mpirun or srun started, which may all write into one folder.
    #[arg(long, value_name = "i/n|mpi", value_parser = Shard::parse)]
    pub shard: Option<Shard>,
    /// Threads, 1 to 1024 [default: all cores]. Results do not depend on it.
    #[arg(long, value_parser = whole::<usize>(1..=1024, "threads"))]
    pub threads: Option<usize>,
    /// Write no trajectories (Parquet, a row per frame), only a line per simulation.
    #[arg(long)]
    pub no_trajectories: bool,
}

/// What to do with results.
#[derive(Debug, Subcommand)]
pub enum SweepAction {
    /// Put the results of shards into one folder; once all are there, summarise them. Trace files are not
    /// needed; shards made with other ones are refused. Exit status 2: batches are missing.
    Merge(SweepMerge),
}

/// `dgs sweep merge`.
#[derive(Debug, Args)]
pub struct SweepMerge {
    /// Folders of results of one configuration over the same traces.
    #[arg(required = true, value_name = "FOLDER")]
    pub folders: Vec<PathBuf>,
    /// Folder for all of them.
    #[arg(short, long, value_name = "FOLDER")]
    pub out: PathBuf,
}
