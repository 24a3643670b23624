// Stable radix sort of 32-bit keys with 32-bit values, least significant digit first: histogram, scan and
// scatter per digit. Equal keys keep their order, so depth ties go by index and tile lists stay in order
// of depth.
//
// No subgroups: a thread finds its rank among the keys of a round from bit masks in workgroup memory, one
// bit per thread and digit.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> counts: array<u32, 16>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read> values: array<u32>;
@group(0) @binding(4) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> values_out: array<u32>;
// Per digit, the number of its keys in every block; after `scan`, in all blocks before.
@group(0) @binding(6) var<storage, read_write> table: array<u32>;
// Per digit, the number of its keys.
@group(0) @binding(7) var<storage, read_write> totals: array<u32, 256>;

// Given by buffer and not by override constants: software adapters take a second to compile a kernel, and one
// kernel serves all digits.
@group(0) @binding(8) var<uniform> sort_pass: SortPass;

struct SortPass {
    // What is sorted: 0 all Gaussians but the skipped, each with its index as value; 1 the splats drawn;
    // 2 the tile entries.
    source: u32,
    // Lowest bit of the digit.
    shift: u32,
    spare: vec2<u32>,
}

const MASK_WORDS: u32 = 8u;

var<workgroup> histogram: array<atomic<u32>, 256>;
var<workgroup> masks: array<atomic<u32>, 2048>;
var<workgroup> base: array<u32, 256>;
var<workgroup> sums: array<u32, 256>;

fn count() -> u32 {
    if sort_pass.source == 0u {
        return frame.gaussians;
    } else if sort_pass.source == 1u {
        return counts[COUNT_DRAWN];
    }
    return counts[COUNT_ENTRIES];
}

fn blocks_of(n: u32) -> u32 {
    return (n + SORT_BLOCK - 1u) / SORT_BLOCK;
}

fn takes_part(i: u32, n: u32) -> bool {
    return i < n && (sort_pass.source != 0u || keys[min(i, n - 1u)] != SKIPPED);
}

fn digit_of(key: u32) -> u32 {
    return (key >> sort_pass.shift) & (DIGITS - 1u);
}

// Sum of `value` over the threads before this one; leaves the inclusive sums in `sums`.
fn sum_before(thread: u32, value: u32) -> u32 {
    sums[thread] = value;
    for (var step = 1u; step < WORKGROUP; step = step * 2u) {
        workgroupBarrier();
        var earlier = 0u;
        if thread >= step {
            earlier = sums[thread - step];
        }
        workgroupBarrier();
        sums[thread] += earlier;
    }
    workgroupBarrier();
    return sums[thread] - value;
}

@compute @workgroup_size(256)
fn count_digits(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) grid: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let n = count();
    let block = id.x + id.y * grid.x;
    atomicStore(&histogram[thread], 0u);
    workgroupBarrier();
    for (var round = 0u; round < SORT_BLOCK / WORKGROUP; round++) {
        let i = block * SORT_BLOCK + round * WORKGROUP + thread;
        if takes_part(i, n) {
            atomicAdd(&histogram[digit_of(keys[i])], 1u);
        }
    }
    workgroupBarrier();
    let blocks = blocks_of(n);
    if block < blocks {
        table[thread * blocks + block] = atomicLoad(&histogram[thread]);
    }
}

// One workgroup per digit; for few blocks one workgroup in all, with a thread per digit.
@compute @workgroup_size(256)
fn scan(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let blocks = blocks_of(count());
    var carry = 0u;
    if blocks <= FEW_BLOCKS {
        for (var place = thread * blocks; place < (thread + 1u) * blocks; place++) {
            let value = table[place];
            table[place] = carry;
            carry += value;
        }
        totals[thread] = carry;
        return;
    }
    let row = id.x * blocks;
    for (var first = 0u; first < blocks; first += WORKGROUP) {
        let block = first + thread;
        var value = 0u;
        if block < blocks {
            value = table[row + block];
        }
        let before = sum_before(thread, value);
        if block < blocks {
            table[row + block] = carry + before;
        }
        carry += sums[WORKGROUP - 1u];
        workgroupBarrier();
    }
    if thread == 0u {
        totals[id.x] = carry;
    }
}

@compute @workgroup_size(256)
fn scatter(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) grid: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let n = count();
    let blocks = blocks_of(n);
    let block = id.x + id.y * grid.x;
    let smaller = sum_before(thread, totals[thread]);
    var start = 0u;
    if block < blocks {
        start = smaller + table[thread * blocks + block];
    }
    base[thread] = start;
    let word = thread / 32u;
    let bit = thread % 32u;
    for (var round = 0u; round < SORT_BLOCK / WORKGROUP; round++) {
        for (var w = 0u; w < MASK_WORDS; w++) {
            atomicStore(&masks[w * DIGITS + thread], 0u);
        }
        workgroupBarrier();
        let i = block * SORT_BLOCK + round * WORKGROUP + thread;
        let mine = takes_part(i, n);
        var key = 0u;
        if mine {
            key = keys[i];
            atomicOr(&masks[word * DIGITS + digit_of(key)], 1u << bit);
        }
        workgroupBarrier();
        if mine {
            let digit = digit_of(key);
            var rank = base[digit];
            for (var w = 0u; w < word; w++) {
                rank += countOneBits(atomicLoad(&masks[w * DIGITS + digit]));
            }
            rank += countOneBits(atomicLoad(&masks[word * DIGITS + digit]) & ((1u << bit) - 1u));
            keys_out[rank] = key;
            if sort_pass.source == 0u {
                values_out[rank] = i;
            } else {
                values_out[rank] = values[i];
            }
        }
        workgroupBarrier();
        // This thread's digit has moved on by the keys of the round.
        var seen = 0u;
        for (var w = 0u; w < MASK_WORDS; w++) {
            seen += countOneBits(atomicLoad(&masks[w * DIGITS + thread]));
        }
        base[thread] += seen;
    }
}
