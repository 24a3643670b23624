//! Train scenes: fine-tune what a receiver shows when delivery is incomplete.

pub mod delivery;
