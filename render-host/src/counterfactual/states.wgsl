// Kernels over many states of one scene share this: `gpu/states.rs` in WGSL. Put after stage/layout.wgsl
// and stage/tile.wgsl.
//
// One workgroup is one tile, one thread is one pixel; the 32 threads of a block of 8 x 4 pixels mostly
// take the same branches.

// Pixels of a tile, threads of a workgroup.
const PIXELS: u32 = 256u;
// Blocks of a tile: two side by side, four rows.
const BLOCKS: u32 = 8u;

// A batch of worlds: a uniform buffer.
struct Batch {
    // Number of groups.
    groups: u32,
    // Words of a set of groups.
    words: u32,
    // Number of worlds.
    worlds: u32,
    // Vectors of four worlds per row of masks.
    quads: u32,
    // Gradient of the loss with respect to half a squared difference.
    scale: f32,
    // Places for what tiles find, per tile.
    columns: u32,
    // First world.
    first: u32,
    // World after the last one.
    past: u32,
}

// One splat of a tile's list.
struct Entry {
    splat: u32,
    // A bit per block that the splat may touch; 0 when its group is in no world.
    blocks: u32,
}
