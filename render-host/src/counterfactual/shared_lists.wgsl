// Finds for each entry of each tile's list the blocks that it touches; for each block the set of its groups
// and their ranks. Put after states.wgsl. Workgroups: columns, rows.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> batch: Batch;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
// Tile `t` is `list[starts[t]..starts[t + 1]]`, nearest first.
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read> list: array<u32>;
@group(0) @binding(5) var<storage, read_write> entries: array<Entry>;
// Per tile and block: `words` words of the set, then the number of members before each word.
@group(0) @binding(6) var<storage, read_write> sets: array<atomic<u32>>;

// A bit per block that holds a pixel centre within reach: pixel by pixel where `blocks_of` takes bounds of u
// and v apart, for what is walked once per batch of worlds. `u` and `v` are those of the pixels bit for bit.
fn exact_blocks(splat: Splat, corner: vec2<u32>) -> u32 {
    let origin = axes(splat, corner);
    let reach = splat.log2_alpha - frame.log2_cutoff + 2.0 * REACH_MARGIN;
    var blocks = 0u;
    for (var y = 0u; y < TILE; y++) {
        let u = fma(splat.root.y, f32(y), origin.x);
        let v = fma(splat.root.z, f32(y), origin.y);
        for (var half = 0u; half < 2u; half++) {
            let left = fma(splat.root.x, f32(8u * half), u);
            let right = fma(splat.root.x, f32(8u * half + 7u), u);
            // Distance of the eight centres from the splat's axis; 0 when they straddle it.
            let gap = max(max(left, -right), 0.0);
            if fma(gap, gap, v * v) <= reach {
                blocks |= 1u << (2u * (y >> 2u) + half);
            }
        }
    }
    return blocks;
}

@compute @workgroup_size(256)
fn shared_lists(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let tile = id.y * frame.size.z + id.x;
    let stride = 2u * batch.words;
    let first = tile * BLOCKS * stride;
    for (var i = thread; i < BLOCKS * stride; i += PIXELS) {
        atomicStore(&sets[first + i], 0u);
    }
    storageBarrier();
    for (var at = starts[tile] + thread; at < starts[tile + 1u]; at += PIXELS) {
        let index = list[at];
        let splat = splats[index];
        let group = splat.group;
        var blocks = 0u;
        if group < batch.groups {
            blocks = exact_blocks(splat, TILE * id.xy);
        }
        entries[at] = Entry(index, blocks);
        for (var block = 0u; block < BLOCKS; block++) {
            if ((blocks >> block) & 1u) == 1u {
                atomicOr(&sets[first + block * stride + (group >> 5u)], 1u << (group & 31u));
            }
        }
    }
    storageBarrier();
    if thread < BLOCKS {
        let row = first + thread * stride;
        var before = 0u;
        for (var word = 0u; word < batch.words; word++) {
            atomicStore(&sets[row + batch.words + word], before);
            before += countOneBits(atomicLoad(&sets[row + word]));
        }
    }
}
