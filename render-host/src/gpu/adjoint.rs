//! Gradients of many worlds on the device.

use super::states::STATES;
use super::wgsl::{Bind, LAYOUT, Source, TILE};

/// Adjoint of stage 4, and the loss.
pub const BLEND_BACK: Source = Source {
    name: "adjoint/blend.wgsl",
    parts: &[LAYOUT, TILE, STATES, include_str!("../adjoint/blend.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("batch", Bind::Uniform),
        ("splats", Bind::Read),
        ("starts", Bind::Read),
        ("entries", Bind::Read),
        ("masks", Bind::Read),
        ("wanted", Bind::Read),
        ("partials", Bind::Write),
        ("marks", Bind::Write),
        ("found", Bind::Write),
    ],
};

/// Adjoint of stage 1.
pub const PROJECT_BACK: Source = Source {
    name: "adjoint/project.wgsl",
    parts: &[LAYOUT, TILE, STATES, include_str!("../adjoint/project.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("gaussians", Bind::Read),
        ("harmonics", Bind::Read),
        ("splats", Bind::Read),
        ("keys", Bind::Read),
        ("starts", Bind::Read),
        ("entries", Bind::Read),
        ("partials", Bind::Read),
        ("gradients", Bind::Write),
    ],
};
