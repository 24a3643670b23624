//! Remembers the inputs of the frame before and their projection, to find what changed and how.

use codec_core::Gaussian;

use crate::{
    Counters, Splats,
    camera::Camera,
    parallel,
    settings::Settings,
    splats::highest_degree,
    stage::{
        Splat,
        project::{Projected, Projector, SKIPPED, Skip},
    },
};

/// Gaussians in one piece of work.
const CHUNK: usize = 2048;

/// Everything but the Gaussians that a projection depends on; equal views give equal bits.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct View {
    gaussians: usize,
    degree: u8,
    camera: [u64; 17],
    size: [u32; 2],
    settings: Settings,
}

impl View {
    pub(super) fn new(splats: &Splats, camera: &Camera, settings: &Settings) -> Self {
        let i = camera.intrinsics();
        let mut numbers = [i.fx, i.fy, i.cx, i.cy, camera.near()].into_iter();
        let mut pose = camera.rotation().into_iter().flatten().chain(camera.translation());
        // By bits, so that zeros of both signs are told apart.
        let bits =
            std::array::from_fn(|_| numbers.next().or_else(|| pose.next()).unwrap_or_default().to_bits());
        Self {
            gaussians: splats.len(),
            degree: splats.sh_degree().get(),
            camera: bits,
            size: [i.width, i.height],
            // The picture does not depend on who computes it.
            settings: Settings { parallel: false, ..settings.clone() },
        }
    }
}

/// A splat that is not what it was.
#[derive(Clone, Copy, Debug)]
pub(super) struct Change {
    pub(super) index: u32,
    /// Before; of no use if it was skipped.
    pub(super) old: Splat,
    pub(super) old_key: u32,
    /// More than its colour changed, so that lists may.
    pub(super) moved: bool,
}

/// The Gaussians of the frame before, and what became of them.
#[derive(Debug, Default)]
pub(super) struct Inputs {
    gaussians: Vec<Gaussian>,
    rest: Vec<f32>,
    /// The degree that a Gaussian's own coefficients hold.
    degrees: Vec<u8>,
    /// The degree that it was projected with.
    weighed: Vec<u8>,
    fates: Vec<Option<Skip>>,
    counts: Vec<Counters>,
    /// Splats that changed.
    flags: Vec<bool>,
    changes: Vec<Vec<Change>>,
    projected: Vec<u64>,
}

/// A piece of all of it.
struct Chunk<'a> {
    gaussians: &'a mut [Gaussian],
    rest: &'a mut [f32],
    degrees: &'a mut [u8],
    weighed: &'a mut [u8],
    fates: &'a mut [Option<Skip>],
    flags: &'a mut [bool],
    slots: &'a mut [Splat],
    keys: &'a mut [u32],
    counts: &'a mut Counters,
    changes: &'a mut Vec<Change>,
    projected: &'a mut u64,
}

impl Inputs {
    /// Takes in the next frame and brings `out`, the projection of the frame before, up to it. All is new
    /// if `fresh`; what did not change is projected again unless `keep`.
    pub(super) fn update(
        &mut self,
        splats: &Splats,
        camera: &Camera,
        settings: &Settings,
        fresh: bool,
        keep: bool,
        out: &mut Projected,
    ) -> Counters {
        let (n, each) = (splats.len(), splats.sh_degree().rest_len());
        let pieces = n.div_ceil(CHUNK);
        if fresh {
            self.resize(n, each, pieces);
            out.splats.resize(n, Splat::NONE);
            out.keys.clear();
            out.keys.resize(n, SKIPPED);
        }
        let projector = Projector::new(camera, settings, settings.degree(splats.sh_degree()));
        let frame = Frame { splats, projector, fresh, keep };
        let mut rest = self.rest.as_mut_slice();
        let parts = self.gaussians.chunks_mut(CHUNK).zip(self.degrees.chunks_mut(CHUNK));
        let parts = parts.zip(self.weighed.chunks_mut(CHUNK)).zip(self.fates.chunks_mut(CHUNK));
        let parts = parts.zip(self.flags.chunks_mut(CHUNK));
        let parts = parts.zip(out.splats.chunks_mut(CHUNK).zip(out.keys.chunks_mut(CHUNK)));
        let parts = parts.zip(self.counts.iter_mut().zip(&mut self.changes).zip(&mut self.projected));
        let mut chunks: Vec<Chunk<'_>> = parts
            .map(|((((((gaussians, degrees), weighed), fates), flags), (slots, keys)), one)| {
                let ((counts, changes), projected) = one;
                let (front, back) = std::mem::take(&mut rest).split_at_mut(gaussians.len() * each);
                rest = back;
                Chunk {
                    gaussians,
                    rest: front,
                    degrees,
                    weighed,
                    fates,
                    flags,
                    slots,
                    keys,
                    counts,
                    changes,
                    projected,
                }
            })
            .collect();
        parallel::for_each(settings.parallel, &mut chunks, |i, chunk| frame.update(i * CHUNK, chunk));
        let mut total = Counters { gaussians: n as u64, ..Counters::default() };
        self.counts.iter().for_each(|counts| total.add(counts));
        total
    }

    fn resize(&mut self, n: usize, each: usize, pieces: usize) {
        self.gaussians.resize(n, Gaussian::ABSENT);
        self.rest.resize(n * each, 0.0);
        self.degrees.resize(n, 0);
        self.weighed.resize(n, 0);
        self.fates.resize(n, None);
        self.flags.clear();
        self.flags.resize(n, false);
        self.counts.resize(pieces, Counters::default());
        self.changes.resize_with(pieces, Vec::new);
        self.changes.iter_mut().for_each(Vec::clear);
        self.projected.resize(pieces, 0);
    }

    /// Splats that changed, in order of index; none in a frame where all is new.
    pub(super) fn changes(&self) -> impl Iterator<Item = &Change> + Clone {
        self.changes.iter().flatten()
    }

    /// Number of splats that changed.
    pub(super) fn changed(&self) -> usize {
        self.changes.iter().map(Vec::len).sum()
    }

    /// Of these, those of which more than the colour did.
    pub(super) fn moved(&self) -> usize {
        self.changes().filter(|change| change.moved).count()
    }

    /// Per Gaussian whether its splat changed.
    pub(super) fn flags(&self) -> &[bool] {
        &self.flags
    }

    /// Gaussians that were projected.
    pub(super) fn projected(&self) -> u64 {
        self.projected.iter().sum()
    }
}

/// What all chunks of a frame read.
struct Frame<'a> {
    splats: &'a Splats<'a>,
    projector: Projector<'a>,
    fresh: bool,
    keep: bool,
}

impl Frame<'_> {
    /// Brings the chunk that begins at Gaussian `first` up to the frame.
    fn update(&self, first: usize, chunk: &mut Chunk<'_>) {
        for change in chunk.changes.drain(..) {
            chunk.flags[change.index as usize - first] = false;
        }
        *chunk.projected = 0;
        let mut recount = self.fresh;
        let n = chunk.gaussians.len();
        let each = chunk.rest.len() / n.max(1);
        for i in 0..n {
            let index = first + i;
            let altered = self.take(index, i, each, chunk);
            if !altered && self.keep {
                continue;
            }
            *chunk.projected += 1;
            let degree = chunk.weighed[i];
            let (fate, key, splat) = match self.projector.splat(self.splats, index, degree) {
                Ok((splat, key)) => (None, key, splat),
                Err(reason) => (Some(reason), SKIPPED, chunk.slots[i]),
            };
            recount |= altered;
            chunk.fates[i] = fate;
            let (old, old_key) = (chunk.slots[i], chunk.keys[i]);
            let moved = old_key != key || (key != SKIPPED && !same_place(&old, &splat));
            let recoloured = key != SKIPPED && old.colour.map(f32::to_bits) != splat.colour.map(f32::to_bits);
            if self.fresh {
                (chunk.slots[i], chunk.keys[i]) = (splat, key);
            } else if moved || recoloured {
                chunk.changes.push(Change { index: index as u32, old, old_key, moved });
                chunk.flags[i] = true;
                (chunk.slots[i], chunk.keys[i]) = (splat, key);
            }
        }
        if recount {
            *chunk.counts = Counters::default();
            for (fate, &weighed) in chunk.fates.iter().zip(chunk.weighed.iter()) {
                match fate {
                    None => chunk.counts.draw(self.projector.degree, weighed),
                    Some(reason) => chunk.counts.skip(*reason),
                }
            }
        }
    }

    /// Remembers Gaussian `index`; true if its projection may differ from the one before.
    fn take(&self, index: usize, i: usize, each: usize, chunk: &mut Chunk<'_>) -> bool {
        let (gaussian, rest) = (&self.splats.gaussians()[index], self.splats.rest(index));
        let old = &mut chunk.rest[i * each..(i + 1) * each];
        let mut altered = self.fresh || !same_gaussian(&chunk.gaussians[i], gaussian);
        if altered {
            chunk.gaussians[i] = *gaussian;
        }
        if self.fresh || !same_bits(old, rest) {
            altered = true;
            old.copy_from_slice(rest);
            chunk.degrees[i] = highest_degree(rest);
        }
        let weighed = self.projector.weighed(chunk.degrees[i].min(self.splats.band(index)));
        altered |= weighed != chunk.weighed[i];
        chunk.weighed[i] = weighed;
        altered
    }
}

fn same_gaussian(a: &Gaussian, b: &Gaussian) -> bool {
    // All words, without a branch between them.
    let words = |g: &Gaussian| {
        let ([x, y, z], [i, j, k], [q, r, s, t], [l, m, n]) = (g.position, g.scale, g.rotation, g.sh0);
        [x, y, z, i, j, k, q, r, s, t, l, m, n, g.opacity].map(f32::to_bits)
    };
    let (a, b) = (words(a), words(b));
    (0..a.len()).fold(0, |all, i| all | (a[i] ^ b[i])) == 0
}

fn same_bits(a: &[f32], b: &[f32]) -> bool {
    a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}

/// Whether two splats are equal in all that lists and alpha depend on.
fn same_place(a: &Splat, b: &Splat) -> bool {
    let words = |s: &Splat| {
        let ([x, y], [p, q, r]) = (s.mean, s.root);
        [x, y, p, q, r].map(f64::to_bits)
    };
    words(a) == words(b) && a.log2_alpha.to_bits() == b.log2_alpha.to_bits() && a.pixels == b.pixels
}
