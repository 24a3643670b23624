// Stage 3 writes an entry per splat and tile in order of depth; sort.wgsl then gathers them by tile,
// stably, so every tile's list is nearest first.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> counts: array<u32, 16>;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read> touched: array<u32>;
@group(0) @binding(4) var<storage, read> order: array<u32>;
@group(0) @binding(5) var<storage, read_write> sums: array<u32>;
@group(0) @binding(6) var<storage, read_write> keys: array<u32>;
@group(0) @binding(7) var<storage, read_write> values: array<u32>;

// Tiles that a thread lists alone; the workgroup lists a larger splat together, a row per thread.
const ALONE: u32 = 64u;

var<workgroup> running: array<u32, 256>;
// Splats of this workgroup that are listed together, and where their entries go.
var<workgroup> large: array<u32, 256>;
var<workgroup> large_place: array<u32, 256>;
var<workgroup> large_count: atomic<u32>;
var<workgroup> large_total: u32;

// Stops at the largest number instead of wrapping around.
fn add_up(a: u32, b: u32) -> u32 {
    return select(a + b, 0xffffffffu, a + b < a);
}

// Sum over the threads before this one; the inclusive sums stay in `running`.
fn sum_before(thread: u32, value: u32) -> u32 {
    running[thread] = value;
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
    if thread == 0u {
        return 0u;
    }
    return running[thread - 1u];
}

@compute @workgroup_size(256)
fn count_entries(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) grid: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let block = id.x + id.y * grid.x;
    let i = block * WORKGROUP + thread;
    let n = counts[COUNT_DRAWN];
    var mine = 0u;
    if i < n {
        mine = touched[order[i]];
    }
    let before = sum_before(thread, mine);
    if thread == WORKGROUP - 1u && block * WORKGROUP < n {
        sums[block] = add_up(before, mine);
    }
}

fn put(place: u32, past: u32, tile: u32, splat: u32) {
    if place < past {
        keys[place] = tile;
        values[place] = splat;
    }
}

@compute @workgroup_size(256)
fn emit_entries(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) grid: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    if thread == 0u {
        atomicStore(&large_count, 0u);
    }
    let block = id.x + id.y * grid.x;
    let i = block * WORKGROUP + thread;
    let n = counts[COUNT_DRAWN];
    let columns = frame.size.z;
    // Entries of a tile that does not exist sort behind all lists.
    let nowhere = columns * frame.size.w;
    var splat = 0u;
    var mine = 0u;
    if i < n {
        splat = order[i];
        mine = touched[splat];
    }
    let before = sum_before(thread, mine);
    if mine > 0u {
        var place = add_up(sums[block], before);
        let past = min(add_up(place, mine), frame.capacity);
        if mine > ALONE {
            let slot = atomicAdd(&large_count, 1u);
            large[slot] = splat;
            large_place[slot] = place;
        } else {
            let s = splats[splat];
            let rows = tile_rows(s);
            for (var row = rows.x; row < rows.y; row++) {
                let found = span(s, row);
                for (var column = found.x; column < found.y; column++) {
                    put(place, past, row * columns + column, splat);
                    place++;
                }
            }
            // Two compilations of one formula may differ by a sliver; every slot counted is written.
            while place < past {
                put(place, past, nowhere, splat);
                place++;
            }
        }
    }
    workgroupBarrier();
    if thread == 0u {
        large_total = atomicLoad(&large_count);
    }
    let together = workgroupUniformLoad(&large_total);
    for (var k = 0u; k < together; k++) {
        splat = workgroupUniformLoad(&large[k]);
        let s = splats[splat];
        let rows = tile_rows(s);
        var place = large_place[k];
        let past = min(add_up(place, touched[splat]), frame.capacity);
        for (var first = rows.x; first < rows.y; first += WORKGROUP) {
            let row = first + thread;
            var found = vec2<u32>(0u, 0u);
            if row < rows.y {
                found = span(s, row);
            }
            var at = add_up(place, sum_before(thread, found.y - found.x));
            for (var column = found.x; column < found.y; column++) {
                put(at, past, row * columns + column, splat);
                at++;
            }
            place = add_up(place, running[WORKGROUP - 1u]);
            workgroupBarrier();
        }
        for (var at = add_up(place, thread); at < past; at += WORKGROUP) {
            put(at, past, nowhere, splat);
        }
    }
}
