// Draws pictures of many worlds and retains them for a loss that looks further than one pixel. Put after
// adjoint/forward.wgsl. Workgroups: columns, rows, vectors of four worlds from `batch.first` on.

// 1: there is one world, and its transmittances are a fourth plane.
override TRANSMITTANCE: u32 = 0u;

// Plane by plane, row by row; planes r g b of one world, then of the next.
@group(0) @binding(7) var<storage, read_write> framebuffer: array<f32>;
// Per tile and vector of worlds, at its first world: entries seen, in whole loads.
@group(0) @binding(8) var<storage, read_write> found: array<f32>;

@compute @workgroup_size(256)
fn draw(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let tile = id.y * frame.size.z + id.x;
    var here = spot(tile, TILE * id.xy, thread);
    let pixel = here.corner + pixel_of(thread);
    let inside = all(pixel < frame.size.xy);
    let quad = batch.first / 4u + id.z;
    here.retained = (batch.past + 3u) / 4u - batch.first / 4u;
    here.slot = id.z;
    if thread == 0u {
        atomicStore(&open, 0u);
    }
    let live = living(quad, inside);
    let seen = forward(here, quad, live);
    if thread == 0u {
        found[tile * batch.columns + 4u * quad] = f32((seen.past - here.start + STAGED - 1u) / STAGED);
    }
    let plane = frame.size.x * frame.size.y;
    let place = pixel.y * frame.size.x + pixel.x;
    for (var k = 0u; k < 4u; k++) {
        if live[k] {
            let first = 3u * (4u * id.z + k) * plane + place;
            framebuffer[first] = seen.r[k];
            framebuffer[first + plane] = seen.g[k];
            framebuffer[first + 2u * plane] = seen.b[k];
        }
    }
    if TRANSMITTANCE == 1u && inside {
        framebuffer[3u * plane + place] = seen.t.x;
    }
}
