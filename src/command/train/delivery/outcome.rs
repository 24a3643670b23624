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

/// Where the stream of so many `bytes` on the wire is not what `options` ask for, or that is not measured.
pub(super) fn missed(options: &DeliveryOptions, gaussians: usize, bytes: u64) -> Option<String> {
    let (name, most) = match options.encode.target? {
        Target::Bytes(most) => ("--target-bytes", most),
        Target::BitsPerGaussian(bits) => {
            ("--target-bits-per-gaussian", (bits * gaussians as f64 / 8.0) as u64)
        }
        Target::PsnrDb(_) => {
            return Some(
                "--target-psnr: is what the scene is encoded at before the first update; how close it is \
                 after the last is not measured so"
                    .to_owned(),
            );
        }
    };
    (bytes > most).then(|| {
        format!(
            "{name}: allows {most} bytes, and fine-tuned for delivery the scene takes {bytes}: steps that \
             are learnt (learn_steps) and candidates (validation.candidates) keep to it"
        )
    })
}
