// Stage 4: every pixel of a tile takes its list of splats, nearest first: `C += T·a·c; T -= T·a`, until T
// is below the stop (inclusive). A workgroup is a tile, a thread a pixel; splats pass through workgroup
// memory in batches, already turned to the tile's own coordinates.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> entries: array<u32>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read_write> counts: array<atomic<u32>, 16>;
// r, g, b without background and transmittance, row by row.
@group(0) @binding(5) var<storage, read_write> image: array<vec4<f32>>;

const BATCH: u32 = 256u;

// u and v at the tile's first pixel, log2 of alpha, first of the factor.
var<workgroup> near: array<vec4<f32>, 256>;
// The rest of the factor, red, green.
var<workgroup> shape: array<vec4<f32>, 256>;
var<workgroup> blue: array<f32, 256>;
// Blocks of pixels that the splat may reach.
var<workgroup> blocks: array<u32, 256>;
// The same seen from the blocks: eight words each, a bit per splat.
var<workgroup> reaching: array<u32, 64>;
var<workgroup> open: atomic<u32>;
var<workgroup> still_open: u32;

// Word `word` of `reaching`.
fn turned(word: u32) -> u32 {
    let block = word / 8u;
    let first = (word % 8u) * 32u;
    var bits = 0u;
    for (var i = 0u; i < 32u; i++) {
        // Threads begin at different places, so that they do not wait for one bank of memory.
        let k = (i + word) % 32u;
        bits |= ((blocks[first + k] >> block) & 1u) << k;
    }
    return bits;
}

@compute @workgroup_size(256)
fn blend(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let corner = id.xy * TILE;
    let local = pixel_of(thread);
    let pixel = corner + local;
    let inside = all(pixel < frame.size.xy);
    let tile = id.y * frame.size.z + id.x;
    let first = starts[tile];
    let past = starts[tile + 1u];
    let at = vec2<f32>(local);
    let my_words = thread / 32u * 8u;
    let stop = frame.stop;
    let cutoff = frame.cutoff;
    let log2_cutoff = frame.log2_cutoff;
    let alpha_max = frame.alpha_max;

    var sum = vec3<f32>(0.0);
    var t = select(0.0, 1.0, inside);
    if thread == 0u {
        atomicStore(&open, 0u);
    }
    for (var batch = first; batch < past; batch += BATCH) {
        workgroupBarrier();
        if t >= stop && inside {
            atomicStore(&open, 1u);
        }
        let n = min(BATCH, past - batch);
        var reached = 0u;
        if thread < n {
            let s = splats[entries[batch + thread]];
            let here = vec3<f32>(axes(s, corner), s.log2_alpha);
            reached = blocks_of(here, s.root, log2_cutoff);
            near[thread] = vec4<f32>(here, s.root.x);
            shape[thread] = vec4<f32>(s.root.yz, s.colour.xy);
            blue[thread] = s.colour.z;
        }
        blocks[thread] = reached;
        workgroupBarrier();
        if thread == 0u {
            still_open = atomicExchange(&open, 0u);
        }
        if thread < 64u {
            reaching[thread] = turned(thread);
        }
        if workgroupUniformLoad(&still_open) == 0u {
            break;
        }
        if inside && t >= stop {
            let words = (n + 31u) / 32u;
            for (var word = 0u; word < words; word++) {
                // Only the splats that reach the block of this thread, which its neighbours share.
                var left = reaching[my_words + word];
                while left != 0u {
                    let k = word * 32u + firstTrailingBit(left);
                    left &= left - 1u;
                    let a = near[k];
                    let b = shape[k];
                    let log2 = log2_alpha_in_tile(a.xyz, vec3<f32>(a.w, b.xy), at);
                    // Below the cut-off by more than rounding: nothing to add.
                    if log2 < log2_cutoff - REACH_MARGIN {
                        continue;
                    }
                    let alpha = alpha_of(log2, cutoff, alpha_max);
                    sum = fma(vec3<f32>(alpha * t), vec3<f32>(b.zw, blue[k]), sum);
                    t = fma(-alpha, t, t);
                    if t < stop {
                        word = words;
                        break;
                    }
                }
            }
        }
    }
    if inside {
        image[pixel.y * frame.size.x + pixel.x] = vec4<f32>(sum, t);
    }
    // Pixels that finished early, counted once per tile.
    workgroupBarrier();
    if thread == 0u {
        atomicStore(&open, 0u);
    }
    workgroupBarrier();
    if inside && t < stop {
        atomicAdd(&open, 1u);
    }
    workgroupBarrier();
    if thread == 0u {
        atomicAdd(&counts[COUNT_STOPPED], atomicLoad(&open));
    }
}
