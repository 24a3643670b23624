// Blending kernels share this: splats of a tile's list pass through workgroup memory in batches, already
// turned to the tile's own coordinates. Put after tile.wgsl; what uses it goes on with binding 4.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> entries: array<u32>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;

const BATCH: u32 = 256u;

// u and v at the tile's first pixel, log2 of alpha, first of the factor.
var<workgroup> near: array<vec4<f32>, 256>;
// The rest of the factor, red, green.
var<workgroup> shape: array<vec4<f32>, 256>;
var<workgroup> blue: array<f32, 256>;
// Blocks of pixels that the splat may reach.
var<workgroup> blocks: array<u32, 256>;
// The same seen from the blocks: eight words each, a bit per splat.
var<workgroup> reaching: array<u32, 64>;
var<workgroup> open: atomic<u32>;
var<workgroup> still_open: u32;

// Puts `s` in place `thread` of the batch; returns u and v at the tile's first pixel and log2 of alpha.
fn put(s: Splat, thread: u32, corner: vec2<u32>) -> vec3<f32> {
    let here = vec3<f32>(axes(s, corner), s.log2_alpha);
    near[thread] = vec4<f32>(here, s.root.x);
    shape[thread] = vec4<f32>(s.root.yz, s.colour.xy);
    blue[thread] = s.colour.z;
    return here;
}

// Word `word` of `reaching`.
fn turned(word: u32) -> u32 {
    let block = word / 8u;
    let first = (word % 8u) * 32u;
    var bits = 0u;
    for (var i = 0u; i < 32u; i++) {
        // Threads begin at different places, so that they do not wait for one bank of memory.
        let k = (i + word) % 32u;
        bits |= ((blocks[first + k] >> block) & 1u) << k;
    }
    return bits;
}
