//! Says in which domain scales and opacities are given.

use pyo3::prelude::*;
use trainer_host::{
    activation::sigmoid,
    scene::{LOG_SCALE_RANGE, OPACITY_LOGIT_LIMIT},
    stream::decoded,
};

use crate::error::refused;

/// The domain of scales and opacities.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Activation {
    /// Natural logarithms of scales and logits of opacities: what files and optimisers hold.
    Log,
    /// Standard deviations in scene units and opacities of 0 to 1: what renderers take.
    Linear,
}

impl Activation {
    /// The domain of that name.
    pub fn of(name: &str) -> PyResult<Self> {
        match name {
            "log" => Ok(Self::Log),
            "linear" => Ok(Self::Linear),
            other => Err(refused(format!("activation is {other:?}; \"log\" or \"linear\" are allowed"))),
        }
    }

    /// A scale for a renderer.
    pub fn to_linear_scale(self, scale: f32) -> f32 {
        if self == Self::Log { scale.clamp(LOG_SCALE_RANGE.0, LOG_SCALE_RANGE.1).exp() } else { scale }
    }

    /// An opacity for a renderer.
    pub fn to_linear_opacity(self, opacity: f32) -> f32 {
        if self == Self::Log { sigmoid(opacity) } else { opacity }
    }

    /// A scale of a scene.
    pub fn to_log_scale(self, scale: f32) -> f32 {
        if self == Self::Log { scale } else { scale.ln() }
    }

    /// An opacity of a scene.
    pub fn to_logit(self, opacity: f32) -> f32 {
        if self == Self::Log { opacity } else { decoded::logit(opacity) }
    }

    /// The logarithm of a scale of a scene in this domain.
    pub fn of_log_scale(self, log: f32) -> f32 {
        if self == Self::Log { log } else { log.exp() }
    }

    /// The logit of an opacity of a scene in this domain.
    pub fn of_logit(self, logit: f32) -> f32 {
        if self == Self::Log { logit } else { sigmoid(logit) }
    }

    /// A decoded scale in this domain.
    pub fn of_linear_scale(self, scale: f32) -> f32 {
        if self == Self::Linear { scale } else { scale.ln().clamp(LOG_SCALE_RANGE.0, LOG_SCALE_RANGE.1) }
    }

    /// A decoded opacity in this domain.
    pub fn of_linear_opacity(self, opacity: f32) -> f32 {
        if self == Self::Linear {
            opacity
        } else {
            decoded::logit(opacity).clamp(-OPACITY_LOGIT_LIMIT, OPACITY_LOGIT_LIMIT)
        }
    }
}
