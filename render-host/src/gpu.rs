//! The wgpu backend runs the stages of [`crate::stage`] as compute shaders, `stage/NAME.wgsl` beside
//! `stage/NAME.rs`.
//!
//! ```text
//! Device ─▶ Scene (uploaded once) ─▶ Renderer::draw (camera in, nothing read back) ─▶ Renderer::read
//!        └▶ Scene + Stages (camera in) ─▶ adjoint::Engine: losses of worlds, gradients summed over them
//! ```
//!
//! All of them write a [`Recording`]: which kernels run on which buffers in how many workgroups. One
//! [`Executor`] compiles kernels, binds buffers and submits.
//!
//! Counts stay on the device: what one stage finds sizes the next through indirect dispatch. The host
//! reads only when asked for a picture; there it also learns whether the tile lists outgrew their buffer,
//! makes room and draws again. No float is summed through atomics, so a picture is the same bit for bit
//! from run to run, and a world drawn in a batch is the world drawn alone.
//!
//! Geometry that f64 serves on the CPU is done here in pairs of f32 (value and remainder): camera
//! coordinates, depth keys and centres. What follows is f32, as in the CPU's blend.
//!
//! The WGSL stays within base WebGPU: 8 storage buffers per stage, 16 KiB of workgroup memory, 65535
//! workgroups per dimension, no subgroups. [`shaders`] lists every shader with its bindings, and a test
//! checks structs, constants and bindings against Rust without a device.

pub mod adjoint;
mod buffers;
mod clock;
mod device;
mod error;
mod executor;
pub mod layout;
mod lists;
mod presence;
mod recording;
mod renderer;
mod scene;
pub mod shaders;
mod source;
mod states;
#[cfg(test)]
mod test_scene;
mod tiles;
mod vulkan;

use self::buffers::GrowableBuffer;
pub use clock::{Clock, StageTime};
pub use device::{Device, DeviceFacts, DeviceOptions};
pub use error::GpuError;
pub use executor::{BoundRecording, Executor};
pub use lists::Lists;
pub use presence::Presence;
pub use recording::{Recording, Workgroups};
pub use renderer::Renderer;
pub use scene::{Packed, Scene};
pub use source::{Bind, Kernel, Source};
pub use tiles::{Stages, Tiles};
/// The graphics library whose types appear here.
pub use wgpu::{self};
