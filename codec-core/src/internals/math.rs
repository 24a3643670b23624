//! The few functions decoding needs beyond + − × ÷ √, written so that every target computes the
//! same bits: fixed order, no fused multiply-add, no platform library.

/// e^x for finite x, relative error under 3e-7 in -80..=80; clamped outside.
///
/// Range reduction by powers of two and a degree-6 polynomial (Taylor, on ±ln2/2).
pub fn exp(x: f32) -> f32 {
    let x = x.clamp(-80.0, 80.0);
    // Round to nearest without a float function: the cast truncates towards zero.
    let scaled = x * core::f32::consts::LOG2_E;
    let n = (scaled + if scaled < 0.0 { -0.5 } else { 0.5 }) as i32;
    let nf = n as f32;
    // ln 2 in two parts keeps the reduced argument exact to about 2^-33.
    let r = (x - nf * 0.693_359_4) + nf * 2.121_944_4e-4;
    let mut p = 1.388_888_9e-3;
    for c in [8.333_334e-3, 4.166_666_7e-2, 1.666_666_7e-1, 0.5, 1.0, 1.0] {
        p = p * r + c;
    }
    p * f32::from_bits(((n + 127) as u32) << 23)
}

/// [`exp`] of each of `values`.
#[inline(never)]
pub fn exp_all(values: &mut [f32]) {
    values.iter_mut().for_each(|value| *value = exp(*value));
}

/// cos(π · num / den) for `den` ≥ 1, absolute error under 1e-7; exact at multiples of π/2.
pub fn cos_pi(num: u32, den: u32) -> f32 {
    let den = u64::from(den.max(1));
    // Position on the circle in units of π / den, then folded to the first quadrant.
    let turn = u64::from(num) % (2 * den);
    let turn = if turn > den { 2 * den - turn } else { turn };
    let (fold, sign) = if 2 * turn > den { (den - turn, -1.0f64) } else { (turn, 1.0) };
    let x = core::f64::consts::PI * fold as f64 / den as f64;
    if 2 * fold == den {
        return 0.0;
    }
    let s = x * x;
    // Taylor to x^16: below 1e-13 on 0..=π/2.
    let mut p = 4.779_477_332_387_385e-14;
    for c in [
        -1.147_074_559_772_972_5e-11,
        2.087_675_698_786_81e-9,
        -2.755_731_922_398_589e-7,
        2.480_158_730_158_73e-5,
        -1.388_888_888_888_889e-3,
        4.166_666_666_666_666_4e-2,
        -0.5,
        1.0,
    ] {
        p = p * s + c;
    }
    (sign * p) as f32
}

/// `q` at unit length; one too short to have a direction becomes the identity.
pub fn normalised(q: [f32; 4]) -> [f32; 4] {
    let length2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    if !(length2 > 1e-12 && length2 < 1e12) {
        return [1.0, 0.0, 0.0, 0.0];
    }
    let scale = 1.0 / libm::sqrtf(length2);
    q.map(|v| v * scale)
}

/// [`normalised`] of many quaternions, component by component: branches and roots apart from what
/// vectors do.
#[inline(never)]
pub fn normalise<const N: usize>([w, x, y, z]: [&mut [f32; N]; 4]) {
    let mut scale = [0f32; N];
    for ((((scale, w), x), y), z) in scale.iter_mut().zip(&*w).zip(&*x).zip(&*y).zip(&*z) {
        let length2 = w * w + x * x + y * y + z * z;
        *scale = if length2 > 1e-12 && length2 < 1e12 { length2 } else { 0.0 };
    }
    scale.iter_mut().for_each(|scale| *scale = libm::sqrtf(*scale));
    // No direction: an infinite scale.
    scale.iter_mut().for_each(|scale| *scale = 1.0 / *scale);
    for (component, identity) in [w, x, y, z].into_iter().zip([1.0, 0.0, 0.0, 0.0]) {
        scaled(component, &scale, identity);
    }
}

#[inline(never)]
fn scaled(component: &mut [f32], scale: &[f32], identity: f32) {
    for (v, &scale) in component.iter_mut().zip(scale) {
        *v = if scale < f32::INFINITY { *v * scale } else { identity };
    }
}

/// Hamilton product a ⊗ b, wxyz.
pub fn quat_mul(a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
    let [aw, ax, ay, az] = a;
    let [bw, bx, by, bz] = b;
    [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
}

/// The unit quaternion of modified Rodrigues parameters `v` = xyz / (1 + w), |v| ≤ 1 for w ≥ 0.
///
/// Only + × ÷, no singularity for w ≥ 0: that is why rotations are quantised in this form.
pub fn quat_from_mrp(v: [f32; 3]) -> [f32; 4] {
    let n = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    let k = 2.0 / (1.0 + n);
    [(1.0 - n) / (1.0 + n), v[0] * k, v[1] * k, v[2] * k]
}

/// Modified Rodrigues parameters of the unit quaternion `q` (or −q, whichever has w ≥ 0).
pub fn mrp_from_quat(q: [f32; 4]) -> [f32; 3] {
    let sign = if q[0] < 0.0 { -1.0 } else { 1.0 };
    let k = sign / (1.0 + q[0] * sign);
    [q[1] * k, q[2] * k, q[3] * k]
}

/// A 3 × 3 matrix, rows first.
pub type Rows = [[f32; 3]; 3];

/// The rotation matrix of unit quaternion `q`, wxyz.
pub fn rows_from_quat(q: [f32; 4]) -> Rows {
    let [w, x, y, z] = q;
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Steps of the iteration in [`turn_of`]: enough for scales of up to a factor of ten.
pub const TURN_STEPS: usize = 8;

/// The rotation part of linear map `m` as a unit quaternion, wxyz: Newton's iteration for the polar
/// decomposition, M ← (M + M⁻ᵀ) / 2, [`TURN_STEPS`] times. A map that mirrors, or that collapses or
/// inflates volume beyond 1e±6, has none and gives the identity.
pub fn turn_of(m: Rows) -> [f32; 4] {
    let mut m = m;
    for _ in 0..TURN_STEPS {
        let [a, b, c] = m;
        let cofactors = [cross(b, c), cross(c, a), cross(a, b)];
        let [x, y, z] = cofactors[0];
        let volume = a[0] * x + a[1] * y + a[2] * z;
        if !(volume > 1e-6 && volume < 1e6) {
            return [1.0, 0.0, 0.0, 0.0];
        }
        let inverse = 1.0 / volume;
        for (row, cofactors) in m.iter_mut().zip(cofactors) {
            for (value, cofactor) in row.iter_mut().zip(cofactors) {
                *value = 0.5 * (*value + cofactor * inverse);
            }
        }
    }
    let [[a, b, c], [d, e, f], [g, h, i]] = m;
    let q = if a + e + i > 0.0 {
        [1.0 + a + e + i, h - f, c - g, d - b]
    } else if a >= e && a >= i {
        [h - f, 1.0 + a - e - i, b + d, c + g]
    } else if e >= i {
        [c - g, b + d, 1.0 - a + e - i, f + h]
    } else {
        [d - b, c + g, f + h, 1.0 - a - e + i]
    };
    normalised(q)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    extern crate std;

    proptest! {
        #[test]
        fn exp_is_within_its_stated_error(x in -80f32..80.0) {
            let exact = f64::from(x).exp();
            prop_assert!(((f64::from(exp(x)) - exact) / exact).abs() < 3e-7);
        }

        #[test]
        fn cos_is_within_its_stated_error(num in 0u32..5000, den in 1u32..300) {
            let exact = (std::f64::consts::PI * f64::from(num) / f64::from(den)).cos();
            prop_assert!((f64::from(cos_pi(num, den)) - exact).abs() < 1e-7);
        }

        #[test]
        fn rotations_survive_rodrigues(w in 0.0f32..1.0, x in -1f32..1.0, y in -1f32..1.0, z in -1f32..1.0) {
            prop_assume!(w * w + x * x + y * y + z * z > 1e-3);
            let q = normalised([w, x, y, z]);
            let v = mrp_from_quat(q);
            prop_assert!(v.iter().map(|v| v * v).sum::<f32>() <= 1.0001);
            let back = quat_from_mrp(v);
            for (a, b) in q.iter().zip(back) { prop_assert!((a - b).abs() < 1e-6); }
        }
    }

    proptest! {
        #[test]
        fn the_turn_of_a_stretched_rotation_is_the_rotation(
            w in -1f32..1.0, x in -1f32..1.0, y in -1f32..1.0, z in -1f32..1.0,
            factors in proptest::array::uniform3(0.4f32..2.5),
        ) {
            prop_assume!(w * w + x * x + y * y + z * z > 1e-3);
            let q = normalised([w, x, y, z]);
            // R · S with S symmetric positive is a polar decomposition.
            let map = rows_from_quat(q).map(|row| [0, 1, 2].map(|c| row[c] * factors[c]));
            let found = turn_of(map);
            let dot: f32 = q.iter().zip(found).map(|(a, b)| a * b).sum();
            prop_assert!(dot.abs() > 1.0 - 1e-5, "{q:?} {found:?}");
        }
    }

    #[test]
    fn many_are_normalised_like_one() {
        let (big, small) = (9e5f32, 2e-7f32);
        let some = [
            [1.0, 2.0, -3.0, 0.5],
            [0.0; 4],
            [f32::NAN; 4],
            [f32::MAX; 4],
            [big; 4],
            [big / 2.0; 4],
            [small; 4],
            [4.0 * small; 4],
            [-0.0, 0.1, f32::INFINITY, 0.0],
        ];
        let [mut w, mut x, mut y, mut z] = [0, 1, 2, 3].map(|c| some.map(|q| q[c]));
        normalise([&mut w, &mut x, &mut y, &mut z]);
        for (i, q) in some.into_iter().enumerate() {
            assert_eq!([w[i], x[i], y[i], z[i]].map(f32::to_bits), normalised(q).map(f32::to_bits), "{q:?}");
        }
    }

    #[test]
    fn maps_without_a_rotation_turn_nothing() {
        let identity = [1.0, 0.0, 0.0, 0.0];
        let mirror = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]];
        for map in [[[0.0; 3]; 3], [[1e9; 3]; 3], [[f32::NAN; 3]; 3], mirror] {
            assert_eq!(turn_of(map), identity);
        }
    }

    #[test]
    fn exact_places() {
        assert_eq!(
            (exp(0.0), cos_pi(0, 7), cos_pi(1, 2), cos_pi(3, 3), cos_pi(9, 6)),
            (1.0, 1.0, 0.0, -1.0, 0.0)
        );
        assert_eq!(normalised([0.0; 4]), [1.0, 0.0, 0.0, 0.0]);
        assert_eq!(normalised([f32::NAN; 4]), [1.0, 0.0, 0.0, 0.0]);
    }
}
