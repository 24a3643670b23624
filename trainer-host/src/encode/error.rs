//! Errors name why a scene cannot be encoded.

use super::evaluator::EvaluationError;

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
    /// An option that is no whole number is out of range, or not a number.
    #[error("option {option} is {found}; {low} to {high} is allowed")]
    Number {
        /// Which option.
        option: &'static str,
        /// Value found.
        found: f64,
        /// Smallest allowed.
        low: f64,
        /// Largest allowed.
        high: f64,
    },
    /// A frame rate that a manifest does not hold: it would be written as another.
    #[error("the scene's frame rate is {found}; {low} to {high} frames per second are allowed")]
    FrameRate {
        /// Value found.
        found: f64,
        /// Smallest allowed.
        low: f64,
        /// Largest allowed.
        high: f64,
    },
    /// There is nothing to encode, or nowhere to measure from.
    #[error("{what} is empty; at least one is needed")]
    Empty {
        /// Which list.
        what: &'static str,
    },
    /// Nothing of the scene would be drawn.
    #[error(
        "every Gaussian stays below opacity 1/255, at which nothing is drawn; at least one above is needed"
    )]
    NeverDrawn,
    /// A Gaussian is further from the origin than the format holds.
    #[error(
        "Gaussian {gaussian} of epoch {epoch} is at {position:?} at frame {frame} of the scene; coordinates \
         of -{most:e} to {most:e} scene units are allowed"
    )]
    Position {
        /// Index of the epoch in the scene.
        epoch: usize,
        /// Index of the Gaussian in its epoch.
        gaussian: usize,
        /// Frame of the scene.
        frame: usize,
        /// Its centre there, scene units.
        position: [f32; 3],
        /// Largest magnitude of a coordinate.
        most: f32,
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
    #[error("{option} is {wanted}; coarseness {coarseness}, the best of those tried, reaches {reached:.2}")]
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
    /// Steps of motion alone, the others being decided, do not meet the target.
    #[error(
        "{option} is {wanted}; {motion} times the usual steps of motion, the furthest that is tried, reach \
         {reached:.2}"
    )]
    UnreachableByMotion {
        /// Which target.
        option: &'static str,
        /// Value wanted.
        wanted: f64,
        /// The closest value, in the target's unit.
        reached: f64,
        /// Its factor on steps of motion.
        motion: f32,
    },
    /// A picture of the stream could not be compared with the scene's.
    #[error(transparent)]
    Evaluation(#[from] EvaluationError),
    /// The symbols of one block do not fit one packet.
    #[error(
        "a block of {gaussians} Gaussians of cluster {cluster} does not fit a packet of {limit} bytes at \
         level {level}"
    )]
    BlockTooLarge {
        /// Level of its symbols.
        level: u8,
        /// Its cluster, within the epoch.
        cluster: usize,
        /// Gaussians in the block.
        gaussians: usize,
        /// Most bytes of a packet.
        limit: usize,
    },
    /// Decisions cannot be followed on this scene.
    #[error("decisions, {place}: {field} is {found}; {allowed} is allowed")]
    Decisions {
        /// Where in the decisions.
        place: String,
        /// Which field.
        field: &'static str,
        /// Value found.
        found: String,
        /// What is allowed.
        allowed: String,
    },
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
    /// Whoever listened to progress stopped the work.
    #[error("stopped at stage {stage}")]
    Stopped {
        /// The stage that was not begun.
        stage: &'static str,
    },
    /// The wire format refused what the encoder made of the scene.
    #[error("the encoder produced something the format refuses: {0}")]
    Format(#[from] codec_core::Error),
}
