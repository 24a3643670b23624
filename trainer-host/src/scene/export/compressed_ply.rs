//! Writes PlayCanvas compressed PLY: sixteen bytes a Gaussian and ranges for every 256, harmonics as bytes.
//!
//! Gaussians are put in Morton order, so that those of a chunk lie together and its ranges are short: rows
//! are not those of the scene. What each number means is in `import::compressed_ply`.

use super::{display_colour, morton_order, sigmoid};
use crate::scene::{
    Attributes, Epoch,
    import::compressed_ply::{COLOURS, PLACES},
};

const CHUNK: usize = 256;

/// Frame `t` of `epoch` as a compressed PLY. `t` must be below the epoch's frame count.
pub fn encode(epoch: &Epoch, t: usize) -> Vec<u8> {
    let (n, a) = (epoch.count(), epoch.attributes());
    let rest = a.sh_degree.rest_len();
    let order = morton_order(a.positions.frame(t, n));
    let mut head = "ply\nformat binary_little_endian 1.0\n".to_owned();
    head += &format!("element chunk {}\n", n.div_ceil(CHUNK));
    PLACES.iter().chain(&COLOURS).for_each(|name| head += &format!("property float {name}\n"));
    head += &format!("element vertex {n}\n");
    for name in ["position", "rotation", "scale", "color"] {
        head += &format!("property uint packed_{name}\n");
    }
    if rest > 0 {
        head += &format!("element sh {n}\n");
        (0..rest).for_each(|i| head += &format!("property uchar f_rest_{i}\n"));
    }
    head += "end_header\n";

    let mut out = head.into_bytes();
    let mut words = Vec::with_capacity(16 * n);
    for chunk in order.chunks(CHUNK) {
        let ranges = ranges(a, t, n, chunk);
        out.extend(ranges.iter().flatten().flat_map(|v| v.to_le_bytes()));
        for &i in chunk {
            words.extend(packed(a, t, n, i as usize, &ranges).into_iter().flat_map(u32::to_le_bytes));
        }
    }
    out.extend(words);
    for &i in order.iter().filter(|_| rest > 0) {
        let bands = &a.sh_rest[i as usize * rest..(i as usize + 1) * rest];
        // Channel after channel.
        let channels = (0..3).flat_map(|channel| bands.iter().skip(channel).step_by(3));
        out.extend(channels.map(|v| in_steps(*v).floor().clamp(0.0, 255.0) as u8));
    }
    out
}

/// A harmonic above band 0 in steps of its byte, of which the first begins at 0.
fn in_steps(harmonic: f32) -> f32 {
    (harmonic / 8.0 + 0.5) * 256.0
}

/// Gaussians of `epoch` that have a harmonic above band 0 which the format does not hold.
pub(super) fn beyond_in_harmonics(epoch: &Epoch) -> usize {
    // Half a step beyond is still as near as steps are.
    super::beyond_in_harmonics(epoch, |_, value| (-0.5..=256.5).contains(&in_steps(value)))
}

/// Position, log-scale and display colour of a Gaussian.
fn values(a: &Attributes, t: usize, n: usize, i: usize) -> [[f32; 3]; 3] {
    [a.positions.frame(t, n)[i], a.log_scales.frame(t, n)[i], a.sh0.frame(t, n)[i].map(display_colour)]
}

/// Least and greatest position, log-scale and colour of a chunk, in the order of [`PLACES`] and
/// [`COLOURS`].
fn ranges(a: &Attributes, t: usize, n: usize, chunk: &[u32]) -> [[f32; 3]; 6] {
    let mut out = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]].repeat(3);
    for &i in chunk {
        for (what, value) in values(a, t, n, i as usize).into_iter().enumerate() {
            for axis in 0..3 {
                out[2 * what][axis] = out[2 * what][axis].min(value[axis]);
                out[2 * what + 1][axis] = out[2 * what + 1][axis].max(value[axis]);
            }
        }
    }
    [out[0], out[1], out[2], out[3], out[4], out[5]]
}

/// The four words of a Gaussian.
fn packed(a: &Attributes, t: usize, n: usize, i: usize, ranges: &[[f32; 3]; 6]) -> [u32; 4] {
    let [position, scale, colour] = values(a, t, n, i);
    let unit = |what: usize, value: [f32; 3]| -> [f32; 3] {
        let (low, high) = (ranges[2 * what], ranges[2 * what + 1]);
        std::array::from_fn(|axis| {
            let width = high[axis] - low[axis];
            if width > 0.0 { ((value[axis] - low[axis]) / width).clamp(0.0, 1.0) } else { 0.0 }
        })
    };
    let steps = |value: f32, most: u32| (value * most as f32).round() as u32;
    let eleven_ten_eleven =
        |[x, y, z]: [f32; 3]| steps(x, 2047) << 21 | steps(y, 1023) << 11 | steps(z, 2047);
    let [r, g, b] = unit(2, colour);
    let alpha = sigmoid(a.opacity_logits.frame(t, n)[i]);
    let rgba = steps(r, 255) << 24 | steps(g, 255) << 16 | steps(b, 255) << 8 | steps(alpha, 255);
    let rotation = quaternion(a.rotations.frame(t, n)[i]);
    [eleven_ten_eleven(unit(0, position)), rotation, eleven_ten_eleven(unit(1, scale)), rgba]
}

/// Two bits for the largest of wxyz, ten for each of the others.
fn quaternion(q: [f32; 4]) -> u32 {
    let (largest, three) = super::smallest_three(q);
    let word = |v: f32| ((v / std::f32::consts::SQRT_2 + 0.5) * 1023.0).round().clamp(0.0, 1023.0) as u32;
    three.iter().fold(largest as u32, |out, &v| out << 10 | word(v))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{
        export::tests::{assert_close, epoch, in_order},
        import::{self, Limits},
    };

    #[test]
    fn files_read_back_within_their_steps() {
        let epoch = epoch(700, 2);
        let bytes = encode(&epoch, 0);
        let again = import::compressed_ply::parse(&bytes, &Limits::default()).unwrap().epoch;
        let order = morton_order(epoch.attributes().positions.frame(0, 700));
        let sorted = in_order(&epoch, &order);
        // Chunks are small, so that a thousandth of their width is far less than this.
        assert_close("position", &sorted, &again, 0.02, |a, n, i| a.positions.frame(0, n)[i].to_vec());
        assert_close("scale", &sorted, &again, 0.01, |a, n, i| a.log_scales.frame(0, n)[i].to_vec());
        assert_close("colour", &sorted, &again, 0.01, |a, n, i| a.sh0.frame(0, n)[i].to_vec());
        assert_close("rotation", &sorted, &again, 0.003, |a, n, i| a.rotations.frame(0, n)[i].to_vec());
        assert_close("bands", &sorted, &again, 0.017, |a, _, i| a.sh_rest[24 * i..24 * i + 24].to_vec());
    }

    #[test]
    fn one_gaussian_has_ranges_of_no_width() {
        let epoch = epoch(1, 0);
        let again = import::compressed_ply::parse(&encode(&epoch, 0), &Limits::default()).unwrap().epoch;
        assert_eq!(again.attributes().positions, epoch.attributes().positions);
    }
}
