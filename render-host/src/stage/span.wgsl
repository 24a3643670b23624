// Finds which tiles of a row a splat touches; the spans of bin.rs in f32, a sliver wider.

// Half-open columns of tiles in tile row `row`; empty where x >= y.
fn span(s: Splat, row: u32) -> vec2<u32> {
    let b = pixel_box(s);
    let all = vec2<u32>(b.x / TILE, (b.y + TILE - 1u) / TILE);
    let rows = (b.w + TILE - 1u) / TILE - b.z / TILE;
    if (frame.flags & FLAG_EXACT) == 0u || rows * (all.y - all.x) <= SMALL_BOX {
        return all;
    }
    let reach = reach_of(s.log2_alpha, frame.log2_cutoff) * 1.000002;
    let xx = s.root.x;
    let xy = s.root.y;
    let yy = s.root.z;
    // The ellipse is u² + v² <= reach. Its rightmost point lies at dy = extreme, its leftmost at -extreme.
    let top = sqrt(reach) / yy;
    let larger = max(abs(xy), yy);
    let slant = vec2<f32>(xy, yy) / larger;
    let extreme = -slant.x * top / length(slant);
    let first = offset(s, vec2<u32>(b.x, max(row * TILE, b.z))).y;
    let last = offset(s, vec2<u32>(b.x, min((row + 1u) * TILE, b.w) - 1u)).y;
    let low = max(first, -top * 1.00001);
    let high = min(last, top * 1.00001);
    if low > high {
        return vec2<u32>(0u, 0u);
    }
    let right_at = clamp(extreme, low, high);
    let left_at = clamp(-extreme, low, high);
    let right_v = yy * right_at;
    let left_v = yy * left_at;
    let right = (sqrt(max(reach - right_v * right_v, 0.0)) - xy * right_at) / xx;
    let left = -(sqrt(max(reach - left_v * left_v, 0.0)) + xy * left_at) / xx;
    // Centre of the box's first pixel from the splat's centre; both ends from there.
    let origin = offset(s, vec2<u32>(b.x, b.z)).x;
    let slack = 2e-3 + 2e-6 * (abs(right) + abs(left) + abs(origin));
    let width = f32(b.y - b.x);
    let begin = clamp(ceil(left - origin - slack), 0.0, width);
    let past = clamp(floor(right - origin + slack) + 1.0, 0.0, width);
    if begin >= past {
        return vec2<u32>(0u, 0u);
    }
    return vec2<u32>((b.x + u32(begin)) / TILE, (b.x + u32(past) + TILE - 1u) / TILE);
}

// Half-open tile rows of the pixel box.
fn tile_rows(s: Splat) -> vec2<u32> {
    let b = pixel_box(s);
    return vec2<u32>(b.z / TILE, (b.w + TILE - 1u) / TILE);
}

fn count_tiles(s: Splat) -> u32 {
    let rows = tile_rows(s);
    var sum = 0u;
    for (var row = rows.x; row < rows.y; row++) {
        let columns = span(s, row);
        sum += columns.y - columns.x;
    }
    return sum;
}
