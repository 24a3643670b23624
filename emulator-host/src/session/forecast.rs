//! Compares what a scheduler forecast of each packet with what became of it.

use crate::{
    graph::PacketIndex,
    report::{ForecastBin, ForecastRow},
};

/// Bins of equal width over the forecast chances.
const BINS: usize = 10;

/// Forecasts made so far: of one packet, the first.
#[derive(Debug, Default)]
pub(super) struct Forecasts {
    made: Vec<(PacketIndex, f64, u32)>,
}

impl Forecasts {
    /// `packet` was given `chance` to arrive before `frame` is shown.
    pub(super) fn note(&mut self, packet: PacketIndex, chance: f64, frame: u32) {
        self.made.push((packet, chance, frame));
    }

    /// The score. `arrived[p]` is the first frame that was still to come when packet p arrived. Forecasts of
    /// frames from `shown` on were never put to the test.
    pub(super) fn score(&self, arrived: &[u32], shown: u32) -> Option<ForecastRow> {
        let mut bins = vec![ForecastBin::default(); BINS];
        let (mut count, mut squares, mut hits) = (0u64, 0.0, 0u64);
        for (packet, chance, frame) in self.made.iter().filter(|(_, _, frame)| *frame < shown) {
            let hit = arrived[packet.at()] <= *frame;
            let miss = chance - f64::from(u8::from(hit));
            squares += miss * miss;
            count += 1;
            hits += u64::from(hit);
            let bin = &mut bins[((chance * BINS as f64) as usize).min(BINS - 1)];
            bin.count += 1;
            bin.chance += chance;
            bin.hits += u64::from(hit);
        }
        if count == 0 {
            return None;
        }
        let rate = hits as f64 / count as f64;
        let mut reliability = 0.0;
        for bin in bins.iter_mut().filter(|bin| bin.count > 0) {
            bin.chance /= bin.count as f64;
            let off = bin.chance - bin.hits as f64 / bin.count as f64;
            reliability += off * off * bin.count as f64 / count as f64;
        }
        Some(ForecastRow {
            count,
            brier: squares / count as f64,
            base_rate_brier: rate * (1.0 - rate),
            reliability,
            bins,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_honest_forecast_scores_better_than_a_boast() {
        // Half of the packets arrive before frame 5.
        let arrived: Vec<u32> = (0..100).map(|at| if at % 2 == 0 { 3 } else { u32::MAX }).collect();
        let score = |chance| {
            let mut forecasts = Forecasts::default();
            (0..100).for_each(|at| forecasts.note(PacketIndex(at), chance, 5));
            forecasts.score(&arrived, 10).unwrap()
        };
        let (honest, boast) = (score(0.5), score(0.99));
        assert!((honest.brier - 0.25).abs() < 1e-12 && honest.reliability < 1e-12);
        assert!(boast.brier > 0.45 && boast.reliability > 0.2);
        assert_eq!(honest.base_rate_brier, 0.25);
        assert_eq!(honest.bins.iter().map(|bin| bin.count).sum::<u64>(), 100);
    }

    #[test]
    fn frames_that_were_never_shown_test_nothing() {
        let mut forecasts = Forecasts::default();
        forecasts.note(PacketIndex(0), 1.0, 7);
        assert_eq!(forecasts.score(&[0], 7), None);
    }
}
