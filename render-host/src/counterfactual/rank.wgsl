// Turns the order of depth around: the place of every splat drawn, from 1. Threads: one per Gaussian.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> counts: array<u32, 16>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
// 0 before, and after for those that were skipped.
@group(0) @binding(3) var<storage, read_write> ranks: array<u32>;

@compute @workgroup_size(256)
fn rank(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) count: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let i = (id.x + id.y * count.x) * WORKGROUP + thread;
    if i < min(counts[COUNT_DRAWN], frame.gaussians) {
        ranks[order[i]] = i + 1u;
    }
}
