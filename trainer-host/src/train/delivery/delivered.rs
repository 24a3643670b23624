//! Shows what states leave of a scene: the pictures that receivers see.

use render_host::{Camera, Image, Settings};

use super::{
    coded::{Coded, no_change},
    error::DeliveryError,
    masks::{Masks, Sampler},
    parameters::Parameters,
    shared_worlds::SharedWorlds,
};
use crate::{encode::Decisions, scene::Scene, stream::Stream};

/// A scene as it is sent, ready to be shown in any state.
pub struct DeliveredScene<'a> {
    scene: &'a Scene,
    parameters: Parameters,
    coded: Coded,
    complete: Vec<u8>,
}

impl<'a> DeliveredScene<'a> {
    /// Writes `scene` by `decisions`.
    ///
    /// # Errors
    /// Decisions that do not fit the scene.
    pub fn new(scene: &'a Scene, decisions: &Decisions) -> Result<Self, DeliveryError> {
        let parameters = no_change(scene);
        let coded = Coded::rewrite(scene, &parameters, decisions)?;
        let sampler = Sampler::new(&coded.encoded.stream, super::config::LossUnit::Packet)?;
        let complete = sampler.complete().to_vec();
        Ok(Self { scene, parameters, coded, complete })
    }

    /// The one state in which everything has arrived.
    pub fn complete(&self) -> Masks {
        Masks { states: vec![self.complete.clone()] }
    }

    /// As it is sent.
    pub fn stream(&self) -> &Stream {
        &self.coded.encoded.stream
    }

    /// What each of `states` shows at `frame` from `camera` over `background`, display values of 0..=1.
    ///
    /// # Errors
    /// States of another stream, a frame past the end, or what the renderer refuses.
    pub fn pictures(
        &self,
        states: &Masks,
        frame: u32,
        camera: &Camera,
        background: [f32; 3],
    ) -> Result<Vec<Image>, DeliveryError> {
        states.check(self.complete.len())?;
        let footprint = self.coded.encoded.stream.manifest()?.footprint();
        let settings = Settings { parallel: true, ..Settings::over(background) }.with_footprint(footprint);
        let moving = self.coded.moving(self.scene, &self.parameters);
        let shared = SharedWorlds::new(&moving, frame, &states.states)?;
        shared.measured(camera, &settings, |image| {
            let values = image.rgb().iter().map(|value| value.clamp(0.0, 1.0)).collect();
            Ok(Image::new(image.width(), image.height(), values)?)
        })
    }
}

#[cfg(test)]
mod tests {
    use render_host::metric;

    use super::*;
    use crate::{
        encode,
        train::delivery::{LossModel, LossUnit, evaluate, view::tests::study},
    };

    #[test]
    fn pictures_of_states_are_those_that_are_evaluated() {
        let (scene, references) = study(3, 1);
        let options =
            encode::EncodeOptions { packet_bytes: 300, block_len: 16, pictures: 0, ..Default::default() };
        let encoded = encode::encode(&scene, &options, &crate::encode::no_progress).unwrap();
        let loss = LossModel::Iid { probability: 0.2 };
        let masks = Masks::draw(&encoded.stream, loss, LossUnit::Packet, 5, 3).unwrap();
        let reference = &references[1];
        let found = evaluate(&scene, &encoded.decisions, &masks, &references[1..2]).unwrap();
        let delivered = DeliveredScene::new(&scene, &encoded.decisions).unwrap();
        let shown = |states: &Masks| {
            let (frame, camera, background) = (reference.frame, &reference.camera, reference.background);
            delivered.pictures(states, frame, camera, background)
        };
        let psnr = |image: &Image| metric::psnr(image, &reference.picture).unwrap();
        for (image, expected) in shown(&masks).unwrap().iter().zip(&found.worlds_db) {
            // What is beyond 1 is shown as 1, and is evaluated as it is.
            assert!((psnr(image) - expected).abs() < 0.05, "{} {expected}", psnr(image));
        }
        let complete = shown(&delivered.complete()).unwrap();
        assert!((psnr(&complete[0]) - found.clean_db).abs() < 0.05);
        assert!(found.worlds_db.iter().any(|db| (db - found.clean_db).abs() > 0.5), "or this says nothing");
        let other = Masks { states: vec![vec![0; 3]] };
        assert!(shown(&other).unwrap_err().to_string().contains("3 blocks"));
        let late = delivered.pictures(&masks, 9, &reference.camera, [0.0; 3]);
        assert!(late.is_err(), "there is no frame 9");
    }
}
