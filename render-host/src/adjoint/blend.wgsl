// The adjoint of stage 4, for many worlds at once. Put after adjoint/forward.wgsl. Workgroups: columns, rows.
//
// Two entries. `blend_back` goes forward, takes the squared error and goes back to front.
// `back_from_gradients` goes back only, from transmittances that adjoint/framebuffer.wgsl retained and pixel
// gradients that adjoint/loss/ssim.wgsl made of its pictures.
//
// Four worlds of a pixel are four lanes. A tile's list is walked in segments; the transmittances at the
// start of each are retained, so nothing is divided: a segment is blended again, written down, and read in
// reverse. `behind` is the pixel gradient times the colour behind a splat, one number per world.
//
// The gradients that a splat's pixels give it are added up over the four worlds, then over rows, then over
// the tile, in one order; one entry has one place for its sums. Worlds beyond four are added there.

// 1: also count what density control asks of each splat, of the one world that there then is.
override STATISTICS: u32 = 0u;

// `blend_back`: r g b per pixel, row by row, the picture wanted. `back_from_gradients`: pixel gradients,
// plane by plane (row by row), three planes per world, from world `batch.first` on.
@group(0) @binding(7) var<storage, read> wanted: array<f32>;
// Three per entry: [h, hu, hv, hu·dx], [hu·dy, hv·dy, r, g], [b, pull, weight, pixels], with
// h = dL/d(exponent) / ln 2. Statistics: pull is the sum over pixels of the length of the gradient of the
// centre, / (2 ln 2); weight that of blend weights; pixels those in which the splat was blended. Else 0.
@group(0) @binding(8) var<storage, read_write> partials: array<vec4<f32>>;
// Per tile: of each world the squared error, or what framebuffer.wgsl says; then the gradient of the
// background.
@group(0) @binding(9) var<storage, read_write> found: array<f32>;

// Gradients of two entries from each pixel: h, r, g, b. Sums over the tile at the end.
var<workgroup> pixel_gradients: array<vec4<f32>, 512>;
// With statistics, of the same entries: the blend weight, -1 where the entry is not blended.
var<workgroup> pixel_weights: array<f32, 512>;
// Per entry and part of its sums, a row each.
var<workgroup> rows: array<vec4<f32>, 96>;

// Thread of pixel (x, y) of the tile.
fn thread_of(x: u32, y: u32) -> u32 {
    return 32u * ((y >> 2u) * 2u + (x >> 3u)) + (y & 3u) * 8u + (x & 7u);
}

// Adds up one row of gradients of the entry at `i`, from half `half` of `pixel_gradients`.
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
    // Pull, weight, pixels.
    var statistics = vec3<f32>(0.0);
    // Each row starts elsewhere, so that the rows read different banks of memory.
    for (var k = 0u; k < TILE; k++) {
        let x = (k + y) % TILE;
        let gradient = pixel_gradients[PIXELS * half + thread_of(x, y)];
        let u = fma(near[i].z, f32(x), u0);
        let part = gradient.x * u;
        h += gradient.x;
        hu += part;
        hux += part * (dx + f32(x));
        colour += gradient.yzw;
        if STATISTICS == 1u {
            let weight = pixel_weights[PIXELS * half + thread_of(x, y)];
            let pull = gradient.x * vec2<f32>(near[i].z * u, fma(near[i].w, u, shape[i].x * v));
            let blended = select(vec2<f32>(0.0), vec2<f32>(weight, 1.0), weight >= 0.0);
            statistics += vec3<f32>(sqrt(dot(pull, pull)), blended);
        }
    }
    rows[48u * half + y] = vec4<f32>(h, hu, h * v, hux);
    rows[48u * half + 16u + y] = vec4<f32>(hu * dy, h * v * dy, colour.rg);
    rows[48u * half + 32u + y] = vec4<f32>(colour.b, statistics);
}

// Adds eight numbers over the tile in a fixed tree: the sums are pixel_gradients[0] and pixel_gradients[256].
fn add_up(thread: u32, a: vec4<f32>, b: vec4<f32>) {
    workgroupBarrier();
    pixel_gradients[thread] = a;
    pixel_gradients[PIXELS + thread] = b;
    for (var half = PIXELS / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if thread < half {
            pixel_gradients[thread] += pixel_gradients[thread + half];
            pixel_gradients[PIXELS + thread] += pixel_gradients[PIXELS + thread + half];
        }
    }
    workgroupBarrier();
}

// Back to front from entry `past`, with the pixel gradients of four worlds; adds to the sums of entries and
// returns the transmittances behind all.
fn backward(here: Spot, quad: u32, past: u32, gr: vec4<f32>, gg: vec4<f32>, gb: vec4<f32>) -> vec4<f32> {
    let thread = here.thread;
    let inside = all(here.corner + pixel_of(thread) < frame.size.xy);
    let block = thread >> 5u;
    let start = here.start;
    let end = here.end;
    var alphas: array<f32, 32>;
    var before: array<vec4<f32>, 32>;
    var last = vec4<f32>(1.0);
    var behind = gr * frame.background.r + gg * frame.background.g + gb * frame.background.b;
    for (var k = (past - start + STAGED - 1u) / STAGED; k > 0u; k--) {
        let first = start + STAGED * (k - 1u);
        load(first, end, thread, here.corner);
        for (var half = 2u; half > 0u; half--) {
            let s = half - 1u;
            let segment = first + SEGMENT * s;
            if segment >= end {
                continue;
            }
            // Blend again, and write down.
            var t = marks[mark_of(here, segment)];
            let touched = atomicLoad(&touching[2u * block + s]);
            var bits = touched;
            while bits != 0u {
                let j = firstTrailingBit(bits);
                bits &= bits - 1u;
                let i = SEGMENT * s + j;
                alphas[j] = alpha_at(i, here.at);
                before[j] = t;
                let alpha = alphas[j] * takes(i, quad, t);
                t = fma(-alpha, t, t);
            }
            if segment + SEGMENT >= past {
                last = t;
            }
            let n = min(SEGMENT, end - segment);
            for (var pair = (n + 1u) / 2u; pair > 0u; pair--) {
                for (var e = 2u; e > 0u; e--) {
                    let j = 2u * (pair - 1u) + e - 1u;
                    var gradient = vec4<f32>(0.0);
                    var blended = -1.0;
                    if ((touched >> j) & 1u) == 1u {
                        let i = SEGMENT * s + j;
                        let alpha = alphas[j] * takes(i, quad, before[j]);
                        let own = gr * shape[i].z + gg * shape[i].w + gb * rest[i].x;
                        let ahead = own - behind;
                        let weight = alpha * before[j];
                        behind = fma(alpha, ahead, behind);
                        // Alpha at its clamp does not move.
                        let h = select(0.0, dot(weight, ahead), alphas[j] < frame.alpha_max);
                        gradient = vec4<f32>(h, dot(weight, gr), dot(weight, gg), dot(weight, gb));
                        blended = select(-1.0, weight.x, inside && alpha.x > 0.0);
                    }
                    if STATISTICS == 1u {
                        pixel_weights[PIXELS * (e - 1u) + thread] = blended;
                    }
                    pixel_gradients[PIXELS * (e - 1u) + thread] = gradient;
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
    return last;
}

@compute @workgroup_size(256)
fn blend_back(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let tile = id.y * frame.size.z + id.x;
    let here = spot(tile, TILE * id.xy, thread);
    let pixel = here.corner + pixel_of(thread);
    let inside = all(pixel < frame.size.xy);
    var want = vec3<f32>(0.0);
    if inside {
        let first = 3u * (pixel.y * frame.size.x + pixel.x);
        want = vec3<f32>(wanted[first], wanted[first + 1u], wanted[first + 2u]);
    }
    var background = vec4<f32>(0.0);
    if thread == 0u {
        atomicStore(&open, 0u);
    }
    for (var quad = 0u; 4u * quad < batch.worlds; quad++) {
        let live = living(quad, inside);
        let seen = forward(here, quad, live);
        let counts = select(vec4<f32>(0.0), vec4<f32>(1.0), live);
        let dr = (seen.r - want.r) * counts;
        let dg = (seen.g - want.g) * counts;
        let db = (seen.b - want.b) * counts;
        add_up(thread, dr * dr + dg * dg + db * db, vec4<f32>(0.0));
        if thread < 4u {
            found[tile * batch.columns + 4u * quad + thread] = pixel_gradients[0][thread];
        }
        let gr = batch.scale * dr;
        let gg = batch.scale * dg;
        let gb = batch.scale * db;
        background += vec4<f32>(dot(gr, seen.t), dot(gg, seen.t), dot(gb, seen.t), 0.0);
        backward(here, quad, seen.past, gr, gg, gb);
    }
    add_up(thread, background, vec4<f32>(0.0));
    if thread < 4u {
        found[tile * batch.columns + 4u * ((batch.worlds + 3u) / 4u) + thread] = pixel_gradients[0][thread];
    }
}

// Gradients of one channel of four worlds; 0 where there is no world or no pixel.
fn given(slot: u32, channel: u32, place: u32, live: vec4<bool>) -> vec4<f32> {
    let plane = frame.size.x * frame.size.y;
    var out = vec4<f32>(0.0);
    for (var k = 0u; k < 4u; k++) {
        if live[k] {
            out[k] = wanted[(3u * (4u * slot + k) + channel) * plane + place];
        }
    }
    return out;
}

@compute @workgroup_size(256)
fn back_from_gradients(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let tile = id.y * frame.size.z + id.x;
    var here = spot(tile, TILE * id.xy, thread);
    let pixel = here.corner + pixel_of(thread);
    let inside = all(pixel < frame.size.xy);
    let place = pixel.y * frame.size.x + pixel.x;
    let first = batch.first / 4u;
    let to = tile * batch.columns + 4u * ((batch.worlds + 3u) / 4u) + thread;
    here.retained = (batch.past + 3u) / 4u - first;
    for (var slot = 0u; slot < here.retained; slot++) {
        let quad = first + slot;
        here.slot = slot;
        if thread == 0u {
            still_open = u32(found[tile * batch.columns + 4u * quad]);
        }
        let past = min(here.start + STAGED * workgroupUniformLoad(&still_open), here.end);
        let live = living(quad, inside);
        let gr = given(slot, 0u, place, live);
        let gg = given(slot, 1u, place, live);
        let gb = given(slot, 2u, place, live);
        let t = backward(here, quad, past, gr, gg, gb);
        // Four worlds after the other, so that it does not show which worlds go together.
        add_up(thread, vec4<f32>(dot(gr, t), dot(gg, t), dot(gb, t), 0.0), vec4<f32>(0.0));
        if thread < 4u {
            var sum = pixel_gradients[0][thread];
            if quad > 0u {
                sum += found[to];
            }
            found[to] = sum;
        }
    }
}
