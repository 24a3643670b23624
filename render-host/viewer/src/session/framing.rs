//! Frames what there is to see: where the camera is until somebody moves it.

use dgs_player::Result;

use super::{Session, Unframed, has_base};
use crate::{
    bounds::bounds,
    orbit::{Orbit, Up},
};

impl Session {
    /// Moves the camera so that every Gaussian of the frame that is due is in a picture `aspect`
    /// times as wide as high. Where none has come yet, [`Session::look_again`] does so later.
    ///
    /// # Errors
    /// None in practice.
    pub fn look_at_all(&mut self, aspect: f64, up: Up) -> Result<()> {
        let seen = self.bounds()?;
        let (middle, radius) = seen.unwrap_or(([0.0; 3], 1.0));
        let placed = Orbit::around(middle, radius, aspect, up);
        let is_open = seen.is_none() && self.awaits_base();
        self.orbit = placed;
        self.unframed = is_open.then_some(Unframed { placed, decoded: self.packets().1, found: false });
        Ok(())
    }

    /// Looks at all once more if there was nothing to look at: as soon as some of it has come, and again when
    /// the base has. A view that somebody has chosen meanwhile stays; the way back to the first is then to
    /// what has come.
    ///
    /// # Errors
    /// None in practice.
    pub fn look_again(&mut self, aspect: f64) -> Result<()> {
        let Some(before) = self.unframed else { return Ok(()) };
        let (is_last, decoded) = (!self.awaits_base(), self.packets().1);
        if !is_last && (before.found || decoded == before.decoded) {
            return Ok(());
        }
        let mut after = Unframed { decoded, ..before };
        if let Some((middle, radius)) = self.bounds()? {
            let around = Orbit::around(middle, radius, aspect, self.orbit.up());
            let is_chosen = self.orbit != before.placed.with_up(self.orbit.up());
            if is_chosen {
                self.orbit = around.at(self.orbit.numbers()).unwrap_or(self.orbit);
            } else {
                (self.orbit, after.placed) = (around, around);
            }
            after.found = true;
        }
        self.unframed = (!is_last).then_some(after);
        Ok(())
    }

    /// Where the Gaussians of the frame that is due are: see [`bounds`].
    ///
    /// # Errors
    /// None in practice.
    pub fn bounds(&mut self) -> Result<Option<([f64; 3], f64)>> {
        self.last = None;
        Ok(bounds(self.decoder.frame(&self.player.content(), self.playback.frame())?.gaussians))
    }

    /// Whether the base of the frame that is due is still to come.
    fn awaits_base(&self) -> bool {
        self.base_timeout_s() > 0.0 && !has_base(&self.player, &self.plan, self.playback.frame())
    }
}
