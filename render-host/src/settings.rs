//! Every tolerance and every skip of the renderers, by name.
//!
//! A *tolerance* changes the picture and is part of what an image means; the reference obeys it too. A
//! *skip* saves work and never changes a bit of the picture (a test says so), except `early_stop`, which
//! switches the tolerance `transmittance_stop` on and off. A *precision* (`depth_bits`,
//! `half_attributes`) says how many bits a value is kept in; it changes the picture by an error that the
//! reference, which keeps every bit, makes visible.

use codec_core::{Footprint, ShDegree};
use serde::{Deserialize, Serialize};

use crate::stage::TileSide;

/// How to render. Plain data; checked by [`Settings::validate`] when rendering starts.
///
/// ```
/// use render_host::Settings;
///
/// let settings = Settings { antialiased: true, ..Settings::over([1.0; 3]) };
/// settings.validate()?;
/// let wrong = Settings { alpha_max: 2.0, ..settings };
/// assert_eq!(wrong.validate().unwrap_err().field, "alpha_max");
/// # Ok::<(), render_host::SettingsError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Colour behind everything, r g b; finite, ±1e6.
    pub background: [f32; 3],
    /// Variance added to both axes of a projected splat, pixels², 0..=100. Source: 0.3 in 3DGS. What a scene
    /// was made for is its [`Footprint`] ([`Settings::with_footprint`]).
    pub low_pass: f64,
    /// Dims a splat by √(det / det dilated), at least 0.005, so that `low_pass` adds no energy
    /// (Mip-Splatting).
    pub antialiased: bool,
    /// A splat adds nothing to a pixel where its alpha is below this, 0..=0.5. Source: 1/255 in 3DGS.
    /// At 0 the support ends at 2⁻¹²⁵, the edge of the normal f32 range.
    pub alpha_cutoff: f32,
    /// Alpha is clamped to this, 0.5..=1. Source: 0.99 in 3DGS.
    pub alpha_max: f32,
    /// A pixel is finished once its transmittance is below this, 0..=0.5: inclusive, the splat that
    /// crosses is still blended. Source: 1e-4 in 3DGS, which leaves that splat out.
    pub transmittance_stop: f32,
    /// Harmonic bands above this degree (0..=3) are ignored.
    pub max_sh_degree: u8,
    /// Precision: bits of the depth key that order splats, 16..=32. Below 32, the lowest bits of the depth
    /// as f32 are dropped; splats with equal keys are drawn in order of index.
    pub depth_bits: u8,
    /// Precision: colour and shape of a projected splat are rounded to f16, as a device with little memory
    /// stores them; centre and opacity are not. Gradients go straight through the rounding.
    pub half_attributes: bool,
    /// Side of the tiles that lists are made for; changes no bit of the picture. Only the forward renderer of
    /// the CPU has others than 16; whatever else is asked for them refuses.
    pub tile: TileSide,
    /// Uses the current rayon pool. The picture is the same bit for bit either way.
    pub parallel: bool,
    /// Skip: leave out what a cheap bound puts wholly outside the image before computing its shape.
    pub cull_frustum: bool,
    /// Skip: leave out a splat whose box holds no pixel centre.
    pub cull_sub_pixel: bool,
    /// Skip: bound a splat by its own opacity, not as if it were opaque.
    pub opacity_bounds: bool,
    /// Skip: list a splat only in tiles that its cut-off ellipse touches, not in all of its box, where that
    /// is more than 6 tiles.
    pub exact_tiles: bool,
    /// Skip: leave a splat out of the lists of tiles none of whose pixel centres it reaches, by looking at
    /// pixel rows where `exact_tiles` (which this refines) looks at the strip they lie in.
    pub cull_entries: bool,
    /// Skip: a tile without a splat costs its background, no blending and no room.
    pub skip_empty_tiles: bool,
    /// Skip: leave out the rows of a tile that a splat does not reach.
    pub row_reach: bool,
    /// Skip: weigh no harmonic bands above those a Gaussian holds, where the caller says which
    /// (see [`crate::Splats::with_bands`]).
    pub sh_by_need: bool,
    /// Skip: stop a pixel at `transmittance_stop`. Off, every splat is blended.
    pub early_stop: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            background: [0.0; 3],
            low_pass: 0.3,
            antialiased: false,
            alpha_cutoff: 1.0 / 255.0,
            alpha_max: 0.99,
            transmittance_stop: 1e-4,
            max_sh_degree: 3,
            depth_bits: 32,
            half_attributes: false,
            tile: TileSide::Sixteen,
            parallel: true,
            cull_frustum: true,
            cull_sub_pixel: true,
            opacity_bounds: true,
            exact_tiles: true,
            cull_entries: false,
            skip_empty_tiles: true,
            row_reach: true,
            sh_by_need: true,
            early_stop: true,
        }
    }
}

/// A setting out of its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("setting {field} is {found}; {}", allowed(*low, *high))]
pub struct SettingsError {
    /// Which setting.
    pub field: &'static str,
    /// Its value.
    pub found: f64,
    /// Smallest allowed.
    pub low: f64,
    /// Largest allowed.
    pub high: f64,
}

fn allowed(low: f64, high: f64) -> String {
    if low == high { format!("only {low} is allowed here") } else { format!("{low} to {high} is allowed") }
}

/// Transmittance that counts as nothing: no sum of f32 shows what is behind it. Below it, it would decay
/// into subnormal numbers, which take a processor up to thirty times as long.
pub(crate) const NOTHING: f32 = 1e-30;

impl Settings {
    /// The defaults over `background`.
    pub fn over(background: [f32; 3]) -> Self {
        Self { background, ..Self::default() }
    }

    /// The same for Gaussians that are made to be drawn with `footprint`: its `low_pass` and `antialiased`.
    #[must_use]
    pub fn with_footprint(self, footprint: Footprint) -> Self {
        Self { low_pass: footprint.low_pass(), antialiased: footprint.compensates_opacity(), ..self }
    }

    /// Every skip that leaves the picture as it is switched off; tolerances stay.
    #[must_use]
    pub fn without_skips(self) -> Self {
        Self {
            cull_frustum: false,
            cull_sub_pixel: false,
            opacity_bounds: false,
            exact_tiles: false,
            cull_entries: false,
            skip_empty_tiles: false,
            row_reach: false,
            sh_by_need: false,
            ..self
        }
    }

    /// Nothing cut and nothing stopped early: what the compositing equation says, for judging tolerances.
    pub fn exact() -> Self {
        Self { alpha_cutoff: 0.0, early_stop: false, ..Self::default() }
    }

    /// Checks every range.
    ///
    /// # Errors
    /// The first setting out of its range, NaN included.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let check = |field, found: f64, low: f64, high: f64| {
            if found >= low && found <= high {
                Ok(())
            } else {
                Err(SettingsError { field, found, low, high })
            }
        };
        for channel in self.background {
            check("background", f64::from(channel), -1e6, 1e6)?;
        }
        check("low_pass", self.low_pass, 0.0, 100.0)?;
        check("alpha_cutoff", f64::from(self.alpha_cutoff), 0.0, 0.5)?;
        check("alpha_max", f64::from(self.alpha_max), 0.5, 1.0)?;
        check("transmittance_stop", f64::from(self.transmittance_stop), 0.0, 0.5)?;
        check("max_sh_degree", f64::from(self.max_sh_degree), 0.0, 3.0)?;
        check("depth_bits", f64::from(self.depth_bits), 16.0, 32.0)
    }

    /// As [`Settings::validate`], for what knows only tiles of the usual side.
    pub(crate) fn validate_for_one_tile_side(&self) -> Result<(), SettingsError> {
        self.validate()?;
        let [found, only] = [self.tile, TileSide::default()].map(|side| side.pixels() as f64);
        if found == only {
            Ok(())
        } else {
            Err(SettingsError { field: "tile", found, low: only, high: only })
        }
    }

    /// The degree actually evaluated for splats of degree `available`.
    pub(crate) fn degree(&self, available: ShDegree) -> u8 {
        self.max_sh_degree.min(available.get())
    }

    /// Transmittance below which a pixel takes no more splats: the stop, and [`NOTHING`] where there is none.
    pub(crate) fn closed_below(&self) -> f32 {
        self.stop().max(NOTHING)
    }

    /// Transmittance below which a pixel is finished; 0 when `early_stop` is off.
    pub(crate) fn stop(&self) -> f32 {
        if self.early_stop { self.transmittance_stop } else { 0.0 }
    }

    /// Alpha below which a splat adds nothing: never 0, and twice the smallest normal f32 at least, so
    /// that where the blend's exponential saturates (2⁻¹²⁶) nothing is added, with or without skips.
    pub(crate) fn cutoff(&self) -> f32 {
        self.alpha_cutoff.max(2.0 * f32::MIN_POSITIVE)
    }

    /// log₂ of [`Settings::cutoff`].
    pub(crate) fn log2_cutoff(&self) -> f64 {
        f64::from(self.cutoff()).log2()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_enforced_by_name() {
        let good = Settings::default();
        good.validate().unwrap();
        Settings::exact().validate().unwrap();
        let bad = [
            ("background", Settings { background: [0.0, f32::NAN, 0.0], ..good.clone() }),
            ("low_pass", Settings { low_pass: -0.1, ..good.clone() }),
            ("alpha_cutoff", Settings { alpha_cutoff: f32::NAN, ..good.clone() }),
            ("alpha_max", Settings { alpha_max: 1.5, ..good.clone() }),
            ("transmittance_stop", Settings { transmittance_stop: -1.0, ..good.clone() }),
            ("max_sh_degree", Settings { max_sh_degree: 4, ..good.clone() }),
            ("depth_bits", Settings { depth_bits: 15, ..good.clone() }),
            ("depth_bits", Settings { depth_bits: 33, ..good.clone() }),
        ];
        for (field, settings) in bad {
            let error = settings.validate().unwrap_err();
            assert_eq!(error.field, field, "{error}");
        }
        let large = Settings { tile: TileSide::ThirtyTwo, ..good };
        large.validate().unwrap();
        let error = large.validate_for_one_tile_side().unwrap_err();
        assert_eq!(error.to_string(), "setting tile is 32; only 16 is allowed here");
    }

    #[test]
    fn settings_survive_json() {
        let settings = Settings { antialiased: true, background: [1.0; 3], ..Settings::default() };
        let text = serde_json::to_string(&settings).unwrap();
        assert_eq!(serde_json::from_str::<Settings>(&text).unwrap(), settings);
        assert_eq!(serde_json::from_str::<Settings>("{}").unwrap(), Settings::default());
        assert!(serde_json::from_str::<Settings>(r#"{"lowpass": 1}"#).is_err());
    }
}
