//! Every bound of the format, once.

/// Largest DGSP payload, bytes (paper section 3).
pub const MAX_PAYLOAD_BYTES: usize = 1200;
/// Default size of a whole packet, bytes: fits a QUIC datagram before path-MTU discovery.
pub const DEFAULT_PACKET_BYTES: usize = 1150;
/// Largest whole packet of any profile: header, dependency words, payload, CRC.
pub const MAX_PACKET_BYTES: usize = 1280;
/// Most dependency words of a `paper` packet.
pub const MAX_DEPENDENCIES: usize = 8;
/// Most values of one packet: bounds the work on it, since tables exist whose values cost next to no
/// bits. Any block fits, however many coefficients it has.
pub const MAX_PACKET_VALUES: u32 = 1 << 18;
/// Most blocks that the extents of one packet span together, with those that bring nothing.
pub const MAX_PACKET_BLOCKS: u32 = 1 << 16;
/// Most symbols of a stream.
pub const MAX_SYMBOLS: u32 = 1 << 31;
/// Most extents of blocks in one packet.
pub const MAX_EXTENTS: usize = 16;
/// Most entropy tables that one stream chooses from.
pub const MAX_TABLE_SET: usize = 8;
/// Most Gaussians in one block.
pub const MAX_BLOCK_LEN: usize = 256;
/// Most Gaussians in one cluster.
pub const MAX_CLUSTER_LEN: usize = 32_768;
/// Most Gaussians in one epoch.
pub const MAX_EPOCH_GAUSSIANS: u32 = 1 << 23;
/// Most epochs in a stream.
pub const MAX_EPOCHS: usize = 4096;
/// Most windows in a stream.
pub const MAX_WINDOWS: usize = 16_384;
/// Most frames in one window.
pub const MAX_WINDOW_FRAMES: usize = 64;
/// Most frames in a stream.
pub const MAX_FRAMES: u32 = 1 << 20;
/// Most coefficients per Gaussian, component and window.
pub const MAX_RANK: usize = MAX_WINDOW_FRAMES;
/// Most clusters in a stream, over all epochs.
pub const MAX_CLUSTERS: u32 = 1 << 17;
/// Most quantisation profiles.
pub const MAX_QUANT_PROFILES: usize = 256;
/// Most entropy tables.
pub const MAX_TABLES: usize = 255;
/// Largest uncompressed manifest, bytes.
pub const MAX_MANIFEST_BYTES: usize = 64 << 20;
/// Most packets one parity packet covers.
pub const MAX_REPAIR_SET: usize = 64;
/// Most parity packets of one repair set.
pub const MAX_REPAIR_PARITY: usize = 8;
/// Largest receipt (DGSF), bytes.
pub const MAX_RECEIPT_BYTES: usize = 1200;
