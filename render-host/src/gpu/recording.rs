//! A recording lists the work of one submission: which kernels run, on which buffers, in how many workgroups.
//!
//! It is plain data. Making one asks nothing of the device; recordings can be joined, compared and run again.
//! [`super::Executor`] runs them.

use super::source::Kernel;

/// Workgroups along x at most; the rest goes to y. Below WebGPU's 65535.
const ROW: u32 = 32_768;

/// How many workgroups a kernel runs in.
#[derive(Clone, Debug, PartialEq)]
pub enum Workgroups {
    /// Along x, y and z.
    Counted([u32; 3]),
    /// As many as the device wrote to place `place` of `arguments` (see [`super::layout::ARGS_STRIDE`]).
    Indirect {
        /// Sizes of dispatches.
        arguments: wgpu::Buffer,
        /// Which of them.
        place: u64,
    },
}

impl Workgroups {
    /// `count` workgroups as two dimensions that WebGPU allows; a kernel numbers them as
    /// `id.x + id.y * count.x` and leaves those past the end.
    pub fn row(count: u32) -> Self {
        Self::Counted([count.min(ROW), count.div_ceil(ROW), 1])
    }
}

/// One kernel on its buffers.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Dispatch {
    pub(super) kernel: Kernel,
    /// In the order of the source's bindings.
    pub(super) buffers: Vec<wgpu::Buffer>,
    pub(super) workgroups: Workgroups,
}

/// Buffers that are set to zero, then kernels that run one after the other.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Pass {
    /// Name of the stage when it is timed.
    pub(super) stage: Option<&'static str>,
    pub(super) cleared: Vec<wgpu::Buffer>,
    pub(super) dispatches: Vec<Dispatch>,
}

/// The work of one submission, in order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    pub(super) passes: Vec<Pass>,
}

impl Recording {
    /// A recording without work.
    pub fn new() -> Self {
        Self::default()
    }

    /// What follows is timed as stage `name` where the device can.
    pub fn stage(&mut self, name: &'static str) {
        self.passes.push(Pass { stage: Some(name), ..Pass::default() });
    }

    /// Sets all of `buffer` to zero before what follows.
    pub fn clear(&mut self, buffer: &wgpu::Buffer) {
        if self.passes.last().is_none_or(|pass| !pass.dispatches.is_empty()) {
            self.passes.push(Pass::default());
        }
        self.last().cleared.push(buffer.clone());
    }

    /// Runs `kernel` on `buffers`, in the order of its bindings, in `workgroups` along x, y and z.
    pub fn dispatch(&mut self, kernel: Kernel, buffers: &[&wgpu::Buffer], workgroups: [u32; 3]) {
        self.dispatch_in(kernel, buffers, Workgroups::Counted(workgroups));
    }

    /// As [`Recording::dispatch`], in workgroups that are given in another way.
    pub fn dispatch_in(&mut self, kernel: Kernel, buffers: &[&wgpu::Buffer], workgroups: Workgroups) {
        let buffers = buffers.iter().map(|&buffer| buffer.clone()).collect();
        self.last().dispatches.push(Dispatch { kernel, buffers, workgroups });
    }

    fn last(&mut self) -> &mut Pass {
        if self.passes.is_empty() {
            self.passes.push(Pass::default());
        }
        let last = self.passes.len() - 1;
        &mut self.passes[last]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_dimensions_hold_all_workgroups_and_stay_below_the_limit() {
        for count in [0, 1, ROW, ROW + 1, 65_536, u32::MAX / 1024] {
            let Workgroups::Counted([x, y, z]) = Workgroups::row(count) else { panic!("counted") };
            assert!(x * y * z >= count && x <= 65_535 && (y <= 65_535 || count > ROW * 65_535), "{count}");
        }
    }
}
