//! Undoes the filters of attributes: directions, quaternions, floats and colours from a few bits each.

use crate::scene::import::bytes::array;

/// Directions of four bytes or four 16-bit numbers, by two coordinates on an octahedron.
pub fn octahedral(data: &mut [u8], stride: usize) {
    each(data, stride, |[x, y, one, rest], full| {
        let one = f32::from(one);
        let (x, y) = (f32::from(x) / one, f32::from(y) / one);
        let z = 1.0 - x.abs() - y.abs();
        // What is below the equator is folded over the corners.
        let fold = z.min(0.0);
        let (x, y) = (x - fold.copysign(x), y - fold.copysign(y));
        let length = (x * x + y * y + z * z).sqrt();
        let [x, y, z] = [x, y, z].map(|v| (v / length * full).round() as i16);
        [x, y, z, rest]
    });
}

/// Quaternions of four 16-bit numbers, by the three smaller ones.
pub fn quaternion(data: &mut [u8]) {
    each(data, 8, |[x, y, z, last], full| {
        let one = f32::from(last | 3);
        let [x, y, z] = [x, y, z].map(|v| f32::from(v) / one * std::f32::consts::FRAC_1_SQRT_2);
        let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
        let mut out = [0; 4];
        let largest = (last & 3) as usize;
        for (place, value) in [w, x, y, z].into_iter().enumerate() {
            out[(largest + place) % 4] = (value * full).round() as i16;
        }
        out
    });
}

/// Floats of an exponent of 8 bits and a whole number of 24.
pub fn exponential(data: &mut [u8]) {
    for bytes in data.chunks_exact_mut(4) {
        let packed = i32::from_le_bytes(array(bytes, 0).unwrap_or_default());
        // Exact: a 64-bit float holds all 24 bits at any such exponent.
        let value = f64::from(packed << 8 >> 8) * 2f64.powi(packed >> 24);
        bytes.copy_from_slice(&(value as f32).to_le_bytes());
    }
}

/// Colours of four bytes or four 16-bit numbers, by brightness and two differences of colour.
pub fn colour(data: &mut [u8], stride: usize) {
    each(data, stride, |[y, co, cg, alpha], full| {
        // Signs do not matter to brightness and alpha.
        let mask = if stride == 4 { 0xff } else { 0xffff };
        let (y, alpha) = (i32::from(y) & mask, i32::from(alpha) & mask);
        let (co, cg) = (i32::from(co), i32::from(cg));
        let bits = 32 - alpha.leading_zeros();
        let most = (1i32 << bits) - 1;
        let alpha = alpha & most >> 1;
        let alpha = alpha << 1 | alpha & 1;
        let brightest = 2.0 * full + 1.0;
        let scale = brightest / most as f32;
        let unsigned = |v: i32| (v as f32 * scale).round().clamp(0.0, brightest) as u16 as i16;
        [y + co - cg, y + cg, y - co - cg, alpha].map(unsigned)
    });
}

/// Replaces each four numbers of `stride / 4` bytes; `change` also gets the largest such signed number.
fn each(data: &mut [u8], stride: usize, change: impl Fn([i16; 4], f32) -> [i16; 4]) {
    for element in data.chunks_exact_mut(stride) {
        if stride == 4 {
            let [x, y, z, w]: [u8; 4] = array(element, 0).unwrap_or_default();
            let changed = change([x, y, z, w].map(|v| i16::from(v as i8)), 127.0);
            element.copy_from_slice(&changed.map(|v| v as u8));
        } else {
            let number = |i: usize| i16::from_le_bytes(array(element, 2 * i).unwrap_or_default());
            let changed = change([0, 1, 2, 3].map(number), 32_767.0).map(i16::to_le_bytes);
            element.copy_from_slice(changed.as_flattened());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(values: [i16; 4]) -> [u8; 8] {
        std::array::from_fn(|i| values[i / 2].to_le_bytes()[i % 2])
    }

    #[test]
    fn directions_and_quaternions_are_of_unit_length() {
        let mut data = words([0, 0, 511, 9]);
        octahedral(&mut data, 8);
        assert_eq!(data, words([0, 0, 32_767, 9]));
        // A corner of the fold is straight down.
        let mut data = words([511, 511, 511, 0]);
        octahedral(&mut data, 8);
        assert_eq!(data, words([0, 0, -32_767, 0]));
        let mut data = [0x7f, 0, 0x7f, 5];
        octahedral(&mut data, 4);
        assert_eq!(data, [0x7f, 0, 0, 5]);
        let mut data = words([0, 0, 0, 0x7ffc | 2]);
        quaternion(&mut data);
        assert_eq!(data, words([0, 0, 32_767, 0]));
        let mut data = words([2047, 0, 0, 2044]);
        quaternion(&mut data);
        assert_eq!(data, words([23_170, 23_170, 0, 0]));
    }

    #[test]
    fn floats_are_exact() {
        let mut data = [(-3i32 << 24 | 5).to_le_bytes(), (-7i32 & 0xff_ffff).to_le_bytes()].concat();
        exponential(&mut data);
        assert_eq!(data, [0.625f32.to_le_bytes(), (-7f32).to_le_bytes()].concat());
    }

    #[test]
    fn colours_come_back() {
        // Eight bits of each: white, then red at half opacity.
        let mut data = [255, 0, 0, 255, 64, 127, (-64i8) as u8, 0xc0];
        colour(&mut data, 4);
        assert_eq!(data, [255, 255, 255, 255, 255, 0, 1, 128]);
        // Nothing of it makes a panic.
        let mut data = [0, 255, 255, 0];
        colour(&mut data, 4);
    }
}
