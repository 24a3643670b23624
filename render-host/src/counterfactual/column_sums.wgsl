// Adds up the rows of a table, column by column, in one fixed order: sixteen pieces of every sixteenth
// row each, every piece in runs of sixteen, then a tree. Workgroups: columns / 16, 1, tables.

struct Table {
    rows: u32,
    columns: u32,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> table: Table;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> totals: array<f32>;

var<workgroup> pieces: array<f32, 256>;

@compute @workgroup_size(256)
fn column_sums(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    let column = 16u * id.x + (thread & 15u);
    let piece = thread >> 4u;
    let first = id.z * table.rows * table.columns + column;
    var sum = 0.0;
    if column < table.columns {
        for (var row = piece; row < table.rows; row += 256u) {
            var few = 0.0;
            let past = min(row + 256u, table.rows);
            for (var r = row; r < past; r += 16u) {
                few += values[first + r * table.columns];
            }
            sum += few;
        }
    }
    pieces[thread] = sum;
    for (var half = 8u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if piece < half {
            pieces[thread] += pieces[thread + 16u * half];
        }
    }
    if piece == 0u && column < table.columns {
        totals[id.z * table.columns + column] = pieces[thread];
    }
}
