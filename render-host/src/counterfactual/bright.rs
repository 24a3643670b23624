//! Scales scenes down that are so bright that squares of their colours leave f32.
//!
//! The fast modes square in f32. Where a colour is above 2⁴⁰ they are asked about the same scene at a power
//! of two of its brightness as well, and what overflowed is taken from that answer, scaled back in f64: it
//! is a square of about the brightest, which the darker scene holds to the last bit. Any other scene is
//! asked about once.

use super::{Engine, Utilities, scaffold::SharedLists, squares::Planes};
use crate::{Camera, Settings, stage::Splat};

/// Brightest colour that is squared in f32 as it is: of its square, f32 holds a tile's sum many times over.
const BRIGHTEST: f32 = (1u64 << 40) as f32;

/// The engine of the same scene, scaled down in brightness.
#[derive(Debug)]
pub(super) struct ScaledDown {
    engine: Engine,
    /// Squares of the scene over squares of the darker one.
    gain: f64,
}

impl ScaledDown {
    /// The darker scene, if this one is too bright.
    pub(super) fn new(
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
                against: crate::Image::default(),
                settings,
                camera: camera.clone(),
                groups,
                scaled_down: None,
            },
            gain,
        }))
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> u64 {
        self.engine.shared.bytes() + size_of_val(self.engine.reference.as_slice()) as u64
    }
}

/// An answer made of squares.
pub(super) trait Squared {
    /// Takes what is not finite from `other`, times `gain`.
    fn mend(&mut self, other: Self, gain: f64);
}

impl Squared for f64 {
    fn mend(&mut self, other: Self, gain: f64) {
        if !self.is_finite() {
            *self = other * gain;
        }
    }
}

impl Squared for Vec<f64> {
    fn mend(&mut self, other: Self, gain: f64) {
        self.iter_mut().zip(other).for_each(|(value, other)| value.mend(other, gain));
    }
}

impl Squared for Utilities {
    fn mend(&mut self, other: Self, gain: f64) {
        self.sse.mend(other.sse, gain);
        self.delta.mend(other.delta, gain);
    }
}

impl Engine {
    /// Asks a fast mode, and the darker scene, if there is one, about what overflows.
    pub(super) fn ask<T: Squared>(&self, mode: impl Fn(&Self) -> T) -> T {
        let mut answer = mode(self);
        if let Some(scaled_down) = &self.scaled_down {
            answer.mend(mode(&scaled_down.engine), scaled_down.gain);
        }
        answer
    }
}
