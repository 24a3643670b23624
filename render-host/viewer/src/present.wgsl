// Shows the picture that the stages made: over its background, pixel for pixel, on a canvas.

struct Shape {
    background: vec4<f32>,
    size: vec2<u32>,
    padding: vec2<u32>,
}

@group(0) @binding(0) var<uniform> shape: Shape;
// r, g, b without background and transmittance, row by row.
@group(0) @binding(1) var<storage, read> image: array<vec4<f32>>;

// One triangle that covers everything.
@vertex
fn corner(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    let x = f32(index & 1u) * 4.0 - 1.0;
    let y = f32(index >> 1u) * 4.0 - 1.0;
    return vec4<f32>(x, y, 0.0, 1.0);
}

// Splat colours are display colours: they are written unchanged.
@fragment
fn colour(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let pixel = min(vec2<u32>(position.xy), shape.size - 1u);
    let sum = image[pixel.y * shape.size.x + pixel.x];
    return vec4<f32>(sum.rgb + sum.a * shape.background.rgb, 1.0);
}
