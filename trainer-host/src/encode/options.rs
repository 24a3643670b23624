//! Options say what an encoding is to be like.

use codec_core::internals::{limits, wire::manifest::Profile};

use super::{EncodeError, Protection, Quality, Target, cluster, search, sensitivity::MOST_PICTURES};

/// What to encode, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Format choices.
    pub profile: Profile,
    /// Clustering.
    pub cluster: cluster::Options,
    /// Gaussians per block, 1..=256 (`dgs1`).
    pub block_len: usize,
    /// Most frames in a motion window, 1..=64; default one second.
    pub window_frames: Option<usize>,
    /// Most vectors in the shared temporal basis.
    pub rank: usize,
    /// Fineness of the quantisers.
    pub quality: Quality,
    /// Pictures per epoch that tell how errors in each Gaussian show, 0 to 1024: steps follow (`dgs1`).
    /// 0 is the steps of `quality` for all.
    pub pictures: usize,
    /// Scale `quality` until the stream meets this.
    pub target: Option<Target>,
    /// Most encodings spent on how attributes share the bits, 0 (none) to 500.
    pub search: usize,
    /// Most entropy tables that the symbol runs of one stream choose from, 1..=8 (`dgs1`): fewer take less
    /// memory of a receiver.
    pub table_choices: usize,
    /// Whether every block has a proxy in the manifest (`dgs1`).
    pub proxies: bool,
    /// Largest packet, header and CRC included, bytes (`dgs1`); 200..=1226.
    pub packet_bytes: usize,
    /// Parity per kind of packets.
    pub repair: Protection,
    /// Whether probabilities follow the symbols of a chunk, in place of tables in the manifest (`paper`).
    pub context_coder: bool,
    /// Send also the Gaussians whose opacity stays below 1/255 at every frame (`dgs1`).
    pub keep_invisible: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            profile: Profile::Dgs1,
            cluster: cluster::Options::default(),
            block_len: 64,
            window_frames: None,
            rank: 8,
            quality: Quality::default(),
            pictures: 16,
            target: None,
            search: 0,
            table_choices: limits::MAX_TABLE_SET,
            proxies: true,
            packet_bytes: limits::DEFAULT_PACKET_BYTES,
            repair: Protection::NONE,
            context_coder: false,
            keep_invisible: false,
        }
    }
}

impl Options {
    /// Defaults of the `paper` profile: rank 4.
    pub fn paper() -> Self {
        Self { profile: Profile::Paper, rank: 4, ..Self::default() }
    }

    /// Defaults of the `paper` profile with the context coder.
    pub fn paper_context() -> Self {
        Self { context_coder: true, ..Self::paper() }
    }

    pub(super) fn check(&self) -> Result<(), EncodeError> {
        let within = |option, found: usize, low: usize, high: usize| {
            if (low..=high).contains(&found) {
                return Ok(());
            }
            Err(EncodeError::Option { option, found, low, high })
        };
        within("block_len", self.block_len, 1, limits::MAX_BLOCK_LEN)?;
        within("window_frames", self.window_frames.unwrap_or(1), 1, limits::MAX_WINDOW_FRAMES)?;
        within("rank", self.rank, 0, limits::MAX_RANK)?;
        within("pictures", self.pictures, 0, MOST_PICTURES)?;
        within("search", self.search, 0, search::MOST)?;
        within("table_choices", self.table_choices, 1, limits::MAX_TABLE_SET)?;
        within("packet_bytes", self.packet_bytes, 200, 1226)?;
        within("cluster.max_gaussians", self.cluster.max_gaussians, 1, limits::MAX_CLUSTER_LEN)?;
        self.target.map_or(Ok(()), Target::check)?;
        self.repair.strengths().try_for_each(|strength| {
            within("repair.set_len", strength.set_len.into(), 2, limits::MAX_REPAIR_SET)?;
            within("repair.parity", strength.parity.into(), 1, limits::MAX_REPAIR_PARITY)
        })
    }
}
