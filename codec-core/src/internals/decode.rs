//! Symbols and a state in, Gaussians at a frame out.
//!
//! Deterministic: integers up to the last dequantise, then + − × ÷ √ in a fixed order. Every state is valid:
//! a block without its base gives [`Gaussian::ABSENT`] values at its fixed indices, but for the first, which
//! is the block's proxy if there are proxies, a cluster without its track keeps the last pose of the latest
//! earlier window that has one (else its canonical pose), and missing refinements leave coarser values.
//! Dropping a packet therefore changes the Gaussians of its blocks and no others.
//!
//! The decoder keeps dequantised canonical Gaussians between frames and redoes only blocks whose
//! state changed.

mod canonical;
mod cluster;
mod column;
pub mod motion;
mod paper;

use self::cluster::{ClusterDecode, cut, symbols_of};
use crate::{
    error::{Error, Result},
    gaussian::Gaussian,
    ids::{ClusterId, EpochId, Span},
    layout::Shape,
    receiver::Content,
    wire::manifest::Profile,
};

/// What [`Decoder::frame`] produced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Decoded {
    /// The epoch shown.
    pub epoch: EpochId,
    /// Gaussians of the epoch: the filled front of the output.
    pub gaussians: usize,
    /// Blocks whose base is usable.
    pub present_blocks: u32,
    /// Blocks of the epoch.
    pub blocks: u32,
    /// Blocks whose canonical attributes were dequantised anew for this frame.
    pub redone_blocks: u32,
}

/// The caller's memory for decoding.
#[derive(Debug, Default)]
pub struct Memory<'a> {
    /// Dequantised canonical Gaussians, at least those of the largest epoch.
    pub canonical: &'a mut [Gaussian],
    /// Usable levels per canonical block as last dequantised, at least those of the largest epoch.
    pub known: &'a mut [u8],
}

/// Dequantises and moves.
#[derive(Debug)]
pub struct Decoder<'a> {
    memory: Memory<'a>,
    epoch: Option<EpochId>,
}

/// Mark of a block that has not been dequantised.
const UNKNOWN: u8 = u8::MAX;

impl<'a> Decoder<'a> {
    /// A decoder that knows nothing yet.
    pub const fn new(memory: Memory<'a>) -> Self {
        Self { memory, epoch: None }
    }

    /// A decoder that goes on with memory another one left, which last showed `epoch` of the same
    /// stream.
    pub const fn resume(memory: Memory<'a>, epoch: Option<EpochId>) -> Self {
        Self { memory, epoch }
    }

    /// The epoch last shown.
    pub const fn epoch(&self) -> Option<EpochId> {
        self.epoch
    }

    /// Forgets what was dequantised; needed only when another stream follows.
    pub fn reset(&mut self) {
        self.epoch = None;
    }

    /// Decodes frame `frame` of `content` into the front of `out`, and the higher bands into
    /// `sh_rest` ([`ShDegree::rest_len`](crate::ShDegree::rest_len) of the manifest's degree per Gaussian).
    ///
    /// # Errors
    /// A frame past the end; [`crate::ErrorKind::Capacity`] naming the memory that is too small.
    pub fn frame(
        &mut self,
        content: &Content<'_>,
        frame: u32,
        out: &mut [Gaussian],
        sh_rest: &mut [f32],
    ) -> Result<Decoded> {
        let manifest = content.manifest;
        let frames = manifest.head().frames;
        let illegal = Error::illegal("frame", 0, frame.into(), (0, u64::from(frames) - 1));
        let id = manifest.epoch_at(frame).ok_or(illegal)?;
        let epoch = manifest.epoch(id).ok_or(illegal)?;
        let n = epoch.gaussians as usize;
        let rest = manifest.sh_degree().rest_len();
        for (field, have, need) in [
            ("decode.out", out.len(), n),
            ("decode.canonical", self.memory.canonical.len(), n),
            ("decode.sh_rest", sh_rest.len(), n * rest),
        ] {
            if have < need {
                return Err(Error::too_small(field, have, need));
            }
        }
        if self.epoch != Some(id) {
            self.memory.known.fill(UNKNOWN);
            self.epoch = Some(id);
        }
        let mut decoded = Decoded { epoch: id, gaussians: n, present_blocks: 0, blocks: 0, redone_blocks: 0 };
        let motion = match manifest.profile() {
            Profile::Dgs1 => motion::Frame::of(manifest, frame)?,
            Profile::Paper => None,
        };
        let (mut first, mut first_block) = (0usize, 0usize);
        for c in 0..epoch.clusters {
            let cluster = ClusterId(c as u16);
            let span = Span::Canonical(id);
            let shape = Shape::in_lattice(manifest, span, cluster)?;
            let cell = content.cell_in_lattice(span, cluster)?;
            let (count, blocks) = (shape.gaussians(), shape.blocks());
            let known = cut("decode.known", self.memory.known, first_block..first_block + blocks)?;
            let range = first..first + count;
            let part = ClusterDecode {
                content,
                epoch: &epoch,
                id,
                cluster,
                shape: &shape,
                cell,
                symbols: symbols_of(content, cell, &shape)?,
                canonical: cut("decode.canonical", self.memory.canonical, range.clone())?,
                out: cut("decode.out", out, range)?,
                sh_rest: cut("decode.sh_rest", sh_rest, first * rest..(first + count) * rest)?,
                rest,
            };
            let (present, redone) = match manifest.profile() {
                Profile::Dgs1 => dgs1(part, known, motion.as_ref())?,
                Profile::Paper => paper(part, frame - epoch.first_frame)?,
            };
            decoded.present_blocks += present;
            decoded.redone_blocks += redone;
            decoded.blocks += blocks as u32;
            first += count;
            first_block += blocks;
        }
        Ok(decoded)
    }
}

/// Decodes a cluster of `dgs1`: blocks that are present, blocks dequantised anew.
fn dgs1(
    mut part: ClusterDecode<'_, '_>,
    known: &mut [u8],
    motion: Option<&motion::Frame>,
) -> Result<(u32, u32)> {
    let (mut present, mut redone) = (0, 0);
    for (block, known) in known.iter_mut().enumerate() {
        let usable = part.content.arrived(part.cell, block)?.usable() as u8;
        present += u32::from(usable > 0);
        if *known != usable {
            canonical::dequantise(&mut part, block, usable)?;
            *known = usable;
            redone += 1;
        }
        if part.rest > 0 {
            // The caller's buffer may be new every frame; bands do not move.
            canonical::rest(&mut part, block, usable)?;
        }
    }
    part.out.iter_mut().zip(part.canonical.iter()).for_each(|(out, canonical)| *out = *canonical);
    if let Some(frame) = motion {
        motion::apply(&mut part, frame)?;
    }
    Ok((present, redone))
}

/// Decodes a cluster of `paper` at frame `t` of its epoch, as [`dgs1`].
fn paper(mut part: ClusterDecode<'_, '_>, t: u32) -> Result<(u32, u32)> {
    let usable = part.content.arrived(part.cell, 0)?.usable();
    paper::dequantise(&mut part, t, usable)?;
    Ok((u32::from(usable > 0), 1))
}
