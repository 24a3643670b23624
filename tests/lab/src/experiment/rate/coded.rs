//! Holds what every codec under measurement gives: sizes, times, decoded frames.

use std::time::Instant;

use trainer_host::Instant as Frame;

/// A scene, coded and decoded again.
pub struct Coded {
    /// Everything a receiver needs, bytes.
    pub bytes: usize,
    /// Wall time of encoding, seconds.
    pub encode_s: f64,
    /// Wall time of decoding all frames, seconds.
    pub decode_s: f64,
    /// The decoded frames that were requested.
    pub shown: Vec<Frame>,
}

/// Wall time.
pub struct Timer(Instant);

impl Timer {
    /// Starts now.
    pub fn start() -> Self {
        Self(Instant::now())
    }

    /// Seconds since.
    pub fn seconds(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }
}
