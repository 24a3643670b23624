// Stage 4 blends a batch of worlds: the tile's list is walked once for eight worlds, whose colours and
// transmittances stay in registers. Alpha is computed once per splat and pixel; a world that lacks the
// splat's group takes 0 of it, which leaves its bits alone. Per world the operations and their order are
// those of blend.wgsl. Put after staged.wgsl.

// `world_words` words per group, a bit per world.
@group(0) @binding(4) var<storage, read> presence: array<u32>;
// World after world, each as in blend.wgsl.
@group(0) @binding(5) var<storage, read_write> images: array<vec4<f32>>;

// Which of the eight worlds include the splat; one that none includes reaches no block.
var<workgroup> holders: array<u32, 256>;

fn bits_of(mask: u32, first: u32) -> vec4<bool> {
    let shifts = vec4<u32>(first, first + 1u, first + 2u, first + 3u);
    return ((vec4<u32>(mask) >> shifts) & vec4<u32>(1u)) != vec4<u32>(0u);
}

@compute @workgroup_size(256)
fn blend_worlds(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let corner = id.xy * TILE;
    let local = pixel_of(thread);
    let pixel = corner + local;
    let inside = all(pixel < frame.size.xy);
    let tile = id.y * frame.size.z + id.x;
    let first = starts[tile];
    let past = starts[tile + 1u];
    let at = vec2<f32>(local);
    let my_words = thread / 32u * 8u;
    let cutoff = frame.cutoff;
    let log2_cutoff = frame.log2_cutoff;
    let alpha_max = frame.alpha_max;
    let first_world = id.z * LANES;
    let lanes = min(LANES, frame.worlds - first_world);

    // A lane without a world counts as finished.
    let every = select(0u, (1u << lanes) - 1u, inside);
    var t0 = select(vec4<f32>(0.0), vec4<f32>(1.0), bits_of(every, 0u));
    var t1 = select(vec4<f32>(0.0), vec4<f32>(1.0), bits_of(every, 4u));
    var r0 = vec4<f32>(0.0);
    var r1 = vec4<f32>(0.0);
    var g0 = vec4<f32>(0.0);
    var g1 = vec4<f32>(0.0);
    var b0 = vec4<f32>(0.0);
    var b1 = vec4<f32>(0.0);
    let stop = vec4<f32>(frame.stop);
    if thread == 0u {
        atomicStore(&open, 0u);
    }
    for (var batch = first; batch < past; batch += BATCH) {
        workgroupBarrier();
        let going = inside && (any(t0 >= stop) || any(t1 >= stop));
        if going {
            atomicStore(&open, 1u);
        }
        let n = min(BATCH, past - batch);
        var reached = 0u;
        if thread < n {
            let s = splats[entries[batch + thread]];
            let here = put(s, thread, corner);
            let word = presence[s.group * frame.world_words + first_world / 32u];
            let holding = (word >> (first_world % 32u)) & 0xffu;
            holders[thread] = holding;
            reached = select(0u, blocks_of(here, s.root, log2_cutoff), holding != 0u);
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
        if going {
            let words = (n + 31u) / 32u;
            for (var word = 0u; word < words; word++) {
                var left = reaching[my_words + word];
                while left != 0u {
                    let k = word * 32u + firstTrailingBit(left);
                    left &= left - 1u;
                    let mask = holders[k];
                    let a = near[k];
                    let b = shape[k];
                    let log2 = log2_alpha_in_tile(a.xyz, vec3<f32>(a.w, b.xy), at);
                    if log2 < log2_cutoff - REACH_MARGIN {
                        continue;
                    }
                    let alpha = vec4<f32>(alpha_of(log2, cutoff, alpha_max));
                    let c = vec3<f32>(b.zw, blue[k]);
                    let a0 = select(vec4<f32>(0.0), alpha, bits_of(mask, 0u) & (t0 >= stop));
                    let a1 = select(vec4<f32>(0.0), alpha, bits_of(mask, 4u) & (t1 >= stop));
                    let w0 = a0 * t0;
                    let w1 = a1 * t1;
                    r0 = fma(w0, vec4<f32>(c.x), r0);
                    r1 = fma(w1, vec4<f32>(c.x), r1);
                    g0 = fma(w0, vec4<f32>(c.y), g0);
                    g1 = fma(w1, vec4<f32>(c.y), g1);
                    b0 = fma(w0, vec4<f32>(c.z), b0);
                    b1 = fma(w1, vec4<f32>(c.z), b1);
                    t0 = fma(-a0, t0, t0);
                    t1 = fma(-a1, t1, t1);
                    if all(t0 < stop) && all(t1 < stop) {
                        word = words;
                        break;
                    }
                }
            }
        }
    }
    if inside {
        let pixels = frame.size.x * frame.size.y;
        let place = first_world * pixels + pixel.y * frame.size.x + pixel.x;
        images[place] = vec4<f32>(r0.x, g0.x, b0.x, t0.x);
        if lanes > 1u { images[place + pixels] = vec4<f32>(r0.y, g0.y, b0.y, t0.y); }
        if lanes > 2u { images[place + 2u * pixels] = vec4<f32>(r0.z, g0.z, b0.z, t0.z); }
        if lanes > 3u { images[place + 3u * pixels] = vec4<f32>(r0.w, g0.w, b0.w, t0.w); }
        if lanes > 4u { images[place + 4u * pixels] = vec4<f32>(r1.x, g1.x, b1.x, t1.x); }
        if lanes > 5u { images[place + 5u * pixels] = vec4<f32>(r1.y, g1.y, b1.y, t1.y); }
        if lanes > 6u { images[place + 6u * pixels] = vec4<f32>(r1.z, g1.z, b1.z, t1.z); }
        if lanes > 7u { images[place + 7u * pixels] = vec4<f32>(r1.w, g1.w, b1.w, t1.w); }
    }
}
