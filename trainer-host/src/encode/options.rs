//! Holds the options of an encoding, and checks their ranges.

use codec_core::internals::{limits, wire::manifest::Profile};

use render_host::{Backend, Camera, DeviceChoice};

use super::{
    EncodeError, Protection, QuantiserSteps, cluster,
    evaluator::{EvaluationError, PSNR_CAP_DB},
    sensitivity::MAX_PICTURES,
};

/// Range of steps and of factors on features: far beyond what can be of use, and no sum of them overflows.
const NUMBERS: (f64, f64) = (1e-9, 1e9);

/// Most encodings that a search may be asked for.
const MAX_TRIALS: usize = 500;

/// What an encoding must meet.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub enum Target {
    /// At most this many bits on the wire per Gaussian of the scene, above 0.
    BitsPerGaussian(f64),
    /// At most this many bytes on the wire: manifest, packets and parity, at least 1.
    Bytes(u64),
    /// At least this PSNR in dB, above 0 and at most 99: mean over validation cameras and frames spread
    /// over the clip, each picture weighed by the share of it that the scene covers.
    PsnrDb(f64),
}

impl Target {
    /// The option's name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::BitsPerGaussian(_) => "target_bits_per_gaussian",
            Self::Bytes(_) => "target_bytes",
            Self::PsnrDb(_) => "target_psnr",
        }
    }

    /// The number asked for.
    pub const fn value(self) -> f64 {
        match self {
            Self::BitsPerGaussian(v) | Self::PsnrDb(v) => v,
            Self::Bytes(v) => v as f64,
        }
    }

    pub(super) fn check(self) -> Result<(), EncodeError> {
        let most = if matches!(self, Self::PsnrDb(_)) { PSNR_CAP_DB } else { f64::MAX };
        let (option, found) = (self.name(), self.value());
        if found > 0.0 && found <= most {
            return Ok(());
        }
        Err(EncodeError::Target { option, found, most })
    }
}

/// Where a target PSNR is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetViews {
    /// At least one.
    pub cameras: Vec<Camera>,
    /// Behind the scene, 0 to 1 per channel.
    pub background: [f32; 3],
}

/// What to encode, and how.
///
/// # Examples
/// ```
/// use trainer_host::{
///     encode::{EncodeOptions, Target, encode},
///     import::{Limits, synth},
/// };
///
/// let options = synth::SynthOptions { gaussians: 1000, frames: 2, ..Default::default() };
/// let scene = synth::make(&options, &Limits::default())?;
/// let target = Some(Target::Bytes(20_000));
/// let options = EncodeOptions { target, pictures: 0, ..EncodeOptions::default() };
/// let encoded = encode(&scene, &options, &trainer_host::encode::no_progress)?;
/// assert!(encoded.report.ledger.wire() <= 20_000.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct EncodeOptions {
    /// Format choices.
    pub profile: Profile,
    /// Clustering.
    pub cluster: cluster::ClusterOptions,
    /// Gaussians per block, 1..=256 (`dgs1`).
    pub block_len: usize,
    /// Most frames in a motion window, 1..=64; default one second.
    pub window_frames: Option<usize>,
    /// Most vectors in the shared temporal basis.
    pub rank: usize,
    /// Fineness of the quantisers.
    pub quality: QuantiserSteps,
    /// Pictures per epoch that tell how errors in each Gaussian show, 0 to 1024: steps follow (`dgs1`).
    /// 0 is the steps of `quality` for all.
    pub pictures: usize,
    /// Scale `quality` until the stream meets this.
    pub target: Option<Target>,
    /// Where a target PSNR is measured; by default from validation cameras, over black.
    pub target_views: Option<TargetViews>,
    /// Most trial encodings spent on how attributes share the bits, 0 (none) to 500; fewer than 4 change
    /// nothing. Up to 8 more then come back to the PSNR that there was, or meet the target.
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
    /// What draws the pictures that choices are made by. Streams of two devices may differ a little.
    pub device: DeviceChoice,
    /// Send also the Gaussians whose opacity stays below 1/255 at every frame (`dgs1`).
    pub keep_invisible: bool,
}

impl Default for EncodeOptions {
    fn default() -> Self {
        Self {
            profile: Profile::Dgs1,
            cluster: cluster::ClusterOptions::default(),
            block_len: 64,
            window_frames: None,
            rank: 8,
            quality: QuantiserSteps::default(),
            pictures: 16,
            target: None,
            target_views: None,
            search: 0,
            table_choices: limits::MAX_TABLE_SET,
            proxies: true,
            packet_bytes: limits::DEFAULT_PACKET_BYTES,
            repair: Protection::NONE,
            context_coder: false,
            device: DeviceChoice::Cpu,
            keep_invisible: false,
        }
    }
}

impl EncodeOptions {
    /// Defaults of the `paper` profile: rank 4.
    pub fn paper() -> Self {
        Self { profile: Profile::Paper, rank: 4, ..Self::default() }
    }

    /// Defaults of the `paper` profile with the context coder.
    pub fn paper_context() -> Self {
        Self { context_coder: true, ..Self::paper() }
    }

    /// What draws the pictures that choices are made by.
    pub(super) fn backend(&self) -> Result<Backend, EvaluationError> {
        Ok(Backend::open(self.device)?)
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
        within("pictures", self.pictures, 0, MAX_PICTURES)?;
        within("search", self.search, 0, MAX_TRIALS)?;
        within("table_choices", self.table_choices, 1, limits::MAX_TABLE_SET)?;
        within("packet_bytes", self.packet_bytes, 200, 1226)?;
        within("cluster.max_gaussians", self.cluster.max_gaussians, 1, limits::MAX_CLUSTER_LEN)?;
        let QuantiserSteps { position, scale, rotation, opacity, sh0, sh_rest, motion } = self.quality;
        number("quality.position", position.into(), NUMBERS)?;
        number("quality.scale", scale.into(), NUMBERS)?;
        number("quality.rotation", rotation.into(), NUMBERS)?;
        number("quality.opacity", opacity.into(), NUMBERS)?;
        number("quality.sh0", sh0.into(), NUMBERS)?;
        number("quality.sh_rest", sh_rest.into(), NUMBERS)?;
        number("quality.motion", motion.into(), NUMBERS)?;
        let from_zero = (0.0, NUMBERS.1);
        number("cluster.max_variance", self.cluster.max_variance, from_zero)?;
        let cluster::FeatureWeights { position, displacement, speed, visibility } = self.cluster.weights;
        number("cluster.weights.position", position, from_zero)?;
        number("cluster.weights.displacement", displacement, from_zero)?;
        number("cluster.weights.speed", speed, from_zero)?;
        number("cluster.weights.visibility", visibility, from_zero)?;
        if self.target_views.as_ref().is_some_and(|views| views.cameras.is_empty()) {
            return Err(EncodeError::Empty { what: "option target_views.cameras" });
        }
        self.target.map_or(Ok(()), Target::check)?;
        self.repair.strengths().try_for_each(|strength| {
            within("repair.set_len", strength.set_len.into(), 2, limits::MAX_REPAIR_SET)?;
            within("repair.parity", strength.parity.into(), 1, limits::MAX_REPAIR_PARITY)?;
            within("repair.loss_percent", strength.loss_percent.into(), 0, 50)
        })
    }
}

/// Refuses what is outside `low` to `high`, and what is not a number.
fn number(option: &'static str, found: f64, (low, high): (f64, f64)) -> Result<(), EncodeError> {
    if found >= low && found <= high {
        return Ok(());
    }
    Err(EncodeError::Number { option, found, low, high })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is said of the defaults after `change`.
    fn said_of(change: impl Fn(&mut EncodeOptions)) -> String {
        let mut options = EncodeOptions::default();
        change(&mut options);
        options.check().unwrap_err().to_string()
    }

    #[test]
    fn numbers_out_of_range_are_named() {
        EncodeOptions::default().check().unwrap();
        for bad in [f32::NAN, f32::INFINITY, -1.0, 0.0] {
            let error = said_of(|options| options.quality.sh0 = bad);
            assert!(error.starts_with(&format!("option quality.sh0 is {bad}; ")), "{error}");
            let error = said_of(|options| options.quality.motion = bad);
            assert!(error.starts_with(&format!("option quality.motion is {bad}; ")), "{error}");
        }
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            let error = said_of(|options| options.cluster.max_variance = bad);
            assert!(error.starts_with(&format!("option cluster.max_variance is {bad}; ")), "{error}");
            let error = said_of(|options| options.cluster.weights.speed = bad);
            assert!(error.starts_with(&format!("option cluster.weights.speed is {bad}; ")), "{error}");
        }
    }

    #[test]
    fn a_target_needs_a_camera() {
        let views = TargetViews { cameras: Vec::new(), background: [0.0; 3] };
        let error = said_of(|options| options.target_views = Some(views.clone()));
        assert_eq!(error, "option target_views.cameras is empty; at least one is needed");
    }
}
