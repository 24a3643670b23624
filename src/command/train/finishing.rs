//! Says what the end of a training left out, and what that cost and saved.

use std::collections::BTreeMap;

use serde::Serialize;
use trainer_host::{
    encode::{Decisions, Encoded},
    train::Pruning,
};

use super::trained::Trained;

/// Attributes of the canonical values.
const CANONICAL: [&str; 8] = ["position", "scale", "rotation", "opacity", "sh0", "sh1", "sh2", "sh3"];

/// What the end of a training did.
#[derive(Debug, Serialize)]
pub(super) struct Finished {
    /// Gaussians that were removed.
    prunings: Vec<Pruning>,
    /// How photographs from different places differ in colour, where that was learnt.
    exposures: Option<Exposures>,
    /// Gaussians that stand still while the others follow nodes.
    standing_gaussians: usize,
    /// Of canonical values: bytes that the training estimated, where it rounded, and that they take, with
    /// their part of the code words of tables.
    estimated_bytes: Option<f64>,
    coded_bytes: f64,
    /// Clusters by the degree of harmonics that they are sent with.
    clusters_of_degree: [usize; 4],
    /// Bytes of higher bands.
    harmonics_bytes: f64,
    /// Clusters over all windows, and those that do not move there.
    moving_cells: usize,
    still_cells: usize,
    /// Bytes of motion.
    motion_bytes: f64,
}

/// How far photographs from different places are from the scene.
#[derive(Debug, Serialize)]
struct Exposures {
    places: usize,
    /// Least and largest factor of a channel.
    factors: [f32; 2],
    /// Least and largest offset of a channel, display values.
    offsets: [f32; 2],
}

impl Exposures {
    fn of(places: &BTreeMap<[u64; 3], [[f32; 3]; 2]>) -> Option<Self> {
        let range = |part: usize| {
            let values = || places.values().flat_map(move |place| place[part]);
            [values().fold(f32::INFINITY, f32::min), values().fold(f32::NEG_INFINITY, f32::max)]
        };
        (!places.is_empty()).then(|| Self { places: places.len(), factors: range(0), offsets: range(1) })
    }
}

impl Finished {
    /// Of the stream that `trained` led to.
    pub(super) fn of(trained: &Trained, encoded: &Encoded) -> Self {
        let ledger = &encoded.report.ledger;
        let bytes = |counts: &dyn Fn(&str) -> bool| -> f64 {
            ledger.shares.iter().filter(|share| counts(share.attribute)).map(|share| share.bits / 8.0).sum()
        };
        let canonical = bytes(&|name| CANONICAL.contains(&name));
        let all = bytes(&|_| true).max(1.0);
        let mut clusters_of_degree = [0; 4];
        let (mut cells, mut still_cells) = (0, 0);
        if let Decisions::Dgs1(decisions) = &encoded.decisions {
            for epoch in &decisions.epochs {
                for cluster in &epoch.clusters {
                    clusters_of_degree[usize::from(cluster.harmonic_degree.min(3))] += 1;
                }
                let motions = || epoch.windows.iter().flat_map(|window| &window.motions);
                cells += motions().count();
                still_cells += motions().filter(|motion| motion.is_still()).count();
            }
        }
        Self {
            prunings: trained.prunings.clone(),
            exposures: Exposures::of(&trained.exposures),
            standing_gaussians: trained.standing,
            estimated_bytes: trained.estimated_bytes,
            coded_bytes: canonical * (1.0 + ledger.table_indices / all),
            clusters_of_degree,
            harmonics_bytes: bytes(&|name| ["sh1", "sh2", "sh3"].contains(&name)),
            moving_cells: cells - still_cells,
            still_cells,
            motion_bytes: bytes(&|name| !CANONICAL.contains(&name)),
        }
    }

    /// For people.
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        for Pruning { before, after, error_share } in &self.prunings {
            let share = 100.0 * error_share;
            text += &format!("  pruned: {before} to {after} Gaussians, {share:.3} % of what all add\n");
        }
        if let Some(estimated) = self.estimated_bytes {
            let off = 100.0 * (estimated / self.coded_bytes.max(1.0) - 1.0);
            text += &format!(
                "  rounded: canonical values {estimated:.0} bytes estimated, {:.0} coded ({off:+.1} %)\n",
                self.coded_bytes
            );
        }
        if let Some(Exposures { places, factors, offsets }) = &self.exposures {
            let [[darkest, brightest], [least, most]] = [factors, offsets];
            text += &format!(
                "  exposures: {places} places, colours times {darkest:.3} to {brightest:.3}, \
                 {least:+.3} to {most:+.3}; the views above are compared without them\n"
            );
        }
        let [none, first, second, third] = self.clusters_of_degree;
        text += &format!(
            "  harmonics: clusters of degree 0 to 3: {none}, {first}, {second}, {third}; {:.0} bytes\n",
            self.harmonics_bytes.max(0.0) + 0.0
        );
        text += &format!(
            "  motion: {} cells move, {} do not; {:.0} bytes; {} Gaussians stand still\n",
            self.moving_cells,
            self.still_cells,
            self.motion_bytes.max(0.0) + 0.0,
            self.standing_gaussians
        );
        text
    }
}
