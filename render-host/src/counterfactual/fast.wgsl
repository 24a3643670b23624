// Takes squared errors of sixteen worlds on one tile. Put after world_lanes.wgsl. Workgroups: columns, rows,
// worlds / 16.

// Set in the group of a splat that none of the sixteen worlds includes: it ends runs, as it would for other
// worlds, so that a world's runs do not depend on the worlds beside it, and adds nothing.
const IN_NO_WORLD: u32 = 0x80000000u;

@compute @workgroup_size(256)
fn fast(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let here = spot(id, thread);
    let column = 4u * id.z;
    var lanes = no_lanes();
    var run = NO_RUN;
    var own = NO_GROUP;
    for (var first = here.start; first < here.end; first += PIXELS) {
        empty_batch(thread);
        if load(here, first, thread) {
            let row = owner[thread] * batch.quads + column;
            let included = masks[row] + masks[row + 1u] + masks[row + 2u] + masks[row + 3u];
            if all(included == vec4<f32>(0.0)) {
                owner[thread] |= IN_NO_WORLD;
            }
        }
        workgroupBarrier();
        for (var word = 0u; word < 8u; word++) {
            var bits = atomicLoad(&touching[8u * here.block + word]);
            while bits != 0u {
                let i = 32u * word + firstTrailingBit(bits);
                bits &= bits - 1u;
                if owner[i] != own {
                    if (own & IN_NO_WORLD) == 0u {
                        lanes = apply(lanes, run, mask_of(own, column));
                    }
                    own = owner[i];
                    run = NO_RUN;
                }
                if (own & IN_NO_WORLD) == 0u {
                    run = extend(run, i, alpha_at(i, here.at));
                }
            }
        }
    }
    if (own & IN_NO_WORLD) == 0u {
        lanes = apply(lanes, run, mask_of(own, column));
    }
    write_errors(here, lanes, thread, column);
}
