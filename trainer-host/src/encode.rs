//! The encoder: a scene in, a stream out. The path is one function, [`encode`], that reads as the
//! diagram: cluster → factorise → layer → quantise → entropy-code → packetise.

pub mod cluster;
mod dgs1;
pub mod factorise;
pub mod judge;
mod ledger;
mod packetise;
mod paper;
mod parity;
mod protection;
mod report;
mod search;
pub mod sensitivity;
mod statistics;
mod steps;
mod strata;
mod target;

pub use ledger::{Ledger, Part, Share};
pub use protection::{Protection, ProtectionError, Strength};
pub use report::{Encoded, QuantiserClass, Report};
pub use search::Searched;
pub use steps::Quality;
pub use target::{COARSENESS, Reached, Target};

use codec_core::internals::{
    ids::{Level, PacketId},
    limits,
    wire::manifest::Profile,
};

use self::strata::Strata;
use self::{judge::JudgeError, sensitivity::MOST_PICTURES};
use crate::scene::Scene;

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
    /// Most entropy tables a stream's runs choose from, 1..=8 (`dgs1`): fewer take less memory of a
    /// receiver.
    pub menu: usize,
    /// Whether every block has a proxy in the manifest (`dgs1`).
    pub proxies: bool,
    /// The highest level sent of each cell of the lattice, canonical cells first (`dgs1`); cells past the
    /// end are sent whole.
    pub tops: Vec<Level>,
    /// Largest packet, header and CRC included, bytes (`dgs1`); 200..=1226.
    pub packet_bytes: usize,
    /// Parity per kind of packets.
    pub repair: Protection,
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
            menu: limits::MAX_TABLE_SET,
            proxies: true,
            tops: Vec::new(),
            packet_bytes: limits::DEFAULT_PACKET_BYTES,
            repair: Protection::NONE,
            keep_invisible: false,
        }
    }
}

impl Options {
    /// Defaults of the `paper` profile: rank 4.
    pub fn paper() -> Self {
        Self { profile: Profile::Paper, rank: 4, ..Self::default() }
    }

    fn check(&self) -> Result<(), EncodeError> {
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
        within("menu", self.menu, 1, limits::MAX_TABLE_SET)?;
        within("packet_bytes", self.packet_bytes, 200, 1226)?;
        within("cluster.max_gaussians", self.cluster.max_gaussians, 1, limits::MAX_CLUSTER_LEN)?;
        self.target.map_or(Ok(()), Target::check)?;
        self.repair.strengths().try_for_each(|strength| {
            within("repair.set_len", strength.set_len.into(), 2, limits::MAX_REPAIR_SET)?;
            within("repair.parity", strength.parity.into(), 1, limits::MAX_REPAIR_PARITY)
        })
    }
}

/// Why a scene cannot be encoded.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EncodeError {
    /// An option is out of range.
    #[error("option {option} is {found}; {low}..={high} is allowed")]
    Option {
        /// Which option.
        option: &'static str,
        /// Value found.
        found: usize,
        /// Smallest allowed.
        low: usize,
        /// Largest allowed.
        high: usize,
    },
    /// A target is out of range.
    #[error("option {option} is {found}; a number above 0 and up to {most} is allowed")]
    Target {
        /// Which target.
        option: &'static str,
        /// Value found.
        found: f64,
        /// Largest allowed.
        most: f64,
    },
    /// A price of bytes is out of range.
    #[error("truncation's lambda is {found}; a number of at least 0 is allowed")]
    Lambda {
        /// Value found.
        found: f64,
    },
    /// No coarseness meets the target.
    #[error("{option} is {wanted}; coarseness {coarseness}, the furthest allowed, reaches {reached}")]
    Unreachable {
        /// Which target.
        option: &'static str,
        /// Value asked for.
        wanted: f64,
        /// The closest value, in the target's unit.
        reached: f64,
        /// Its coarseness.
        coarseness: f32,
    },
    /// A picture of the stream could not be compared with the scene's.
    #[error(transparent)]
    Judge(#[from] JudgeError),
    /// The scene exceeds a bound of the format.
    #[error("the scene has {found} {what}; the format holds up to {most}")]
    Bound {
        /// What there is too much of.
        what: &'static str,
        /// How much.
        found: usize,
        /// How much is allowed.
        most: usize,
    },
    /// The wire format refused what the encoder made of the scene.
    #[error("the encoder produced something the format refuses: {0}")]
    Format(#[from] codec_core::Error),
}

/// Told how far the encoder is: stage name and share done, 0..=1.
pub type Progress<'p> = &'p (dyn Fn(&'static str, f64) + Sync);

/// Encodes `scene`.
///
/// Deterministic: equal scenes and options give equal bytes on any number of threads.
///
/// # Errors
/// An option out of range, a scene beyond the bounds of the format, or a target that no coarseness
/// meets.
pub fn encode(scene: &Scene, options: &Options, progress: Progress<'_>) -> Result<Encoded, EncodeError> {
    options.check()?;
    check_scene(scene)?;
    let strata = if options.profile == Profile::Paper {
        Strata::none()
    } else if options.pictures == 0 {
        Strata::one(scene, options)?
    } else {
        progress("measure", 0.0);
        Strata::measured(scene, options)?
    };
    let stream = match options.target {
        Some(target) => target::encode(scene, options, &strata, target, progress)?,
        None => once(scene, options, &strata, progress)?,
    };
    if options.search == 0 { Ok(stream) } else { search::encode(scene, options, &strata, stream, progress) }
}

/// Encodes `scene` at the quality of `options`, whatever their target and search.
fn once(
    scene: &Scene,
    options: &Options,
    strata: &Strata,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    match options.profile {
        Profile::Dgs1 => {
            // A block whose symbols do not fit one packet is halved until they do.
            let mut options = options.clone();
            loop {
                match dgs1::encode(scene, &options, strata, progress) {
                    Err(EncodeError::Format(error)) if error.field == "body" && options.block_len > 1 => {
                        options.block_len = options.block_len.div_ceil(2);
                    }
                    result => break result,
                }
            }
        }
        Profile::Paper => paper::encode(scene, options, progress),
    }
}

fn check_scene(scene: &Scene) -> Result<(), EncodeError> {
    let within = |what, found: usize, most: usize| {
        if found <= most { Ok(()) } else { Err(EncodeError::Bound { what, found, most }) }
    };
    within("epochs", scene.epochs().len(), limits::MAX_EPOCHS)?;
    within("frames", scene.frames(), limits::MAX_FRAMES as usize)?;
    within("Gaussians in an epoch", scene.max_count(), limits::MAX_EPOCH_GAUSSIANS as usize)
}

/// The frame rate as a fraction: frames, seconds.
fn rate(scene: &Scene) -> (u32, u32) {
    let fps = scene.frames_per_second();
    for seconds in [1u32, 1001, 1000] {
        let frames = fps * f64::from(seconds);
        if frames.fract().abs() < 1e-9 && frames <= 1e9 {
            return ((frames as u32).max(1), seconds);
        }
    }
    (((fps * 1000.0).round().clamp(1.0, 1e9)) as u32, 1000)
}

fn packet_id(id: usize) -> Result<PacketId, EncodeError> {
    let most = PacketId::MAX as usize;
    u32::try_from(id).ok().and_then(PacketId::new).ok_or(EncodeError::Bound {
        what: "packets",
        found: id,
        most,
    })
}
