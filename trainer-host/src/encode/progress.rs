//! Reports progress to a function of the caller's.

/// Hears how far the encoder is: stage name and share done, 0..=1.
pub type Progress<'p> = &'p (dyn Fn(&'static str, f64) + Sync);
