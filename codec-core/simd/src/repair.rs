//! The host's arithmetic of repair: vectors where the machine has them.

use std::sync::OnceLock;

use codec_core::internals::repair::{self, Combine};

/// Every [`Combine`] of this machine by the name of its instructions, the slowest first: that of
/// codec-core, then those by vectors. All give the same sums.
pub fn combines() -> Vec<(&'static str, Combine)> {
    let mut all: Vec<(&'static str, Combine)> = vec![("portable", repair::combine)];
    #[cfg(target_arch = "x86_64")]
    all.extend(crate::kernel::galois::combines());
    all
}

/// The fastest [`Combine`] of this machine, for encoders and receivers on hosts.
pub fn combine() -> Combine {
    static BEST: OnceLock<Combine> = OnceLock::new();
    *BEST.get_or_init(|| combines().last().map_or(repair::combine, |best| best.1))
}
