// Every kernel shares these structs, constants and functions: `gpu/layout.rs` in WGSL. A test compares the
// two.

const TILE: u32 = 16u;
const SMALL_BOX: u32 = 6u;
const WORKGROUP: u32 = 256u;
const SORT_BLOCK: u32 = 1024u;
const FEW_BLOCKS: u32 = 64u;
const DIGITS: u32 = 256u;
const LANES: u32 = 8u;
const SKIPPED: u32 = 0xffffffffu;
const REACH_MARGIN: f32 = 1e-4;
const MIN_COMPENSATION: f32 = 0.005;
const MIN_QUATERNION_NORM2: f32 = 1e-12;

const COUNT_ABSENT: u32 = 0u;
const COUNT_NON_FINITE: u32 = 1u;
const COUNT_TRANSPARENT: u32 = 2u;
const COUNT_DEGENERATE: u32 = 3u;
const COUNT_BEHIND_NEAR: u32 = 4u;
const COUNT_OUTSIDE: u32 = 5u;
const COUNT_SUB_PIXEL: u32 = 6u;
const COUNT_DRAWN: u32 = 7u;
const COUNT_ENTRIES: u32 = 8u;
const COUNT_WANTED: u32 = 9u;
const COUNT_TOUCHED: u32 = 10u;
const COUNT_STOPPED: u32 = 11u;
const COUNTS: u32 = 16u;

const FLAG_ANTIALIASED: u32 = 1u;
const FLAG_CULL: u32 = 2u;
const FLAG_EXACT: u32 = 4u;

struct Splat {
    mean: vec2<f32>,
    columns: u32,
    rows: u32,
    root: vec3<f32>,
    log2_alpha: f32,
    colour: vec3<f32>,
    group: u32,
}

struct Frame {
    view: array<vec4<f32>, 3>,
    view_low: array<vec4<f32>, 3>,
    focal: vec4<f32>,
    principal: vec4<f32>,
    slope: vec4<f32>,
    background: vec4<f32>,
    size: vec4<u32>,
    near: f32,
    near_low: f32,
    low_pass: f32,
    alpha_cutoff: f32,
    cutoff: f32,
    log2_cutoff: f32,
    alpha_max: f32,
    stop: f32,
    gaussians: u32,
    degree: u32,
    flags: u32,
    zero: u32,
    capacity: u32,
    worlds: u32,
    world_words: u32,
    spare: u32,
}

// Half-open pixel box: x0, x1, y0, y1.
fn pixel_box(s: Splat) -> vec4<u32> {
    return vec4<u32>(s.columns & 0xffffu, s.columns >> 16u, s.rows & 0xffffu, s.rows >> 16u);
}

// Centre of pixel `p` from the splat's centre, pixels: a difference of whole numbers, then one rounding.
fn offset(s: Splat, p: vec2<u32>) -> vec2<f32> {
    let b = pixel_box(s);
    let anchor = vec2<i32>(i32((b.x + b.y) / 2u), i32((b.z + b.w) / 2u));
    return vec2<f32>(vec2<i32>(p) - anchor) - s.mean;
}

// `u` and `v` at the centre of pixel `p`. Products that meet a sum are fused by name everywhere, so that
// every pipeline, whatever its compiler, gives the same bits.
fn axes(s: Splat, p: vec2<u32>) -> vec2<f32> {
    let d = offset(s, p);
    return vec2<f32>(fma(s.root.x, d.x, s.root.y * d.y), s.root.z * d.y);
}

// log2 of alpha at `u`, `v`.
fn log2_alpha_at(peak: f32, u: f32, v: f32) -> f32 {
    return fma(-u, u, fma(-v, v, peak));
}

// Largest u² + v² worth a look, from the log2 of a splat's alpha.
fn reach_of(log2_alpha: f32, log2_cutoff: f32) -> f32 {
    return max(log2_alpha - log2_cutoff, 0.0) + REACH_MARGIN;
}

// 2^x for -126 <= x <= 0, relative error below 2e-7; 2^-126 below. The polynomial is that of the CPU's
// blend; a device's own exp2 may be off by 1e-6.
fn power_of_two(exponent: f32) -> f32 {
    let x = max(exponent, -126.0);
    // Adding 1.5 * 2^23 leaves the nearest integer in the low bits. These bits are set already, which a
    // compiler cannot know: the difference below must not be simplified to zero.
    let shifted = bitcast<u32>(x + 12582912.0) | 0x4b000000u;
    let f = x - (bitcast<f32>(shifted) - 12582912.0);
    var p = fma(0.00015345812, f, 0.0013399931);
    p = fma(p, f, 0.009618489);
    p = fma(p, f, 0.05550329);
    p = fma(p, f, 0.24022647);
    p = fma(p, f, 0.6931472);
    p = fma(p, f, 1.0);
    return p * bitcast<f32>((shifted + 127u) << 23u);
}

// Alpha where it is at least the cut-off, else 0.
fn alpha_of(log2: f32, cutoff: f32, alpha_max: f32) -> f32 {
    let alpha = min(power_of_two(log2), alpha_max);
    return select(0.0, alpha, alpha >= cutoff);
}
