//! The host's arithmetic of repair: vectors where the machine has them.

use std::sync::OnceLock;

use codec_core::internals::repair::{self, Combine};

/// Every [`Combine`] of this machine by the name of its instructions, the slowest first: that of
/// codec-core, then those by vectors. All give the same sums.
pub fn combines() -> Vec<(&'static str, Combine)> {
    let portable: (&'static str, Combine) = ("portable", repair::combine);
    #[cfg(target_arch = "x86_64")]
    let by_vectors = crate::kernel::galois::combines();
    #[cfg(not(target_arch = "x86_64"))]
    let by_vectors = Vec::new();
    std::iter::once(portable).chain(by_vectors).collect()
}

/// The fastest [`Combine`] of this machine, for encoders and receivers on hosts.
pub fn combine() -> Combine {
    static BEST: OnceLock<Combine> = OnceLock::new();
    *BEST.get_or_init(|| combines().last().map_or(repair::combine, |best| best.1))
}
