// Squared errors of sixteen worlds on one tile. Put after lanes.wgsl. Workgroups: columns, rows, worlds / 16.

// Set in the group of what none of the sixteen worlds holds: it ends runs, as it would for other worlds, so
// that a world's runs do not depend on the worlds beside it, and adds nothing.
const HELD_BY_NONE: u32 = 0x80000000u;

@compute @workgroup_size(256)
fn fast(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let tile = id.y * frame.size.z + id.x;
    let corner = TILE * id.xy;
    let block = thread >> 5u;
    let inside = pixel_of(thread);
    let at = vec2<f32>(inside);
    let end = starts[tile + 1u];
    let column = 4u * id.z;
    var lanes = no_lanes();
    var run = NO_RUN;
    var own = NO_GROUP;
    for (var first = starts[tile]; first < end; first += PIXELS) {
        workgroupBarrier();
        if thread < 64u {
            atomicStore(&touching[thread], 0u);
        }
        workgroupBarrier();
        if first + thread < end {
            let entry = entries[first + thread];
            if entry.blocks != 0u {
                let splat = splats[entry.splat];
                put(entry, splat, thread, corner);
                let row = splat.group * batch.quads + column;
                let held = masks[row] + masks[row + 1u] + masks[row + 2u] + masks[row + 3u];
                if all(held == vec4<f32>(0.0)) {
                    owner[thread] |= HELD_BY_NONE;
                }
            }
        }
        workgroupBarrier();
        for (var word = 0u; word < 8u; word++) {
            var bits = atomicLoad(&touching[8u * block + word]);
            while bits != 0u {
                let i = 32u * word + firstTrailingBit(bits);
                bits &= bits - 1u;
                if owner[i] != own {
                    if (own & HELD_BY_NONE) == 0u {
                        lanes = apply(lanes, run, mask_of(own, column));
                    }
                    own = owner[i];
                    run = NO_RUN;
                }
                if (own & HELD_BY_NONE) == 0u {
                    run = extend(run, i, alpha_at(i, at));
                }
            }
        }
    }
    if (own & HELD_BY_NONE) == 0u {
        lanes = apply(lanes, run, mask_of(own, column));
    }
    let found = errors(lanes, corner + inside);
    let out = (tile * batch.quads + column) * 4u;
    add_up(thread, found[0], found[1], out);
    add_up(thread, found[2], found[3], out + 8u);
}
