//! Makes a study of a scene that was trained from photographs, tested on photographs.

use std::path::Path;

use anyhow::Result;
use render_host::{Backend, Image, Settings};
use trainer_host::{
    Scene,
    encode::{self, EncodeOptions},
    evaluator,
    train::{self, Dataset, PosedPhotograph, TrainOptions, Trainer, Views, delivery::Reference},
};

use super::{Size, Study};

/// Side of the photographs, pixels.
const SIDE: u32 = 200;
/// Steps of the training.
const STEPS: u32 = 4000;
/// Most Gaussians while it is trained.
const GAUSSIANS: usize = 10_000;
const WHITE: [f32; 3] = [1.0; 3];
/// Photographs to fine-tune towards, and to test on.
const TRAINING: usize = 48;
const TEST: usize = 10;

impl Study {
    /// The scene of the dataset at `path`, trained here, with packets and blocks as by default.
    ///
    /// # Errors
    /// What the dataset, the training or the encoder refuses.
    pub(in crate::experiment) fn of_photographs(path: &Path, size: Size) -> Result<Self> {
        let (dataset, scene) = trained(path)?;
        let training = references(&scene, &dataset.train.sample(TRAINING))?;
        let test = references(&scene, &dataset.test.sample(TEST))?;
        let following = test.iter().map(|reference| next(&scene, reference)).collect::<Result<_>>()?;
        let coding = EncodeOptions::default();
        let encoded = encode::encode(&scene, &coding, &trainer_host::encode::no_progress)?;
        let size = Size { gaussians: scene.max_count(), frames: scene.frames(), side: SIDE, ..size };
        Ok(Self { scene, training, test, following, encoded, coding, size })
    }

    /// As a protocol says it.
    pub(in crate::experiment) fn photographs_in_words(&self, name: &str) -> String {
        format!(
            "{name} trained from its photographs at {SIDE}x{SIDE} in {STEPS} steps, {} Gaussians over {} \
             frames, {} packets of at most {} bytes, fine-tuned towards {TRAINING} training photographs, \
             tested on {TEST} test photographs, white background, {} updates of {} worlds",
            self.size.gaussians,
            self.size.frames,
            self.encoded.stream.packets().len(),
            self.coding.packet_bytes,
            self.size.updates,
            self.size.worlds
        )
    }
}

/// The dataset at `path`, and the scene that a short training makes of it.
///
/// # Errors
/// What the dataset or the training refuses.
pub(in crate::experiment) fn trained(path: &Path) -> Result<(Dataset, Scene)> {
    let dataset = train::dataset::read(path)?;
    let options = TrainOptions {
        max_side: SIDE,
        background: WHITE,
        max_gaussians: GAUSSIANS,
        ..TrainOptions::default()
    };
    let mut trainer = Trainer::new(&dataset, &options)?;
    while trainer.steps() < STEPS {
        trainer.step(f64::from(trainer.steps()) / f64::from(STEPS))?;
    }
    let scene = trainer.model().scene(dataset.frames, 30.0)?;
    Ok((dataset, scene))
}

/// What would be seen a frame after `reference`: it, and what changes there in renders of `scene`, since no
/// photograph was taken then.
fn next(scene: &Scene, reference: &Reference) -> Result<Option<Image>> {
    let Reference { frame, camera, background, picture } = reference;
    if *frame as usize + 1 >= scene.frames() {
        return Ok(None);
    }
    let settings = Settings::over(*background);
    let renders = evaluator::references(scene, &[*frame, frame + 1], camera, &settings, &Backend::Cpu)?;
    let changes = renders[1].rgb().iter().zip(renders[0].rgb()).map(|(after, before)| after - before);
    let values = picture.rgb().iter().zip(changes).map(|(value, change)| value + change).collect();
    Ok(Some(Image::new(picture.width(), picture.height(), values)?))
}

/// Photographs as pictures of frames of `scene` over white.
fn references<Split>(scene: &Scene, views: &Views<Split>) -> Result<Vec<Reference>> {
    let last = scene.frames().saturating_sub(1) as f64;
    let reference = |view: &PosedPhotograph| {
        let picture = view.photograph.over(WHITE).resized_box(SIDE, SIDE)?;
        let camera = view.camera.resized(SIDE, SIDE)?;
        let frame = (f64::from(view.time) * last).round() as u32;
        Ok(Reference { frame, camera, background: WHITE, picture })
    };
    views.photographs().iter().map(reference).collect()
}
