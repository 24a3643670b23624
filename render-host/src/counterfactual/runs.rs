//! Per pixel, consecutive splats of one group composed once.
//!
//! Compositing operators `x → C + T·x` form a monoid, so a run of splats of one group is one operator,
//! the same for every world that holds the group and the identity for every other. A tile keeps an open
//! run per pixel, in rows of 16; a splat of another group closes it.

use super::scaffold::{Entry, Shared};
use super::squares::inside;
use crate::settings::Settings;
use crate::stage::blend::{LANE, Lanes, exp2};
use crate::stage::{REACH_MARGIN, TILE};

/// No group.
const NONE: u32 = u32::MAX;

/// Every pixel of a row, a byte each.
const EVERY: u128 = u128::from_le_bytes([1; TILE]);

/// Several splats as one: what they hide and what they add.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    /// Index into the tile's groups.
    pub local: u32,
    /// `T - 1`: the share of what lies behind that the run hides, negated.
    pub hidden: f32,
    /// r, g, b that the run adds.
    pub colour: [f32; 3],
}

/// The open runs of a row of pixels; aligned, because it is read again right after it is written.
#[derive(Clone, Debug)]
#[repr(align(64))]
struct Open {
    owner: [u32; TILE],
    t: Lanes,
    rgb: [Lanes; 3],
}

impl Open {
    const EMPTY: Self = Self { owner: [NONE; TILE], t: [1.0; TILE], rgb: [[0.0; TILE]; 3] };
}

/// Alpha of a splat on a row of pixels.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Row(Lanes);

/// The runs of one tile, a list per pixel, nearest first.
#[derive(Debug)]
pub(super) struct Runs {
    lists: Vec<Vec<Run>>,
    open: [Open; TILE],
    alphas: [Row; TILE],
    /// Width and height of the part inside the image.
    pub inside: (usize, usize),
}

impl Default for Runs {
    fn default() -> Self {
        Self {
            lists: vec![Vec::new(); TILE * TILE],
            open: [Open::EMPTY; TILE],
            alphas: [Row([0.0; TILE]); TILE],
            inside: (0, 0),
        }
    }
}

impl Runs {
    /// Takes the runs of `tile`, of all its groups.
    pub(super) fn fill(&mut self, shared: &Shared, tile: usize, settings: &Settings) {
        self.lists.iter_mut().for_each(Vec::clear);
        self.open.fill(Open::EMPTY);
        let corner = shared.corner(tile);
        self.inside = inside(corner, shared.size);
        let entries = shared.entries(tile);
        pulp::Arch::new().dispatch(Fill { shared, entries, corner, settings, runs: self });
    }

    /// Runs of pixel `(x, y)`.
    #[inline(always)]
    pub(super) fn at(&self, x: usize, y: usize) -> &[Run] {
        &self.lists[y * TILE + x]
    }
}

/// One tile's work, as a value, so that it can be compiled once per vector width.
struct Fill<'a> {
    shared: &'a Shared,
    entries: &'a [Entry],
    corner: [usize; 2],
    settings: &'a Settings,
    runs: &'a mut Runs,
}

impl pulp::NullaryFnOnce for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { shared, entries, corner, settings, runs } = self;
        let limits = [settings.cutoff(), settings.alpha_max];
        let reach0 = REACH_MARGIN - settings.log2_cutoff() as f32;
        let centre = [corner[0] as f64 + 0.5, corner[1] as f64 + 0.5];
        for entry in entries {
            let splat = &shared.splats[entry.splat as usize];
            // The walk over rows is the blend's, alpha for alpha.
            let (dx, dy) = (centre[0] - splat.mean[0], centre[1] - splat.mean[1]);
            let [xx, xy, yy] = splat.root;
            let (u0, v0) = ((xx * dx + xy * dy) as f32, (yy * dy) as f32);
            let (xx, xy, yy) = (xx as f32, xy as f32, yy as f32);
            let reach = splat.log2_alpha + reach0;
            let first = usize::from(splat.pixels[2]).saturating_sub(corner[1]);
            let past = usize::from(splat.pixels[3]).saturating_sub(corner[1]).min(TILE);
            // Alphas of all rows first: their long chains of arithmetic overlap, which they would not
            // between the branches of closing runs, that no processor predicts.
            let mut hit = 0u16;
            for y in first..past {
                let (u, v) = (u0 + xy * y as f32, v0 + yy * y as f32);
                let left = reach - v * v;
                let gap = u.max(-(u + 15.0 * xx)).max(0.0);
                if gap * gap <= left {
                    runs.alphas[y].0 = alphas(u, xx, splat.log2_alpha - v * v, limits);
                    hit |= 1 << y;
                }
            }
            while hit != 0 {
                let y = hit.trailing_zeros() as usize % TILE;
                hit &= hit - 1;
                let alpha = &runs.alphas[y].0;
                let open = &mut runs.open[y];
                let lists = &mut runs.lists[y * TILE..][..TILE];
                let going = going(open, alpha, entry.local);
                let ended = ended(&going);
                if ended != 0 {
                    close(open, lists, ended);
                }
                extend(open, alpha, &going, entry.local, splat.colour);
            }
        }
        for (open, lists) in runs.open.iter_mut().zip(runs.lists.chunks_exact_mut(TILE)) {
            close(open, lists, EVERY);
        }
    }
}

/// Alpha on 16 pixels, 0 below the cut-off.
#[inline(always)]
fn alphas(u: f32, xx: f32, exponent: f32, [cutoff, max]: [f32; 2]) -> Lanes {
    let mut out = [0.0; TILE];
    for i in 0..TILE {
        let q = u + xx * LANE[i];
        let alpha = exp2(exponent - q * q);
        let alpha = if alpha < max { alpha } else { max };
        out[i] = if alpha >= cutoff { alpha } else { 0.0 };
    }
    out
}

/// All ones where the open run goes on, 0 where group `local` touches a pixel whose run is another group's.
#[inline(always)]
fn going(open: &Open, alpha: &Lanes, local: u32) -> [u32; TILE] {
    let mut out = [0; TILE];
    for i in 0..TILE {
        let on = (alpha[i] <= 0.0) | (open.owner[i] == local);
        out[i] = if on { u32::MAX } else { 0 };
    }
    out
}

/// The zeros of `going`: a byte each, 1 or 0, the first lane lowest.
#[inline(always)]
fn ended(going: &[u32; TILE]) -> u128 {
    let mut bytes = [0u8; TILE];
    for i in 0..TILE {
        bytes[i] = !going[i] as u8 & 1;
    }
    u128::from_le_bytes(bytes)
}

/// Writes down the open runs of `pixels`, a byte each.
#[inline(always)]
fn close(open: &Open, lists: &mut [Vec<Run>], mut pixels: u128) {
    while pixels != 0 {
        let i = pixels.trailing_zeros() as usize / 8 % TILE;
        pixels &= pixels - 1;
        if open.owner[i] != NONE {
            let colour = [open.rgb[0][i], open.rgb[1][i], open.rgb[2][i]];
            lists[i].push(Run { local: open.owner[i], hidden: open.t[i] - 1.0, colour });
        }
    }
}

/// Adds a splat of group `local` behind the open runs that go on; the others begin anew.
///
/// All lanes are written as vectors, without branches: a vector read after scalar writes to its parts
/// would stall.
#[inline(always)]
fn extend(open: &mut Open, alpha: &Lanes, going: &[u32; TILE], local: u32, [cr, cg, cb]: [f32; 3]) {
    const ONE: u32 = 1.0f32.to_bits();
    let kept = |value: f32, mask: u32| f32::from_bits(value.to_bits() & mask);
    let Open { owner, t, rgb: [r, g, b] } = open;
    for i in 0..TILE {
        let before = f32::from_bits(t[i].to_bits() & going[i] | ONE & !going[i]);
        let weight = alpha[i] * before;
        r[i] = kept(r[i], going[i]) + weight * cr;
        g[i] = kept(g[i], going[i]) + weight * cg;
        b[i] = kept(b[i], going[i]) + weight * cb;
        t[i] = before - weight;
        owner[i] = if alpha[i] > 0.0 { local } else { owner[i] };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_ends_where_another_group_touches_the_pixel() {
        let (mut open, mut lists) = (Open::EMPTY, vec![Vec::new(); TILE]);
        let mut add = |alpha: f32, pixels: std::ops::Range<usize>, local: u32| {
            let mut lanes = [0.0; TILE];
            lanes[pixels].fill(alpha);
            let going = going(&open, &lanes, local);
            close(&open, &mut lists, ended(&going));
            extend(&mut open, &lanes, &going, local, [1.0, 0.5, 0.0]);
        };
        add(0.5, 0..16, 7);
        add(0.5, 0..16, 7);
        add(0.25, 0..8, 3); // pixels 8.. do not see group 3, so their run of 7 goes on
        add(0.5, 0..16, 7);
        close(&open, &mut lists, EVERY);
        let of = |x: usize| lists[x].iter().map(|r: &Run| (r.local, -r.hidden)).collect::<Vec<_>>();
        assert_eq!(of(2), [(7, 0.75), (3, 0.25), (7, 0.5)]);
        assert_eq!(of(9), [(7, 0.875)]);
        assert_eq!(lists[9][0].colour, [0.875, 0.4375, 0.0]);
    }
}
