// Finds what toggling each group does to the squared error of one tile in one context. Put after
// world_lanes.wgsl.
// Workgroups: columns, rows, contexts.
//
// Lane 0 is the context as it is, the other lanes toggle one group each of those that the block meets.
// A block that meets more than fifteen groups takes several passes; groups that it does not meet cost
// nothing and change nothing.

// Per tile and block: `words` words of the set of groups, then the number of members before each word.
@group(0) @binding(8) var<storage, read> sets: array<u32>;

// Sums of sixteen lanes of each block.
var<workgroup> found: array<f32, 128>;

// Lanes that toggle.
const TOGGLES: u32 = 15u;

@compute @workgroup_size(256)
fn utilities(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let here = spot(id, thread);
    let tile = here.tile;
    let stride = 2u * batch.words;
    let row = (tile * BLOCKS + here.block) * stride;
    var passes = 1u;
    for (var b = 0u; b < BLOCKS; b++) {
        passes = max(passes, (members((tile * BLOCKS + b) * stride) + TOGGLES - 1u) / TOGGLES);
    }
    let mine = (members(row) + TOGGLES - 1u) / TOGGLES;
    let tiles = frame.size.z * frame.size.w;
    let context = batch.first + id.z;
    let out = (id.z * tiles + tile) * (batch.groups + 1u);

    for (var turn = 0u; turn < passes; turn++) {
        var lanes = no_lanes();
        var run = NO_RUN;
        var own = NO_GROUP;
        for (var first = here.start; first < here.end; first += PIXELS) {
            empty_batch(thread);
            load(here, first, thread);
            workgroupBarrier();
            if turn < mine {
                for (var word = 0u; word < 8u; word++) {
                    var bits = atomicLoad(&touching[8u * here.block + word]);
                    while bits != 0u {
                        let i = 32u * word + firstTrailingBit(bits);
                        bits &= bits - 1u;
                        if owner[i] != own {
                            if own != NO_GROUP {
                                lanes = apply(lanes, run, toggles(row, own, context, turn));
                            }
                            own = owner[i];
                            run = NO_RUN;
                        }
                        run = extend(run, i, alpha_at(i, here.at));
                    }
                }
            }
        }
        if own != NO_GROUP {
            lanes = apply(lanes, run, toggles(row, own, context, turn));
        }
        let e = errors(lanes, here.corner + here.inside);
        let base = vec4<f32>(e[0].x);
        add_blocks(thread, vec4<f32>(e[0].x, (e[0] - base).yzw), e[1] - base, 0u);
        add_blocks(thread, e[2] - base, e[3] - base, 8u);
        workgroupBarrier();

        if thread == 0u && turn == 0u {
            var sum = 0.0;
            for (var b = 0u; b < BLOCKS; b++) {
                sum += found[16u * b];
            }
            partials[out] = sum;
        }
        for (var g = thread; g < batch.groups; g += PIXELS) {
            var sum = 0.0;
            for (var b = 0u; b < BLOCKS; b++) {
                let other = (tile * BLOCKS + b) * stride;
                if ((sets[other + (g >> 5u)] >> (g & 31u)) & 1u) == 1u {
                    let lane = lane_of(other, g, turn);
                    if lane > 0u {
                        sum += found[16u * b + lane];
                    }
                }
            }
            // Without the group minus with it.
            let delta = select(-sum, sum, included(g, context) > 0.0);
            if turn == 0u {
                partials[out + 1u + g] = delta;
            } else {
                partials[out + 1u + g] += delta;
            }
        }
    }
}

// Number of groups of a block.
fn members(row: u32) -> u32 {
    let last = batch.words - 1u;
    return sets[row + batch.words + last] + countOneBits(sets[row + last]);
}

// 1 where `context` includes group `g`.
fn included(g: u32, context: u32) -> f32 {
    return masks[g * batch.quads + (context >> 2u)][context & 3u];
}

// The lane that toggles group `g` in this pass, or 0.
fn lane_of(row: u32, g: u32, turn: u32) -> u32 {
    let word = g >> 5u;
    let below = sets[row + word] & ((1u << (g & 31u)) - 1u);
    let rank = sets[row + batch.words + word] + countOneBits(below);
    return select(0u, rank - TOGGLES * turn + 1u, rank / TOGGLES == turn);
}

// Which lanes include group `g`.
fn toggles(row: u32, g: u32, context: u32, turn: u32) -> mat4x4<f32> {
    let is = included(g, context);
    let lane = vec4<u32>(lane_of(row, g, turn));
    let here = vec4<f32>(is);
    let not = vec4<f32>(1.0 - is);
    let first = vec4<u32>(0u, 1u, 2u, 3u);
    // Lane 0 toggles nothing.
    let none = lane == vec4<u32>(0u);
    return mat4x4<f32>(
        select(select(here, not, first == lane), here, none),
        select(here, not, first + 4u == lane),
        select(here, not, first + 8u == lane),
        select(here, not, first + 12u == lane),
    );
}

// Adds eight lanes over each block in a fixed tree; they become lanes `lane..` of `found`.
fn add_blocks(thread: u32, a: vec4<f32>, b: vec4<f32>, lane: u32) {
    let within = thread & 31u;
    workgroupBarrier();
    staged[thread] = a;
    staged[PIXELS + thread] = b;
    for (var half = 16u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if within < half {
            staged[thread] += staged[thread + half];
            staged[PIXELS + thread] += staged[PIXELS + thread + half];
        }
    }
    workgroupBarrier();
    if within < 4u {
        found[16u * (thread >> 5u) + lane + within] = staged[thread - within][within];
        found[16u * (thread >> 5u) + lane + 4u + within] = staged[PIXELS + thread - within][within];
    }
}
