//! Compares the model of QUIC with `quinn-proto` in virtual time: what comes through, how late, how fast.

pub(super) mod pairing;
mod paths;

use anyhow::Result;
use dgs_quic::virtual_time;
use emulator_host::{ControllerKind, SessionConfig, graph::Synthetic, simulate};
use rayon::prelude::*;

use self::{
    pairing::{Load, Pair, percentile},
    paths::Group,
};
use super::clock;
use crate::{
    figures::{Bench, Figure, median},
    setup::Setup,
};

/// Controllers that both transports have.
const CONTROLLERS: [ControllerKind; 2] = [ControllerKind::NewReno, ControllerKind::Cubic];

/// Runs the bench.
///
/// # Errors
/// A trace that cannot be read, or a session that either transport refuses.
pub fn run(setup: &Setup) -> Result<Bench> {
    let mut bench = Bench::new("quic-model", protocol(setup));
    let groups = paths::all(setup, &mut bench)?;
    let mut every = Vec::new();
    for controller in CONTROLLERS {
        for load in Load::ALL {
            for group in &groups {
                let compared = compare(controller, load, group)?;
                let key = format!("{}.{}.{}", controller.name(), load.name(), group.name);
                enter_goodput(&mut bench, &key, &compared);
                // Of bulk, lateness says no more than goodput: all of it may be sent from the start.
                if load == Load::Limited {
                    enter_lateness(&mut bench, &key, &compared);
                }
                every.push((controller, load, compared));
            }
        }
    }
    for controller in CONTROLLERS {
        let all = |load: Load| -> Vec<Compared> {
            let of = every.iter().filter(|row| (row.0, row.1) == (controller, load));
            of.flat_map(|(_, _, compared)| compared).copied().collect()
        };
        let key = format!("{}.all", controller.name());
        enter_goodput(&mut bench, &key, &[all(Load::Bulk), all(Load::Limited)].concat());
        enter_lateness(&mut bench, &key, &all(Load::Limited));
    }
    speed(&mut bench, setup)?;
    Ok(bench)
}

fn protocol(setup: &Setup) -> String {
    let windows = if setup.quick { "a few" } else { "at least 200" };
    format!(
        "layered scheduler, 10 s clips, playout after 500 ms, uplink 2 Mbit/s, 20 ms each way unless \
         said; bulk: twice the link's rate, limited: six tenths of it, frame by frame with 500 ms of \
         lookahead; constant links of 2, 5 and 20 Mbit/s with 10 and 40 ms each way and 200 ms of queue, \
         without loss, with 1, 2 and 5 % independent loss and with 2 % in bursts of three, means over seeds \
         as losses are drawn per datagram; {windows} windows of measured traces, mean rate between 1 and 20 \
         Mbit/s, 300 ms of queue. goodput: median difference of model to quinn-proto in absolute value, \
         error the 95th percentile. late: pairs whose 95th percentile of frame lateness agrees within 5 ms \
         or 5 %, error the median difference. quinn-proto differs from RFC 9002 in that windows grow before \
         losses of the same acknowledgement are counted, and from the model in that one datagram is chosen \
         before the window opens; its CUBIC takes the Reno-friendly window of RFC 8312, by time, where the \
         model takes that of RFC 9438, by acknowledgements"
    )
}

/// How a path compares, mean over its seeds.
#[derive(Clone, Copy, Debug)]
struct Compared {
    /// Difference of goodput, as a share.
    goodput: f64,
    late_ms: f64,
    late_agrees: bool,
}

fn compare(controller: ControllerKind, load: Load, group: &Group) -> Result<Vec<Compared>> {
    group
        .paths
        .par_iter()
        .map(|(rate, path)| {
            let graph = load.graph(*rate)?;
            let pairs = (1..=group.seeds)
                .map(|seed| Pair::run(&graph, &load.session(controller, path.clone(), seed)));
            let pairs: Vec<Pair> = pairs.collect::<Result<_>>()?;
            Ok(compared(&pairs))
        })
        .collect()
}

fn compared(pairs: &[Pair]) -> Compared {
    let mean = |of: fn(&Pair) -> f64| pairs.iter().map(of).sum::<f64>() / pairs.len().max(1) as f64;
    let (model, quic) = (mean(|pair| pair.model.goodput), mean(|pair| pair.quic.goodput));
    let (model_late, quic_late) = (mean(|pair| pair.model.late_ms), mean(|pair| pair.quic.late_ms));
    let late_ms = model_late - quic_late;
    Compared {
        goodput: model / quic.max(1.0) - 1.0,
        late_ms,
        late_agrees: late_ms.abs() <= (0.05 * quic_late).max(5.0),
    }
}

fn enter_goodput(bench: &mut Bench, key: &str, compared: &[Compared]) {
    let sizes = ascending(compared, |path| 100.0 * path.goodput.abs());
    let signed = ascending(compared, |path| 100.0 * path.goodput);
    let figure = Figure::new(format!("goodput.{key}"), percentile(&sizes, 0.5), "%");
    let figure = figure.error(percentile(&sizes, 0.95), "% at the 95th percentile");
    bench.push(figure.runs(compared.len()));
    bench.push(Figure::new(format!("goodput_signed.{key}"), percentile(&signed, 0.5), "%"));
}

fn enter_lateness(bench: &mut Bench, key: &str, compared: &[Compared]) {
    let late = ascending(compared, |path| path.late_ms.abs());
    let agrees = compared.iter().filter(|path| path.late_agrees).count();
    let share = 100.0 * agrees as f64 / compared.len().max(1) as f64;
    let figure = Figure::new(format!("late.{key}"), share, "% of pairs agree");
    bench.push(figure.error(percentile(&late, 0.5), "ms, median difference").runs(compared.len()));
}

fn ascending(compared: &[Compared], of: fn(&Compared) -> f64) -> Vec<f64> {
    let mut values: Vec<f64> = compared.iter().map(of).collect();
    values.sort_by(f64::total_cmp);
    values
}

/// Deliveries of 30 s at 5 Mbit/s per second of one core.
fn speed(bench: &mut Bench, setup: &Setup) -> Result<()> {
    let graph = Synthetic::default().build(1)?;
    let config = SessionConfig::default();
    let runs = if setup.quick { 3 } else { 9 };
    let (mut model, mut quic) = (Vec::new(), Vec::new());
    for _ in 0..runs {
        let start = clock::seconds();
        simulate(&graph, &config)?;
        let between = clock::seconds();
        virtual_time::simulate(&graph, &config)?;
        model.push(1.0 / (between - start));
        quic.push(1.0 / (clock::seconds() - between));
    }
    let figure = Figure::new("sims_per_s.quic", median(&quic), "1/s");
    bench.push(figure.peer("the model", median(&model), false).runs(runs));
    Ok(())
}

#[cfg(test)]
mod tests {
    use emulator_host::{
        Nanos, Rate,
        link::{Capacity, LossModel, PathConfig},
    };

    use super::*;

    fn pair(load: Load, model_path: PathConfig, quic_path: PathConfig) -> Compared {
        let graph = load.graph(Rate::from_mbps(5)).unwrap();
        let session = |path| load.session(ControllerKind::NewReno, path, 1);
        let mut pair = Pair::run(&graph, &session(quic_path)).unwrap();
        pair.model = Pair::run(&graph, &session(model_path)).unwrap().model;
        compared(&[pair])
    }

    #[test]
    fn the_model_agrees_on_a_constant_link_and_the_comparison_can_fail() {
        let path = PathConfig::default();
        for load in Load::ALL {
            let same = pair(load, path.clone(), path.clone());
            assert!(same.goodput.abs() < 0.01 && same.late_agrees, "{same:?}");
        }
        let capacity = Capacity::Constant(Rate::from_mbps(4));
        let slower = pair(Load::Bulk, PathConfig { capacity, ..path.clone() }, path.clone());
        assert!(slower.goodput < -0.1, "{slower:?}");
        let lossy = PathConfig { loss: LossModel::Iid(0.05), ..path.clone() };
        assert!(pair(Load::Bulk, lossy, path.clone()).goodput < -0.3);
        let longer = PathConfig { delay: Nanos::from_ms(40), ..path.clone() };
        let later = pair(Load::Limited, longer, path);
        assert!(later.late_ms > 10.0 && !later.late_agrees, "{later:?}");
    }
}
