// Blends many worlds front to back, four to a vector; the way back uses the same workgroup memory.
// Put after counterfactual/states.wgsl; what uses it goes on with binding 7.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> batch: Batch;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read> entries: array<Entry>;
// Per group, 1 where a world includes it and 0 where not, four worlds a vector.
@group(0) @binding(5) var<storage, read> masks: array<vec4<f32>>;
// Transmittance of every pixel at the start of every segment, of as many vectors of worlds as are retained.
@group(0) @binding(6) var<storage, read_write> marks: array<vec4<f32>>;

// Entries in workgroup memory.
const STAGED: u32 = 64u;
// Entries between two retained transmittances.
const SEGMENT: u32 = 32u;

// Of a staged entry: [u0, v0, xx, xy], [yy, log2_alpha, r, g], [b, offset of the tile's first pixel].
var<workgroup> near: array<vec4<f32>, 64>;
var<workgroup> shape: array<vec4<f32>, 64>;
var<workgroup> rest: array<vec3<f32>, 64>;
var<workgroup> owner: array<u32, 64>;
// Per block and segment, a bit per entry that touches it.
var<workgroup> touching: array<atomic<u32>, 16>;
var<workgroup> open: atomic<u32>;
var<workgroup> still_open: u32;

// Loads up to 64 entries from `first`.
fn load(first: u32, end: u32, thread: u32, corner: vec2<u32>) {
    workgroupBarrier();
    if thread < 16u {
        atomicStore(&touching[thread], 0u);
    }
    workgroupBarrier();
    if thread < STAGED && first + thread < end {
        let entry = entries[first + thread];
        let s = splats[entry.splat];
        near[thread] = vec4<f32>(axes(s, corner), s.root.xy);
        shape[thread] = vec4<f32>(s.root.z, s.log2_alpha, s.colour.rg);
        rest[thread] = vec3<f32>(s.colour.b, offset(s, corner));
        owner[thread] = s.group;
        for (var block = 0u; block < BLOCKS; block++) {
            if ((entry.blocks >> block) & 1u) == 1u {
                atomicOr(&touching[2u * block + thread / SEGMENT], 1u << (thread % SEGMENT));
            }
        }
    }
    workgroupBarrier();
}

// Alpha of staged entry `i` on pixel `at` of the tile.
fn alpha_at(i: u32, at: vec2<f32>) -> f32 {
    let a = near[i];
    let b = shape[i].xy;
    let log2 = log2_alpha_in_tile(vec3<f32>(a.xy, b.y), vec3<f32>(a.zw, b.x), at);
    return alpha_of(log2, frame.cutoff, frame.alpha_max);
}

// 1 where a world includes staged entry `i` and its pixel is not finished.
fn takes(i: u32, quad: u32, t: vec4<f32>) -> vec4<f32> {
    return select(vec4<f32>(0.0), masks[owner[i] * batch.quads + quad], t >= vec4<f32>(frame.stop));
}

// Where a thread stands: its tile, its pixel, and its place among the transmittances.
struct Spot {
    thread: u32,
    corner: vec2<u32>,
    // Pixel of the tile.
    at: vec2<f32>,
    // Half-open list of the tile.
    start: u32,
    end: u32,
    // Segment of the tile's first entry, over all tiles.
    mark: u32,
    // Vectors of worlds whose transmittances are retained, and which of them this is.
    retained: u32,
    slot: u32,
}

fn spot(tile: u32, corner: vec2<u32>, thread: u32) -> Spot {
    let start = starts[tile];
    // Segments of the tiles before this one take up to as many places.
    let mark = start / SEGMENT + tile;
    let at = vec2<f32>(pixel_of(thread));
    return Spot(thread, corner, at, start, starts[tile + 1u], mark, 1u, 0u);
}

// Place of the transmittances at the start of the segment whose first entry is `first`.
fn mark_of(here: Spot, first: u32) -> u32 {
    let segment = here.mark + (first - here.start) / SEGMENT;
    return (segment * here.retained + here.slot) * PIXELS + here.thread;
}

// What a pixel shows in four worlds.
struct Blended {
    r: vec4<f32>,
    g: vec4<f32>,
    b: vec4<f32>,
    t: vec4<f32>,
    // Entry from which on no pixel of the tile sees anything.
    past: u32,
}

// Which worlds of a vector there are.
fn living(quad: u32, inside: bool) -> vec4<bool> {
    let world = vec4<u32>(4u * quad) + vec4<u32>(0u, 1u, 2u, 3u);
    return (world < vec4<u32>(batch.worlds)) & vec4<bool>(inside);
}

// Blends front to back over the background; `open` must be 0.
fn forward(here: Spot, quad: u32, live: vec4<bool>) -> Blended {
    let thread = here.thread;
    let block = thread >> 5u;
    var t = vec4<f32>(1.0);
    var r = vec4<f32>(0.0);
    var g = vec4<f32>(0.0);
    var b = vec4<f32>(0.0);
    var past = here.start;
    for (var first = here.start; first < here.end; first += STAGED) {
        load(first, here.end, thread, here.corner);
        if any((t >= vec4<f32>(frame.stop)) & live) {
            atomicStore(&open, 1u);
        }
        workgroupBarrier();
        if thread == 0u {
            still_open = atomicExchange(&open, 0u);
        }
        if workgroupUniformLoad(&still_open) == 0u {
            break;
        }
        past = min(first + STAGED, here.end);
        for (var s = 0u; s < 2u; s++) {
            let segment = first + SEGMENT * s;
            if segment < here.end {
                marks[mark_of(here, segment)] = t;
            }
            var bits = atomicLoad(&touching[2u * block + s]);
            while bits != 0u {
                let i = SEGMENT * s + firstTrailingBit(bits);
                bits &= bits - 1u;
                let alpha = alpha_at(i, here.at) * takes(i, quad, t);
                let weight = alpha * t;
                r = fma(weight, vec4<f32>(shape[i].z), r);
                g = fma(weight, vec4<f32>(shape[i].w), g);
                b = fma(weight, vec4<f32>(rest[i].x), b);
                t = fma(-alpha, t, t);
            }
        }
    }
    r = fma(t, vec4<f32>(frame.background.r), r);
    g = fma(t, vec4<f32>(frame.background.g), g);
    b = fma(t, vec4<f32>(frame.background.b), b);
    return Blended(r, g, b, t, past);
}
