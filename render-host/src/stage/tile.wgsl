// Inside a tile: what all blending kernels share, so that they give the same bits.

// Pixel of a thread: neighbouring threads cover 8 × 4 pixels, so that those of one subgroup agree more often.
fn pixel_of(thread: u32) -> vec2<u32> {
    let block = thread / 32u;
    return vec2<u32>((block % 2u) * 8u + thread % 8u, (block / 2u) * 4u + (thread / 8u) % 4u);
}

// log2 of alpha at pixel `at` of the tile, from `near` (u, v at its first pixel, log2 of alpha).
fn log2_alpha_in_tile(near: vec3<f32>, root: vec3<f32>, at: vec2<f32>) -> f32 {
    let u = fma(root.x, at.x, fma(root.y, at.y, near.x));
    let v = fma(root.z, at.y, near.y);
    return log2_alpha_at(near.z, u, v);
}
