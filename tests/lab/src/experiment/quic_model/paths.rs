//! Lists the paths over which the model is compared: made ones, and windows of measured traces.

use anyhow::{Context, Result};
use emulator_host::{
    Nanos, Rate,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
    trace::TraceError,
};

use crate::{experiment::transport::channels, figures::Bench, setup::Setup};

/// Paths that are reported together.
pub struct Group {
    /// In keys of figures.
    pub name: &'static str,
    /// Mean rate of each, and its forward direction.
    pub paths: Vec<(Rate, PathConfig)>,
    /// Seeds of each; a figure of a path is the mean over them.
    pub seeds: u64,
}

/// Windows of one trace.
const WINDOWS: u64 = 25;
/// Length of a window: the clip, its start, and what is left at the end.
const LENGTH: Nanos = Nanos::from_s(12);

/// All of them.
///
/// # Errors
/// A trace that cannot be read or cut.
pub fn all(setup: &Setup, bench: &mut Bench) -> Result<Vec<Group>> {
    let bursts = LossModel::GilbertElliott {
        enter_bad: 0.02 / 3.0 / 0.98,
        leave_bad: 1.0 / 3.0,
        loss_good: 0.0,
        loss_bad: 1.0,
    };
    let mut groups: Vec<Group> = [
        ("constant", LossModel::None),
        ("loss1", LossModel::Iid(0.01)),
        ("loss2", LossModel::Iid(0.02)),
        ("loss5", LossModel::Iid(0.05)),
        ("bursts", bursts),
    ]
    .into_iter()
    .map(|(name, loss)| {
        let seeds = if loss == LossModel::None {
            1
        } else if setup.quick {
            6
        } else {
            24
        };
        Group { name, paths: constant(loss), seeds }
    })
    .collect();
    groups.push(Group { name: "traces", paths: windows(setup, bench)?, seeds: 1 });
    Ok(groups)
}

fn constant(loss: LossModel) -> Vec<(Rate, PathConfig)> {
    let delays = [Nanos::from_ms(10), Nanos::from_ms(40)];
    let rates = [2, 5, 20].map(Rate::from_mbps);
    let pairs = rates.into_iter().flat_map(|rate| delays.map(|delay| (rate, delay)));
    pairs
        .map(|(rate, delay)| {
            let queue = QueueLimit::lasting(Nanos::from_ms(200), rate);
            let capacity = Capacity::Constant(rate);
            (rate, PathConfig { capacity, queue, loss, delay, ..PathConfig::default() })
        })
        .collect()
}

fn windows(setup: &Setup, bench: &mut Bench) -> Result<Vec<(Rate, PathConfig)>> {
    let mut found = Vec::new();
    for trace in channels::measured(setup, bench)? {
        let windows = if setup.quick { 2 } else { WINDOWS };
        for window in 0..windows {
            let offset = Nanos(trace.period().0 / windows * window);
            let cut = match trace.window(offset, LENGTH.min(trace.period())) {
                Err(TraceError::NoCapacity) => continue,
                cut => cut.with_context(|| trace.name().to_owned())?,
            };
            let rate = cut.mean_rate().clamp(Rate::from_mbps(1), Rate::from_mbps(20));
            let cut = cut.scaled(rate.0, cut.mean_rate().0)?;
            let queue = QueueLimit::lasting(Nanos::from_ms(300), rate);
            found.push((rate, PathConfig { capacity: Capacity::Trace(cut), queue, ..PathConfig::default() }));
        }
    }
    Ok(found)
}
