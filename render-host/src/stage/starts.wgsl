// Finds where every tile's list starts in the sorted entries; one start more than there are tiles.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read_write> counts: array<atomic<u32>, 16>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read_write> starts: array<u32>;

// First entry whose tile is at least `tile`.
fn first_of(tile: u32, n: u32) -> u32 {
    var low = 0u;
    var high = n;
    while low < high {
        let middle = low + (high - low) / 2u;
        if keys[middle] < tile {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

@compute @workgroup_size(256)
fn find_starts(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) grid: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let tile = (id.x + id.y * grid.x) * WORKGROUP + thread;
    let tiles = frame.size.z * frame.size.w;
    if tile > tiles {
        return;
    }
    let n = atomicLoad(&counts[COUNT_ENTRIES]);
    let start = first_of(tile, n);
    starts[tile] = start;
    if tile < tiles && start < n && keys[min(start, n - 1u)] == tile {
        atomicAdd(&counts[COUNT_TOUCHED], 1u);
    }
}
