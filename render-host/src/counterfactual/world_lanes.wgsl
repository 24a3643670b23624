// Kernels that walk a tile's list for sixteen worlds share this: a batch of the list in workgroup memory,
// and the sixteen worlds in registers ("world lanes"). Put after states.wgsl.
//
// Per pixel, consecutive splats of one group are composed once to a run, which is then applied to every
// lane: `w = T · mask; C += w · c; T += w · hidden`. No division, no early stop. strict.wgsl takes splats one
// by one instead.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> batch: Batch;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read> entries: array<Entry>;
// Per group, 1 where a world includes it and 0 where not, four worlds a vector.
@group(0) @binding(5) var<storage, read> masks: array<vec4<f32>>;
// r g b per pixel, row by row.
@group(0) @binding(6) var<storage, read> wanted: array<f32>;
@group(0) @binding(7) var<storage, read_write> partials: array<f32>;

// A batch of 256 entries: [u0, v0, xx, xy] and, behind them, [yy, log2_alpha, r, g]. Sums of lanes later.
var<workgroup> staged: array<vec4<f32>, 512>;
var<workgroup> blue: array<f32, 256>;
var<workgroup> owner: array<u32, 256>;
// Per block, a bit per entry of the batch that touches it.
var<workgroup> touching: array<atomic<u32>, 64>;

// Sixteen worlds of one pixel.
struct Lanes {
    t: mat4x4<f32>,
    r: mat4x4<f32>,
    g: mat4x4<f32>,
    b: mat4x4<f32>,
}

// The run that a pixel is gathering: r g b, transmittance.
const NO_RUN: vec4<f32> = vec4<f32>(0.0, 0.0, 0.0, 1.0);
const NO_GROUP: u32 = 0xffffffffu;

fn no_lanes() -> Lanes {
    let ones = vec4<f32>(1.0);
    let zeros = mat4x4<f32>();
    return Lanes(mat4x4<f32>(ones, ones, ones, ones), zeros, zeros, zeros);
}

// Where a thread works: its tile, its pixel, and the tile's half-open list.
struct Spot {
    tile: u32,
    corner: vec2<u32>,
    // Pixel of the tile.
    inside: vec2<u32>,
    at: vec2<f32>,
    // Block of the pixel.
    block: u32,
    start: u32,
    end: u32,
}

fn spot(id: vec3<u32>, thread: u32) -> Spot {
    let tile = id.y * frame.size.z + id.x;
    let inside = pixel_of(thread);
    return Spot(tile, TILE * id.xy, inside, vec2<f32>(inside), thread >> 5u, starts[tile], starts[tile + 1u]);
}

// Empties the batch.
fn empty_batch(thread: u32) {
    workgroupBarrier();
    if thread < 64u {
        atomicStore(&touching[thread], 0u);
    }
    workgroupBarrier();
}

// Puts entry `first + thread` of the list in place `thread` of the batch; false when it touches nothing.
// A barrier must follow.
fn load(here: Spot, first: u32, thread: u32) -> bool {
    if first + thread >= here.end {
        return false;
    }
    let entry = entries[first + thread];
    if entry.blocks == 0u {
        return false;
    }
    put(entry, splats[entry.splat], thread, here.corner);
    return true;
}

fn put(entry: Entry, splat: Splat, thread: u32, corner: vec2<u32>) {
    staged[thread] = vec4<f32>(axes(splat, corner), splat.root.xy);
    staged[PIXELS + thread] = vec4<f32>(splat.root.z, splat.log2_alpha, splat.colour.rg);
    blue[thread] = splat.colour.b;
    owner[thread] = splat.group;
    for (var block = 0u; block < BLOCKS; block++) {
        if ((entry.blocks >> block) & 1u) == 1u {
            atomicOr(&touching[8u * block + (thread >> 5u)], 1u << (thread & 31u));
        }
    }
}

// Alpha of place `i` of the batch on pixel `at` of the tile.
fn alpha_at(i: u32, at: vec2<f32>) -> f32 {
    let a = staged[i];
    let b = staged[PIXELS + i].xy;
    let log2 = log2_alpha_in_tile(vec3<f32>(a.xy, b.y), vec3<f32>(a.zw, b.x), at);
    return alpha_of(log2, frame.cutoff, frame.alpha_max);
}

// `run` with place `i` of the batch behind it.
fn extend(run: vec4<f32>, i: u32, alpha: f32) -> vec4<f32> {
    let weight = alpha * run.w;
    let colour = vec3<f32>(staged[PIXELS + i].zw, blue[i]);
    return vec4<f32>(run.rgb + weight * colour, run.w - weight);
}

// `lanes` with `run` behind them where `mask` is 1.
fn apply(lanes: Lanes, run: vec4<f32>, mask: mat4x4<f32>) -> Lanes {
    let t = lanes.t;
    let w = mat4x4<f32>(t[0] * mask[0], t[1] * mask[1], t[2] * mask[2], t[3] * mask[3]);
    let hidden = run.w - 1.0;
    return Lanes(t + w * hidden, lanes.r + w * run.r, lanes.g + w * run.g, lanes.b + w * run.b);
}

fn squares_of(r: vec4<f32>, g: vec4<f32>, b: vec4<f32>, t: vec4<f32>, want: vec3<f32>) -> vec4<f32> {
    let dr = fma(t, vec4<f32>(frame.background.r), r) - want.r;
    let dg = fma(t, vec4<f32>(frame.background.g), g) - want.g;
    let db = fma(t, vec4<f32>(frame.background.b), b) - want.b;
    return fma(db, db, fma(dg, dg, dr * dr));
}

// Squared error of every lane of one pixel; 0 outside the image.
fn errors(lanes: Lanes, at: vec2<u32>) -> mat4x4<f32> {
    if any(at >= frame.size.xy) {
        return mat4x4<f32>();
    }
    let first = 3u * (at.y * frame.size.x + at.x);
    let want = vec3<f32>(wanted[first], wanted[first + 1u], wanted[first + 2u]);
    return mat4x4<f32>(
        squares_of(lanes.r[0], lanes.g[0], lanes.b[0], lanes.t[0], want),
        squares_of(lanes.r[1], lanes.g[1], lanes.b[1], lanes.t[1], want),
        squares_of(lanes.r[2], lanes.g[2], lanes.b[2], lanes.t[2], want),
        squares_of(lanes.r[3], lanes.g[3], lanes.b[3], lanes.t[3], want),
    );
}

// 1 for the worlds from vector `column` on that include group `own`.
fn mask_of(own: u32, column: u32) -> mat4x4<f32> {
    let row = own * batch.quads + column;
    return mat4x4<f32>(masks[row], masks[row + 1u], masks[row + 2u], masks[row + 3u]);
}

// Adds eight lanes over the tile in a fixed tree and writes the sums.
fn add_up(thread: u32, a: vec4<f32>, b: vec4<f32>, out: u32) {
    workgroupBarrier();
    staged[thread] = a;
    staged[PIXELS + thread] = b;
    for (var half = PIXELS / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if thread < half {
            staged[thread] += staged[thread + half];
            staged[PIXELS + thread] += staged[PIXELS + thread + half];
        }
    }
    workgroupBarrier();
    if thread < 4u {
        partials[out + thread] = staged[0][thread];
        partials[out + 4u + thread] = staged[PIXELS][thread];
    }
}

// Writes the squared errors of sixteen worlds over the tile, from vector `column` on.
fn write_errors(here: Spot, lanes: Lanes, thread: u32, column: u32) {
    let found = errors(lanes, here.corner + here.inside);
    let out = (here.tile * batch.quads + column) * 4u;
    add_up(thread, found[0], found[1], out);
    add_up(thread, found[2], found[3], out + 8u);
}
