//! Shows frames of a stream in any state, as renderers and scenes take them.

use codec_core::{
    internals::{error, receiver::Content, wire::manifest::Manifest},
    player::Frame,
};
use dgs_player::FrameDecoder;

use crate::scene::Instant;

/// A decoder with its own memory.
#[derive(Clone, Debug)]
pub struct Player(FrameDecoder);

impl Player {
    /// A player for streams like `manifest`.
    pub fn new(manifest: &Manifest<'_>) -> Self {
        Self(FrameDecoder::new(manifest))
    }

    /// Decodes one frame of `content` in its state; all calls must be for the same stream.
    ///
    /// # Errors
    /// A frame past the end.
    pub fn show(&mut self, content: &Content<'_>, frame: u32) -> error::Result<Frame<'_>> {
        self.0.frame(content, frame)
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
