//! Chooses the rank of the shared temporal basis by validation: never fixed by hand (paper section 3).

use std::ops::ControlFlow;

use codec_core::internals::digest::Digest;
use render_host::Backend;

use super::{
    config::DeliveryOptions,
    error::DeliveryError,
    evaluate::{Evaluation, evaluate},
    fine_tune::{Update, fine_tune},
    masks::Masks,
    record::hex,
    tuning::references_hash,
    view::Reference,
    {LossModel, Validation},
};
use crate::scene::Scene;

/// What one rank came to with one seed.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RankResult {
    /// Vectors of the shared temporal basis, at most.
    pub rank: usize,
    /// Seed of the training.
    pub seed: u64,
    /// PSNR of the complete state on validation pictures, dB.
    pub clean_db: f64,
    /// The 0.10 quantile of PSNR over validation states, dB.
    pub p10_db: f64,
    /// Mean PSNR of the worst tenth of the validation states, dB.
    pub worst_tenth_db: f64,
    /// Bytes of packets and manifest.
    pub wire_bytes: u64,
    /// What rendered and differentiated the training.
    pub device: String,
}

/// The rank that the rule takes, and why.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct RankChoice {
    /// The rank.
    pub rank: usize,
    /// Mean over seeds of the 0.10 quantile at that rank, dB.
    pub p10_db: f64,
    /// The rule.
    pub rule: &'static str,
}

/// The rule, as it is reported.
const RULE: &str = "the highest mean 0.10 quantile of PSNR over validation states; within 0.02 dB of it the \
     fewest bytes";
/// Ranks within this of the best count as equal to it, dB.
const EQUAL_DB: f64 = 0.02;

/// Fine-tunes `scene` under `options` at one rank with one seed, and measures it on `validation`: bursts of
/// 5 % loss drawn on that rank's own stream with the seed of the training. Its updates run on `backend`.
/// `None` where `progress` ends it.
///
/// # Errors
/// As [`fine_tune`].
pub fn measure_rank(
    scene: &Scene,
    references: &[Reference],
    validation: &[Reference],
    options: &DeliveryOptions,
    (rank, seed): (usize, u64),
    backend: &Backend,
    progress: &dyn Fn(&Update) -> ControlFlow<()>,
) -> Result<Option<RankResult>, DeliveryError> {
    let mut options = DeliveryOptions { seed, registration: None, ..options.clone() };
    options.encode.rank = rank;
    options.validation = Validation { candidates: 0, ..options.validation };
    let tuned = fine_tune(scene, references, &options, backend, progress)?;
    if tuned.record.objective.len() < options.updates {
        return Ok(None);
    }
    let encoded = crate::encode::write(&tuned.scene, &tuned.decisions, &crate::encode::no_progress)?;
    let loss = LossModel::Burst { share: 0.05, length: 6.0 };
    let masks = Masks::draw(&encoded.stream, loss, options.unit, options.validation.states, seed)?;
    let found: Evaluation = evaluate(&tuned.scene, &tuned.decisions, &masks, validation)?;
    Ok(Some(RankResult {
        rank,
        seed,
        clean_db: found.clean_db,
        p10_db: found.p10_db(),
        worst_tenth_db: found.worst_tenth_db(),
        wire_bytes: found.wire_bytes,
        device: backend.name(),
    }))
}

/// Hashes of `scene` and of `references`, on which results depend besides the options: FNV-1a, 64 bits, as 16
/// hexadecimal digits each.
pub fn input_hashes(scene: &Scene, references: &[Reference]) -> [String; 2] {
    let digest = Digest::new().bytes(&scene.frames_per_second().to_le_bytes());
    let digest = digest.bytes(&scene.digest().get().to_le_bytes());
    [hex(digest.get()), references_hash(references)]
}

/// The rank with the highest mean 0.10 quantile over seeds; of ranks within 0.02 dB of it the one with the
/// fewest wire bytes, of equals the lowest. `None` of no result.
pub fn choose_rank(results: &[RankResult]) -> Option<RankChoice> {
    let mut ranks: Vec<usize> = results.iter().map(|r| r.rank).collect();
    ranks.sort_unstable();
    ranks.dedup();
    let mean = |rank: usize, of: fn(&RankResult) -> f64| {
        let own: Vec<f64> = results.iter().filter(|r| r.rank == rank).map(of).collect();
        own.iter().sum::<f64>() / own.len().max(1) as f64
    };
    let quality = |rank| mean(rank, |r| r.p10_db);
    let bytes = |rank| mean(rank, |r| r.wire_bytes as f64);
    let best = ranks.iter().map(|&rank| quality(rank)).max_by(f64::total_cmp)?;
    let equal = ranks.into_iter().filter(|&rank| quality(rank) >= best - EQUAL_DB);
    let rank = equal.min_by(|&a, &b| bytes(a).total_cmp(&bytes(b)).then(a.cmp(&b)))?;
    Some(RankChoice { rank, p10_db: quality(rank), rule: RULE })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn result(rank: usize, seed: u64, p10_db: f64, wire_bytes: u64) -> RankResult {
        let (clean_db, worst_tenth_db, device) = (30.0, p10_db - 1.0, "cpu".to_owned());
        RankResult { rank, seed, clean_db, p10_db, worst_tenth_db, wire_bytes, device }
    }

    #[test]
    fn quality_over_seeds_comes_first_and_equals_go_by_bytes() {
        let mut results = vec![
            result(0, 1, 24.0, 100),
            result(2, 1, 25.50, 130),
            result(2, 2, 25.52, 130),
            result(4, 1, 25.51, 180),
            result(4, 2, 25.53, 180),
            result(8, 1, 25.9, 300),
            result(8, 2, 24.9, 300),
        ];
        let choice = choose_rank(&results).unwrap();
        assert_eq!(choice.rank, 2, "4 is better by 0.01 dB only");
        results.iter_mut().filter(|r| r.rank == 4).for_each(|r| r.p10_db += 0.1);
        assert_eq!(choose_rank(&results).unwrap().rank, 4);
        assert!(choose_rank(&[]).is_none());
    }
}
