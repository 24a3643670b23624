//! Ids, each a type of its own, so that a cluster is never taken for a window.

use crate::{cursor::Reader, error::Result};

macro_rules! id {
    ($(#[$doc:meta])* $name:ident($inner:ty)) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $name(pub $inner);

        impl $name {
            /// As an index into a list.
            pub const fn index(self) -> usize {
                self.0 as usize
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

id!(
    /// An epoch of a manifest, counted from 0.
    EpochId(u16)
);
id!(
    /// A motion window, counted over all epochs from 0.
    WindowId(u16)
);
id!(
    /// A cluster, counted inside its epoch from 0.
    ClusterId(u16)
);
id!(
    /// A cell of the lattice: one cluster in one epoch (canonical) or in one window (motion).
    CellId(u32)
);

/// A packet, counted over the whole stream from 0; 24 bits on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PacketId(u32);

impl PacketId {
    /// Largest id there is.
    pub const MAX: u32 = (1 << 24) - 1;

    /// `id` in 0..=[`PacketId::MAX`], or `None`.
    pub const fn new(id: u32) -> Option<Self> {
        if id <= Self::MAX { Some(Self(id)) } else { None }
    }

    /// From the three bytes on the wire.
    pub const fn from_bytes(bytes: [u8; 3]) -> Self {
        Self(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], 0]))
    }

    /// From a varint on the wire, the field `packet.id`.
    ///
    /// # Errors
    /// As [`Reader::varint`].
    pub fn read(reader: &mut Reader<'_>) -> Result<Self> {
        let [a, b, c, _] = reader.varint("packet.id", Self::MAX)?.to_le_bytes();
        Ok(Self::from_bytes([a, b, c]))
    }

    /// The three bytes on the wire, little-endian.
    pub const fn to_bytes(self) -> [u8; 3] {
        let [a, b, c, _] = self.0.to_le_bytes();
        [a, b, c]
    }

    /// As a number.
    pub const fn get(self) -> u32 {
        self.0
    }

    /// As an index into a list.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

impl core::fmt::Display for PacketId {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        self.0.fmt(f)
    }
}

/// A refinement level: 0 is the base, 1..=3 refine it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Level(u8);

impl Level {
    /// The base level.
    pub const BASE: Self = Self(0);
    /// The highest level, of which nothing is missing where all levels are there.
    pub const HIGHEST: Self = Self(Self::COUNT as u8 - 1);
    /// Number of levels.
    pub const COUNT: usize = 4;
    /// All levels, base first.
    pub const ALL: [Self; Self::COUNT] = [Self(0), Self(1), Self(2), Self(3)];

    /// `level` in 0..=3, or `None`.
    pub const fn new(level: u8) -> Option<Self> {
        if level < Self::COUNT as u8 { Some(Self(level)) } else { None }
    }

    /// The two low bits of `bits`.
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits & 3)
    }

    /// As a number, 0..=3.
    pub const fn get(self) -> u8 {
        self.0
    }

    /// As an index, 0..=3.
    pub const fn index(self) -> usize {
        // The mask changes nothing; it shows the compiler that lists of four need no check.
        (self.0 & 3) as usize
    }
}

impl core::fmt::Display for Level {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        self.0.fmt(f)
    }
}

/// What a cell's data describes, and over which span of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Span {
    /// Canonical attributes of an epoch.
    Canonical(EpochId),
    /// Motion inside a window.
    Motion(WindowId),
}

/// A completion group: (window or epoch, cluster, level). Utility is measured per group.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Group {
    /// Epoch or window.
    pub span: Span,
    /// Cluster inside the epoch (a window's clusters are those of its epoch).
    pub cluster: ClusterId,
    /// Level.
    pub level: Level,
}
