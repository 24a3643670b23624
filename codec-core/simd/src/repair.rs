//! The host's arithmetic of repair: vectors where the machine has them.

use std::sync::OnceLock;

use codec_core::repair::{self, Mix};

/// Every [`Mix`] of this machine by the name of its instructions, the slowest first: that of
/// codec-core, then those by vectors. All give the same sums.
pub fn mixes() -> Vec<(&'static str, Mix)> {
    let mut all: Vec<(&'static str, Mix)> = vec![("portable", repair::mix)];
    #[cfg(target_arch = "x86_64")]
    all.extend(crate::kernel::galois::mixes());
    all
}

/// The fastest [`Mix`] of this machine, for encoders and receivers on hosts.
pub fn mix() -> Mix {
    static BEST: OnceLock<Mix> = OnceLock::new();
    *BEST.get_or_init(|| mixes().last().map_or(repair::mix, |best| best.1))
}
