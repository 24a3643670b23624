// Takes squared errors of sixteen worlds on one tile, each as it is drawn alone: per world the operations of
// stage/blend.wgsl in their order, early stop included. Put after world_lanes.wgsl. Workgroups: columns,
// rows, worlds / 16.

var<workgroup> open: atomic<u32>;
var<workgroup> still_open: u32;

// `alpha` where a world includes the splat and its pixel is not finished.
fn taken(alpha: f32, mask: vec4<f32>, t: vec4<f32>) -> vec4<f32> {
    return select(vec4<f32>(0.0), alpha * mask, t >= vec4<f32>(frame.stop));
}

// `lanes` with one splat behind them where `mask` is 1.
fn blend_one(lanes: Lanes, alpha: f32, colour: vec3<f32>, mask: mat4x4<f32>) -> Lanes {
    var out = lanes;
    let t = lanes.t;
    let a = mat4x4<f32>(
        taken(alpha, mask[0], t[0]),
        taken(alpha, mask[1], t[1]),
        taken(alpha, mask[2], t[2]),
        taken(alpha, mask[3], t[3]),
    );
    let w = mat4x4<f32>(a[0] * t[0], a[1] * t[1], a[2] * t[2], a[3] * t[3]);
    out.r = add_product(w, colour.r, lanes.r);
    out.g = add_product(w, colour.g, lanes.g);
    out.b = add_product(w, colour.b, lanes.b);
    out.t = mat4x4<f32>(
        fma(-a[0], t[0], t[0]),
        fma(-a[1], t[1], t[1]),
        fma(-a[2], t[2], t[2]),
        fma(-a[3], t[3], t[3]),
    );
    return out;
}

fn add_product(w: mat4x4<f32>, c: f32, sum: mat4x4<f32>) -> mat4x4<f32> {
    let v = vec4<f32>(c);
    return mat4x4<f32>(
        fma(w[0], v, sum[0]),
        fma(w[1], v, sum[1]),
        fma(w[2], v, sum[2]),
        fma(w[3], v, sum[3]),
    );
}

fn any_open(t: mat4x4<f32>) -> bool {
    let most = max(max(t[0], t[1]), max(t[2], t[3]));
    return any(most >= vec4<f32>(frame.stop));
}

@compute @workgroup_size(256)
fn strict(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let here = spot(id, thread);
    let column = 4u * id.z;
    var lanes = no_lanes();
    let in_image = all(here.corner + here.inside < frame.size.xy);
    if thread == 0u {
        atomicStore(&open, 0u);
    }
    for (var first = here.start; first < here.end; first += PIXELS) {
        empty_batch(thread);
        if in_image && any_open(lanes.t) {
            atomicStore(&open, 1u);
        }
        workgroupBarrier();
        if thread == 0u {
            still_open = atomicExchange(&open, 0u);
        }
        if workgroupUniformLoad(&still_open) == 0u {
            break;
        }
        load(here, first, thread);
        workgroupBarrier();
        for (var word = 0u; word < 8u; word++) {
            var bits = atomicLoad(&touching[8u * here.block + word]);
            while bits != 0u {
                let i = 32u * word + firstTrailingBit(bits);
                bits &= bits - 1u;
                let colour = vec3<f32>(staged[PIXELS + i].zw, blue[i]);
                lanes = blend_one(lanes, alpha_at(i, here.at), colour, mask_of(owner[i], column));
            }
        }
    }
    write_errors(here, lanes, thread, column);
}
