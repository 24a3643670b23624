//! Writes `.splat`: headerless records of 32 bytes, as `import::splat` reads them.
//!
//! Positions and sizes are exact; colour and opacity are bytes, rotations bytes of each component.
//! Harmonics above band 0 are left out: the format has none.

use super::{byte, display_colour, sigmoid};
use crate::scene::Epoch;

/// Frame `t` of `epoch` as records. `t` must be below the epoch's frame count.
pub fn encode(epoch: &Epoch, t: usize) -> Vec<u8> {
    let (n, a) = (epoch.count(), epoch.attributes());
    let (p, q) = (a.positions.frame(t, n), a.rotations.frame(t, n));
    let (s, o, c) = (a.log_scales.frame(t, n), a.opacity_logits.frame(t, n), a.sh0.frame(t, n));
    let mut out = Vec::with_capacity(32 * n);
    for i in 0..n {
        let floats = p[i].into_iter().chain(s[i].map(f32::exp));
        out.extend(floats.flat_map(f32::to_le_bytes));
        out.extend(c[i].map(|c| byte(display_colour(c))));
        out.push(byte(sigmoid(o[i])));
        // 128 is zero; one is cut to 255.
        out.extend(q[i].map(|v| (v * 128.0 + 128.0).round().clamp(0.0, 255.0) as u8));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{
        export::tests::{assert_close, epoch},
        import::{self, Limits},
    };

    #[test]
    fn records_read_back_within_half_a_byte() {
        let epoch = epoch(300, 0);
        let bytes = encode(&epoch, 0);
        assert_eq!(bytes.len(), 300 * 32);
        let again = import::splat::parse(&bytes, &Limits::default()).unwrap().epoch;
        let (a, b) = (epoch.attributes(), again.attributes());
        assert_eq!(a.positions, b.positions);
        assert_close("scale", &epoch, &again, 1e-6, |a, n, i| a.log_scales.frame(0, n)[i].to_vec());
        assert_close("colour", &epoch, &again, 0.51 / 255.0 / 0.282, |a, n, i| a.sh0.frame(0, n)[i].to_vec());
        assert_close("rotation", &epoch, &again, 0.02, |a, n, i| a.rotations.frame(0, n)[i].to_vec());
    }
}
