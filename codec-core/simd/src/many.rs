//! Decodes many packets by the kernel that this machine has.

use crate::{
    bundle,
    job::{self, Job, Tables},
    kernel::Kernel,
};

/// Decodes `jobs` with `kernel`; with the scalar one if this machine lacks it.
pub fn decode_many_with(kernel: Kernel, tables: &Tables<'_>, jobs: &mut [Job<'_>]) {
    match kernel.vectors() {
        Some(vectors) => bundle::decode(vectors, tables, jobs),
        None => jobs.iter_mut().for_each(|job| job.result = job::decode(tables, job)),
    }
}
