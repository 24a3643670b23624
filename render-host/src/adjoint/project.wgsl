// The adjoint of stage 1 takes gradients of entries back to Gaussians. Put after counterfactual/states.wgsl.
// Threads: one per Gaussian.
//
// A Gaussian finds its entries again: in every tile of its box, by its place in the order of depth, which the
// list is sorted by. So its sums have one order, that of tiles, however the lists were made.

@group(0) @binding(0) var<uniform> frame: Frame;
// One row per field, see GAUSSIAN_ROWS.
@group(0) @binding(1) var<storage, read> gaussians: array<u32>;
// One row per coefficient and channel.
@group(0) @binding(2) var<storage, read> harmonics: array<u32>;
@group(0) @binding(3) var<storage, read> splats: array<Splat>;
// Place in the order of depth, from 1; 0 when it was skipped.
@group(0) @binding(4) var<storage, read> ranks: array<u32>;
@group(0) @binding(5) var<storage, read> starts: array<u32>;
@group(0) @binding(6) var<storage, read> entries: array<Entry>;
// As adjoint/blend.wgsl writes them.
@group(0) @binding(7) var<storage, read> partials: array<vec4<f32>>;
// First what each Gaussian adds to the camera's pose: translation 3, rotation 3, rows of a length that 256
// divides. Then one row per field: position 3, log-scale 3, rotation 4, opacity logit, band 0 of the
// harmonics 3, centre on the image plane 2, then higher bands; then what is no gradient: statistics (sum of
// the centre's gradients, of blend weights, of pixels), and 1 where a gradient overflowed and counts as 0.
@group(0) @binding(8) var<storage, read_write> gradients: array<f32>;

const LN_2: f32 = 0.6931472;
// Square root of log2(e) / 2.
const BASE_2: f32 = 0.8493218;
// Rows before those of higher bands.
const ROWS: u32 = 16u;
// Rows of the pose.
const POSE_ROWS: u32 = 6u;
const NOWHERE: u32 = 0xffffffffu;

struct Sums {
    a: vec4<f32>,
    b: vec4<f32>,
    c: vec4<f32>,
}

fn field(row: u32, i: u32) -> f32 {
    return bitcast<f32>(gaussians[row * frame.gaussians + i]);
}

fn harmonic(k: u32, i: u32) -> vec3<f32> {
    let n = frame.gaussians;
    return vec3<f32>(
        bitcast<f32>(harmonics[(3u * k) * n + i]),
        bitcast<f32>(harmonics[(3u * k + 1u) * n + i]),
        bitcast<f32>(harmonics[(3u * k + 2u) * n + i]),
    );
}

fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

// Place of splat `i` in the list of `tile`, or NOWHERE.
fn find(tile: u32, i: u32) -> u32 {
    let rank = ranks[i];
    let end = starts[tile + 1u];
    var low = starts[tile];
    var high = end;
    while low < high {
        let middle = low + (high - low) / 2u;
        if ranks[entries[middle].splat] < rank {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    if low < end && entries[low].splat == i {
        return low;
    }
    return NOWHERE;
}

// Gradients of splat `i` from the pixels of all tiles.
fn gather(s: Splat, i: u32) -> Sums {
    var sums: Sums;
    let b = pixel_box(s);
    for (var row = b.z / TILE; row * TILE < b.w; row++) {
        for (var column = b.x / TILE; column * TILE < b.y; column++) {
            let at = find(row * frame.size.z + column, i);
            if at != NOWHERE {
                sums.a += partials[3u * at];
                sums.b += partials[3u * at + 1u];
                sums.c += partials[3u * at + 2u];
            }
        }
    }
    return sums;
}

// Place of a Gaussian in a row of the pose.
fn pose_place(row: u32, i: u32) -> u32 {
    return row * ((frame.gaussians + 255u) / 256u * 256u) + i;
}

// Place of a Gaussian in a row of its fields.
fn place(row: u32, i: u32) -> u32 {
    return pose_place(POSE_ROWS, row * frame.gaussians + i);
}

fn put(row: u32, i: u32, value: f32) {
    gradients[place(row, i)] = value;
}

fn put_pose(row: u32, i: u32, value: vec3<f32>) {
    gradients[pose_place(row, i)] = value.x;
    gradients[pose_place(row + 1u, i)] = value.y;
    gradients[pose_place(row + 2u, i)] = value.z;
}

fn put3(row: u32, i: u32, value: vec3<f32>) {
    put(row, i, value.x);
    put(row + 1u, i, value.y);
    put(row + 2u, i, value.z);
}

// One coefficient: its gradient is `weight · given`, and it turns the view direction by `slope`.
fn band(k: u32, i: u32, given: vec3<f32>, weight: f32, slope: vec3<f32>) -> vec3<f32> {
    put3(ROWS + 3u * k, i, weight * given);
    return dot(given, harmonic(k, i)) * slope;
}

// Writes the gradients of higher bands and returns that of the direction `d`, taken as free.
fn bands(i: u32, d: vec3<f32>, given: vec3<f32>) -> vec3<f32> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let s = d * d;
    let c1 = 0.48860252;
    var sum = band(0u, i, given, -c1 * y, vec3<f32>(0.0, -c1, 0.0));
    sum += band(1u, i, given, c1 * z, vec3<f32>(0.0, 0.0, c1));
    sum += band(2u, i, given, -c1 * x, vec3<f32>(-c1, 0.0, 0.0));
    if frame.degree >= 2u {
        let a = 1.0925485;
        let b = 0.31539157;
        let c = 0.54627422;
        sum += band(3u, i, given, a * x * y, a * vec3<f32>(y, x, 0.0));
        sum += band(4u, i, given, -a * y * z, -a * vec3<f32>(0.0, z, y));
        sum += band(5u, i, given, b * (2.0 * s.z - s.x - s.y), b * vec3<f32>(-2.0 * x, -2.0 * y, 4.0 * z));
        sum += band(6u, i, given, -a * x * z, -a * vec3<f32>(z, 0.0, x));
        sum += band(7u, i, given, c * (s.x - s.y), c * vec3<f32>(2.0 * x, -2.0 * y, 0.0));
    }
    if frame.degree >= 3u {
        let a = -0.5900436;
        let b = 2.8906114;
        let c = -0.4570458;
        let e = 0.37317633;
        let f = 1.4453057;
        sum += band(8u, i, given, a * y * (3.0 * s.x - s.y), a * vec3<f32>(6.0 * x * y, 3.0 * (s.x - s.y), 0.0));
        sum += band(9u, i, given, b * x * y * z, b * vec3<f32>(y * z, x * z, x * y));
        sum += band(10u, i, given, c * y * (4.0 * s.z - s.x - s.y),
            c * vec3<f32>(-2.0 * x * y, 4.0 * s.z - s.x - 3.0 * s.y, 8.0 * y * z));
        sum += band(11u, i, given, e * z * (2.0 * s.z - 3.0 * s.x - 3.0 * s.y),
            e * vec3<f32>(-6.0 * x * z, -6.0 * y * z, 6.0 * s.z - 3.0 * s.x - 3.0 * s.y));
        sum += band(12u, i, given, c * x * (4.0 * s.z - s.x - s.y),
            c * vec3<f32>(4.0 * s.z - 3.0 * s.x - s.y, -2.0 * x * y, 8.0 * x * z));
        sum += band(13u, i, given, f * z * (s.x - s.y), f * vec3<f32>(2.0 * x * z, -2.0 * y * z, s.x - s.y));
        sum += band(14u, i, given, a * x * (s.x - 3.0 * s.y), a * vec3<f32>(3.0 * (s.x - s.y), -6.0 * x * y, 0.0));
    }
    return sum;
}

fn count_rows() -> u32 {
    return ROWS + 3u * ((frame.degree + 1u) * (frame.degree + 1u) - 1u);
}

fn put_statistics(i: u32, statistics: vec3<f32>, overflowed: f32) {
    put3(count_rows(), i, statistics);
    put(count_rows() + 3u, i, overflowed);
}

// Column `k` of the rotation matrix of the unit quaternion `q` (wxyz).
fn local_axis(q: vec4<f32>, k: u32) -> vec3<f32> {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    if k == 0u {
        return vec3<f32>(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y));
    } else if k == 1u {
        return vec3<f32>(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x));
    }
    return vec3<f32>(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// From camera axes to the world's.
fn turned_back(d: vec3<f32>) -> vec3<f32> {
    return frame.view[0].xyz * d.x + frame.view[1].xyz * d.y + frame.view[2].xyz * d.z;
}

fn seen(p: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot(frame.view[0].xyz, p), dot(frame.view[1].xyz, p), dot(frame.view[2].xyz, p));
}

// Gradient of the raw quaternion of length `norm`: across it. `d` are gradients of the matrix's columns.
fn quaternion(q: vec4<f32>, norm: f32, d0: vec3<f32>, d1: vec3<f32>, d2: vec3<f32>) -> vec4<f32> {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    let unit = 2.0 * vec4<f32>(
        x * (d1.z - d2.y) + y * (d2.x - d0.z) + z * (d0.y - d1.x),
        w * (d1.z - d2.y) + y * (d0.y + d1.x) + z * (d0.z + d2.x) - 2.0 * x * (d1.y + d2.z),
        w * (d2.x - d0.z) + x * (d0.y + d1.x) + z * (d1.z + d2.y) - 2.0 * y * (d0.x + d2.z),
        w * (d0.y - d1.x) + x * (d0.z + d2.x) + y * (d1.z + d2.y) - 2.0 * z * (d0.x + d1.y),
    );
    return (unit - dot(unit, q) * q) / norm;
}

fn back(i: u32, s: Splat, sums: Sums) {
    // From sums to the ellipse: exponent = log2_alpha - u² - v².
    let slope_of = -2.0 * LN_2;
    let du = slope_of * sums.a.y;
    let dv = slope_of * sums.a.z;
    let d_mean = -vec2<f32>(s.root.x * du, s.root.y * du + s.root.z * dv);
    let d_root_raw = slope_of * vec3<f32>(sums.a.w, sums.b.x, sums.b.y);
    let colour = vec3<f32>(sums.b.z, sums.b.w, sums.c.x);

    let position = vec3<f32>(field(0u, i), field(1u, i), field(2u, i));
    let scale = vec3<f32>(field(3u, i), field(4u, i), field(5u, i));
    var q = vec4<f32>(field(6u, i), field(7u, i), field(8u, i), field(9u, i));
    let norm = length(q);
    q /= norm;
    let turned = seen(position);
    let moved = vec3<f32>(frame.view[0].w, frame.view[1].w, frame.view[2].w);
    let there = turned + moved;
    let z = there.z;
    let gain = frame.focal.xy / z;
    let straight = there.xy / z;
    let slope = clamp(straight, frame.slope.xz, frame.slope.yw);

    // The factor of the covariance, in units of its largest side.
    let a0 = scale.x * seen(local_axis(q, 0u));
    let a1 = scale.y * seen(local_axis(q, 1u));
    let a2 = scale.z * seen(local_axis(q, 2u));
    let deep = vec3<f32>(a0.z, a1.z, a2.z);
    var u = gain.x * (vec3<f32>(a0.x, a1.x, a2.x) - slope.x * deep);
    var v = gain.y * (vec3<f32>(a0.y, a1.y, a2.y) - slope.y * deep);
    let sides = max(abs(u), abs(v));
    let unit = max(max(max(sides.x, sides.y), sides.z), sqrt(frame.low_pass));
    u /= unit;
    v /= unit;
    let low_pass = frame.low_pass / unit / unit;
    let area = cross(u, v);
    let det0 = dot(area, area);
    let c = dot(v, v) + low_pass;
    let det = det0 + low_pass * (dot(u, u) + dot(v, v)) + low_pass * low_pass;
    let root = s.root * unit;
    let d_root = d_root_raw / unit;

    // root = BASE_2 · [√c / √det, -b / (√c √det), 1 / √c] with b = u·v.
    let d_c = (d_root.x * root.x - d_root.y * root.y - d_root.z * root.z) / (2.0 * c);
    let d_b = -d_root.y * BASE_2 / (sqrt(c) * sqrt(det));
    var d_det = -(d_root.x * root.x + d_root.y * root.y) / (2.0 * det);
    var d_det0 = 0.0;
    if (frame.flags & FLAG_ANTIALIASED) != 0u && sqrt(det0 / det) > MIN_COMPENSATION {
        let dimming = 0.5 * sums.a.x;
        d_det0 += dimming / det0;
        d_det -= dimming / det;
    }
    d_det0 += d_det;
    let dilation = low_pass * d_det;
    let d_area = 2.0 * d_det0 * area;
    let d_u = (cross(v, d_area) + 2.0 * dilation * u + d_b * v) / unit;
    let d_v = (cross(d_area, u) + 2.0 * (d_c + dilation) * v + d_b * u) / unit;

    // u = gain · (axes' x - slope · axes' z), v likewise from y.
    let d_x = gain.x * d_u;
    let d_y = gain.y * d_v;
    let d_z = -slope.x * d_x - slope.y * d_y;
    var d_there = vec3<f32>(d_mean * gain, 0.0);
    d_there.z -= dot(d_mean * gain, straight);
    d_there.z -= unit * (dot(d_u, u) + dot(d_v, v)) / z;
    let d_slope = -vec2<f32>(dot(d_x, deep), dot(d_y, deep));
    if slope.x == straight.x {
        d_there.x += d_slope.x / z;
        d_there.z -= d_slope.x * slope.x / z;
    }
    if slope.y == straight.y {
        d_there.y += d_slope.y / z;
        d_there.z -= d_slope.y * slope.y / z;
    }

    // Colour, gated where it was clamped at 0, and the direction it is seen from.
    let given = select(vec3<f32>(0.0), colour, s.colour > vec3<f32>(0.0));
    var d_offset = vec3<f32>(0.0);
    if frame.degree > 0u {
        let far = length(there);
        let d = turned_back(there / far);
        let towards = bands(i, d, given);
        d_offset = (towards - dot(towards, d) * d) / far;
    }
    let d_position = turned_back(d_there) + d_offset;

    let d0 = vec3<f32>(d_x.x, d_y.x, d_z.x);
    let d1 = vec3<f32>(d_x.y, d_y.y, d_z.y);
    let d2 = vec3<f32>(d_x.z, d_y.z, d_z.z);
    let d_log_scale = vec3<f32>(dot(d0, a0), dot(d1, a1), dot(d2, a2));
    let d_q = quaternion(
        q, norm, scale.x * turned_back(d0), scale.y * turned_back(d1), scale.z * turned_back(d2),
    );
    // Pose: there = R·p + t, axes = R·…, offset = p + Rᵀ·t.
    let d_view = seen(d_offset);
    put_pose(0u, i, d_there + d_view);
    let by_shape = cross(a0, d0) + cross(a1, d1) + cross(a2, d2);
    put_pose(3u, i, cross(turned, d_there) + cross(d_view, moved) + by_shape);
    put3(0u, i, d_position);
    put3(3u, i, d_log_scale);
    put(6u, i, d_q.x);
    put(7u, i, d_q.y);
    put(8u, i, d_q.z);
    put(9u, i, d_q.w);
    put(10u, i, sums.a.x * (1.0 - min(field(10u, i), 1.0)));
    put3(11u, i, 0.2820948 * given);
    put(14u, i, d_mean.x);
    put(15u, i, d_mean.y);
}

@compute @workgroup_size(256)
fn project_back(
    @builtin(workgroup_id) id: vec3<u32>,
    @builtin(num_workgroups) count: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let i = (id.x + id.y * count.x) * WORKGROUP + thread;
    if i >= frame.gaussians {
        return;
    }
    var statistics = vec3<f32>(0.0);
    var overflowed = 0.0;
    if ranks[i] != 0u {
        let s = splats[i];
        let sums = gather(s, i);
        statistics = vec3<f32>(2.0 * LN_2 * sums.c.y, sums.c.zw);
        back(i, s, sums);
        // All or nothing: a gradient that overflowed is none.
        var good = true;
        for (var row = 0u; row < count_rows(); row++) {
            good = good && is_finite(gradients[place(row, i)]);
        }
        for (var row = 0u; row < POSE_ROWS; row++) {
            good = good && is_finite(gradients[pose_place(row, i)]);
        }
        if good {
            put_statistics(i, statistics, 0.0);
            return;
        }
        overflowed = 1.0;
    }
    for (var row = 0u; row < count_rows(); row++) {
        put(row, i, 0.0);
    }
    put_pose(0u, i, vec3<f32>(0.0));
    put_pose(3u, i, vec3<f32>(0.0));
    put_statistics(i, statistics, overflowed);
}
