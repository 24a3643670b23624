//! Names the low-pass filters on the screen that scenes are fitted with and must be drawn with.

/// The low-pass filter of projected Gaussians (EWA splatting): a variance that is added along both axes of
/// the screen, and whether opacity is lowered for it. A scene must be drawn with the one that it was fitted
/// with.
///
/// # Examples
/// ```
/// use codec_core::Footprint;
///
/// assert_eq!(Footprint::named("pixel"), Some(Footprint::Pixel));
/// assert_eq!(Footprint::Pixel.low_pass(), 0.1);
/// assert!(Footprint::Pixel.compensates_opacity() && !Footprint::default().compensates_opacity());
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Footprint {
    /// 0.3 pixels², opacity is kept (the dilation of 3DGS): a scene grows where pixels are larger than those
    /// that it was fitted to, and shrinks where they are smaller.
    #[default]
    Dilated = 0,
    /// 0.3 pixels², opacity is lowered (gsplat's *antialiased*, the flag of SPZ and SOG).
    Compensated = 1,
    /// 0.1 pixels², about the box of a pixel, opacity is lowered (the 2D Mip filter of Mip-Splatting): the
    /// same at any size of pixels.
    Pixel = 2,
}

impl Footprint {
    /// Each of them; the place is the number on the wire.
    pub const ALL: [Self; 3] = [Self::Dilated, Self::Compensated, Self::Pixel];

    /// The footprint of `number` on the wire.
    pub fn numbered(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    /// The footprint of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|footprint| footprint.name() == name)
    }

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Dilated => "dilated",
            Self::Compensated => "compensated",
            Self::Pixel => "pixel",
        }
    }

    /// Variance that is added along both axes of a projected Gaussian, pixels².
    pub const fn low_pass(self) -> f64 {
        match self {
            Self::Dilated | Self::Compensated => 0.3,
            Self::Pixel => 0.1,
        }
    }

    /// Whether opacity is multiplied by the root of the ratio of determinants before and after.
    pub const fn compensates_opacity(self) -> bool {
        !matches!(self, Self::Dilated)
    }
}
