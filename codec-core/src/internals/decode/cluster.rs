//! A cluster while it is decoded: where its symbols come from and where its Gaussians go.

use core::ops::Range;

use crate::{
    error::{Error, Result},
    gaussian::Gaussian,
    ids::{ClusterId, EpochId},
    layout::Shape,
    receiver::{Cell, Content},
    wire::manifest::Epoch,
};

/// One cluster at one frame.
pub(super) struct ClusterDecode<'p, 'm> {
    pub content: &'p Content<'m>,
    pub epoch: &'p Epoch,
    pub id: EpochId,
    pub cluster: ClusterId,
    pub shape: &'p Shape,
    pub cell: Cell,
    /// Symbols of the canonical cell.
    pub symbols: &'m [i16],
    pub canonical: &'p mut [Gaussian],
    pub out: &'p mut [Gaussian],
    pub sh_rest: &'p mut [f32],
    /// Values of `sh_rest` per Gaussian.
    pub rest: usize,
}

/// The elements `range` of the caller's memory `field`.
pub(super) fn cut<'s, T>(field: &'static str, all: &'s mut [T], range: Range<usize>) -> Result<&'s mut [T]> {
    let (have, need) = (all.len(), range.end);
    all.get_mut(range).ok_or_else(|| Error::too_small(field, have, need))
}

/// The symbols of a cell.
pub(super) fn symbols_of<'m>(content: &Content<'m>, cell: Cell, shape: &Shape) -> Result<&'m [i16]> {
    let (start, all) = (cell.symbols as usize, content.symbols);
    let end = start + shape.len();
    all.get(start..end).ok_or_else(|| Error::too_small("memory.symbols", all.len(), end))
}
