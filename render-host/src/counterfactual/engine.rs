//! An engine holds what all states of one scene share, seen by one camera, beside one reference image.

use super::{
    error::CounterfactualError,
    shared_lists::SharedLists,
    squares::{Planes, cut},
    states::States,
    variants::Variants,
};
use crate::{
    Camera, Settings,
    image::{Image, same_size},
    stage::Splat,
};

/// What all worlds share. Every answer is the same for any number of threads.
///
/// ```
/// use render_host::{Camera, Gaussian, Settings, Splats, render};
/// use render_host::counterfactual::{Engine, States, Variants};
///
/// let ball = |x: f32| {
///     Gaussian { position: [x, 0.0, 0.0], scale: [0.3; 3], opacity: 0.9, ..Gaussian::ABSENT }
/// };
/// let gaussians = [ball(-0.5), ball(0.5)];
/// let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.8, 64, 48)?;
/// let settings = Settings::default();
/// let whole = render(&Splats::plain(&gaussians), &camera, &settings)?.image;
///
/// // Each ball is a group; what is the error without the second one?
/// let variants = Variants::new(Splats::plain(&gaussians), &[0, 1], 2)?;
/// let engine = Engine::new(&variants, &camera, &whole, &settings)?;
/// let mut states = States::full(2);
/// states.push(|group| group == 0);
/// let errors = engine.strict(&states)?;
/// assert!(errors[0] == 0.0 && errors[1] > 1.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Engine {
    pub(super) shared: SharedLists,
    pub(super) reference: Vec<Planes>,
    /// The reference image as it was given.
    pub(super) against: Image,
    pub(super) settings: Settings,
    pub(super) camera: Camera,
    /// Number of groups.
    pub(super) groups: usize,
    /// The same scene, darker, for squares that leave f32.
    pub(super) scaled_down: Option<Box<ScaledDown>>,
}

impl Engine {
    /// Projects, orders and bins all variants as `camera` sees them. Errors are measured against
    /// `reference`, as sums of squares over all channels of all pixels (data range 1, values not clamped).
    ///
    /// # Errors
    /// A setting out of range, or a reference of another size than the camera.
    pub fn new(
        variants: &Variants,
        camera: &Camera,
        reference: &Image,
        settings: &Settings,
    ) -> Result<Self, CounterfactualError> {
        settings.validate_for_one_tile_side()?;
        let mut blank = Image::default();
        blank.reset(camera.width(), camera.height())?;
        same_size(&blank, reference)?;
        let shared = SharedLists::new(variants, camera, settings);
        let (reference, against) = (cut(reference, settings.parallel), reference.clone());
        let (settings, camera, groups) = (settings.clone(), camera.clone(), variants.count());
        let scaled_down = ScaledDown::new(&shared, &reference, &settings, &camera, groups);
        Ok(Self { shared, reference, against, settings, camera, groups, scaled_down })
    }

    /// Number of groups.
    pub fn groups(&self) -> usize {
        self.groups
    }

    pub(super) fn check(&self, states: &States) -> Result<(), CounterfactualError> {
        let (found, needed) = (states.groups(), self.groups);
        if found == needed { Ok(()) } else { Err(CounterfactualError::States { found, needed }) }
    }
}

/// One finite weight per world.
pub(super) fn check_weights(states: &States, weights: &[f64]) -> Result<(), CounterfactualError> {
    let needed = states.len();
    let good = weights.len() == needed && weights.iter().all(|w| w.is_finite());
    if good { Ok(()) } else { Err(CounterfactualError::Weights { needed }) }
}

/// Brightest colour that is squared in f32 as it is: of its square, f32 holds a tile's sum many times over.
const BRIGHTEST: f32 = (1u64 << 40) as f32;

/// The engine of the same scene, scaled down in brightness.
#[derive(Debug)]
pub(super) struct ScaledDown {
    pub(super) engine: Engine,
    /// Squares of the scene over squares of the darker one.
    pub(super) gain: f64,
}

impl ScaledDown {
    /// The darker scene, if this one is too bright.
    fn new(
        shared: &SharedLists,
        reference: &[Planes],
        settings: &Settings,
        camera: &Camera,
        groups: usize,
    ) -> Option<Box<Self>> {
        let mut brightest = 0.0f32;
        for Splat { colour: [r, g, b], .. } in &shared.projected.splats {
            brightest = brightest.max(r.max(*g).max(*b));
        }
        if brightest <= BRIGHTEST {
            return None;
        }
        let factor = f32::powi(0.5, (brightest / BRIGHTEST).log2().ceil() as i32);
        let mut shared = shared.clone();
        shared.projected.splats.iter_mut().for_each(|splat| splat.colour = splat.colour.map(|c| c * factor));
        let mut reference = reference.to_vec();
        let values = reference.as_flattened_mut().as_flattened_mut().as_flattened_mut();
        values.iter_mut().for_each(|v| *v *= factor);
        let settings = Settings { background: settings.background.map(|c| c * factor), ..settings.clone() };
        let gain = f64::from(factor).powi(-2);
        Some(Box::new(Self {
            engine: Engine {
                shared,
                reference,
                against: Image::default(),
                settings,
                camera: camera.clone(),
                groups,
                scaled_down: None,
            },
            gain,
        }))
    }
}
