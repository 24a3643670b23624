//! Measures the wgpu backend: time on the device beside the error against f64, many worlds in one call.
//!
//! Needs only the binary and a Vulkan driver. `DGS_GPU` names the adapter; an adapter that is a CPU gets
//! smaller worlds. Every part is one function over a [`Context`].

mod context;
mod forward;
mod gradients;
mod peer;
mod worlds;

use anyhow::Result;
use render_host::gpu::{Device, DeviceOptions, Executor, GpuError};

use self::context::Context;
use crate::{figures::Bench, setup::Setup};

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let mut bench = Bench::new(
        "gpu",
        "random Gaussians in [-1,1]^3, SH 0, focal length 0.9 W, distance 3.2, default settings. forward: \
         medians of 7 (quick: 3) interleaved frames; stage times by device timestamps, wall from \
         submission to completion, stream per frame of a train without waiting between (not on a CPU \
         adapter); error max: pixels away from any threshold, against the f64 reference; peer: crate \
         wgpu-3dgs-viewer (feature gpu-peer) with an 8-bit picture, interleaved on the same device. \
         worlds: three repetitions after five warm-ups, mean and Student-t 95 % interval; serial draws \
         every world alone; error: bits of a world in the batch that differ from the world drawn alone. \
         gradients: scene A (64 cells) and B (64 shells), 128 groups, every step from \
         the camera to sums on the device in one submission, steps in a train without waiting; peers with \
         their set-up; gradients: of squared error, and (mse+ssim) of squared error + (1 - SSIM)",
    );
    let device = match Device::open(&DeviceOptions::from_env()) {
        Ok(device) => device,
        Err(error @ GpuError::NoAdapter { .. }) => {
            bench.skipped.push(error.to_string());
            return Ok(bench);
        }
        Err(error) => return Err(error.into()),
    };
    let facts = device.facts();
    bench.machine.device = Some(format!("{} ({}, {})", facts.name, facts.api, facts.driver));
    let context = Context { quick: setup.quick, is_cpu: facts.is_cpu, executor: Executor::new(&device) };
    forward::run(&context, &mut bench)?;
    worlds::run(&context, &mut bench)?;
    gradients::run(&context, &mut bench)?;
    Ok(bench)
}
