//! Names the scenes made from formulas, and holds their size and seed.

/// Which scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SynthKind {
    /// Rigid textured balls bouncing over a still chequered floor.
    Balls,
    /// A figure walking on the spot.
    Figure,
    /// A hanging sheet that waves in four modes.
    Cloth,
    /// Blobs that appear and fade; half way, one ring becomes three balls: a second epoch.
    Births,
}

impl SynthKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Balls, Self::Figure, Self::Cloth, Self::Births];

    /// The kind called `name`, one of `balls`, `figure`, `cloth`, `births`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|k| k.name() == name)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Balls => "balls",
            Self::Figure => "figure",
            Self::Cloth => "cloth",
            Self::Births => "births",
        }
    }
}

/// How to make a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct SynthOptions {
    /// Which scene.
    pub kind: SynthKind,
    /// Gaussians in all, 1,000 to 1,000,000; a scene holds exactly as many (births: its first epoch).
    pub gaussians: usize,
    /// Frames.
    pub frames: usize,
    /// Frames per second.
    pub frames_per_second: f64,
    /// Seed of everything that varies: positions, colours, phases.
    pub seed: u64,
}

impl Default for SynthOptions {
    fn default() -> Self {
        Self { kind: SynthKind::Balls, gaussians: 20_000, frames: 60, frames_per_second: 30.0, seed: 1 }
    }
}
