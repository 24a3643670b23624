// Takes `1 - SSIM` and the squared error of many pictures, and their gradients: ssim.rs in WGSL. Put after
// counterfactual/states.wgsl. Workgroups: columns, rows, planes (three per world, from `batch.first` on).
//
// `window_gradients` takes the moments of every window that is centred in a tile, along rows and then down,
// and leaves how the loss changes with each; `pixel_gradients` takes those back to pixels in the same way,
// and puts the gradient in the place of the picture. A tile reads the pixels up to a radius around it; no
// number depends on the tiles beyond that.

// Of `1 - SSIM` and its mix with the squared error.
struct Window {
    // Weights by distance from the middle, 0 beyond the window; the last two of eight are padding.
    along: array<vec4<f32>, 2>,
    down: array<vec4<f32>, 2>,
    // First and half-open last column, then row, on which a window can be centred.
    centres: vec4<u32>,
    // Of the gradients of half a squared difference and of a window's `1 - SSIM`.
    scale: vec2<f32>,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> batch: Batch;
@group(0) @binding(2) var<uniform> window: Window;
// r g b per pixel, row by row.
@group(0) @binding(3) var<storage, read> wanted: array<f32>;
// Mean less 1/2 and variance of the picture wanted around each pixel: three planes, row by row.
@group(0) @binding(4) var<storage, read> target_moments: array<vec2<f32>>;
// Pictures, then their gradients: plane by plane, row by row; three planes per world.
@group(0) @binding(5) var<storage, read_write> framebuffer: array<f32>;
// How the loss changes with e, e² and (y - 1/2)·e of each window: three planes for each of the framebuffer.
@group(0) @binding(6) var<storage, read_write> slopes: array<f32>;
// Per tile and channel, of each world: sums of squared errors and of `1 - SSIM`.
@group(0) @binding(7) var<storage, read_write> losses: array<f32>;

// Pixels from the middle of a window to its end.
const MIDDLE: u32 = 5u;
const C1: f32 = 1e-4;
const C2: f32 = 9e-4;
// Largest difference that counts.
const FARTHEST: f32 = 1e6;

// Side of a tile with what windows reach around it, and pixels of that.
const REACH: u32 = 26u;
const AROUND: u32 = 676u;
// Pixels of a tile and of what is above and below it.
const COLUMN: u32 = 416u;

// Three kinds, each of a tile with its surroundings.
var<workgroup> flat: array<f32, 2028>;
// The same, filtered along rows.
var<workgroup> lines: array<f32, 1248>;

fn weight_along(k: u32) -> f32 {
    return window.along[k / 4u][k % 4u];
}

fn weight_down(k: u32) -> f32 {
    return window.down[k / 4u][k % 4u];
}

// Pixel `i` of the tile's surroundings; may lie outside the picture.
fn around(corner: vec2<u32>, i: u32) -> vec2<i32> {
    return vec2<i32>(corner) + vec2<i32>(vec2<u32>(i % REACH, i / REACH)) - i32(MIDDLE);
}

fn within(pixel: vec2<i32>) -> bool {
    return all(pixel >= vec2<i32>(0)) && all(pixel < vec2<i32>(frame.size.xy));
}

// Filters all kinds of `flat` along, to `lines`.
fn filter_along(thread: u32) {
    for (var i = thread; i < COLUMN; i += WORKGROUP) {
        let middle = (i / TILE) * REACH + i % TILE + MIDDLE;
        for (var kind = 0u; kind < 3u; kind++) {
            let at = kind * AROUND + middle;
            var sum = weight_along(0u) * flat[at];
            for (var k = 1u; k <= MIDDLE; k++) {
                sum += weight_along(k) * (flat[at - k] + flat[at + k]);
            }
            lines[kind * COLUMN + i] = sum;
        }
    }
}

// A kind of `lines` filtered down at the thread's pixel.
fn filter_down(thread: u32, kind: u32) -> f32 {
    let at = kind * COLUMN + MIDDLE * TILE + thread;
    var sum = weight_down(0u) * lines[at];
    for (var k = 1u; k <= MIDDLE; k++) {
        sum += weight_down(k) * (lines[at - k * TILE] + lines[at + k * TILE]);
    }
    return sum;
}

@compute @workgroup_size(256)
fn window_gradients(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let corner = TILE * id.xy;
    let width = frame.size.x;
    let plane = width * frame.size.y;
    let channel = id.z % 3u;
    for (var i = thread; i < AROUND; i += WORKGROUP) {
        let pixel = around(corner, i);
        var e = 0.0;
        var y = 0.0;
        if within(pixel) {
            let place = u32(pixel.y) * width + u32(pixel.x);
            y = wanted[3u * place + channel];
            e = clamp(framebuffer[id.z * plane + place] - y, -FARTHEST, FARTHEST);
        }
        flat[i] = e;
        flat[AROUND + i] = e * e;
        flat[2u * AROUND + i] = (y - 0.5) * e;
    }
    workgroupBarrier();
    filter_along(thread);
    workgroupBarrier();

    let pixel = corner + vec2<u32>(thread % TILE, thread / TILE);
    let place = pixel.y * width + pixel.x;
    let inside = all(pixel < frame.size.xy);
    let centred = inside && all(pixel >= window.centres.xz) && all(pixel < window.centres.yw);
    var by = vec3<f32>(0.0);
    var sums = vec2<f32>(0.0);
    if centred {
        let me = filter_down(thread, 0u);
        let ee = filter_down(thread, 1u);
        let ye = filter_down(thread, 2u);
        let m = target_moments[channel * plane + place];
        let my = m.x + 0.5;
        let me2 = me * me;
        let ve = ee - me2;
        let cov = ye - m.x * me;
        let a1 = 2.0 * (my + me) * my + C1;
        let a2 = 2.0 * (m.y + cov) + C2;
        let b1 = 1.0 / (a1 + me2);
        let b2 = 1.0 / (a2 + ve);
        let l = a1 * b1;
        let s = a2 * b2;
        let differs = ve * b2;
        let apart = me2 * b1;
        let by_variance = l * s * b2;
        let by_cov = -2.0 * l * b2 * differs;
        let by_mean = 2.0 * s * b1 * (l * me - my * apart);
        by = vec3<f32>(by_mean - 2.0 * me * by_variance - m.x * by_cov, by_variance, by_cov);
        sums.y = differs + s * apart;
    }
    if inside {
        let first = 3u * id.z * plane + place;
        slopes[first] = by.x;
        slopes[first + plane] = by.y;
        slopes[first + 2u * plane] = by.z;
        let d = framebuffer[id.z * plane + place] - wanted[3u * place + channel];
        sums.x = d * d;
    }

    // Sums over the tile, in a fixed tree.
    flat[thread] = sums.x;
    flat[WORKGROUP + thread] = sums.y;
    for (var half = WORKGROUP / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if thread < half {
            flat[thread] += flat[thread + half];
            flat[WORKGROUP + thread] += flat[WORKGROUP + thread + half];
        }
    }
    workgroupBarrier();
    if thread < 2u {
        let row = 3u * (id.y * frame.size.z + id.x) + channel;
        let world = batch.first + id.z / 3u;
        losses[2u * (row * batch.worlds + world) + thread] = flat[WORKGROUP * thread];
    }
}

@compute @workgroup_size(256)
fn pixel_gradients(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let corner = TILE * id.xy;
    let width = frame.size.x;
    let plane = width * frame.size.y;
    for (var i = thread; i < AROUND; i += WORKGROUP) {
        let pixel = around(corner, i);
        let there = within(pixel);
        let place = 3u * id.z * plane + select(0u, u32(pixel.y) * width + u32(pixel.x), there);
        for (var kind = 0u; kind < 3u; kind++) {
            flat[kind * AROUND + i] = select(0.0, slopes[place + kind * plane], there);
        }
    }
    workgroupBarrier();
    filter_along(thread);
    workgroupBarrier();
    let pixel = corner + vec2<u32>(thread % TILE, thread / TILE);
    if all(pixel < frame.size.xy) {
        let place = pixel.y * width + pixel.x;
        let y = wanted[3u * place + id.z % 3u];
        let d = framebuffer[id.z * plane + place] - y;
        let e = clamp(d, -FARTHEST, FARTHEST);
        let structure =
            filter_down(thread, 0u) + 2.0 * e * filter_down(thread, 1u) + (y - 0.5) * filter_down(thread, 2u);
        framebuffer[id.z * plane + place] = window.scale.x * d + window.scale.y * structure;
    }
}
