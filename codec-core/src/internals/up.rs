//! Names the axes that may point up.

/// The axis of the world that points up.
///
/// # Examples
/// ```
/// use codec_core::Up;
///
/// assert_eq!(Up::named("minus-y"), Some(Up::MinusY));
/// assert_eq!(Up::default().vector(), [0.0, 1.0, 0.0]);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Up {
    /// +y, as in glTF.
    #[default]
    Y = 0,
    /// +x.
    X = 1,
    /// +z, as in Blender.
    Z = 2,
    /// −x.
    MinusX = 3,
    /// −y, as in many captures.
    MinusY = 4,
    /// −z.
    MinusZ = 5,
}

impl Up {
    /// Each of them; the place is the number on the wire.
    pub const ALL: [Self; 6] = [Self::Y, Self::X, Self::Z, Self::MinusX, Self::MinusY, Self::MinusZ];

    /// The axis of `number` on the wire.
    pub fn numbered(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    /// The axis of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|up| up.name() == name)
    }

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
            Self::MinusX => "minus-x",
            Self::MinusY => "minus-y",
            Self::MinusZ => "minus-z",
        }
    }

    /// The axis as a unit vector.
    pub const fn vector(self) -> [f64; 3] {
        match self {
            Self::X => [1.0, 0.0, 0.0],
            Self::Y => [0.0, 1.0, 0.0],
            Self::Z => [0.0, 0.0, 1.0],
            Self::MinusX => [-1.0, 0.0, 0.0],
            Self::MinusY => [0.0, -1.0, 0.0],
            Self::MinusZ => [0.0, 0.0, -1.0],
        }
    }
}

impl core::fmt::Display for Up {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_names_come_back() {
        for up in Up::ALL {
            assert_eq!((Up::numbered(up as u8), Up::named(up.name())), (Some(up), Some(up)));
        }
        assert_eq!((Up::numbered(6), Up::named("up")), (None, None));
    }
}
