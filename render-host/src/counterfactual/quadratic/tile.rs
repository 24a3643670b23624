//! One tile of the quadratic form: pictures of what each group adds, and their products.

use super::Paint;
use crate::adjoint::trace::{SEGMENT, Trace};
use crate::counterfactual::scaffold::Shared;
use crate::counterfactual::squares::{Planes, inside};
use crate::settings::Settings;
use crate::stage::TILE;
use crate::stage::blend::{Lanes, Rules};

/// A tile's share of the form.
#[derive(Clone, Debug, Default)]
pub(super) struct Part {
    /// Groups met, in order of first appearance.
    pub(super) groups: Vec<u32>,
    pub(super) constant: f64,
    /// One per group met.
    pub(super) linear: Vec<f64>,
    /// Products of every two groups met, row by row.
    pub(super) gram: Vec<f64>,
    /// Square of the picture of what clamping can change at most.
    pub(super) clamp: f64,
}

/// A picture of the tile, and its rows that are not 0.
#[derive(Clone, Debug)]
#[repr(align(64))]
struct Layer {
    rows: Planes,
    touched: u16,
}

impl Layer {
    const EMPTY: Self = Self { rows: [[[0.0; TILE]; 3]; TILE], touched: 0 };

    /// Adds `weight · colour` to row `y`.
    #[inline(always)]
    fn add(&mut self, y: usize, weight: &Lanes, colour: [f32; 3]) {
        self.touched |= 1 << y;
        for (row, colour) in self.rows[y].iter_mut().zip(colour) {
            (0..TILE).for_each(|i| row[i] += weight[i] * colour);
        }
    }

    /// Makes everything outside the image 0.
    fn crop(&mut self, (width, height): (usize, usize)) {
        self.rows[height..].fill([[0.0; TILE]; 3]);
        for row in self.rows[..height].as_flattened_mut() {
            row[width..].fill(0.0);
        }
    }

    /// Sum of products of all values, in f64.
    #[inline(always)]
    fn dot(&self, other: &Self) -> f64 {
        let both = self.touched & other.touched;
        let mut sums = [0.0f64; TILE];
        for y in (0..TILE).filter(|y| both >> y & 1 == 1) {
            for (a, b) in self.rows[y].iter().zip(&other.rows[y]) {
                (0..TILE).for_each(|i| sums[i] += f64::from(a[i]) * f64::from(b[i]));
            }
        }
        sums.iter().sum()
    }
}

/// Scratch memory of a tile.
#[derive(Debug, Default)]
pub(super) struct Room {
    trace: Trace,
    list: Vec<u32>,
    /// Tile in which each group was last met, plus 1, and its place there.
    slots: Vec<(usize, u32)>,
    layers: Vec<Layer>,
}

impl Room {
    pub(super) fn tile(
        &mut self,
        shared: &Shared,
        paint: &Paint,
        reference: &Planes,
        settings: &Settings,
        tile: usize,
        part: &mut Part,
    ) {
        self.slots.resize(paint.groups, (0, 0));
        self.list.clear();
        self.list.extend(shared.entries(tile).iter().map(|entry| entry.splat));
        pulp::Arch::new().dispatch(Work { shared, paint, reference, settings, tile, room: self, part });
    }
}

/// One tile's work, as a value, so that it can be compiled once per vector width.
struct Work<'a> {
    shared: &'a Shared,
    paint: &'a Paint,
    reference: &'a Planes,
    settings: &'a Settings,
    tile: usize,
    room: &'a mut Room,
    part: &'a mut Part,
}

impl pulp::NullaryFnOnce for Work<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { shared, paint, reference, settings, tile, room, part } = self;
        let Room { trace, list, slots, layers } = room;
        let (corner, rules) = (shared.corner(tile), Rules::new(settings));
        layers.clear();
        let (mut picture, mut clamp) = (Layer::EMPTY, Layer::EMPTY);
        let walked = trace.forward(&shared.projected.splats, list, corner, &rules);
        for (y, row) in picture.rows.iter_mut().enumerate() {
            for (c, row) in row.iter_mut().enumerate() {
                let behind = settings.background[c];
                (0..TILE).for_each(|i| row[i] = trace.now.0[y][i] * behind - reference[y][c][i]);
            }
        }
        picture.touched = u16::MAX;
        for k in (0..walked).rev() {
            let segment = &list[k * SEGMENT..list.len().min((k + 1) * SEGMENT)];
            if k + 1 < walked {
                trace.again(k, &shared.projected.splats, segment, corner, &rules, |_| true);
            }
            for (i, &splat) in segment.iter().enumerate() {
                let (visits, changes) = (trace.visits(i), paint.changes(splat));
                if visits.is_empty() {
                    continue;
                }
                let (base, shortfall) = (paint.base[splat as usize], paint.shortfall[splat as usize]);
                for &(group, _) in changes {
                    let slot = &mut slots[group as usize];
                    if slot.0 != tile + 1 {
                        *slot = (tile + 1, layers.len() as u32);
                        layers.push(Layer::EMPTY);
                        part.groups.push(group);
                    }
                }
                for (visit, record) in trace.visits[visits.clone()].iter().zip(&trace.records[visits]) {
                    let y = visit.y as usize % TILE;
                    let mut weight = [0.0; TILE];
                    (0..TILE).for_each(|i| weight[i] = record.alpha[i] * record.transmittance[i]);
                    picture.add(y, &weight, base);
                    if shortfall != [0.0; 3] {
                        clamp.add(y, &weight, shortfall);
                    }
                    for &(group, colour) in changes {
                        layers[slots[group as usize].1 as usize].add(y, &weight, colour);
                    }
                }
            }
        }
        let inside = inside(corner, shared.size);
        picture.crop(inside);
        clamp.crop(inside);
        layers.iter_mut().for_each(|layer| layer.crop(inside));
        part.constant = picture.dot(&picture);
        part.clamp = clamp.dot(&clamp);
        part.linear.extend(layers.iter().map(|layer| layer.dot(&picture)));
        let n = layers.len();
        part.gram.resize(n * n, 0.0);
        for a in 0..n {
            for b in a..n {
                let product = layers[a].dot(&layers[b]);
                part.gram[a * n + b] = product;
                part.gram[b * n + a] = product;
            }
        }
    }
}
