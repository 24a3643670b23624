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

// u and v at the tile's first pixel, log2 of alpha; factor; colour.
var<workgroup> near: array<vec3<f32>, 256>;
var<workgroup> root: array<vec3<f32>, 256>;
var<workgroup> colour: array<vec3<f32>, 256>;
// Blocks of pixels that the splat may reach.
var<workgroup> blocks: array<u32, 256>;
var<workgroup> open: atomic<u32>;
var<workgroup> still_open: u32;

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
    let my_block = 1u << (thread / 32u);

    var sum = vec3<f32>(0.0);
    var t = select(0.0, 1.0, inside);
    if thread == 0u {
        atomicStore(&open, 0u);
    }
    for (var batch = first; batch < past; batch += BATCH) {
        workgroupBarrier();
        if t >= frame.stop && inside {
            atomicStore(&open, 1u);
        }
        let n = min(BATCH, past - batch);
        if thread < n {
            let s = splats[entries[batch + thread]];
            let here = vec3<f32>(axes(s, corner), s.log2_alpha);
            near[thread] = here;
            blocks[thread] = blocks_of(here, s.root, frame.log2_cutoff);
            root[thread] = s.root;
            colour[thread] = s.colour;
        }
        workgroupBarrier();
        if thread == 0u {
            still_open = atomicExchange(&open, 0u);
        }
        if workgroupUniformLoad(&still_open) == 0u {
            break;
        }
        if inside && t >= frame.stop {
            for (var k = 0u; k < n; k++) {
                if (blocks[k] & my_block) == 0u {
                    continue;
                }
                let log2 = log2_alpha_in_tile(near[k], root[k], at);
                // Below the cut-off by more than rounding: nothing to add.
                if log2 < frame.log2_cutoff - REACH_MARGIN {
                    continue;
                }
                let alpha = alpha_of(log2, frame.cutoff, frame.alpha_max);
                sum = fma(vec3<f32>(alpha * t), colour[k], sum);
                t = fma(-alpha, t, t);
                if t < frame.stop {
                    break;
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
    if inside && t < frame.stop {
        atomicAdd(&open, 1u);
    }
    workgroupBarrier();
    if thread == 0u {
        atomicAdd(&counts[COUNT_STOPPED], atomicLoad(&open));
    }
}
