//! Indices of packets and groups of a graph.

/// Index of a packet in [`super::PacketGraph::packets`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PacketIndex(pub u32);

/// Index of a group in [`super::PacketGraph::groups`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GroupIndex(pub u32);

impl PacketIndex {
    /// As a slice index.
    pub fn at(self) -> usize {
        self.0 as usize
    }
}

impl GroupIndex {
    /// As a slice index.
    pub fn at(self) -> usize {
        self.0 as usize
    }
}
