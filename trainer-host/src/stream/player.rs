//! A host's end of a stream: memory to receive it in and a decoder to show it with.

use codec_core::{
    Caps, Gaussian, decode, error,
    gaussian::ShDegree,
    ids::{EpochId, Span},
    receiver::{Cell, Content, Memory, Requirements, for_each_cell},
    wire::manifest::Manifest,
};

use crate::scene::Instant;

/// Receiver memory on the heap, sized for one manifest.
#[derive(Clone, Debug)]
pub struct HostMemory {
    manifest: Vec<u8>,
    cells: Vec<Cell>,
    symbols: Vec<i16>,
    blocks: Vec<u8>,
    seen: Vec<u32>,
    slots: Vec<u32>,
    progress: Vec<u32>,
    parity: Vec<u8>,
    early: Vec<u8>,
}

impl HostMemory {
    /// Memory for `manifest`, with `early` bytes for media that comes before it.
    ///
    /// # Errors
    /// If the stream is larger than [`Caps::HOST`] allows.
    pub fn new(manifest: &Manifest<'_>, early: usize) -> error::Result<Self> {
        let need = Requirements::of(manifest, &Caps::HOST)?;
        Ok(Self {
            manifest: vec![0; manifest.raw().len()],
            cells: vec![Cell::default(); need.cells],
            symbols: vec![0; need.symbols],
            blocks: vec![0; need.blocks],
            seen: vec![0; need.seen],
            slots: vec![0; need.slots],
            progress: vec![0; need.progress],
            parity: vec![0; need.parity],
            early: vec![0; early],
        })
    }

    /// The memory as a receiver takes it.
    pub fn memory(&mut self) -> Memory<'_> {
        Memory {
            manifest: &mut self.manifest,
            cells: &mut self.cells,
            symbols: &mut self.symbols,
            blocks: &mut self.blocks,
            seen: &mut self.seen,
            slots: &mut self.slots,
            progress: &mut self.progress,
            parity: &mut self.parity,
            early: &mut self.early,
        }
    }

    /// What a receiver left in this memory.
    pub fn content<'m>(&'m self, manifest: &Manifest<'m>) -> Content<'m> {
        Content { manifest: *manifest, cells: &self.cells, symbols: &self.symbols, blocks: &self.blocks }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.manifest.len()
            + std::mem::size_of_val(self.cells.as_slice())
            + std::mem::size_of_val(self.symbols.as_slice())
            + self.blocks.len()
            + std::mem::size_of_val(self.seen.as_slice())
            + std::mem::size_of_val(self.slots.as_slice())
            + std::mem::size_of_val(self.progress.as_slice())
            + self.parity.len()
            + self.early.len()
    }
}

/// A decoder with its own memory.
#[derive(Clone, Debug)]
pub struct Player {
    canonical: Vec<Gaussian>,
    known: Vec<u8>,
    out: Vec<Gaussian>,
    sh_rest: Vec<f32>,
    degree: ShDegree,
    epoch: Option<EpochId>,
}

impl Player {
    /// A player for streams like `manifest`.
    pub fn new(manifest: &Manifest<'_>) -> Self {
        let most = manifest.epochs().map(|e| e.gaussians as usize).max().unwrap_or(0);
        let mut blocks = vec![0usize; usize::from(manifest.head().epochs)];
        for_each_cell(manifest, |span, _, shape| {
            if let Span::Canonical(EpochId(e)) = span {
                blocks[usize::from(e)] += shape.blocks();
            }
        });
        let degree = manifest.sh_degree();
        Self {
            canonical: vec![Gaussian::ABSENT; most],
            known: vec![0; blocks.into_iter().max().unwrap_or(0)],
            out: vec![Gaussian::ABSENT; most],
            sh_rest: vec![0.0; most * degree.rest_len()],
            degree,
            epoch: None,
        }
    }

    /// Decodes one frame of `content` in its state; all calls must be for the same stream.
    ///
    /// # Errors
    /// A frame past the end.
    pub fn show(&mut self, content: &Content<'_>, frame: u32) -> error::Result<Shown<'_>> {
        let memory = decode::Memory { canonical: &mut self.canonical, known: &mut self.known };
        let mut decoder = decode::Decoder::resume(memory, self.epoch);
        let decoded = decoder.frame(content, frame, &mut self.out, &mut self.sh_rest)?;
        self.epoch = decoder.epoch();
        Ok(Shown {
            gaussians: &self.out[..decoded.gaussians],
            sh_rest: &self.sh_rest[..decoded.gaussians * self.degree.rest_len()],
            sh_degree: self.degree,
            decoded,
        })
    }

    /// As [`Player::show`], copied out.
    ///
    /// # Errors
    /// A frame past the end.
    pub fn instant(&mut self, content: &Content<'_>, frame: u32) -> error::Result<Instant> {
        let shown = self.show(content, frame)?;
        Ok(Instant {
            gaussians: shown.gaussians.to_vec(),
            sh_rest: shown.sh_rest.to_vec(),
            sh_degree: shown.sh_degree,
        })
    }
}

/// A decoded frame in a [`Player`]'s memory.
#[derive(Clone, Copy, Debug)]
pub struct Shown<'p> {
    /// The Gaussians; absent ones have opacity 0.
    pub gaussians: &'p [Gaussian],
    /// Their higher bands.
    pub sh_rest: &'p [f32],
    /// Degree of `sh_rest`.
    pub sh_degree: ShDegree,
    /// What decoding did.
    pub decoded: decode::Decoded,
}
