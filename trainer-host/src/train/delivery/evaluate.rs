//! Measures what receivers see of a scene in given states: PSNR of every world, and of the complete one.

use render_host::{Settings, metric::mse};

use super::{
    Weights,
    coded::{Coded, Moving, no_change},
    error::DeliveryError,
    masks::{Masks, Sampler},
    monotone::{self, PREFIXES},
    shared_worlds::{SharedWorlds, distortion},
    view::Reference,
};
use crate::{
    encode::Decisions,
    evaluator::{PSNR_CAP_DB, worst_tenth},
    scene::Scene,
    utility::quantile,
};

/// Rises of distortion from a prefix to the next that count as none: below rounding.
const TOLERANCE: f64 = 1e-7;
/// Worlds this far below the complete state are cliffs, dB. Source: the paper's erasure study.
const CLIFF_DB: f64 = 3.0;

/// What states show of a scene.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Evaluation {
    /// PSNR of the complete state, mean over pictures, dB.
    pub clean_db: f64,
    /// PSNR of each state, mean over pictures, dB.
    pub worlds_db: Vec<f64>,
    /// Bytes of packets and manifest.
    pub wire_bytes: u64,
    /// Steps at which a longer prefix looks worse than a shorter one, mean D over pictures, 0 to 3.
    pub violations: usize,
}

impl Evaluation {
    /// Mean PSNR over states, dB.
    pub fn mean_db(&self) -> f64 {
        self.worlds_db.iter().sum::<f64>() / self.worlds_db.len().max(1) as f64
    }

    /// Mean PSNR of the worst tenth of the states, dB.
    pub fn worst_tenth_db(&self) -> f64 {
        worst_tenth(&self.worlds_db)
    }

    /// The 0.10 quantile of PSNR over states, dB.
    pub fn p10_db(&self) -> f64 {
        let mut sorted = self.worlds_db.clone();
        sorted.sort_by(f64::total_cmp);
        quantile(&sorted, 0.1)
    }

    /// Whether state `state` is more than 3 dB below the complete one; none that is not there is.
    pub fn is_cliff(&self, state: usize) -> bool {
        self.worlds_db.get(state).is_some_and(|&db| db < self.clean_db - CLIFF_DB)
    }

    /// Share of states more than 3 dB below the complete one, 0..=1.
    pub fn cliffs(&self) -> f64 {
        let fallen = (0..self.worlds_db.len()).filter(|&state| self.is_cliff(state)).count();
        fallen as f64 / self.worlds_db.len().max(1) as f64
    }
}

/// Writes `scene` by `decisions` and measures `masks` against `references`.
///
/// # Errors
/// Decisions that do not fit the scene, states of another stream, or what the renderer refuses.
pub fn evaluate(
    scene: &Scene,
    decisions: &Decisions,
    masks: &Masks,
    references: &[Reference],
) -> Result<Evaluation, DeliveryError> {
    let parameters = no_change(scene);
    let coded = Coded::rewrite(scene, &parameters, decisions)?;
    evaluate_coded(&coded.moving(scene, &parameters), masks, references, Weights::default().structure)
}

/// As [`evaluate`], of a scene that is encoded; steps of quality are compared by a D with this weight of
/// `structure`.
///
/// # Errors
/// As [`evaluate`].
pub(super) fn evaluate_coded(
    moving: &Moving<'_>,
    masks: &Masks,
    references: &[Reference],
    structure: f64,
) -> Result<Evaluation, DeliveryError> {
    let encoded = &moving.coded().encoded;
    let sampler = Sampler::new(&encoded.stream, super::config::LossUnit::Packet)?;
    masks.check(sampler.complete().len())?;
    if references.is_empty() {
        return Err(DeliveryError::NoReference { found: 0, purpose: "evaluation" });
    }
    let prefixes: Vec<Vec<u8>> = (0..PREFIXES).map(|level| sampler.prefix(level)).collect();
    let footprint = encoded.stream.manifest()?.footprint();
    let plain = Settings { parallel: true, ..Settings::default() }.with_footprint(footprint);
    let share = 1.0 / references.len() as f64;
    let mut worlds_db = vec![0.0; masks.states.len()];
    let (mut clean_db, mut of_prefixes) = (0.0, [0.0; PREFIXES]);
    for reference in references {
        let Reference { frame, camera, picture, .. } = reference;
        let settings = reference.settings(&plain);
        let shared = SharedWorlds::new(moving, *frame, &masks.states)?;
        let errors = shared.squared_errors(camera, picture, &settings)?;
        worlds_db.iter_mut().zip(errors).for_each(|(sum, error)| *sum += share * psnr(error));
        let shared = SharedWorlds::new(moving, *frame, &prefixes)?;
        let found = shared.measured(camera, &settings, |image| {
            Ok((distortion(image, picture, structure)?, mse(image, picture)?))
        })?;
        clean_db += share * found.last().map_or(0.0, |(_, error)| psnr(*error));
        of_prefixes.iter_mut().zip(found).for_each(|(sum, (d, _))| *sum += share * d);
    }
    let wire_bytes = encoded.report.ledger.wire() as u64;
    let violations = monotone::violations(&of_prefixes, TOLERANCE);
    Ok(Evaluation { clean_db, worlds_db, wire_bytes, violations })
}

/// PSNR of a mean squared error, dB, capped at 99.
fn psnr(error: f64) -> f64 {
    (-10.0 * error.log10()).min(PSNR_CAP_DB)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        encode,
        train::delivery::{LossModel, LossUnit, view::tests::study},
    };

    /// A scene before its own picture over white is right over white, and wrong over anything else.
    #[test]
    fn a_picture_is_compared_over_its_own_background() {
        let (scene, mut references) = study(2, 1);
        let decisions =
            encode::encode(&scene, &encode::EncodeOptions::default(), &crate::encode::no_progress)
                .unwrap()
                .decisions;
        let instant = scene.instant(0).unwrap();
        let splats =
            render_host::Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree).unwrap();
        let white = Settings::over([1.0; 3]);
        let rendered = render_host::Renderer::new().render(&splats, &references[0].camera, &white).unwrap();
        references.truncate(1);
        references[0].picture = rendered.image;
        let clean_db = |background: [f32; 3]| {
            let reference = Reference { background, ..references[0].clone() };
            evaluate(&scene, &decisions, &Masks { states: Vec::new() }, &[reference]).unwrap().clean_db
        };
        let (right, wrong) = (clean_db([1.0; 3]), clean_db([0.0; 3]));
        assert!(right > 35.0 && wrong < 15.0, "{right} {wrong}");
    }

    #[test]
    fn losses_cost_quality_and_the_complete_state_is_the_best() {
        let (scene, references) = study(3, 1);
        let options =
            encode::EncodeOptions { packet_bytes: 300, block_len: 16, pictures: 0, ..Default::default() };
        let encoded = encode::encode(&scene, &options, &crate::encode::no_progress).unwrap();
        let share = |probability| {
            let loss = LossModel::Iid { probability };
            let masks = Masks::draw(&encoded.stream, loss, LossUnit::Packet, 12, 3).unwrap();
            evaluate(&scene, &encoded.decisions, &masks, &references).unwrap()
        };
        let (none, some, many) = (share(0.0), share(0.05), share(0.5));
        assert!(none.worlds_db.iter().all(|&db| (db - none.clean_db).abs() < 1e-9), "{none:?}");
        assert!(some.mean_db() < none.mean_db() && many.mean_db() < some.mean_db());
        assert!(many.worst_tenth_db() <= many.p10_db() && many.p10_db() <= many.mean_db());
        assert!(many.cliffs() > none.cliffs() && none.cliffs() == 0.0);
        assert_eq!(none.violations, 0, "levels of dgs1 are nested");
        let other = Masks { states: vec![vec![0; 3]] };
        let error = evaluate(&scene, &encoded.decisions, &other, &references).unwrap_err().to_string();
        assert!(error.contains("3 blocks"), "{error}");
    }
}
