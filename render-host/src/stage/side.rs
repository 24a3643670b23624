//! A tile side says how large the tiles are that lists are made for.

use serde::{Deserialize, Serialize};

use super::TILE;

/// Side of a tile, pixels. The picture is the same bit for bit with any: pixels are blended in cells of
/// [`TILE`] pixels either way, from whose corner positions are rounded; a smaller tile is a quarter of a
/// cell, a larger one is four cells that share a list.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub enum TileSide {
    /// 8 pixels: more entries, of which fewer are in vain.
    Eight,
    /// 16 pixels, as all stages but bin and blend of the CPU have it.
    #[default]
    Sixteen,
    /// 32 pixels: fewer entries, of which more are in vain.
    ThirtyTwo,
}

/// A tile side that is not one of those there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("setting tile is {0}; 8, 16 and 32 pixels are allowed")]
pub struct TileSideError(pub u8);

impl TileSide {
    /// All of them, smallest first.
    pub const ALL: [Self; 3] = [Self::Eight, Self::Sixteen, Self::ThirtyTwo];

    /// Side, pixels.
    pub const fn pixels(self) -> usize {
        1 << self.shift()
    }

    const fn shift(self) -> u32 {
        match self {
            Self::Eight => 3,
            Self::Sixteen => 4,
            Self::ThirtyTwo => 5,
        }
    }

    /// Tiles that begin before pixel `past`.
    pub(crate) const fn tiles(self, past: usize) -> usize {
        (past + self.pixels() - 1) >> self.shift()
    }

    /// Tile that holds pixel `pixel`.
    pub(crate) const fn of(self, pixel: usize) -> usize {
        pixel >> self.shift()
    }

    /// Rows of tiles in a row of cells, at least one.
    pub(crate) const fn rows_per_cell(self) -> usize {
        TILE.div_ceil(self.pixels())
    }
}

impl TryFrom<u8> for TileSide {
    type Error = TileSideError;

    fn try_from(pixels: u8) -> Result<Self, TileSideError> {
        Self::ALL.into_iter().find(|side| side.pixels() == usize::from(pixels)).ok_or(TileSideError(pixels))
    }
}

impl From<TileSide> for u8 {
    fn from(side: TileSide) -> Self {
        1 << side.shift()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_three_sides_are_allowed() {
        for pixels in 0..=u8::MAX {
            match TileSide::try_from(pixels) {
                Ok(side) => assert_eq!((side.pixels(), u8::from(side)), (usize::from(pixels), pixels)),
                Err(error) => {
                    assert!(
                        ![8, 16, 32].contains(&pixels) && error.to_string().contains(&pixels.to_string())
                    );
                }
            }
        }
        assert_eq!(TileSide::default().pixels(), TILE);
        assert!(serde_json::from_str::<TileSide>("12").unwrap_err().to_string().contains("tile is 12"));
    }

    #[test]
    fn tiles_and_cells() {
        assert_eq!(TileSide::ALL.map(|side| side.tiles(33)), [5, 3, 2]);
        assert_eq!(TileSide::ALL.map(|side| side.of(31)), [3, 1, 0]);
        assert_eq!(TileSide::ALL.map(TileSide::rows_per_cell), [2, 1, 1]);
    }
}
