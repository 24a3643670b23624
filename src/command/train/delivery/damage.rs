//! Shows what lost packets leave of a scene, as it was given and fine-tuned.

use anyhow::Result;
use render_host::{Image, metric};
use trainer_host::{
    Scene,
    train::delivery::{DeliveredScene, FineTuned, LossModel, LossUnit, Masks, Reference},
};

use crate::command::train::page::small;

/// What is lost, and how a person says it.
const LOSSES: [(&str, LossModel); 4] = [
    ("5 % of the packets lost", LossModel::Iid { probability: 0.05 }),
    ("10 % lost", LossModel::Iid { probability: 0.10 }),
    ("20 % lost", LossModel::Iid { probability: 0.20 }),
    ("10 % lost in bursts of six", LossModel::Burst { share: 0.10, length: 6.0 }),
];
/// States that each loss is drawn for, and their seed.
pub(super) const STATES: usize = 16;
const SEED: u64 = 1;

/// One view in some states, before fine-tuning and after.
pub(super) struct Damage {
    /// Column by column a state; from above: what should be seen, the scene as it was given, fine-tuned.
    pub(super) pictures: Image,
    /// Of each column, what was lost, and PSNR before and after, dB.
    pub(super) columns: Vec<(&'static str, [f64; 2])>,
}

impl Damage {
    /// `scene` and what it was `tuned` to in the view of `reference`: complete, and after each loss in the
    /// state whose PSNR before is the median.
    ///
    /// # Errors
    /// What the renderer refuses.
    pub(super) fn of(scene: &Scene, tuned: &FineTuned, reference: &Reference) -> Result<Self> {
        let before = DeliveredScene::new(scene, &tuned.given)?;
        let after = DeliveredScene::new(&tuned.scene, &tuned.decisions)?;
        let Reference { frame, camera, background, picture } = reference;
        let mut states = vec![("all packets there", before.complete())];
        for (words, loss) in LOSSES {
            let mut drawn = Masks::draw(before.stream(), loss, LossUnit::Packet, STATES, SEED)?;
            let images = before.pictures(&drawn, *frame, camera, *background)?;
            let psnr: Vec<f64> =
                images.iter().map(|image| metric::psnr(image, picture)).collect::<Result<_, _>>()?;
            states.push((words, Masks { states: vec![drawn.states.swap_remove(median(&psnr))] }));
        }
        let mut rows: [Vec<Image>; 3] = Default::default();
        let mut columns = Vec::new();
        for (words, state) in states {
            let images = [
                before.pictures(&state, *frame, camera, *background)?,
                after.pictures(&state, *frame, camera, *background)?,
            ];
            let mut psnr = [0.0; 2];
            rows[0].push(small(picture)?);
            for ((image, db), row) in images.iter().flatten().zip(&mut psnr).zip(&mut rows[1..]) {
                *db = metric::psnr(image, picture)?;
                row.push(small(image)?);
            }
            columns.push((words, psnr));
        }
        let all: Vec<&Image> = rows.iter().flatten().collect();
        Ok(Self { pictures: Image::strip(&all, columns.len(), 4)?, columns })
    }
}

/// Index of the median of `values`, the upper one of two; of none, 0.
fn median(values: &[f64]) -> usize {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]).then(a.cmp(&b)));
    order.get(values.len() / 2).copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_are_of_values_and_not_of_places() {
        assert_eq!(median(&[30.0, 10.0, 20.0]), 2);
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), 3);
        assert_eq!(median(&[]), 0);
    }
}
