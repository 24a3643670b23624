//! Rust and WGSL share these structs and constants: `stage/layout.wgsl` in Rust.
//!
//! Each struct lies in memory exactly as its WGSL namesake; a test asks naga.

use bytemuck::{Pod, Zeroable};

use crate::{
    Camera, Settings,
    adjoint::loss::ssim::{FARTHEST, MIDDLE},
    metric::ssim::{C1, C2},
    stage::{REACH_MARGIN, SMALL_BOX, TILE, project::slope_limits},
};

/// Bytes from one place of the indirect arguments to the next: three counts and padding.
pub const ARGS_STRIDE: u64 = 16;
/// Indirect arguments: blocks of [`SORT_BLOCK`] over the splats drawn.
pub const ARGS_SORT_DRAWN: u64 = 0;
/// Indirect arguments: workgroups of [`WORKGROUP`] over the splats drawn.
pub const ARGS_DRAWN: u64 = 1;
/// Indirect arguments: blocks of [`SORT_BLOCK`] over the tile entries.
pub const ARGS_SORT_ENTRIES: u64 = 2;
/// Indirect arguments: workgroups that sum up the digits of the splats drawn.
pub const ARGS_SCAN_DRAWN: u64 = 3;
/// Indirect arguments: workgroups that sum up the digits of the tile entries.
pub const ARGS_SCAN_ENTRIES: u64 = 4;
/// Places of indirect arguments; the ones after those above are free for other engines.
pub const ARGS: u64 = 8;

/// Threads of a workgroup in every kernel: the pixels of a tile.
pub const WORKGROUP: u32 = (TILE * TILE) as u32;
/// Keys that one workgroup of the radix sort takes.
pub const SORT_BLOCK: u32 = 1024;
/// Up to so many blocks, digits are summed up by a thread each: cheaper than the barriers of a workgroup
/// each.
pub const FEW_BLOCKS: u32 = 64;
/// Values of one digit of the radix sort.
pub const DIGITS: u32 = 256;
/// Worlds that one thread of a world batch blends.
pub const LANES: u32 = 8;

/// Words of [`COUNTS`]: first the reasons for skipping, in the order of [`crate::Counters`].
pub const COUNT_ABSENT: u32 = 0;
/// A NaN or an infinity.
pub const COUNT_NON_FINITE: u32 = 1;
/// Below the alpha cut-off.
pub const COUNT_TRANSPARENT: u32 = 2;
/// Without area.
pub const COUNT_DEGENERATE: u32 = 3;
/// Nearer than the near plane.
pub const COUNT_BEHIND_NEAR: u32 = 4;
/// Outside the image.
pub const COUNT_OUTSIDE: u32 = 5;
/// Between pixel centres.
pub const COUNT_SUB_PIXEL: u32 = 6;
/// Splats drawn.
pub const COUNT_DRAWN: u32 = 7;
/// Tile entries that fit, and are drawn.
pub const COUNT_ENTRIES: u32 = 8;
/// Tile entries there are; more than fit when above the capacity. Saturates.
pub const COUNT_WANTED: u32 = 9;
/// Tiles with an entry.
pub const COUNT_TOUCHED: u32 = 10;
/// Pixels finished early.
pub const COUNT_STOPPED: u32 = 11;
/// Words of the counts buffer.
pub const COUNTS: u32 = 16;

/// Bit of [`Frame::flags`]: [`Settings::antialiased`].
pub const FLAG_ANTIALIASED: u32 = 1;
/// Bit of [`Frame::flags`]: [`Settings::cull_frustum`].
pub const FLAG_CULL: u32 = 2;
/// Bit of [`Frame::flags`]: [`Settings::exact_tiles`].
pub const FLAG_EXACT: u32 = 4;

/// Depth key of a Gaussian that was skipped.
pub const SKIPPED: u32 = crate::stage::project::SKIPPED;

/// Rows of the Gaussians' buffer: a row holds one field of all Gaussians, so that neighbouring threads
/// read neighbouring words. Position 3, scale 3, rotation 4, opacity, band 0 of the harmonics 3.
pub const GAUSSIAN_ROWS: u32 = 14;

/// Constants that must have the same value in WGSL, by name.
pub const CONSTANTS: &[(&str, f64)] = &[
    ("TILE", TILE as f64),
    ("SMALL_BOX", SMALL_BOX as f64),
    ("WORKGROUP", WORKGROUP as f64),
    ("SORT_BLOCK", SORT_BLOCK as f64),
    ("FEW_BLOCKS", FEW_BLOCKS as f64),
    ("DIGITS", DIGITS as f64),
    ("LANES", LANES as f64),
    ("SKIPPED", SKIPPED as f64),
    ("REACH_MARGIN", REACH_MARGIN as f64),
    ("MIN_COMPENSATION", crate::stage::project::MIN_COMPENSATION as f32 as f64),
    ("MIN_QUATERNION_NORM2", crate::stage::project::MIN_QUATERNION_NORM2 as f32 as f64),
    ("COUNT_ABSENT", COUNT_ABSENT as f64),
    ("COUNT_NON_FINITE", COUNT_NON_FINITE as f64),
    ("COUNT_TRANSPARENT", COUNT_TRANSPARENT as f64),
    ("COUNT_DEGENERATE", COUNT_DEGENERATE as f64),
    ("COUNT_BEHIND_NEAR", COUNT_BEHIND_NEAR as f64),
    ("COUNT_OUTSIDE", COUNT_OUTSIDE as f64),
    ("COUNT_SUB_PIXEL", COUNT_SUB_PIXEL as f64),
    ("COUNT_DRAWN", COUNT_DRAWN as f64),
    ("COUNT_ENTRIES", COUNT_ENTRIES as f64),
    ("COUNT_WANTED", COUNT_WANTED as f64),
    ("COUNT_TOUCHED", COUNT_TOUCHED as f64),
    ("COUNT_STOPPED", COUNT_STOPPED as f64),
    ("COUNTS", COUNTS as f64),
    ("FLAG_ANTIALIASED", FLAG_ANTIALIASED as f64),
    ("FLAG_CULL", FLAG_CULL as f64),
    ("FLAG_EXACT", FLAG_EXACT as f64),
];

/// Constants of the structural loss that must have the same value in WGSL, by name.
pub const LOSS_CONSTANTS: &[(&str, f64)] = &[
    ("MIDDLE", MIDDLE as f64),
    ("C1", C1 as f32 as f64),
    ("C2", C2 as f32 as f64),
    ("FARTHEST", FARTHEST as f64),
];

/// A projected splat, 48 bytes, as every later stage reads it.
///
/// Alpha at the centre of pixel `p` is `2^(log2_alpha - u² - v²)` with `u = root.x·dx + root.y·dy`,
/// `v = root.z·dy` and `d = (p - anchor) - mean`. The *anchor* is the pixel in the middle of the pixel
/// box, `((x0 + x1) / 2, (y0 + y1) / 2)` in whole pixels: differences of pixels are exact, and what is
/// rounded is small. (A centre in pixels from the corner of the image, in f32, is off by up to 3e-5 at
/// 800 pixels.)
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Splat {
    /// Centre from the centre of the anchor pixel, pixels.
    pub mean: [f32; 2],
    /// Half-open columns of the pixel box: `x0 | x1 << 16`.
    pub columns: u32,
    /// Half-open rows of the pixel box: `y0 | y1 << 16`.
    pub rows: u32,
    /// Upper triangular factor `[xx, xy, yy]`, 1 / pixels.
    pub root: [f32; 3],
    /// log₂ of alpha at the centre, ≤ 0.
    pub log2_alpha: f32,
    /// Display colour r g b, ≥ 0 and finite.
    pub colour: [f32; 3],
    /// Group of the Gaussian; 0 in a scene without groups.
    pub group: u32,
}

impl Splat {
    /// Half-open pixel box `[x0, x1, y0, y1]`.
    pub fn pixels(&self) -> [u32; 4] {
        [self.columns & 0xffff, self.columns >> 16, self.rows & 0xffff, self.rows >> 16]
    }

    /// The anchor pixel.
    pub fn anchor(&self) -> [u32; 2] {
        let [x0, x1, y0, y1] = self.pixels();
        [(x0 + x1) / 2, (y0 + y1) / 2]
    }

    /// Centre, pixels from the top left corner of the image.
    pub fn centre(&self) -> [f64; 2] {
        let anchor = self.anchor();
        std::array::from_fn(|k| f64::from(anchor[k]) + 0.5 + f64::from(self.mean[k]))
    }
}

/// Everything that a frame's kernels know of camera and settings: a uniform buffer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Frame {
    /// World to camera, three rows `[r, r, r, translation]`.
    pub view: [[f32; 4]; 3],
    /// What `view` lost to rounding.
    pub view_low: [[f32; 4]; 3],
    /// `fx fy` and what they lost to rounding.
    pub focal: [f32; 4],
    /// `cx cy` and what they lost to rounding.
    pub principal: [f32; 4],
    /// Lowest and highest `x / z`, lowest and highest `y / z`, of the Jacobian.
    pub slope: [f32; 4],
    /// Background r g b, and padding.
    pub background: [f32; 4],
    /// Width, height (pixels), columns, rows (tiles).
    pub size: [u32; 4],
    /// Near plane, scene units.
    pub near: f32,
    /// What `near` lost to rounding.
    pub near_low: f32,
    /// [`Settings::low_pass`], pixels².
    pub low_pass: f32,
    /// [`Settings::alpha_cutoff`] as it is set.
    pub alpha_cutoff: f32,
    /// The cut-off in force: never 0.
    pub cutoff: f32,
    /// Its log₂.
    pub log2_cutoff: f32,
    /// [`Settings::alpha_max`].
    pub alpha_max: f32,
    /// Transmittance below which a pixel is finished; 0 to blend all.
    pub stop: f32,
    /// Gaussians in the scene.
    pub gaussians: u32,
    /// Degree of harmonics in use.
    pub degree: u32,
    /// Bits `FLAG_…`.
    pub flags: u32,
    /// 0; unknown to the compiler, so that it cannot simplify error-free sums away.
    pub zero: u32,
    /// Room for tile entries.
    pub capacity: u32,
    /// Worlds of the batch; 1 for a plain picture.
    pub worlds: u32,
    /// Words of presence bits per group.
    pub world_words: u32,
    /// Padding.
    pub spare: u32,
}

impl Frame {
    /// The frame of `camera` and `settings` for a scene of `gaussians` of which `degree` is evaluated.
    pub fn new(camera: &Camera, settings: &Settings, gaussians: u32, degree: u8) -> Self {
        let i = camera.intrinsics();
        let (rotation, translation) = (camera.rotation(), camera.translation());
        let rows: [[f64; 4]; 3] = std::array::from_fn(|r| {
            std::array::from_fn(|c| if c < 3 { rotation[r][c] } else { translation[r] })
        });
        let [fx, fy, cx, cy, near] = [i.fx, i.fy, i.cx, i.cy, camera.near()].map(split);
        let [[x0, x1], [y0, y1]] = slope_limits(camera).map(|axis| axis.map(|v| v as f32));
        let [r, g, b] = settings.background;
        let tile = TILE as u32;
        let flag = |on: bool, bit: u32| if on { bit } else { 0 };
        Self {
            view: rows.map(|row| row.map(|v| split(v)[0])),
            view_low: rows.map(|row| row.map(|v| split(v)[1])),
            focal: [fx[0], fy[0], fx[1], fy[1]],
            principal: [cx[0], cy[0], cx[1], cy[1]],
            slope: [x0, x1, y0, y1],
            background: [r, g, b, 0.0],
            size: [i.width, i.height, i.width.div_ceil(tile), i.height.div_ceil(tile)],
            near: near[0],
            near_low: near[1],
            low_pass: settings.low_pass as f32,
            alpha_cutoff: settings.alpha_cutoff,
            cutoff: settings.cutoff(),
            log2_cutoff: settings.log2_cutoff() as f32,
            alpha_max: settings.alpha_max,
            stop: settings.closed_below(),
            gaussians,
            degree: u32::from(degree),
            flags: flag(settings.antialiased, FLAG_ANTIALIASED)
                | flag(settings.cull_frustum, FLAG_CULL)
                | flag(settings.exact_tiles, FLAG_EXACT),
            zero: 0,
            capacity: 0,
            worlds: 1,
            world_words: 1,
            spare: 0,
        }
    }

    /// Tiles of the image.
    pub fn tiles(&self) -> u32 {
        self.size[2] * self.size[3]
    }
}

/// `v` as the nearest f32 and the nearest f32 to the rest.
fn split(v: f64) -> [f32; 2] {
    let high = v as f32;
    [high, (v - f64::from(high)) as f32]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_split_number_is_good_to_48_bits() {
        for v in [std::f64::consts::PI, -1e15 / 3.0, 1e-9 / 7.0, 0.0] {
            let [high, low] = split(v);
            assert!((f64::from(high) + f64::from(low) - v).abs() <= v.abs() * 2f64.powi(-48), "{v}");
        }
    }

    #[test]
    fn a_splats_centre_is_its_anchor_and_what_is_left() {
        let splat = Splat { mean: [-0.25, 0.5], columns: 10 | 21 << 16, rows: 3 << 16, ..Splat::default() };
        assert_eq!((splat.anchor(), splat.centre()), ([15, 1], [15.25, 2.0]));
        assert_eq!(splat.pixels(), [10, 21, 0, 3]);
    }
}
