// All blending kernels share these functions inside a tile, so that they give the same bits.

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

// A bit per 8 × 4 block of pixels in which the splat may reach the cut-off: the threads of a block, which
// are neighbours, leave out the others together. Bounds of u and v over the block are taken apart, so a
// block may be marked in vain and is never missed; what is left out would add 0, so no bit of the picture
// depends on it.
fn blocks_of(near: vec3<f32>, root: vec3<f32>, log2_cutoff: f32) -> u32 {
    let reach = near.z - log2_cutoff + 2.0 * REACH_MARGIN;
    // Half the width of u and of v over a block, and what rounding may add.
    let half_u = fma(3.5, root.x, 1.5 * abs(root.y)) * 1.00001 + 1e-6 * abs(near.x);
    let half_v = 1.5 * root.z * 1.00001 + 1e-6 * abs(near.y);
    var hit = 0u;
    for (var block = 0u; block < 8u; block++) {
        let middle = vec2<f32>(f32(block % 2u) * 8.0 + 3.5, f32(block / 2u) * 4.0 + 1.5);
        let u = abs(fma(root.x, middle.x, fma(root.y, middle.y, near.x)));
        let v = abs(fma(root.z, middle.y, near.y));
        let du = max(u - half_u, 0.0);
        let dv = max(v - half_v, 0.0);
        hit |= select(0u, 1u << block, fma(du, du, dv * dv) <= reach);
    }
    return hit;
}
