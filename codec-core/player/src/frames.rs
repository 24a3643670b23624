//! Decodes frames of one stream in any state, in memory of its own.

use codec_core::{
    Gaussian, Result,
    internals::{
        arena::FrameRequirements,
        decode::{Decoder, Memory},
        gaussian::ShDegree,
        ids::EpochId,
        receiver::Content,
        wire::manifest::Manifest,
    },
    player::Frame,
};

/// A decoder with its own memory, for hosts that show many states of one stream, several at once.
///
/// A [`Player`](crate::Player) shows the state that has arrived; this shows any.
#[derive(Clone, Debug)]
pub struct FrameDecoder {
    canonical: Vec<Gaussian>,
    known: Vec<u8>,
    gaussians: Vec<Gaussian>,
    sh_rest: Vec<f32>,
    degree: ShDegree,
    epoch: Option<EpochId>,
}

impl FrameDecoder {
    /// A decoder for streams like that of `manifest`.
    pub fn new(manifest: &Manifest<'_>) -> Self {
        let FrameRequirements { gaussians, blocks, sh_rest } = FrameRequirements::of(manifest);
        Self {
            canonical: vec![Gaussian::ABSENT; gaussians],
            known: vec![0; blocks],
            gaussians: vec![Gaussian::ABSENT; gaussians],
            sh_rest: vec![0.0; sh_rest],
            degree: manifest.sh_degree(),
            epoch: None,
        }
    }

    /// Decodes frame `frame` of `content` in its state; all calls must be for the same stream.
    ///
    /// # Errors
    /// A frame past the end.
    pub fn frame(&mut self, content: &Content<'_>, frame: u32) -> Result<Frame<'_>> {
        let memory = Memory { canonical: &mut self.canonical, known: &mut self.known };
        let mut decoder = Decoder::resume(memory, self.epoch);
        let decoded = decoder.frame(content, frame, &mut self.gaussians, &mut self.sh_rest)?;
        self.epoch = decoder.epoch();
        Ok(Frame {
            gaussians: &self.gaussians[..decoded.gaussians],
            sh_rest: &self.sh_rest[..decoded.gaussians * self.degree.rest_len()],
            sh_degree: self.degree,
            decoded,
        })
    }
}
