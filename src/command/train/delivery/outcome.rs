//! Says what came of a fine-tuning.

use trainer_host::{
    encode::Target,
    train::delivery::{Candidate, DeliveryOptions, RankChoice, Record},
};

use super::rank;

/// What came of it, for people: which updates were taken, and what that gives where packets are lost.
pub(in super::super) fn outcome(
    record: &Record,
    options: &DeliveryOptions,
    choice: Option<&RankChoice>,
) -> String {
    let mut text = choice.map_or_else(String::new, rank::said);
    text += &format!(
        "  {} of {} updates for delivery, {}\n",
        record.objective.len(),
        options.updates,
        options.variant.name()
    );
    if let Some(why) = &record.stopped {
        text += &format!("  ended there, since {why}\n");
    }
    let Some((before, taken)) = record.before_and_taken() else { return text };
    if taken.updates == 0 {
        text += &format!("  {}: the scene is as it was given\n", why_as_given(record, before));
        return text;
    }
    text += &format!(
        "  taken after update {}: with lost packets, 0.10 quantile {:.2} → {:.2} dB; with all of \
         them {:.2} → {:.2} dB; {} → {} bytes on the wire\n",
        taken.updates,
        before.p10_db,
        taken.p10_db,
        before.clean_db,
        taken.clean_db,
        before.wire_bytes,
        taken.wire_bytes
    );
    text
}

/// Why no update was taken, of which the scene `before` the first is one that could be.
fn why_as_given(record: &Record, before: &Candidate) -> &'static str {
    let others = &record.candidates[1..];
    if others.is_empty() {
        "none of them was validated before it ended"
    } else if others.iter().any(|candidate| candidate.p10_db > before.p10_db) {
        "those that were better where packets are lost had more prefixes that lose quality, or were too large"
    } else {
        "none of them was better where packets are lost"
    }
}

/// Where the stream of so many `bytes` on the wire is larger than was asked for, or whether it is as close as
/// was asked for is not measured.
pub(super) fn missed(target: Option<Target>, record: &Record, bytes: u64) -> Option<String> {
    if let Some(Target::PsnrDb(_)) = target {
        return Some(
            "--target-psnr: is what the scene is encoded at before the first update; how close it is after \
             the last is not measured so"
                .to_owned(),
        );
    }
    let most = record.allowed_bytes.filter(|&most| bytes > most)?;
    Some(format!(
        "fine-tuned for delivery the scene takes {bytes} bytes on the wire, and {most} were asked for: steps \
         that are learnt (learn_steps) and candidates (validation.candidates) keep to it"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(allowed_bytes: Option<u64>, p10_db: &[f64]) -> Record {
        let candidate = |(at, &p10_db): (usize, &f64)| Candidate {
            updates: 10 * at,
            violations: 0,
            p10_db,
            clean_db: 30.0,
            wire_bytes: 900,
        };
        Record {
            registration: serde_json::from_value(serde_json::json!({
                "options": {}, "config_hash": "", "weights": {}, "validation_masks": "", "selection_rule": ""
            }))
            .unwrap(),
            allowed_bytes,
            stopped: None,
            device: "cpu".to_owned(),
            objective: Vec::new(),
            terms: Vec::new(),
            candidates: p10_db.iter().enumerate().map(candidate).collect(),
            taken: Some(0),
        }
    }

    #[test]
    fn why_a_scene_stays_as_it_was_given_is_said_as_it_is() {
        let said = |p10_db: &[f64]| outcome(&record(None, p10_db), &DeliveryOptions::default(), None);
        assert!(said(&[25.0]).contains("none of them was validated before it ended"), "{}", said(&[25.0]));
        let better = said(&[25.0, 27.0]);
        assert!(better.contains("had more prefixes that lose quality, or were too large"), "{better}");
        assert!(said(&[25.0, 24.0]).contains("none of them was better where packets are lost"));
    }

    #[test]
    fn a_size_that_is_missed_and_a_psnr_that_is_not_measured_are_said() {
        let sized = record(Some(900), &[25.0]);
        assert_eq!(missed(Some(Target::Bytes(900)), &sized, 900), None);
        let words = missed(Some(Target::Bytes(900)), &sized, 901).unwrap();
        assert!(words.contains("takes 901 bytes on the wire, and 900 were asked for"), "{words}");
        assert!(missed(Some(Target::PsnrDb(40.0)), &record(None, &[25.0]), 901).is_some());
        assert_eq!(missed(None, &record(None, &[25.0]), 901), None);
    }
}
