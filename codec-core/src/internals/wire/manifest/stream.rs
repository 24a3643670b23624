//! The symbol streams of `dgs1` have numbers, and each a table set of its own.

use super::Track;
use crate::{ids::Level, quant::Class};

/// Bands of temporal frequencies of a track: 0, 1..=3, 4..=7 and those above.
pub const TRACK_BANDS: [usize; 5] = [0, 1, 4, 8, usize::MAX];
const START_FIRST: usize = Class::COUNT * Level::COUNT;
const TRACK_FIRST: usize = START_FIRST + Class::COUNT;
const COEFFICIENT_FIRST: usize = TRACK_FIRST + 3 * 4;
const COEFFICIENT_START_FIRST: usize = COEFFICIENT_FIRST + Class::MOVING * 3 * 2;
/// Number of streams.
pub const COUNT: usize = COEFFICIENT_START_FIRST + Class::MOVING;

/// Canonical attribute `class` at `level`.
pub const fn canonical(class: Class, level: Level) -> usize {
    class.index() * Level::COUNT + level.index()
}

/// The first value of each component of a block where `class` is coded in differences.
pub const fn start(class: Class) -> usize {
    START_FIRST + class.index()
}

/// Track parameters of band `band` (0..4): those that turn by `track`, or translation.
pub const fn track(track: Option<Track>, band: usize) -> usize {
    let kind = match track {
        None => 0,
        Some(Track::Rigid) => 1,
        Some(_) => 2,
    };
    TRACK_FIRST + kind * 4 + band % 4
}

/// Motion coefficient `k` of `class` (one of the moving ones) at `level` 1..=3.
pub const fn coefficient(class: Class, level: Level, k: usize) -> usize {
    let level = (level.index() + 2) % 3;
    COEFFICIENT_FIRST + (class.index() % Class::MOVING * 3 + level) * 2 + if k == 0 { 0 } else { 1 }
}

/// The first coefficient of each component of a block where `class`'s are coded in differences.
pub const fn coefficient_start(class: Class) -> usize {
    COEFFICIENT_START_FIRST + class.index() % Class::MOVING
}

/// What `stream` codes, for people: attribute and whether it is motion.
pub fn attribute(stream: usize) -> (Option<Class>, bool) {
    let class = |index: usize| Class::ALL.get(index).copied();
    match stream {
        0..START_FIRST => (class(stream / Level::COUNT), false),
        START_FIRST..TRACK_FIRST => (class(stream - START_FIRST), false),
        TRACK_FIRST..COEFFICIENT_FIRST => (None, true),
        COEFFICIENT_FIRST..COEFFICIENT_START_FIRST => (class((stream - COEFFICIENT_FIRST) / 6), true),
        _ => (class(stream - COEFFICIENT_START_FIRST), true),
    }
}
