//! Renders Gaussians: a scene and a camera go in, images and numbers about images come out.
//!
//! ```text
//! Splats + Camera ─▶ stage::{project, sort, bin, blend} ─▶ Rendered { image, transmittance, counters }
//! … on a device   ─▶ Backend (CPU or gpu)               ─▶ the same
//! … frame after frame ─▶ Sequence                     ─▶ the same, from what the frame before left
//! … + loss        ─▶ adjoint                            ─▶ Gradients { loss, splats, pose, … }
//! Variants + States ─▶ counterfactual::Engine ─▶ distortion of every state, utility of every group
//! Image × Image   ─▶ metric::{psnr, ssim, flip, flicker, distortion, heat}
//! ```
//!
//! [`render`](mod@render) is the tile renderer; [`mod@reference`] is the slow, obvious f64 renderer that
//! judges it. Both read the same [`Settings`], in which every tolerance and every skip has a name. With
//! feature `gpu` (on by default) the same stages run on a graphics device, many worlds at once.
//!
//! Glossary. *Camera axes*: x right, y down, z forward (OpenCV). *Pixel* `(x, y)` has its centre at
//! `(x + 0.5, y + 0.5)`; row 0 is at the top. *Transmittance*: the share of the background that still
//! shows, 1 where nothing was drawn. *World*: one delivery state of a scene; worlds of one call share a
//! camera and settings.
//!
//! Examples: `cargo run -p render-host --example counterfactuals` (what each level of each cluster adds) and
//! `--example gradients` (a Gaussian that moves towards a picture).
//!
//! Deliberately absent: files of splats (trainer-host reads them), packets (codec-core), clocks.

pub mod adjoint;
pub mod animation;
pub mod backend;
pub mod camera;
pub mod counterfactual;
pub mod counters;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod harmonics;
pub mod image;
pub mod image_file;
pub mod metric;
mod parallel;
pub mod reference;
pub mod render;
pub mod sequence;
pub mod settings;
pub mod splats;
pub mod stage;
mod transparent;

pub use codec_core::{Footprint, Gaussian, ShDegree};

pub use adjoint::{Gradients, Loss, Workspace, render_and_gradients};
pub use backend::{Backend, BackendError, DeviceChoice, Differentiator, FrameRenderer};
pub use camera::{Camera, CameraError, Intrinsics, View};
pub use counters::Counters;
pub use image::{Image, ImageError};
pub use render::{RenderError, Rendered, Renderer, render, render_many};
pub use sequence::{ReuseCounts, ReuseOptions, SequenceRenderer};
pub use settings::{Settings, SettingsError};
pub use splats::{Splats, SplatsError};

/// Compiles the examples of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
