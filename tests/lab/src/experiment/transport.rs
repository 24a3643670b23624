//! Prints what schedulers deliver: over measured traces, beside the best that was possible, and in pictures.

mod ablations;
pub(super) mod channels;
mod controllers;
mod limits;
mod optimum;
mod paired;
mod pictures;
mod schedulers;
mod viewport;
mod watched;
pub(super) mod workloads;

use anyhow::Result;

use crate::{figures::Bench, setup::Setup};

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let parts = [
        ablations::PROTOCOL.to_owned(),
        controllers::protocol(setup),
        optimum::protocol(setup),
        pictures::protocol(setup),
        schedulers::protocol(setup),
        viewport::protocol(setup),
    ];
    let mut bench = Bench::new("transport", parts.join("; "));
    controllers::run(&mut bench)?;
    let channels = channels::all(setup, &mut bench)?;
    optimum::run(&mut bench, setup, &channels)?;
    pictures::run(&mut bench, setup, &channels)?;
    schedulers::run(&mut bench, setup)?;
    viewport::run(&mut bench, setup, &channels)?;
    Ok(bench)
}
