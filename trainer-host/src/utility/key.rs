//! Names all that a table of utilities depends on, so that a stored table is used for nothing else.

use std::fmt;

use codec_core::{receiver::Content, wire::crc::crc32};
use render_host::Settings;
use serde_json::Value;

use super::Options;

/// Counts changes of how utilities are measured; a table of another number is measured anew.
const METHOD: u32 = 2;

/// What utilities were measured on and how.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Key {
    /// CRC-32 of the stream's manifest.
    pub manifest_crc: u32,
    /// CRC-32 of the decoded symbols.
    pub symbols_crc: u32,
    /// Distance between pictures.
    pub metric: String,
    /// Cameras, each with its pose, intrinsics and size, as JSON: a camera that is read is made orthonormal
    /// again, which may change its last bit.
    pub cameras: Vec<Value>,
    /// Width and height of the first camera's pictures, pixels.
    pub size: (u32, u32),
    /// Random states per span.
    pub contexts: usize,
    /// Frames of a span that each camera looks at.
    pub frames_per_span: usize,
    /// Whether everything else had arrived.
    pub complete: bool,
    /// Weight of the lower tail.
    pub alpha: f64,
    /// Weight of the deviation.
    pub beta: f64,
    /// Seed of contexts and frames.
    pub seed: u64,
    /// Render settings, apart from `parallel`, which changes no bit.
    pub settings: Settings,
    /// Version of the package and of the method that measured.
    pub version: String,
}

impl Key {
    /// Of utilities of `content` (all symbols arrived) measured with `options`.
    pub fn of(content: &Content<'_>, options: &Options) -> Self {
        Self {
            manifest_crc: crc32(content.manifest.raw()),
            symbols_crc: crc32(bytemuck::cast_slice(content.symbols)),
            metric: "MSE + 0.20 (1 - SSIM)".to_owned(),
            cameras: options.cameras.iter().map(|camera| serde_json::json!(camera)).collect(),
            size: options.cameras.first().map_or((0, 0), |camera| (camera.width(), camera.height())),
            contexts: options.states(),
            frames_per_span: options.frames_per_span,
            complete: options.complete,
            alpha: options.alpha,
            beta: options.beta,
            seed: options.seed,
            settings: Settings { parallel: true, ..options.settings.clone() },
            version: format!("{} method {METHOD}", env!("CARGO_PKG_VERSION")),
        }
    }

    /// Whether these utilities are of `content` and measured as this version measures.
    pub fn is_of(&self, content: &Content<'_>) -> bool {
        let here = Self::of(content, &Options::paper(Vec::new()));
        let same = |other: &Self| (other.manifest_crc, other.symbols_crc, other.version.clone());
        same(self) == same(&here)
    }

    /// Names of the fields in which `other` differs.
    pub fn differences(&self, other: &Self) -> Vec<&'static str> {
        let Self { manifest_crc, symbols_crc, metric, cameras, contexts, frames_per_span, .. } = self;
        let Self { complete, alpha, beta, seed, settings, version, .. } = self;
        let fields = [
            ("manifest", *manifest_crc == other.manifest_crc),
            ("symbols", *symbols_crc == other.symbols_crc),
            ("metric", *metric == other.metric),
            ("cameras", *cameras == other.cameras && self.size == other.size),
            ("contexts", *contexts == other.contexts),
            ("frames per span", *frames_per_span == other.frames_per_span),
            ("complete", *complete == other.complete),
            ("alpha", *alpha == other.alpha),
            ("beta", *beta == other.beta),
            ("seed", *seed == other.seed),
            ("render settings", *settings == other.settings),
            ("version", *version == other.version),
        ];
        fields.into_iter().filter(|(_, is_same)| !is_same).map(|(name, _)| name).collect()
    }
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { metric, cameras, size: (width, height), contexts, frames_per_span, .. } = self;
        let Self { alpha, beta, seed, .. } = self;
        let contexts =
            if self.complete { "complete state".to_owned() } else { format!("{contexts} contexts") };
        write!(
            f,
            "D = {metric}, {} cameras at {width}x{height}, {contexts}, {frames_per_span} frames per span and \
             camera, alpha {alpha}, beta {beta}, seed {seed}",
            cameras.len()
        )
    }
}
