//! Makes compressed PLY from formulas.

/// A file of `n` Gaussians.
pub fn compressed_ply(n: usize) -> Vec<u8> {
    let chunks = n.div_ceil(256);
    let mut out = format!("ply\nformat binary_little_endian 1.0\nelement chunk {chunks}\n");
    for kind in ["", "scale_"] {
        for end in ["min", "max"] {
            for axis in ["x", "y", "z"] {
                out += &format!("property float {end}_{kind}{axis}\n");
            }
        }
    }
    out += &format!("element vertex {n}\n");
    for name in ["position", "rotation", "scale", "color"] {
        out += &format!("property uint packed_{name}\n");
    }
    let mut out = (out + "end_header\n").into_bytes();
    for _ in 0..chunks {
        for v in [-1.0f32, -2.0, -3.0, 1.0, 2.0, 3.0, -8.0, -8.0, -8.0, -2.0, -2.0, -2.0] {
            out.extend(v.to_le_bytes());
        }
    }
    for i in 0..n as u32 {
        let position = (i * 37 % 2048) << 21 | (i * 11 % 1024) << 11 | (i * 5 % 2048);
        for word in [position, (i % 4) << 30 | 512 << 20 | 600 << 10 | 400, u32::MAX, 0xff00_80ff] {
            out.extend(word.to_le_bytes());
        }
    }
    out
}
