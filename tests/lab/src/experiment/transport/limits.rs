//! Says where the distance from the bound to each scheduler goes: to the plan, the transport, the order.

use emulator_host::PolicyKind;

use super::{
    optimum::LIVE,
    paired::{Window, clustered},
    watched::Seen,
};
use crate::figures::{Bench, Figure};

/// The schedulers, and where two of them stand.
pub(super) const POLICIES: [PolicyKind; 5] = PolicyKind::ALL;
pub(super) const LAYERED: usize = 4;
pub(super) const OURS: usize = 1;

/// What limits one window: the most that any schedule shows; for each policy, the most that the bytes show
/// which arrived; and what our plan shows over a transport that fills the link and loses nothing.
#[derive(Clone, Debug)]
pub(super) struct Limits {
    pub bound: f64,
    pub arrived: Vec<f64>,
    pub ideal: Seen,
}

/// A window and what limits it.
pub(super) type Limited = (Window<Seen>, Limits);

/// From the bound down to `layered`: where the distance goes, for each policy.
pub(super) fn push_limits(bench: &mut Bench, prefix: &str, windows: &[Limited]) {
    let mut push = |key: &str, (value, ci): (f64, [f64; 2]), unit: &str, of: usize| {
        let mut figure = Figure::new(format!("{prefix}.{key}"), value, unit).runs(of);
        figure.ci95 = Some(ci);
        bench.push(figure);
    };
    let count = windows.len();
    for (at, policy) in POLICIES.iter().enumerate() {
        let name = policy.name();
        let all = levels(windows.iter(), at);
        let of_all =
            |statistic: &dyn Fn(&Steps) -> f64| clustered(&all, &|drawn| statistic(&Steps::of(drawn)));
        if at == OURS {
            push("bound.utility", of_all(&|steps| steps.bound), "at most", count);
            push("bound.distance", of_all(&Steps::distance), "from layered", count);
        }
        let words = "utility, at most, of the bytes that arrived";
        push(&format!("{name}.arrived_bound"), of_all(&|steps| steps.arrived), words, count);
        let of_bound = of_all(&|steps| 100.0 * steps.own / steps.bound);
        push(&format!("{name}.share_of_bound"), of_bound, "% of the bound", count);
        if at == LAYERED {
            continue;
        }
        let part = "% of the distance";
        let undelivered = of_all(&|steps| steps.part(steps.bound - steps.arrived));
        push(&format!("{name}.lost_to_delivery"), undelivered, part, count);
        let misordered = of_all(&|steps| steps.part(steps.arrived - steps.own));
        push(&format!("{name}.lost_to_order"), misordered, "% of the distance, at most", count);
        if at == OURS {
            let words = "link filled, nothing lost, its rate known";
            push("deadline-utility.ideal_transport.utility", of_all(&|steps| steps.ideal), words, count);
            let to_plan = of_all(&|steps| steps.part(steps.bound - steps.ideal));
            push("deadline-utility.lost_to_plan", to_plan, "% of the distance, at most", count);
            let to_transport = of_all(&|steps| steps.part(steps.ideal - steps.own));
            push("deadline-utility.lost_to_transport", to_transport, part, count);
        }
        let live = levels(windows.iter().filter(|(_, limits)| limits.bound >= LIVE), at);
        let of_live = clustered(&live, &|drawn| Steps::of(drawn).share());
        let words = format!("{part}, in windows whose bound is above {LIVE}");
        push(&format!("{name}.share_live"), of_live, &words, live.len());
        push(&format!("{name}.share"), of_all(&Steps::share), part, count);
        // D has no bound; what is known to be reachable over the same link without losses stands in for it.
        let distortions: Vec<Window<f64>> = windows
            .iter()
            .map(|(window, limits)| {
                let shown = [limits.ideal, window.runs[at], window.runs[LAYERED]].map(|seen| seen.distortion);
                Window { family: window.family, trace: window.trace, runs: shown.to_vec() }
            })
            .collect();
        if at == OURS {
            let ideal = clustered(&distortions, &|drawn| 1000.0 * mean_at(drawn, 0));
            push("deadline-utility.ideal_transport.distortion", ideal, "x 10^-3", count);
        }
        let share = clustered(&distortions, &|drawn| {
            let [ideal, own, layered] = [0, 1, 2].map(|place| mean_at(drawn, place));
            100.0 * (layered - own) / (layered - ideal)
        });
        let words = "% of the distance in D from layered to our plan where nothing is lost";
        push(&format!("{name}.distortion_share"), share, words, count);
    }
}

/// The mean of the values at `place` of `windows`.
fn mean_at(windows: &[&Window<f64>], place: usize) -> f64 {
    windows.iter().map(|window| window.runs[place]).sum::<f64>() / windows.len() as f64
}

/// For each of `windows`, the utilities of [`Steps`] of the policy `at`.
fn levels<'w>(windows: impl Iterator<Item = &'w Limited>, at: usize) -> Vec<Window<f64>> {
    let level = |(window, limits): &Limited| Window {
        family: window.family,
        trace: window.trace,
        runs: vec![
            limits.bound,
            limits.ideal.utility,
            limits.arrived[at],
            window.runs[at].utility,
            window.runs[LAYERED].utility,
        ],
    };
    windows.map(level).collect()
}

/// Mean utilities of one policy: the bound, our plan over an ideal transport, the bound by what arrived, the
/// policy's own, that of `layered`.
struct Steps {
    bound: f64,
    ideal: f64,
    arrived: f64,
    own: f64,
    layered: f64,
}

impl Steps {
    /// Of windows with these five, in this order.
    fn of(windows: &[&Window<f64>]) -> Self {
        let [bound, ideal, arrived, own, layered] = [0, 1, 2, 3, 4].map(|place| mean_at(windows, place));
        Self { bound, ideal, arrived, own, layered }
    }

    fn distance(&self) -> f64 {
        self.bound - self.layered
    }

    /// `utility` in percent of the distance.
    fn part(&self, utility: f64) -> f64 {
        100.0 * utility / self.distance()
    }

    fn share(&self) -> f64 {
        self.part(self.own - self.layered)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every policy has its share of what was possible, and its bound by what arrived.
    #[test]
    fn each_policy_stands_beside_what_was_possible() {
        let limited = |trace: usize| -> Limited {
            let runs = (0..POLICIES.len())
                .map(|at| Seen::of_utility(if at == LAYERED { 0.5 } else { 0.6 + 0.05 * at as f64 }));
            let window = Window { family: "made", trace, runs: runs.collect() };
            (
                window,
                Limits { bound: 0.9, arrived: vec![0.85; POLICIES.len()], ideal: Seen::of_utility(0.88) },
            )
        };
        let mut bench = Bench::new("t", "");
        push_limits(&mut bench, "p", &[limited(0), limited(1)]);
        let value = |key: &str| {
            let found: Vec<&Figure> = bench.figures.iter().filter(|figure| figure.key == key).collect();
            assert!(found.len() == 1 && found[0].ci95.is_some(), "{key}: {found:?}");
            found[0].value
        };
        for (at, policy) in POLICIES.iter().enumerate() {
            let name = policy.name();
            let own = if at == LAYERED { 0.5 } else { 0.6 + 0.05 * at as f64 };
            assert!((value(&format!("p.{name}.share_of_bound")) - 100.0 * own / 0.9).abs() < 1e-9);
            assert!((value(&format!("p.{name}.arrived_bound")) - 0.85).abs() < 1e-9);
            if at == LAYERED {
                continue;
            }
            let parts = ["share", "lost_to_order", "lost_to_delivery"];
            let parts = parts.map(|part| value(&format!("p.{name}.{part}")));
            assert!((parts[0] - 250.0 * (own - 0.5)).abs() < 1e-9, "{name}: {parts:?}");
            assert!((parts.iter().sum::<f64>() - 100.0).abs() < 1e-9, "{name}: {parts:?}");
            assert!(value(&format!("p.{name}.distortion_share")) > 0.0);
        }
        let [plan, transport, ideal] = ["lost_to_plan", "lost_to_transport", "ideal_transport.utility"]
            .map(|part| value(&format!("p.deadline-utility.{part}")));
        assert!((plan - 5.0).abs() < 1e-9 && (transport - 57.5).abs() < 1e-9, "{plan} {transport}");
        assert!((ideal - 0.88).abs() < 1e-9);
    }
}
