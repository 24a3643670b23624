//! Where every symbol lives: the one order that encoder, packets and dequantiser share.
//!
//! A *cell* is one cluster in one span. Its symbols are stored level after level. In `dgs1` a
//! level is stored block after block, a block class after class, component after component, and
//! a component Gaussian after Gaussian, so that any run of whole blocks is one contiguous range
//! and a packet decodes straight into place. Motion level 0 (the cluster track) belongs to the
//! whole cell. In `paper` a level is one range, stored as [`paper`] says.

use core::{num::NonZero, ops::Range};

use crate::{
    error::{Error, ErrorKind, Result},
    ids::{ClusterId, EpochId, Level, Span},
    quant::{Class, Quantiser},
    wire::manifest::{Cluster, Manifest, Motion, Profile, Quant, stream},
};

/// Sizes of one cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// The cluster.
    pub cluster: Cluster,
    /// Its quantisation profile.
    pub quant: Quant,
    /// How it moves in the window; all zero for a canonical cell.
    pub motion: Motion,
    /// Frames the cell covers.
    pub frames: u32,
    /// Whether this is a motion cell.
    pub is_motion: bool,
    /// Gaussians per block.
    pub block_len: NonZero<u32>,
    /// Symbols of the whole cell per level (track; everything in `paper`).
    fixed: [usize; Level::COUNT],
    /// Symbols per Gaussian per level.
    per_gaussian: [usize; Level::COUNT],
}

impl Shape {
    /// The shape of `cluster` in `span`, if there is such a cell.
    pub fn of(manifest: &Manifest<'_>, span: Span, cluster: ClusterId) -> Option<Self> {
        let (epoch_id, window) = match span {
            Span::Canonical(epoch) => (epoch, None),
            Span::Motion(id) => {
                let window = manifest.window(id)?;
                (EpochId(window.epoch), Some((id, window)))
            }
        };
        let epoch = manifest.epoch(epoch_id)?;
        let record = manifest.cluster(epoch_id, cluster)?;
        let quant = manifest.quant(record.quant)?;
        let motion = match window {
            Some((id, _)) => manifest.motion(id, cluster)?,
            None => Motion::default(),
        };
        let frames = window.map_or(epoch.frames, |(_, w)| u32::from(w.frames));
        let moving = window.map(|_| motion);
        let mut shape = Self::dgs1(record, quant, moving, frames, manifest.block_len());
        if manifest.profile() == Profile::Paper {
            shape.per_gaussian = [0; Level::COUNT];
            shape.fixed = paper::symbols(
                usize::from(record.gaussians),
                frames as usize,
                usize::from(epoch.rank),
                rest_len(record.sh_degree()),
            );
        }
        Some(shape)
    }

    /// As [`Shape::of`], of a cell that the lattice has.
    ///
    /// # Errors
    /// [`ErrorKind::Contradiction`]: there is no such cell.
    pub fn in_lattice(manifest: &Manifest<'_>, span: Span, cluster: ClusterId) -> Result<Self> {
        Self::of(manifest, span, cluster).ok_or_else(|| no_cell(manifest, cluster))
    }

    /// The shape of a `dgs1` cell: canonical without `motion`, else a motion cell of `frames`
    /// frames.
    pub fn dgs1(
        cluster: Cluster,
        quant: Quant,
        motion: Option<Motion>,
        frames: u32,
        block_len: NonZero<u32>,
    ) -> Self {
        let mut shape = Self {
            cluster,
            quant,
            motion: motion.unwrap_or_default(),
            frames,
            is_motion: motion.is_some(),
            block_len,
            fixed: [0; Level::COUNT],
            per_gaussian: [0; Level::COUNT],
        };
        for level in Level::ALL {
            shape.per_gaussian[level.index()] = shape.components(level).map(|(_, _, dims)| dims).sum();
        }
        shape.fixed[0] = shape.motion.class().parameters() * usize::from(shape.motion.track);
        shape
    }

    /// The highest level that carries symbols.
    pub const fn top(&self) -> Level {
        if self.is_motion { self.motion.top() } else { self.cluster.top() }
    }

    /// The level at which `class` appears in this cell.
    const fn first_level(&self, class: Class) -> Level {
        if self.is_motion { Level::ALL[1] } else { class.first_level() }
    }

    /// The quantiser of `class` in this cell.
    fn quantiser(&self, class: Class) -> Option<&Quantiser> {
        let quantisers = if self.is_motion { &self.quant.motion[..] } else { &self.quant.canonical[..] };
        quantisers.get(class.index())
    }

    /// Whether `level` carries a symbol per component (and coefficient) of `class`.
    pub fn carries(&self, class: Class, level: Level) -> bool {
        let exists = self.is_motion || class.sh_degree() <= self.cluster.sh_degree();
        let symbol = |q: &Quantiser| q.has_symbol(level, self.first_level(class));
        exists && level <= self.top() && self.quantiser(class).is_some_and(symbol)
    }

    /// Gaussians in the cell.
    pub const fn gaussians(&self) -> usize {
        self.cluster.gaussians as usize
    }

    /// Blocks in the cell, ≥ 1.
    pub fn blocks(&self) -> usize {
        self.cluster.blocks(self.block_len) as usize
    }

    /// Index of the first Gaussian of block `block`; past the last block, the number of Gaussians.
    pub fn first_of(&self, block: usize) -> usize {
        (block * self.block_len.get() as usize).min(self.gaussians())
    }

    /// Gaussians in block `block`; none past the last block.
    pub fn block_gaussians(&self, block: usize) -> usize {
        self.first_of(block + 1) - self.first_of(block)
    }

    /// Symbols of `level`.
    ///
    /// Saturates, as all sizes here do, where a hostile manifest asks for more than an address
    /// space holds; [`Requirements`](crate::receiver::Requirements) refuses such a stream.
    pub const fn level_len(&self, level: Level) -> usize {
        let per = self.per_gaussian[level.index()].saturating_mul(self.gaussians());
        self.fixed[level.index()].saturating_add(per)
    }

    /// Symbols of the whole cell.
    pub fn len(&self) -> usize {
        Level::ALL.into_iter().fold(0, |sum, l| self.level_len(l).saturating_add(sum))
    }

    /// True when the cell holds no symbols (a cluster that does not move in the window).
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether `level` of this cell is one piece that cannot be split by blocks.
    pub const fn is_whole(&self, level: Level) -> bool {
        self.fixed[level.index()] > 0
    }

    /// Offset in the cell and number of symbols of `blocks`, first to last, at `level`.
    pub fn range(&self, level: Level, blocks: Range<usize>) -> (usize, usize) {
        let before: usize = Level::ALL.into_iter().take(level.index()).map(|l| self.level_len(l)).sum();
        if self.is_whole(level) {
            return (before, self.level_len(level));
        }
        let per = self.per_gaussian[level.index()];
        let (start, end) = (self.first_of(blocks.start), self.first_of(blocks.end));
        (before + per * start, per * (end - start))
    }

    /// The parts of a Gaussian at `level` (`dgs1`), in order: class, coefficient, components.
    /// Canonical classes have the one coefficient 0.
    pub fn components(&self, level: Level) -> impl Iterator<Item = (Class, usize, usize)> + use<> {
        let this = *self;
        let wanted = move |class: &Class| this.carries(*class, level);
        Class::ALL.into_iter().filter(wanted).flat_map(move |class| {
            let coefficients = if this.is_motion { this.motion.rank(class) } else { 1 };
            (0..coefficients).map(move |k| (class, k, class.components()))
        })
    }

    /// Calls `run` with (stream, symbols) for each run of symbols of `blocks` at `level`, in
    /// storage order (`dgs1`): one per component of a block, the first value apart where values are
    /// coded in differences; one per kind and frequency band of a track. Stops at the first error.
    ///
    /// # Errors
    /// Whatever `run` returns.
    pub fn runs<E>(
        &self,
        level: Level,
        blocks: Range<usize>,
        mut run: impl FnMut(usize, usize) -> core::result::Result<(), E>,
    ) -> core::result::Result<(), E> {
        if self.is_whole(level) {
            let (track, coefficients) = (self.motion.class(), usize::from(self.motion.track));
            for (kind, parameters) in [(Some(track), track.turning()), (None, 3)] {
                let edges = stream::TRACK_BANDS.map(|edge| edge.min(coefficients));
                for (band, (low, high)) in edges.iter().zip(edges.iter().skip(1)).enumerate() {
                    if high > low {
                        run(stream::track(kind, band), parameters * (high - low))?;
                    }
                }
            }
            return Ok(());
        }
        for block in blocks {
            let n = self.block_gaussians(block);
            for (class, k, dims) in self.components(level) {
                let differences = level == self.first_level(class)
                    && self.quantiser(class).is_some_and(Quantiser::predicted);
                let (stream, start) = if self.is_motion {
                    (stream::coefficient(class, level, k), stream::coefficient_start(class))
                } else {
                    (stream::canonical(class, level), stream::start(class))
                };
                for _ in 0..dims {
                    if !differences {
                        run(stream, n)?;
                        continue;
                    }
                    run(start, 1)?;
                    if n > 1 {
                        run(stream, n - 1)?;
                    }
                }
            }
        }
        Ok(())
    }
}

#[cold]
fn no_cell(manifest: &Manifest<'_>, cluster: ClusterId) -> Error {
    let last = u64::from(manifest.head().clusters).saturating_sub(1);
    let none = Error::illegal("manifest.cells", 0, cluster.0.into(), (0, last));
    none.kind(ErrorKind::Contradiction)
}

/// Harmonic coefficients above band 0, all channels, of `degree`.
pub const fn rest_len(degree: u8) -> usize {
    let d = degree as usize + 1;
    (d * d - 1) * 3
}

/// Storage order of the `paper` profile, and its sizes.
///
/// With n Gaussians, T frames and rank R, each list component-major, Gaussian inner:
/// level 0: position 3, log-scale 3, quaternion 4, opacity 1, band 0 3; level 1: q (R × 3), then
/// per frame the first refinement of the 11 attributes, then the higher bands; levels 2 and 3:
/// per frame δ (3) and a refinement of the 11 attributes.
pub mod paper {
    /// Attributes with refinements: log-scale 3, quaternion 4, opacity 1, band 0 3.
    pub const ATTRIBUTES: usize = 11;
    /// Symbols per Gaussian of level 0.
    pub const BASE: usize = 3 + ATTRIBUTES;

    /// Symbols per level.
    pub const fn symbols(n: usize, frames: usize, rank: usize, rest: usize) -> [usize; 4] {
        let fine = n.saturating_mul(frames).saturating_mul(3 + ATTRIBUTES);
        let first = frames.saturating_mul(ATTRIBUTES).saturating_add(3 * rank + rest);
        [n.saturating_mul(BASE), n.saturating_mul(first), fine, fine]
    }

    /// Offset of the first refinement in level 1.
    pub const fn refinement1(n: usize, rank: usize) -> usize {
        n * 3 * rank
    }

    /// Offset of the higher bands in level 1.
    pub const fn rest(n: usize, frames: usize, rank: usize) -> usize {
        n * (3 * rank + frames * ATTRIBUTES)
    }
}
