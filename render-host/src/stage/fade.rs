//! Early termination of whole tiles: finds the splat behind which every pixel of a tile is opaque.
//!
//! A splat that covers a whole tile takes at least `1 - a` from every transmittance in it, where `a` is its
//! smallest alpha there: log alpha is concave, so that is the alpha of a corner. Once the product of what
//! is left is below the stop, no splat behind is blended in any pixel. A million splats over one tile
//! then cost a list of some thousands at most, and a picture cannot tell.

use super::Splat;
use crate::settings::Settings;

/// The rule, for one set of settings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fade {
    /// log₂ of the transmittance at which nothing more is listed.
    pub(super) stop: f64,
    log2_cutoff: f64,
    max: f64,
    /// Side of a tile, pixels.
    pub(super) side: usize,
}

/// Relative rounding, in f32, of a transmittance per splat, with room.
const ROUNDING: f64 = 1e-6;
/// Share by which an alpha of the blend may be below the exact one, with room.
const ALPHA_MARGIN: f64 = 1e-4;

impl Fade {
    /// The rule by which a render stops. `None` where it never does.
    pub(super) fn of_picture(settings: &Settings) -> Option<Self> {
        Self::at(settings, f64::from(settings.stop()))
    }

    /// As a render stops, but not before a transmittance of 1e-10, so that sums without early stop do not
    /// change either.
    pub(super) fn of_class(settings: &Settings) -> Option<Self> {
        Self::at(settings, f64::from(settings.stop()).min(1e-10))
    }

    fn at(settings: &Settings, stop: f64) -> Option<Self> {
        let (log2_cutoff, max) = (settings.log2_cutoff(), f64::from(settings.alpha_max));
        (stop > 0.0).then(|| Self { stop: stop.log2(), log2_cutoff, max, side: settings.tile.pixels() })
    }

    /// What `splat` adds to an upper bound of log₂ transmittance in every pixel of the tile at `corner`: 0
    /// unless it covers the tile.
    pub(super) fn step(&self, splat: &Splat, corner: [usize; 2]) -> f64 {
        // A quick no; the yes is that of the corners.
        if usize::from(splat.pixels[0]) > corner[0] || usize::from(splat.pixels[2]) > corner[1] {
            return 0.0;
        }
        let [xx, xy, yy] = splat.root;
        let near = |k: usize| corner[k] as f64 + 0.5 - splat.mean[k];
        let far = |k: usize| near(k) + (self.side - 1) as f64;
        let mut distance2 = 0.0f64;
        for (dx, dy) in [(near(0), near(1)), (far(0), near(1)), (near(0), far(1)), (far(0), far(1))] {
            distance2 = distance2.max((xx * dx + xy * dy).powi(2) + (yy * dy).powi(2));
        }
        let log2 = f64::from(splat.log2_alpha) - distance2;
        // As a number that fails: an alpha that is not one covers nothing.
        if log2 >= self.log2_cutoff + ALPHA_MARGIN {
            let alpha = log2.exp2().min(self.max) * (1.0 - ALPHA_MARGIN);
            ((1.0 - alpha).log2() + ROUNDING).min(0.0)
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::TILE;
    use crate::stage::blend::{Tile, blend_tile};

    fn cover(i: u32) -> Splat {
        let t = f64::from(i);
        Splat {
            mean: [8.0 + 30.0 * t.sin(), 8.0 + 30.0 * (1.3 * t).cos()],
            root: [0.01, 0.004 * (0.7 * t).sin(), 0.012],
            colour: [0.5, 0.001 * (i % 900) as f32, 1.0],
            log2_alpha: -1.0 - (i % 5) as f32,
            pixels: [0, 40, 0, 40],
        }
    }

    /// Where the rule says finished, the rest of the list does not change a bit; a little earlier it does.
    #[test]
    fn what_is_left_out_is_not_seen() {
        let splats: Vec<Splat> = (0..4000).map(cover).collect();
        let settings = Settings { alpha_cutoff: 1e-3, ..Settings::default() };
        let fade = Fade::of_picture(&settings).unwrap();
        let mut left = 0.0;
        let needed = splats.iter().position(|s| {
            left += fade.step(s, [16, 16]);
            left < fade.stop
        });
        let needed = needed.unwrap() + 1;
        assert!((10..2000).contains(&needed), "{needed}");
        let picture = |count: usize| {
            let list: Vec<u32> = (0..count as u32).collect();
            let mut tile = Tile::EMPTY;
            blend_tile(&splats, &list, [16, 16], [40, 40], &settings, false, &mut tile);
            (0..TILE).flat_map(|y| tile.over(y, [0.3; 3])).flatten().map(f32::to_bits).collect::<Vec<_>>()
        };
        assert_eq!(picture(needed), picture(4000));
        assert_ne!(picture(needed / 2), picture(4000));
    }

    #[test]
    fn only_covers_count() {
        let fade = Fade::of_picture(&Settings::default()).unwrap();
        assert!(fade.step(&cover(3), [16, 16]) < -0.01);
        // The last tile of the image, of 8 pixels.
        assert!(fade.step(&cover(3), [32, 16]) < -0.01);
        assert_eq!(fade.step(&Splat { pixels: [17, 40, 0, 40], ..cover(3) }, [16, 16]), 0.0);
        assert_eq!(fade.step(&Splat { root: [1.0, 0.0, 1.0], ..cover(3) }, [16, 16]), 0.0);
        assert_eq!(fade.step(&Splat { log2_alpha: -30.0, ..cover(3) }, [16, 16]), 0.0);
        assert!(
            Fade::of_picture(&Settings::exact()).is_none() && Fade::of_class(&Settings::exact()).is_none()
        );
    }
}
