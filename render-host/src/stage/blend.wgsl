// Stage 4 blends: each pixel of a tile takes its list of splats, nearest first: `C += T·a·c; T -= T·a`, until
// T is below the stop (inclusive). A workgroup is a tile, a thread a pixel. Put after staged.wgsl.

@group(0) @binding(4) var<storage, read_write> counts: array<atomic<u32>, 16>;
// r, g, b without background and transmittance, row by row.
@group(0) @binding(5) var<storage, read_write> image: array<vec4<f32>>;

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
            reached = blocks_of(put(s, thread, corner), s.root, log2_cutoff);
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
