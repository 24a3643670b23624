//! Chooses which Gaussians get fine steps, and which coarse ones.
//!
//! An error shows much in a large opaque Gaussian in front and hardly in a faint one behind it. At
//! high rate bits are spent best where step² times sensitivity is the same for every value. So
//! Gaussians of like sensitivity make a *quantiser class* with steps of its own, per class of attributes, and
//! are clustered apart from the others. What one saves is ½ log₂ of the ratio of the arithmetic to
//! the geometric mean of the sensitivities per value; what it costs is to know which class a
//! Gaussian is in, which its cluster tells: the entropy of the classes, in positions that lie farther
//! apart. Where Gaussians move that would also tear apart what moves together, so there a class is
//! one of whole clusters. Where to cut is found exactly, by dynamic programming over a histogram.

mod epoch_classes;
mod step_refinement;

pub(super) use epoch_classes::EpochClasses;

use super::{
    EncodeError, EncodeOptions, Progress, QuantiserSteps, cluster,
    decisions::QuantiserClass,
    sensitivity::{self, CLASSES, Weights},
    steps::{DGS1_MOST_RATIO, Factors, Grid},
};
use crate::scene::Scene;

/// The clusters of a scene, and which of them share steps.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct QuantiserClasses {
    /// Per epoch, clusters: see [`cluster::cluster`].
    sets: Vec<Vec<Vec<u32>>>,
    /// Per epoch, the class of each Gaussian; the same within a cluster.
    of: Vec<Vec<u8>>,
    /// Per class, the most sensitive first, factors on the steps of [`EncodeOptions::quality`].
    factors: Vec<Factors>,
}

/// Most classes.
pub const MOST: usize = 6;
/// A Gaussian counts as sensitive as this share of the mean, by class: less is beyond what a few
/// pictures can tell.
const FLOOR: f64 = 0.01;
/// Bits that one more class must save: per Gaussian, and for its quantisers and clusters that are not
/// full.
const MIN_GAIN: (f64, f64) = (0.5, 2000.0);
/// Factors stay within this and its inverse.
const MAX_FACTOR: f32 = 16.0;
/// Bins of the histogram of sensitivities.
const BINS: usize = 256;

impl QuantiserClasses {
    /// Clusters of `scene` with no classes, for a profile without.
    pub fn none(scene: &Scene, options: &EncodeOptions) -> Self {
        let sets = scene.epochs().iter().map(|epoch| cluster::cluster(epoch, &options.cluster)).collect();
        Self { sets, of: Vec::new(), factors: Vec::new() }
    }

    /// The clusters of each epoch.
    pub fn clusters(&self) -> &[Vec<Vec<u32>>] {
        &self.sets
    }

    /// All Gaussians of `scene` in one class, with the steps of [`EncodeOptions::quality`] or finer where
    /// that is cheap.
    ///
    /// # Errors
    /// Steps that the format does not hold.
    pub fn one(scene: &Scene, options: &EncodeOptions) -> Result<Self, EncodeError> {
        let clustered = |epoch| cluster::cluster(epoch, &options.cluster);
        let sets: Vec<Vec<Vec<u32>>> = scene.epochs().iter().map(clustered).collect();
        let of = scene.epochs().iter().map(|epoch| vec![0; epoch.count()]).collect();
        Self { sets, of, factors: vec![[1.0; CLASSES]] }.with_finer_steps(scene, options)
    }

    /// The classes of `scene` and steps that make errors weigh alike in pictures, in sum as much as
    /// those of [`EncodeOptions::quality`] do. Where nothing moves, Gaussians of different classes are
    /// clustered apart; else whole clusters share a class.
    ///
    /// # Errors
    /// What the renderer refuses; steps that the format does not hold; `progress` stops the work.
    pub fn measured(
        scene: &Scene,
        options: &EncodeOptions,
        progress: Progress<'_>,
    ) -> Result<Self, EncodeError> {
        let mut costs = sensitivity::measure(scene, options.pictures, &options.backend()?, progress)?;
        for (epoch, costs) in scene.epochs().iter().zip(&mut costs) {
            let mut quality = options.quality;
            quality.position = Grid::of(epoch, DGS1_MOST_RATIO).step(&quality);
            let steps = quality.steps().map(|step| f64::from(*step));
            for cost in costs.iter_mut() {
                (0..CLASSES).for_each(|c| cost[c] *= steps[c] * steps[c]);
            }
        }
        let degree = scene.epochs().iter().map(|e| e.attributes().sh_degree).max().unwrap_or_default();
        let Some(found) = Costs::new(costs, [3, 3, 3, 1, 3, degree.rest_len()]) else {
            return Self::one(scene, options);
        };
        let still = scene.epochs().iter().all(|epoch| epoch.attributes().is_constant());
        let classes = if still { found.apart(scene, options) } else { found.together(scene, options) };
        classes.with_finer_steps(scene, options)
    }

    /// The same with finer steps where they are cheap in the middle epoch.
    fn with_finer_steps(mut self, scene: &Scene, options: &EncodeOptions) -> Result<Self, EncodeError> {
        let middle = scene.epochs().len() / 2;
        if let Some(epoch) = scene.epochs().get(middle) {
            let finer = step_refinement::finer(epoch, &self.of_epoch(middle, &options.quality), options)?;
            for (factors, finer) in self.factors.iter_mut().zip(finer) {
                factors.iter_mut().zip(finer).for_each(|(factor, finer)| *factor *= finer);
            }
        }
        Ok(self)
    }

    /// The classes of epoch `epoch` alone.
    pub fn part(&self, epoch: usize) -> Self {
        Self {
            sets: self.sets.get(epoch).cloned().into_iter().collect(),
            of: self.of.get(epoch).cloned().into_iter().collect(),
            factors: self.factors.clone(),
        }
    }

    /// How many Gaussians each has, and its steps.
    pub fn shares(&self, quality: &QuantiserSteps) -> Vec<QuantiserClass> {
        let count =
            |class: usize| self.of.iter().flatten().filter(|&&s| usize::from(s) == class).count() as u64;
        let share = |(class, factors): (usize, &Factors)| QuantiserClass {
            gaussians: count(class),
            quality: quality.times(factors),
        };
        self.factors.iter().enumerate().map(share).collect()
    }

    /// Those of epoch `epoch`, with their steps.
    pub fn of_epoch(&self, epoch: usize, quality: &QuantiserSteps) -> EpochClasses<'_> {
        EpochClasses {
            sets: self.sets.get(epoch).map_or(&[][..], Vec::as_slice),
            of: self.of.get(epoch).map_or(&[][..], Vec::as_slice),
            qualities: self.factors.iter().map(|factors| quality.times(factors)).collect(),
        }
    }
}

/// What an error of one step costs, per epoch and Gaussian.
struct Costs {
    each: Vec<Vec<Weights>>,
    mean: Weights,
    /// Components per class; none of those that nobody has.
    components: [f64; CLASSES],
}

impl Costs {
    /// `None` if nothing shows.
    fn new(mut each: Vec<Vec<Weights>>, components: [usize; CLASSES]) -> Option<Self> {
        let count = each.iter().map(Vec::len).sum::<usize>() as f64;
        let mut mean: Weights = [0.0; CLASSES];
        for cost in each.iter().flatten() {
            (0..CLASSES).for_each(|c| mean[c] += cost[c] / count);
        }
        let known = |c: usize| mean[c] > 0.0 && mean[c].is_finite();
        let components: [f64; CLASSES] =
            std::array::from_fn(|c| if known(c) { components[c] as f64 } else { 0.0 });
        for cost in each.iter_mut().flatten() {
            (0..CLASSES).for_each(|c| cost[c] = cost[c].max(FLOOR * mean[c]));
        }
        components.iter().any(|&n| n > 0.0).then_some(Self { each, mean, components })
    }

    /// Gaussians of different classes clustered apart.
    fn apart(&self, scene: &Scene, options: &EncodeOptions) -> QuantiserClasses {
        let units = self.each.iter().flatten().map(|&sums| Bin { count: 1.0, sums }).collect();
        let (classes, factors) = self.classes(units, true);
        let mut classes = classes.into_iter();
        let (mut sets, mut of) = (Vec::new(), Vec::new());
        for epoch in scene.epochs() {
            let class_of: Vec<u8> = classes.by_ref().take(epoch.count()).collect();
            let mut parts = vec![Vec::new(); factors.len()];
            for (i, &class) in (0..).zip(&class_of) {
                parts[usize::from(class)].push(i);
            }
            parts.retain(|part| !part.is_empty());
            sets.push(cluster::cluster_within(epoch, parts, &options.cluster));
            of.push(class_of);
        }
        QuantiserClasses { sets, of, factors }
    }

    /// Clusters as they are, each in one class.
    fn together(&self, scene: &Scene, options: &EncodeOptions) -> QuantiserClasses {
        let mut sets = Vec::new();
        let mut units = Vec::new();
        for (epoch, costs) in scene.epochs().iter().zip(&self.each) {
            let clusters = cluster::cluster(epoch, &options.cluster);
            for members in &clusters {
                let each: Vec<Bin> =
                    members.iter().map(|&i| Bin { count: 1.0, sums: costs[i as usize] }).collect();
                units.push(Bin::sum(&each));
            }
            sets.push(clusters);
        }
        let (classes, factors) = self.classes(units, false);
        let mut classes = classes.into_iter();
        let mut of = Vec::new();
        for (epoch, clusters) in scene.epochs().iter().zip(&sets) {
            let mut class_of = vec![0; epoch.count()];
            for (members, class) in clusters.iter().zip(&mut classes) {
                members.iter().for_each(|&i| class_of[i as usize] = class);
            }
            of.push(class_of);
        }
        QuantiserClasses { sets, of, factors }
    }

    /// The class of each of `units`, and the factors of each class. `signalled`: whether it takes bits to
    /// say which class a unit is in.
    fn classes(&self, units: Vec<Bin>, signalled: bool) -> (Vec<u8>, Vec<Factors>) {
        let scores: Vec<f64> = units.iter().map(|unit| self.score(unit)).collect();
        let low = scores.iter().copied().fold(f64::INFINITY, f64::min);
        let high = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let width = ((high - low) / BINS as f64).max(1e-12);
        // From the most sensitive down.
        let bin_of = |score: f64| (((high - score) / width) as usize).min(BINS - 1);
        let mut bins = vec![Bin::default(); BINS];
        for (unit, &score) in units.iter().zip(&scores) {
            let bin = &mut bins[bin_of(score)];
            *bin = Bin::sum(&[*bin, *unit]);
        }
        let ends = cut(&bins, &self.components, signalled);
        let class_of = |&score: &f64| ends.iter().take_while(|&&end| bin_of(score) >= end).count() as u8;
        let which = scores.iter().map(class_of).collect();
        (which, self.factors(&bins, &ends))
    }

    /// How sensitive the values of `unit` are: mean logarithm of what an error costs over its mean.
    fn score(&self, unit: &Bin) -> f64 {
        let values: f64 = self.components.iter().sum();
        let mut sum = 0.0;
        for c in (0..CLASSES).filter(|&c| self.components[c] > 0.0) {
            sum += self.components[c] * (unit.sums[c] / unit.count / self.mean[c]).ln();
        }
        sum / values
    }

    /// The factors of each class of `bins`, which end at `ends`: what the steps cost in all, spread evenly
    /// over the values.
    fn factors(&self, bins: &[Bin], ends: &[usize]) -> Vec<Factors> {
        let values: f64 = self.components.iter().sum();
        let all = Bin::sum(bins);
        let total: f64 = (0..CLASSES).map(|c| self.components[c] * all.sums[c]).sum();
        let each = total / all.count / values;
        let mut factors = Vec::new();
        let mut first = 0;
        for &end in ends {
            let class = Bin::sum(&bins[first..end]);
            first = end;
            let mut own: Factors = [1.0; CLASSES];
            for c in (0..CLASSES).filter(|&c| self.components[c] != 0.0) {
                let factor = (each * class.count / class.sums[c]).sqrt() as f32;
                own[c] = factor.clamp(1.0 / MAX_FACTOR, MAX_FACTOR);
            }
            factors.push(own);
        }
        factors
    }
}

/// Gaussians of like sensitivity.
#[derive(Clone, Copy, Debug, Default)]
struct Bin {
    count: f64,
    /// What errors of a step cost, by class.
    sums: Weights,
}

impl Bin {
    fn sum(bins: &[Self]) -> Self {
        let mut all = Self::default();
        for bin in bins {
            all.count += bin.count;
            (0..CLASSES).for_each(|c| all.sums[c] += bin.sums[c]);
        }
        all
    }
}

/// Ends of the ranges of `bins` that take the fewest bits; the last is the number of bins.
fn cut(bins: &[Bin], components: &[f64; CLASSES], signalled: bool) -> Vec<usize> {
    let n = bins.len();
    let all = Bin::sum(bins);
    let least_gain = MIN_GAIN.0 * all.count + MIN_GAIN.1;
    let mut before = vec![Bin::default(); n + 1];
    for (i, bin) in bins.iter().enumerate() {
        before[i + 1] = Bin::sum(&[before[i], *bin]);
    }
    // Bits of bins `a..b` as one class, up to what all choices have in common.
    let bits = |a: usize, b: usize| -> f64 {
        let count = before[b].count - before[a].count;
        if count < 0.5 {
            return f64::INFINITY;
        }
        let half_log = |c: usize| {
            let mean = (before[b].sums[c] - before[a].sums[c]) / count;
            0.5 * components[c] * mean.max(f64::MIN_POSITIVE).log2()
        };
        let signalling = if signalled { (count / all.count).log2() } else { 0.0 };
        count * ((0..CLASSES).map(half_log).sum::<f64>() - signalling) + least_gain
    };
    // best[s][b]: bits of bins `0..b` in s + 1 classes, and where the last begins.
    let mut best: Vec<Vec<(f64, usize)>> = vec![(0..=n).map(|b| (bits(0, b), 0)).collect()];
    for s in 1..MOST {
        let of_one_more = (0..=n)
            .map(|b| {
                (s..b)
                    .map(|a| (best[s - 1][a].0 + bits(a, b), a))
                    .fold((f64::INFINITY, 0), |least, found| if found.0 < least.0 { found } else { least })
            })
            .collect();
        best.push(of_one_more);
    }
    let classes = (0..MOST).fold(0, |least, s| if best[s][n].0 < best[least][n].0 { s } else { least });
    let mut ends = vec![n];
    for s in (1..=classes).rev() {
        let end = ends.last().map_or(n, |&end| end);
        ends.push(best[s][end].1);
    }
    ends.reverse();
    ends
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        encode::{
            encode,
            evaluator::{Evaluator, spread},
            no_progress,
        },
        import::{
            Limits,
            synth::{self, SynthKind},
        },
    };

    const COMPONENTS: [usize; CLASSES] = [3, 3, 3, 1, 3, 0];

    /// The definition: bits of every Gaussian's values at the factors of its class, and what it takes to
    /// tell the classes.
    fn naive_bits(each: &[Weights], of: &[u8], factors: &[Factors]) -> f64 {
        let n = each.len() as f64;
        let values: f64 = of
            .iter()
            .map(|&s| {
                (0..5)
                    .map(|c| -(COMPONENTS[c] as f64) * f64::from(factors[usize::from(s)][c]).log2())
                    .sum::<f64>()
            })
            .sum();
        let signalling: f64 = (0..factors.len())
            .map(|s| of.iter().filter(|&&o| usize::from(o) == s).count() as f64)
            .filter(|&k| k > 0.0)
            .map(|k| k * (n / k).log2())
            .sum();
        values + signalling
    }

    fn distortion(each: &[Weights], of: &[u8], factors: &[Factors]) -> f64 {
        let one = |cost: &Weights, s: u8| -> f64 {
            let factor = |c: usize| f64::from(factors[usize::from(s)][c]).powi(2);
            (0..5).map(|c| COMPONENTS[c] as f64 * cost[c] * factor(c)).sum()
        };
        each.iter().zip(of).map(|(cost, &s)| one(cost, s)).sum()
    }

    /// Sensitivities over three decades, in two clumps.
    fn costs(n: usize) -> Vec<Weights> {
        (0..n)
            .map(|i| {
                let clump = if i % 3 == 0 { 1.0 } else { 0.02 };
                let own = clump * (1.0 + (i * 7919 % 101) as f64 / 50.0);
                [own, 2.0 * own, 0.5 * own, own * own, own, 0.0]
            })
            .collect()
    }

    #[test]
    fn classes_keep_what_errors_cost_and_save_bits() {
        let costs = Costs::new(vec![costs(3000)], COMPONENTS).unwrap();
        let each = &costs.each[0];
        let (of, factors) = costs.classes(each.iter().map(|&sums| Bin { count: 1.0, sums }).collect(), true);
        assert!((2..=MOST).contains(&factors.len()), "{factors:?}");
        let (one, zero) = (vec![[1.0; CLASSES]], vec![0; each.len()]);
        let (before, after) = (distortion(each, &zero, &one), distortion(each, &of, &factors));
        assert!((after / before - 1.0).abs() < 1e-3, "{after} for {before}");
        let saved = naive_bits(each, &zero, &one) - naive_bits(each, &of, &factors);
        assert!(saved / each.len() as f64 > 5.0, "{saved}");
        // The most sensitive first, with the finest steps.
        assert!(factors.is_sorted_by(|a, b| a[0] < b[0]), "{factors:?}");
        for (cost, &s) in each.iter().zip(&of) {
            assert!(cost[0] > 0.5 || s > 0, "a Gaussian of {cost:?} in class {s}");
        }
    }

    #[test]
    fn cuts_are_those_of_the_search_over_all() {
        let costs = costs(200);
        let mut bins = vec![Bin::default(); 9];
        for cost in &costs {
            let bin = ((2.0 - cost[0].log2()).clamp(0.0, 8.0)) as usize;
            bins[bin] = Bin::sum(&[bins[bin], Bin { count: 1.0, sums: *cost }]);
        }
        bins.retain(|bin| bin.count > 0.0);
        let components = COMPONENTS.map(|n| n as f64);
        let all = Bin::sum(&bins);
        let cost = |ends: &[usize], signalled: bool| -> f64 {
            let mut first = 0;
            let mut sum = 0.0;
            for &end in ends {
                let part = Bin::sum(&bins[first..end]);
                first = end;
                let half_log = |c: usize| 0.5 * components[c] * (part.sums[c] / part.count).log2();
                sum += part.count * (0..5).map(half_log).sum::<f64>();
                sum += if signalled { part.count * (all.count / part.count).log2() } else { 0.0 };
                sum += MIN_GAIN.0 * all.count + MIN_GAIN.1;
            }
            sum
        };
        for signalled in [false, true] {
            let mut least = f64::INFINITY;
            for choice in 0..1u32 << (bins.len() - 1) {
                let mut ends: Vec<usize> = (1..bins.len()).filter(|b| choice >> (b - 1) & 1 == 1).collect();
                ends.push(bins.len());
                if ends.len() <= MOST {
                    least = least.min(cost(&ends, signalled));
                }
            }
            let found = cut(&bins, &components, signalled);
            assert!((cost(&found, signalled) - least).abs() < 1e-6, "{found:?}");
        }
    }

    #[test]
    fn nothing_to_see_or_all_alike_is_one_class() {
        assert!(Costs::new(vec![vec![[0.0; CLASSES]; 9]], COMPONENTS).is_none());
        assert!(Costs::new(vec![Vec::new()], COMPONENTS).is_none());
        assert!(Costs::new(vec![vec![[f64::NAN; CLASSES]; 9]], COMPONENTS).is_none());
        let alike = Costs::new(vec![vec![[2.0, 2.0, 2.0, 2.0, 2.0, 0.0]; 50]], COMPONENTS).unwrap();
        let (of, factors) = alike.classes(vec![Bin { count: 1.0, sums: alike.each[0][0] }; 50], true);
        assert_eq!((of, factors), (vec![0; 50], vec![[1.0; CLASSES]]));
    }

    #[test]
    fn clusters_never_mix_classes_and_hold_everybody_once() {
        for (kind, frames) in [(SynthKind::Figure, 1), (SynthKind::Figure, 6), (SynthKind::Births, 6)] {
            let options = synth::SynthOptions { gaussians: 1500, frames, kind, ..Default::default() };
            let scene = synth::make(&options, &Limits::default()).unwrap();
            let classes =
                QuantiserClasses::measured(&scene, &EncodeOptions::default(), &no_progress).unwrap();
            assert!(classes.factors.len() > 1, "{kind:?} {frames}");
            for (e, epoch) in scene.epochs().iter().enumerate() {
                let own = classes.of_epoch(e, &QuantiserSteps::default());
                let mut seen: Vec<u32> = own.sets.concat();
                seen.sort_unstable();
                assert!(seen.into_iter().eq(0..epoch.count() as u32));
                for set in own.sets {
                    assert!(set.iter().all(|&i| own.of(&[i]) == own.of(set)));
                }
            }
            let shares = classes.shares(&QuantiserSteps::default());
            let all: u64 = shares.iter().map(|s| s.gaussians).sum();
            assert_eq!(all, scene.epochs().iter().map(|e| e.count() as u64).sum::<u64>());
        }
    }

    /// The same PSNR from cameras on which nothing was chosen, for fewer bytes.
    #[test]
    fn measured_steps_pay() {
        let options =
            synth::SynthOptions { gaussians: 4000, frames: 1, kind: SynthKind::Figure, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let evaluator = Evaluator::validation(&scene, spread(0, 1, 1)).unwrap();
        let marks = |pictures: usize, coarseness: f32| {
            let quality = QuantiserSteps::default().scaled(coarseness);
            let options = EncodeOptions { pictures, quality, ..EncodeOptions::default() };
            let encoded = encode(&scene, &options, &no_progress).unwrap();
            (encoded.report.ledger.wire(), evaluator.whole(&encoded.stream).unwrap())
        };
        let (even, psnr) = marks(0, 1.0);
        let finer = (1..20).map(|k| marks(16, 1.1 * 0.9f32.powi(k))).find(|m| m.1 >= psnr);
        let (measured, _) = finer.unwrap();
        assert!(measured < 0.95 * even, "{measured} for {even} bytes");
    }
}
