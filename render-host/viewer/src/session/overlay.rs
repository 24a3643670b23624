//! An overlay paints blocks of Gaussians by what is known of them, and moves nothing.

use std::collections::BTreeMap;

use codec_core::internals::{ids::Span, receiver::Content};
use dgs_player::Result;
use render_host::Gaussian;

use super::quality::{BlockOfFrame, LEVELS, blocks_of, missing};

/// Colours of what a block is shown at: its proxy, its base, refinements 1 to 3. People with any colour
/// vision tell them apart.
pub const LEVEL_COLOURS: [[f32; 3]; LEVELS + 1] =
    [[0.80, 0.27, 0.13], [0.95, 0.64, 0.16], [0.90, 0.88, 0.35], [0.25, 0.66, 0.70], [0.22, 0.38, 0.75]];

/// Display colour per unit of band 0.
pub(super) const SH0: f32 = render_host::harmonics::C0 as f32;
/// How long a block stays bright after a level has come, seconds.
const BRIGHT_S: f64 = 1.0;
/// Colours of a block that has just gained a level, and of one that has not for long.
const ARRIVALS: [[f32; 3]; 2] = [[1.0, 0.92, 0.35], [0.14, 0.15, 0.20]];
/// From nothing that is missing to the most that can be; brightness rises with it.
const MISSING: [[f32; 3]; 5] =
    [[0.10, 0.05, 0.30], [0.40, 0.10, 0.45], [0.75, 0.25, 0.35], [0.95, 0.55, 0.20], [0.98, 0.95, 0.60]];

/// What blocks are painted by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Overlay {
    /// Nothing: they have their own colours.
    #[default]
    None,
    /// The level that they are shown at: see [`LEVEL_COLOURS`].
    Levels,
    /// How long ago they gained a level: bright at first, dark after a second.
    Arrivals,
    /// The utility of what has not come, estimated, since receivers have no table of utilities: opacity times
    /// area of the largest cross-section, times the share of the error that is left at the levels that came;
    /// as a share of the most that it is of any block without a level.
    Missing,
}

impl Overlay {
    /// All of them, in the order in which a key goes through them.
    pub const ALL: [Self; 4] = [Self::None, Self::Levels, Self::Arrivals, Self::Missing];

    /// The one of this name; `None` where there is none.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().zip(NAMES).find(|(_, known)| *known == name).map(|(overlay, _)| overlay)
    }

    /// The colours that it paints in: of levels, those of [`LEVEL_COLOURS`]; else from the most to the least.
    pub fn colours(self) -> Vec<[f32; 3]> {
        match self {
            Self::None => Vec::new(),
            Self::Levels => LEVEL_COLOURS.to_vec(),
            Self::Arrivals => ARRIVALS.to_vec(),
            Self::Missing => MISSING.into_iter().rev().collect(),
        }
    }

    /// The one after this.
    #[must_use]
    pub fn next(self) -> Self {
        let at = Self::ALL.iter().position(|overlay| *overlay == self).unwrap_or(0);
        Self::ALL[(at + 1) % Self::ALL.len()]
    }
}

/// Names of all overlays.
const NAMES: [&str; 4] = ["none", "levels", "arrivals", "missing"];

/// An epoch, a cluster of it and a block of that.
type BlockPlace = (u16, u16, usize);

/// Paints Gaussians.
#[derive(Debug, Default)]
pub(super) struct Painter {
    overlay: Overlay,
    painted: Vec<Gaussian>,
    /// The time, seconds.
    now_s: f64,
    /// Of each block that was painted by arrivals, its usable levels and when they grew last.
    grown: BTreeMap<BlockPlace, (usize, f64)>,
    /// When any did.
    last_grown_s: f64,
    /// Whether one was painted brighter than it will be in the end.
    fading: bool,
}

impl Painter {
    pub(super) fn overlay(&self) -> Overlay {
        self.overlay
    }

    pub(super) fn set_overlay(&mut self, overlay: Overlay) {
        *self = Self { overlay, now_s: self.now_s, last_grown_s: f64::NEG_INFINITY, ..Self::default() };
    }

    /// Forgets when levels came: all packets come again.
    pub(super) fn forget_arrivals(&mut self) {
        self.set_overlay(self.overlay);
    }

    /// Sets the time.
    pub(super) fn set_time(&mut self, now_s: f64) {
        self.now_s = now_s;
    }

    /// Whether colours of what was painted last change with time: until it is painted as nothing new.
    pub(super) fn fading(&self) -> bool {
        self.fading
    }

    /// `gaussians` of a frame of `epoch`, painted by what of `content` has come; without higher harmonics.
    ///
    /// # Errors
    /// None in practice: content is as its manifest says.
    pub(super) fn paint(
        &mut self,
        gaussians: &[Gaussian],
        epoch: u16,
        span: Span,
        content: &Content,
    ) -> Result<&[Gaussian]> {
        self.painted.clear();
        self.painted.extend_from_slice(gaussians);
        let is_first = self.grown.range((epoch, 0, 0)..=(epoch, u16::MAX, usize::MAX)).next().is_none();
        let blocks = blocks_of(content, span, gaussians.len())?;
        let (utilities, most) = match self.overlay {
            Overlay::Missing => missing(&blocks, gaussians),
            _ => (vec![0.0; blocks.len()], 1.0),
        };
        for (block, utility) in blocks.into_iter().zip(utilities) {
            let BlockOfFrame { cluster, block, usable, gaussians } = block;
            let place = (epoch, cluster.0, block);
            let colour = match self.overlay {
                Overlay::None | Overlay::Levels => LEVEL_COLOURS[usable],
                Overlay::Arrivals => self.arrival_colour(place, usable, is_first),
                Overlay::Missing => ramp(&MISSING, (utility / most).sqrt()),
            };
            let sh0 = colour.map(|c| (c - 0.5) / SH0);
            self.painted[gaussians].iter_mut().for_each(|gaussian| gaussian.sh0 = sh0);
        }
        self.fading = self.overlay == Overlay::Arrivals && self.now_s < self.last_grown_s + BRIGHT_S;
        Ok(&self.painted)
    }

    /// The colour of a block that has `usable` levels now; what is there when an epoch is painted for the
    /// first time has been there for long.
    fn arrival_colour(&mut self, place: BlockPlace, usable: usize, is_first: bool) -> [f32; 3] {
        let begun = if is_first { (usable, f64::NEG_INFINITY) } else { (0, f64::NEG_INFINITY) };
        let (had, grown_s) = self.grown.entry(place).or_insert(begun);
        if usable > *had {
            (*had, *grown_s) = (usable, self.now_s);
            self.last_grown_s = self.now_s;
        }
        let age = ((self.now_s - *grown_s) / BRIGHT_S).clamp(0.0, 1.0);
        ramp(&ARRIVALS, age as f32)
    }
}

/// The colour at `share` of the way along `colours`, 0 to 1.
fn ramp(colours: &[[f32; 3]], share: f32) -> [f32; 3] {
    let last = colours.len() - 1;
    let at = share.clamp(0.0, 1.0) * last as f32;
    let before = (at as usize).min(last.saturating_sub(1));
    let part = at - before as f32;
    std::array::from_fn(|c| {
        colours[before][c] + part * (colours[(before + 1).min(last)][c] - colours[before][c])
    })
}
