// Shows the picture that the stages made: over its background, scaled to what it is shown on.

struct Shape {
    background: vec4<f32>,
    // Of the picture, and of what it is shown on, pixels.
    size: vec2<u32>,
    shown: vec2<u32>,
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

fn pixel(at: vec2<u32>) -> vec4<f32> {
    let inside = min(at, shape.size - 1u);
    return image[inside.y * shape.size.x + inside.x];
}

// Splat colours are display colours: they are written unchanged. Where both sizes are equal, so are all pixels.
@fragment
fn colour(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    var sum = pixel(vec2<u32>(position.xy));
    if any(shape.size != shape.shown) {
        let at = max(position.xy * vec2<f32>(shape.size) / vec2<f32>(shape.shown) - 0.5, vec2<f32>(0.0));
        let first = vec2<u32>(at);
        let share = at - vec2<f32>(first);
        let above = mix(pixel(first), pixel(first + vec2<u32>(1u, 0u)), share.x);
        let below = mix(pixel(first + vec2<u32>(0u, 1u)), pixel(first + 1u), share.x);
        sum = mix(above, below, share.y);
    }
    return vec4<f32>(sum.rgb + sum.a * shape.background.rgb, 1.0);
}
