// Counts found on the device become the sizes of the dispatches that follow.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read_write> counts: array<u32, 16>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> dispatch: array<vec4<u32>, 8>;

var<workgroup> running: array<u32, 256>;
var<workgroup> drawn: u32;

// Workgroups along x at most.
const ROW: u32 = 32768u;

fn groups(n: u32, each: u32) -> vec4<u32> {
    let all = n / each + select(0u, 1u, n % each > 0u);
    return vec4<u32>(min(all, ROW), (all + ROW - 1u) / ROW, 1u, 0u);
}

// Workgroups of `scan` in a sort of `n` keys.
fn scans(n: u32) -> vec4<u32> {
    let is_few = n <= FEW_BLOCKS * SORT_BLOCK;
    return vec4<u32>(select(DIGITS, 1u, is_few), 1u, 1u, 0u);
}

// Stops at the largest number instead of wrapping around.
fn add_up(a: u32, b: u32) -> u32 {
    return select(a + b, 0xffffffffu, a + b < a);
}

// After `project`: what sort and bin run over.
@compute @workgroup_size(1)
fn plan_drawn() {
    dispatch[0] = groups(counts[COUNT_DRAWN], SORT_BLOCK);
    dispatch[1] = groups(counts[COUNT_DRAWN], WORKGROUP);
    dispatch[3] = scans(counts[COUNT_DRAWN]);
}

// After `count_entries`: one workgroup turns the sums of blocks into places, and sizes the sort of entries.
@compute @workgroup_size(256)
fn plan_entries(@builtin(local_invocation_index) thread: u32) {
    if thread == 0u {
        drawn = counts[COUNT_DRAWN];
    }
    let blocks = (workgroupUniformLoad(&drawn) + WORKGROUP - 1u) / WORKGROUP;
    // Every thread takes as many neighbouring blocks.
    let each = (blocks + WORKGROUP - 1u) / WORKGROUP;
    let first = min(thread * each, blocks);
    let past = min(first + each, blocks);
    var sum = 0u;
    for (var b = first; b < past; b++) {
        sum = add_up(sum, sums[b]);
    }
    running[thread] = sum;
    for (var step = 1u; step < WORKGROUP; step = step * 2u) {
        workgroupBarrier();
        var earlier = 0u;
        if thread >= step {
            earlier = running[thread - step];
        }
        workgroupBarrier();
        running[thread] = add_up(running[thread], earlier);
    }
    workgroupBarrier();
    var place = 0u;
    if thread > 0u {
        place = running[thread - 1u];
    }
    for (var b = first; b < past; b++) {
        let here = sums[b];
        sums[b] = place;
        place = add_up(place, here);
    }
    if thread == WORKGROUP - 1u {
        let wanted = running[thread];
        let entries = min(wanted, frame.capacity);
        counts[COUNT_WANTED] = wanted;
        counts[COUNT_ENTRIES] = entries;
        dispatch[2] = groups(entries, SORT_BLOCK);
        dispatch[4] = scans(entries);
    }
}
