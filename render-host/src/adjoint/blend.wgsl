// Adjoint of stage 4 for many worlds at once: forward, squared error and back to front in one kernel.
// Put after counterfactual/states.wgsl. Workgroups: columns, rows.
//
// Four worlds of a pixel are four lanes. A tile's list is walked in segments; the transmittances at the
// start of each are kept, so nothing is divided: a segment is blended again, written down, and read in
// reverse. `behind` is the pixel gradient times the colour behind a splat, one number per world.
//
// What a splat's pixels pull at is added up over the four worlds, then over rows, then over the tile, in
// one order; one entry has one place for its sums. Worlds beyond four are added there.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> batch: Batch;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read> entries: array<Entry>;
// Per group, 1 where a world holds it and 0 where not, four worlds a vector.
@group(0) @binding(5) var<storage, read> masks: array<vec4<f32>>;
// r g b per pixel, row by row: the picture wanted, or pixel gradients (see Batch).
@group(0) @binding(6) var<storage, read> wanted: array<f32>;
// Three per entry: [h, hu, hv, hu·dx], [hu·dy, hv·dy, r, g], [b], with h = dL/d(exponent) / ln 2.
@group(0) @binding(7) var<storage, read_write> partials: array<vec4<f32>>;
// Transmittance of every pixel at the start of every segment.
@group(0) @binding(8) var<storage, read_write> marks: array<vec4<f32>>;
// Per tile: squared error of each world, then the gradient of the background.
@group(0) @binding(9) var<storage, read_write> found: array<f32>;

// Entries in workgroup memory.
const STAGED: u32 = 64u;
// Entries between two kept transmittances.
const SEGMENT: u32 = 32u;

// Of a staged entry: [u0, v0, xx, xy], [yy, log2_alpha, r, g], [b, offset of the tile's first pixel].
var<workgroup> near: array<vec4<f32>, 64>;
var<workgroup> shape: array<vec4<f32>, 64>;
var<workgroup> rest: array<vec3<f32>, 64>;
var<workgroup> owner: array<u32, 64>;
// Per block and segment, a bit per entry that touches it.
var<workgroup> touching: array<atomic<u32>, 16>;
// What two entries pull at each pixel: h, r, g, b. Sums over the tile at the end.
var<workgroup> pulls: array<vec4<f32>, 512>;
// Per entry and part of its sums, a row each.
var<workgroup> rows: array<vec4<f32>, 96>;
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

// 1 where a world holds staged entry `i` and its pixel is not finished.
fn takes(i: u32, quad: u32, t: vec4<f32>) -> vec4<f32> {
    return select(vec4<f32>(0.0), masks[owner[i] * batch.quads + quad], t >= vec4<f32>(frame.stop));
}

// Thread of pixel (x, y) of the tile.
fn thread_of(x: u32, y: u32) -> u32 {
    return 32u * ((y >> 2u) * 2u + (x >> 3u)) + (y & 3u) * 8u + (x & 7u);
}

// Adds up one row of what the entry at `i`, in half `half` of `pulls`, pulls at.
fn add_row(i: u32, half: u32, y: u32) {
    let down = f32(y);
    let u0 = fma(near[i].w, down, near[i].x);
    let v = fma(shape[i].x, down, near[i].y);
    let dx = rest[i].y;
    let dy = rest[i].z + down;
    var h = 0.0;
    var hu = 0.0;
    var hux = 0.0;
    var colour = vec3<f32>(0.0);
    // Each row starts elsewhere, so that the rows read different banks of memory.
    for (var k = 0u; k < TILE; k++) {
        let x = (k + y) % TILE;
        let pull = pulls[PIXELS * half + thread_of(x, y)];
        let part = pull.x * fma(near[i].z, f32(x), u0);
        h += pull.x;
        hu += part;
        hux += part * (dx + f32(x));
        colour += pull.yzw;
    }
    rows[48u * half + y] = vec4<f32>(h, hu, h * v, hux);
    rows[48u * half + 16u + y] = vec4<f32>(hu * dy, h * v * dy, colour.rg);
    rows[48u * half + 32u + y] = vec4<f32>(colour.b, 0.0, 0.0, 0.0);
}

// Adds eight numbers over the tile in a fixed tree: the sums are pulls[0] and pulls[256].
fn add_up(thread: u32, a: vec4<f32>, b: vec4<f32>) {
    workgroupBarrier();
    pulls[thread] = a;
    pulls[PIXELS + thread] = b;
    for (var half = PIXELS / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if thread < half {
            pulls[thread] += pulls[thread + half];
            pulls[PIXELS + thread] += pulls[PIXELS + thread + half];
        }
    }
    workgroupBarrier();
}

@compute @workgroup_size(256)
fn blend_back(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let tile = id.y * frame.size.z + id.x;
    let corner = TILE * id.xy;
    let block = thread >> 5u;
    let local = pixel_of(thread);
    let at = vec2<f32>(local);
    let pixel = corner + local;
    let inside = all(pixel < frame.size.xy);
    let start = starts[tile];
    let end = starts[tile + 1u];
    // Segments of the tiles before this one take up to as many places.
    let mark = start / SEGMENT + tile;
    var want = vec3<f32>(0.0);
    if inside {
        let first = 3u * (pixel.y * frame.size.x + pixel.x);
        want = vec3<f32>(wanted[first], wanted[first + 1u], wanted[first + 2u]);
    }
    var background = vec4<f32>(0.0);
    var alphas: array<f32, 32>;
    var before: array<vec4<f32>, 32>;
    if thread == 0u {
        atomicStore(&open, 0u);
    }

    for (var quad = 0u; 4u * quad < batch.worlds; quad++) {
        // Front to back.
        var t = vec4<f32>(1.0);
        var r = vec4<f32>(0.0);
        var g = vec4<f32>(0.0);
        var b = vec4<f32>(0.0);
        let world = vec4<u32>(4u * quad) + vec4<u32>(0u, 1u, 2u, 3u);
        let live = (world < vec4<u32>(batch.worlds)) & vec4<bool>(inside);
        var past = start;
        for (var first = start; first < end; first += STAGED) {
            load(first, end, thread, corner);
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
            past = min(first + STAGED, end);
            for (var s = 0u; s < 2u; s++) {
                let segment = first + SEGMENT * s;
                if segment < end {
                    marks[(mark + (segment - start) / SEGMENT) * PIXELS + thread] = t;
                }
                var bits = atomicLoad(&touching[2u * block + s]);
                while bits != 0u {
                    let i = SEGMENT * s + firstTrailingBit(bits);
                    bits &= bits - 1u;
                    let alpha = alpha_at(i, at) * takes(i, quad, t);
                    let weight = alpha * t;
                    r = fma(weight, vec4<f32>(shape[i].z), r);
                    g = fma(weight, vec4<f32>(shape[i].w), g);
                    b = fma(weight, vec4<f32>(rest[i].x), b);
                    t = fma(-alpha, t, t);
                }
            }
        }

        // The loss.
        let counts = select(vec4<f32>(0.0), vec4<f32>(1.0), live);
        let dr = (fma(t, vec4<f32>(frame.background.r), r) - want.r) * counts;
        let dg = (fma(t, vec4<f32>(frame.background.g), g) - want.g) * counts;
        let db = (fma(t, vec4<f32>(frame.background.b), b) - want.b) * counts;
        add_up(thread, dr * dr + dg * dg + db * db, vec4<f32>(0.0));
        if thread < 4u {
            found[tile * batch.columns + 4u * quad + thread] = pulls[0][thread];
        }
        var gr = batch.scale * dr;
        var gg = batch.scale * dg;
        var gb = batch.scale * db;
        if batch.scale == 0.0 {
            gr = counts * want.r;
            gg = counts * want.g;
            gb = counts * want.b;
        }
        background += vec4<f32>(dot(gr, t), dot(gg, t), dot(gb, t), 0.0);

        // Back to front.
        var behind = gr * frame.background.r + gg * frame.background.g + gb * frame.background.b;
        for (var k = (past - start + STAGED - 1u) / STAGED; k > 0u; k--) {
            let first = start + STAGED * (k - 1u);
            load(first, end, thread, corner);
            for (var half = 2u; half > 0u; half--) {
                let s = half - 1u;
                let segment = first + SEGMENT * s;
                if segment >= end {
                    continue;
                }
                // Blend again, and write down.
                t = marks[(mark + (segment - start) / SEGMENT) * PIXELS + thread];
                let touched = atomicLoad(&touching[2u * block + s]);
                var bits = touched;
                while bits != 0u {
                    let j = firstTrailingBit(bits);
                    bits &= bits - 1u;
                    let i = SEGMENT * s + j;
                    alphas[j] = alpha_at(i, at);
                    before[j] = t;
                    let alpha = alphas[j] * takes(i, quad, t);
                    t = fma(-alpha, t, t);
                }
                let n = min(SEGMENT, end - segment);
                for (var pair = (n + 1u) / 2u; pair > 0u; pair--) {
                    for (var e = 2u; e > 0u; e--) {
                        let j = 2u * (pair - 1u) + e - 1u;
                        var pull = vec4<f32>(0.0);
                        if ((touched >> j) & 1u) == 1u {
                            let i = SEGMENT * s + j;
                            let alpha = alphas[j] * takes(i, quad, before[j]);
                            let own = gr * shape[i].z + gg * shape[i].w + gb * rest[i].x;
                            let ahead = own - behind;
                            let weight = alpha * before[j];
                            behind = fma(alpha, ahead, behind);
                            // Alpha at its clamp does not move.
                            let h = select(0.0, dot(weight, ahead), alphas[j] < frame.alpha_max);
                            pull = vec4<f32>(h, dot(weight, gr), dot(weight, gg), dot(weight, gb));
                        }
                        pulls[PIXELS * (e - 1u) + thread] = pull;
                    }
                    workgroupBarrier();
                    if thread < 32u {
                        let which = thread >> 4u;
                        add_row(SEGMENT * s + 2u * (pair - 1u) + which, which, thread & 15u);
                    }
                    workgroupBarrier();
                    if thread < 6u {
                        let which = thread / 3u;
                        let entry = segment + 2u * (pair - 1u) + which;
                        if entry < end {
                            var sum = vec4<f32>(0.0);
                            for (var y = 0u; y < TILE; y++) {
                                sum += rows[48u * which + 16u * (thread % 3u) + (y + thread) % TILE];
                            }
                            let place = 3u * entry + thread % 3u;
                            if quad > 0u {
                                sum += partials[place];
                            }
                            partials[place] = sum;
                        }
                    }
                }
            }
        }
        // What no pixel saw has no gradient.
        if quad == 0u {
            for (var place = 3u * past + thread; place < 3u * end; place += PIXELS) {
                partials[place] = vec4<f32>(0.0);
            }
        }
        storageBarrier();
    }
    add_up(thread, background, vec4<f32>(0.0));
    if thread < 4u {
        found[tile * batch.columns + 4u * ((batch.worlds + 3u) / 4u) + thread] = pulls[0][thread];
    }
}
