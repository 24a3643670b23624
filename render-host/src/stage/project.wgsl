// Stage 1 projects Gaussians to ellipses on the image plane, with colour, a depth key and a count of tiles.
//
// The decisions are those of project.rs, in its order. Camera coordinates, depth and centre are computed
// in pairs of f32 (value and remainder, about 46 bits), so depth keys and centres equal those of f64 but
// for the last place of f32. Sizes are divided by the largest before they are squared: nothing overflows
// for ellipses of up to 1e15 pixels, and longer ones are drawn as that long.

@group(0) @binding(0) var<uniform> frame: Frame;
// One row per field, see GAUSSIAN_ROWS. Bits, because a NaN must be seen before arithmetic may hide it.
@group(0) @binding(1) var<storage, read> gaussians: array<u32>;
// One row per coefficient and channel.
@group(0) @binding(2) var<storage, read> harmonics: array<u32>;
@group(0) @binding(3) var<storage, read> groups: array<u32>;
@group(0) @binding(4) var<storage, read_write> splats: array<Splat>;
@group(0) @binding(5) var<storage, read_write> keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> touched: array<u32>;
@group(0) @binding(7) var<storage, read_write> counts: array<atomic<u32>, 16>;

// Longest axis on the image plane, pixels.
const LONGEST: f32 = 1e15;
const LN_2: f32 = 0.6931472;
const LOG2_E: f32 = 1.442695;
// Square root of log2(e) / 2.
const BASE_2: f32 = 0.8493218;

var<workgroup> found: array<atomic<u32>, 8>;

fn is_finite(bits: u32) -> bool {
    return (bits & 0x7f800000u) != 0x7f800000u;
}

fn is_finite_value(x: f32) -> bool {
    return is_finite(bitcast<u32>(x));
}

// A value and its remainder.
struct Pair {
    high: f32,
    low: f32,
}

// `x`, in a way that no compiler sees through.
fn opaque(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) ^ frame.zero);
}

fn two_sum(a: f32, b: f32) -> Pair {
    let sum = opaque(a + b);
    let b_part = opaque(sum - a);
    let a_part = opaque(sum - b_part);
    return Pair(sum, opaque(a - a_part) + opaque(b - b_part));
}

// a + b for |a| >= |b|.
fn quick_sum(a: f32, b: f32) -> Pair {
    let sum = opaque(a + b);
    return Pair(sum, b - opaque(sum - a));
}

// Exact: halves of 12 bits have exact products.
fn two_product(a: f32, b: f32) -> Pair {
    let product = opaque(a * b);
    let a1 = bitcast<f32>(bitcast<u32>(a) & 0xfffff000u);
    let b1 = bitcast<f32>(bitcast<u32>(b) & 0xfffff000u);
    let a2 = opaque(a - a1);
    let b2 = opaque(b - b1);
    let error = opaque(opaque(opaque(a1 * b1 - product) + opaque(a1 * b2)) + opaque(a2 * b1)) + a2 * b2;
    return Pair(product, error);
}

fn add(a: Pair, b: Pair) -> Pair {
    let s = two_sum(a.high, b.high);
    return quick_sum(s.high, opaque(s.low + opaque(a.low + b.low)));
}

fn times(a: Pair, b: f32) -> Pair {
    let p = two_product(a.high, b);
    return quick_sum(p.high, opaque(p.low + a.low * b));
}

fn times_pair(a: Pair, b: Pair) -> Pair {
    let p = two_product(a.high, b.high);
    return quick_sum(p.high, opaque(p.low + opaque(a.high * b.low + a.low * b.high)));
}

fn divide(a: Pair, b: Pair) -> Pair {
    let first = opaque(a.high / b.high);
    let product = times(b, first);
    let rest = add(a, Pair(-product.high, -product.low));
    return quick_sum(first, opaque(rest.high / b.high));
}

// Row `row` of the view applied to a point.
fn view(row: u32, p: vec3<f32>) -> Pair {
    let h = frame.view[row];
    let l = frame.view_low[row];
    let xy = add(times(Pair(h.x, l.x), p.x), times(Pair(h.y, l.y), p.y));
    return add(add(xy, times(Pair(h.z, l.z), p.z)), Pair(h.w, l.w));
}

// log2 to the last place: the device's own, corrected by the accurate power.
fn log2_of(x: f32) -> f32 {
    let first = clamp(log2(x), -126.0, 0.0);
    let power = power_of_two(first);
    return min(first + (x - power) / power * LOG2_E, 0.0);
}

fn half_extent(reach: f32, variance: f32) -> f32 {
    return sqrt(2.0 * LN_2 * reach * variance);
}

fn gaussian(row: u32, i: u32) -> u32 {
    return gaussians[row * frame.gaussians + i];
}

fn gaussian_value(row: u32, i: u32) -> f32 {
    return bitcast<f32>(gaussian(row, i));
}

fn harmonic(k: u32, i: u32) -> vec3<f32> {
    let n = frame.gaussians;
    return vec3<f32>(
        bitcast<f32>(harmonics[(3u * k) * n + i]),
        bitcast<f32>(harmonics[(3u * k + 1u) * n + i]),
        bitcast<f32>(harmonics[(3u * k + 2u) * n + i]),
    );
}

// Higher bands towards the unit vector `d`.
fn bands(i: u32, d: vec3<f32>) -> vec3<f32> {
    let s = d * d;
    var sum = -0.48860252 * d.y * harmonic(0u, i) + 0.48860252 * d.z * harmonic(1u, i)
        - 0.48860252 * d.x * harmonic(2u, i);
    if frame.degree >= 2u {
        sum += 1.0925485 * d.x * d.y * harmonic(3u, i);
        sum += -1.0925485 * d.y * d.z * harmonic(4u, i);
        sum += 0.31539157 * (2.0 * s.z - s.x - s.y) * harmonic(5u, i);
        sum += -1.0925485 * d.x * d.z * harmonic(6u, i);
        sum += 0.54627422 * (s.x - s.y) * harmonic(7u, i);
    }
    if frame.degree >= 3u {
        sum += -0.5900436 * d.y * (3.0 * s.x - s.y) * harmonic(8u, i);
        sum += 2.8906114 * d.x * d.y * d.z * harmonic(9u, i);
        sum += -0.4570458 * d.y * (4.0 * s.z - s.x - s.y) * harmonic(10u, i);
        sum += 0.37317633 * d.z * (2.0 * s.z - 3.0 * s.x - 3.0 * s.y) * harmonic(11u, i);
        sum += -0.4570458 * d.x * (4.0 * s.z - s.x - s.y) * harmonic(12u, i);
        sum += 1.4453057 * d.z * (s.x - s.y) * harmonic(13u, i);
        sum += -0.5900436 * d.x * (s.x - 3.0 * s.y) * harmonic(14u, i);
    }
    return sum;
}

struct Outcome {
    splat: Splat,
    key: u32,
    reason: u32,
}

fn skip(reason: u32) -> Outcome {
    var none: Outcome;
    none.key = SKIPPED;
    none.reason = reason;
    return none;
}

fn all_finite(i: u32) -> bool {
    var good = true;
    for (var row = 0u; row < 14u; row++) {
        good = good && is_finite(gaussian(row, i));
    }
    let rest = 3u * ((frame.degree + 1u) * (frame.degree + 1u) - 1u);
    for (var row = 0u; row < rest; row++) {
        good = good && is_finite(harmonics[row * frame.gaussians + i]);
    }
    return good;
}

// Scaled axis `column` of the rotation of the unit quaternion `q` (wxyz), in camera axes.
fn axis(q: vec4<f32>, column: u32, scale: f32) -> vec3<f32> {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    var local = vec3<f32>(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y));
    if column == 1u {
        local = vec3<f32>(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x));
    } else if column == 2u {
        local = vec3<f32>(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
    }
    return scale * vec3<f32>(
        dot(frame.view[0].xyz, local),
        dot(frame.view[1].xyz, local),
        dot(frame.view[2].xyz, local),
    );
}

fn project_one(i: u32) -> Outcome {
    // A number at most 0, by its bits: the sign, or a zero.
    let opacity_bits = gaussian(10u, i);
    let opacity_is_nan = (opacity_bits & 0x7fffffffu) > 0x7f800000u;
    if !opacity_is_nan && (opacity_bits >= 0x80000000u || opacity_bits == 0u) {
        return skip(COUNT_ABSENT);
    }
    if !all_finite(i) {
        return skip(COUNT_NON_FINITE);
    }
    let opacity = bitcast<f32>(opacity_bits);
    var alpha = min(opacity, 1.0);
    if opacity < frame.alpha_cutoff {
        return skip(COUNT_TRANSPARENT);
    }
    var q = vec4<f32>(gaussian_value(6u, i), gaussian_value(7u, i), gaussian_value(8u, i), gaussian_value(9u, i));
    let most = max(max(abs(q.x), abs(q.y)), max(abs(q.z), abs(q.w)));
    if most < 1e-9 {
        return skip(COUNT_DEGENERATE);
    }
    q /= most;
    let norm2 = dot(q, q);
    var scale = vec3<f32>(gaussian_value(3u, i), gaussian_value(4u, i), gaussian_value(5u, i));
    if (most < 1.0 && most * most * norm2 < MIN_QUATERNION_NORM2) || any(scale < vec3<f32>(0.0)) {
        return skip(COUNT_DEGENERATE);
    }
    q /= sqrt(norm2);

    let position = vec3<f32>(gaussian_value(0u, i), gaussian_value(1u, i), gaussian_value(2u, i));
    let x = view(0u, position);
    let y = view(1u, position);
    let z = view(2u, position);
    if !(z.high > frame.near || (z.high == frame.near && z.low >= frame.near_low)) {
        return skip(COUNT_BEHIND_NEAR);
    }
    // Overflows (camera or Gaussian at more than 1e38) end as a remainder that is no number.
    if !(is_finite_value(x.low) && is_finite_value(y.low) && is_finite_value(z.low)) {
        return skip(COUNT_OUTSIDE);
    }
    let slope_x = divide(x, z);
    let slope_y = divide(y, z);
    let mean_x = add(times_pair(slope_x, Pair(frame.focal.x, frame.focal.z)), Pair(frame.principal.x, frame.principal.z));
    let mean_y = add(times_pair(slope_y, Pair(frame.focal.y, frame.focal.w)), Pair(frame.principal.y, frame.principal.w));
    if !(is_finite_value(mean_x.low) && is_finite_value(mean_y.low)) {
        return skip(COUNT_OUTSIDE);
    }
    // Whole pixels and what is left of the centre.
    let whole = floor(vec2<f32>(mean_x.high, mean_y.high));
    let part = (vec2<f32>(mean_x.high, mean_y.high) - whole) + vec2<f32>(mean_x.low, mean_y.low);
    let size = vec2<f32>(frame.size.xy);

    let gain = frame.focal.xy / z.high;
    let slope = clamp(vec2<f32>(slope_x.high, slope_y.high), frame.slope.xz, frame.slope.yw);
    scale = min(scale, vec3<f32>(LONGEST / max(gain.x, gain.y)));
    if (frame.flags & FLAG_CULL) != 0u {
        let largest = max(max(scale.x, scale.y), scale.z);
        let reach = reach_of(log2_of(alpha), frame.log2_cutoff);
        let side = gain * largest;
        let variance = side * side * (1.0 + slope * slope) + frame.low_pass;
        let half = vec2<f32>(half_extent(reach, variance.x), half_extent(reach, variance.y)) * 1.00001 + 0.001;
        if any(whole + (part + half) < vec2<f32>(0.0)) || any(whole + (part - half) > size) {
            return skip(COUNT_OUTSIDE);
        }
    }

    let a0 = axis(q, 0u, scale.x);
    let a1 = axis(q, 1u, scale.y);
    let a2 = axis(q, 2u, scale.z);
    var u = gain.x * (vec3<f32>(a0.x, a1.x, a2.x) - slope.x * vec3<f32>(a0.z, a1.z, a2.z));
    var v = gain.y * (vec3<f32>(a0.y, a1.y, a2.y) - slope.y * vec3<f32>(a0.z, a1.z, a2.z));
    let sides = max(abs(u), abs(v));
    let unit = max(max(max(sides.x, sides.y), sides.z), sqrt(frame.low_pass));
    if !(unit > 0.0) {
        return skip(COUNT_DEGENERATE);
    }
    u /= unit;
    v /= unit;
    let low_pass = frame.low_pass / unit / unit;
    let area = cross(u, v);
    let det0 = dot(area, area);
    let uu = dot(u, u);
    let vv = dot(v, v);
    let det = det0 + low_pass * (uu + vv) + low_pass * low_pass;
    if !(det > 0.0) || !is_finite_value(det) {
        return skip(COUNT_DEGENERATE);
    }
    if (frame.flags & FLAG_ANTIALIASED) != 0u {
        alpha *= max(sqrt(det0 / det), MIN_COMPENSATION);
        if alpha < frame.alpha_cutoff {
            return skip(COUNT_TRANSPARENT);
        }
    }
    let root_c = sqrt(vv + low_pass);
    let root_det = sqrt(det);
    let root = BASE_2 / unit
        * vec3<f32>(root_c / root_det, -dot(u, v) / (root_c * root_det), 1.0 / root_c);
    if !(is_finite_value(root.x) && is_finite_value(root.y) && is_finite_value(root.z))
        || !(root.x > 0.0) || !(root.z > 0.0) {
        return skip(COUNT_DEGENERATE);
    }

    var out: Outcome;
    out.splat.log2_alpha = log2_of(alpha);
    let reach = reach_of(out.splat.log2_alpha, frame.log2_cutoff);
    let half = unit * vec2<f32>(half_extent(reach, uu + low_pass), half_extent(reach, vv + low_pass));
    // A little wider than f64 would make it, never narrower.
    let wide = half * 1.00001 + 1e-5;
    let first = whole + ceil(part - wide - 0.5);
    let past = whole + (floor(part + wide - 0.5) + 1.0);
    if any(first >= past) {
        return skip(COUNT_SUB_PIXEL);
    }
    let low = max(first, vec2<f32>(0.0));
    let high = min(past, size);
    if any(low >= high) {
        return skip(COUNT_OUTSIDE);
    }
    let begin = vec2<u32>(low);
    let to = vec2<u32>(high);
    out.splat.columns = begin.x | (to.x << 16u);
    out.splat.rows = begin.y | (to.y << 16u);
    out.splat.mean = (whole - vec2<f32>((begin + to) / 2u)) + (part - 0.5);
    out.splat.root = root;

    var colour = 0.5 + 0.2820948 * vec3<f32>(gaussian_value(11u, i), gaussian_value(12u, i), gaussian_value(13u, i));
    if frame.degree > 0u {
        // Back from camera axes, where the difference of position and centre did not cancel.
        let far = max(max(abs(x.high), abs(y.high)), z.high);
        let c = vec3<f32>(x.high, y.high, z.high) / far;
        let d = c.x * frame.view[0].xyz + c.y * frame.view[1].xyz + c.z * frame.view[2].xyz;
        colour += bands(i, normalize(d));
    }
    if !(is_finite_value(colour.x) && is_finite_value(colour.y) && is_finite_value(colour.z)) {
        return skip(COUNT_NON_FINITE);
    }
    out.splat.colour = max(colour, vec3<f32>(0.0));
    out.splat.group = groups[i];
    out.key = bitcast<u32>(z.high);
    out.reason = COUNT_DRAWN;
    return out;
}

@compute @workgroup_size(256)
fn project(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) grid: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    if thread < 8u {
        atomicStore(&found[thread], 0u);
    }
    workgroupBarrier();
    let i = (id.x + id.y * grid.x) * WORKGROUP + thread;
    if i < frame.gaussians {
        let outcome = project_one(i);
        keys[i] = outcome.key;
        atomicAdd(&found[outcome.reason], 1u);
        if outcome.key != SKIPPED {
            splats[i] = outcome.splat;
            touched[i] = count_tiles(outcome.splat);
        }
    }
    workgroupBarrier();
    if thread < 8u {
        let n = atomicLoad(&found[thread]);
        if n > 0u {
            atomicAdd(&counts[thread], n);
        }
    }
}
