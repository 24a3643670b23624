//! Checks decisions against the scene they are to be followed on, so that writing can rely on them.

use codec_core::internals::{ids::Level, limits, quant::Class};

use super::{Decisions, Dgs1Decisions, EpochDecisions, WindowDecisions};
use crate::{
    encode::{EncodeError, Protection},
    scene::{Epoch, Scene},
};

/// An error at `place`.
pub(in crate::encode) fn misfit(
    place: impl std::fmt::Display,
    field: &'static str,
    found: impl std::fmt::Display,
    allowed: impl std::fmt::Display,
) -> EncodeError {
    EncodeError::Decisions {
        place: place.to_string(),
        field,
        found: found.to_string(),
        allowed: allowed.to_string(),
    }
}

fn within(
    place: &str,
    field: &'static str,
    found: usize,
    low: usize,
    high: usize,
) -> Result<(), EncodeError> {
    if (low..=high).contains(&found) {
        return Ok(());
    }
    Err(misfit(place, field, found, format_args!("{low}..={high}")))
}

impl Decisions {
    /// Whether these decisions can be followed on `scene`.
    ///
    /// # Errors
    /// Names the place and field that do not fit.
    pub fn check(&self, scene: &Scene) -> Result<(), EncodeError> {
        let (repair, epochs) = match self {
            Self::Dgs1(d) => (&d.repair, d.epochs.len()),
            Self::Paper(d) => (&d.repair, d.epochs.len()),
        };
        let needed = scene.epochs().len();
        within("all", "number of epochs", epochs, needed, needed)?;
        check_repair(repair)?;
        match self {
            Self::Dgs1(decisions) => check_dgs1(decisions, scene),
            Self::Paper(decisions) => {
                for (e, (decided, epoch)) in decisions.epochs.iter().zip(scene.epochs()).enumerate() {
                    let place = format!("epoch {e}");
                    within(&place, "rank", decided.rank, 0, limits::MAX_RANK)?;
                    check_members(&place, epoch, decided.clusters.iter().map(Vec::as_slice))?;
                }
                Ok(())
            }
        }
    }
}

fn check_repair(repair: &Protection) -> Result<(), EncodeError> {
    match repair.strengths().find(|strength| !strength.is_allowed()) {
        None => Ok(()),
        Some(s) => {
            let found = format!("{}+{}@{}%", s.set_len, s.parity, s.loss_percent);
            Err(misfit("all", "repair", found, "2..=64 packets + 1..=8 parity packets @ 0..=50 %"))
        }
    }
}

fn check_dgs1(decisions: &Dgs1Decisions, scene: &Scene) -> Result<(), EncodeError> {
    within("all", "block_len", decisions.block_len, 1, limits::MAX_BLOCK_LEN)?;
    within("all", "packet_bytes", decisions.packet_bytes, 200, 1226)?;
    for (e, (decided, epoch)) in decisions.epochs.iter().zip(scene.epochs()).enumerate() {
        check_epoch(e, decided, epoch)?;
        check_proxy_changes(e, decided, decisions.block_len)?;
    }
    Ok(())
}

fn check_proxy_changes(e: usize, decided: &EpochDecisions, block_len: usize) -> Result<(), EncodeError> {
    let changes = &decided.proxy_changes;
    let place = format!("epoch {e}");
    if !changes.is_empty() {
        let blocks = decided.clusters.iter().map(|c| c.gaussians.len().div_ceil(block_len)).sum();
        within(&place, "number of proxy_changes", changes.len(), blocks, blocks)?;
    }
    for (b, change) in changes.iter().enumerate() {
        let values = [change.offset.as_slice(), &[change.log_scale, change.opacity], &change.sh0].concat();
        if !values.iter().all(|v| v.is_finite()) {
            let place = format!("epoch {e}, block {b}");
            return Err(misfit(place, "proxy_changes", format_args!("{change:?}"), "finite numbers"));
        }
    }
    Ok(())
}

fn check_epoch(e: usize, decided: &EpochDecisions, epoch: &Epoch) -> Result<(), EncodeError> {
    let place = format!("epoch {e}");
    if !decided.origin.iter().all(|v| v.is_finite()) {
        return Err(misfit(place, "origin", format_args!("{:?}", decided.origin), "three finite numbers"));
    }
    check_members(&place, epoch, decided.clusters.iter().map(|c| c.gaussians.as_slice()))?;
    let degree = usize::from(epoch.attributes().sh_degree.get());
    for (c, cluster) in decided.clusters.iter().enumerate() {
        let place = format!("epoch {e}, cluster {c}");
        let most = decided.quantisers.len().saturating_sub(1);
        within(&place, "quantisers", cluster.quantisers, 0, most)?;
        within(&place, "harmonic_degree", cluster.harmonic_degree.into(), 0, degree)?;
        within(&place, "highest_level", cluster.highest_level.into(), 0, Level::COUNT - 1)?;
    }
    if decided.quantisers.is_empty() && !decided.clusters.is_empty() {
        return Err(misfit(place, "quantisers", "an empty list", "at least one"));
    }
    for (w, window) in decided.windows.iter().enumerate() {
        check_window(&format!("epoch {e}, window {w}"), window, decided.clusters.len())?;
    }
    let frames: usize = decided.windows.iter().map(|w| w.frames).sum();
    if !decided.windows.is_empty() {
        within(&place, "frames of all windows", frames, epoch.frames(), epoch.frames())?;
    }
    Ok(())
}

fn check_window(place: &str, window: &WindowDecisions, clusters: usize) -> Result<(), EncodeError> {
    within(place, "frames", window.frames, 1, limits::MAX_WINDOW_FRAMES)?;
    within(place, "number of motions", window.motions.len(), clusters, clusters)?;
    within(place, "vectors in basis", window.basis.len(), 0, window.frames.min(limits::MAX_RANK))?;
    for vector in &window.basis {
        within(place, "length of a basis vector", vector.len(), window.frames, window.frames)?;
    }
    for (c, motion) in window.motions.iter().enumerate() {
        let place = format!("{place}, cluster {c}");
        within(&place, "highest_level", motion.highest_level.into(), 0, Level::COUNT - 1)?;
        within(&place, "track_shift", motion.track_shift.into(), 0, 24)?;
        for (class, &rank) in Class::ALL.into_iter().zip(&motion.ranks) {
            let most = if class == Class::Position { window.basis.len() } else { window.frames };
            within(&place, "ranks", rank.into(), 0, most)?;
        }
    }
    Ok(())
}

/// Every cluster has members of `epoch`, and none is in two.
fn check_members<'c>(
    place: &str,
    epoch: &Epoch,
    clusters: impl Iterator<Item = &'c [u32]>,
) -> Result<(), EncodeError> {
    let mut seen = vec![false; epoch.count()];
    for (c, members) in clusters.enumerate() {
        let place = format!("{place}, cluster {c}");
        within(&place, "number of gaussians", members.len(), 1, limits::MAX_CLUSTER_LEN)?;
        for &i in members {
            within(&place, "gaussians", i as usize, 0, epoch.count().saturating_sub(1))?;
            if std::mem::replace(&mut seen[i as usize], true) {
                return Err(misfit(place, "gaussians", format_args!("{i} again"), "each Gaussian once"));
            }
        }
    }
    Ok(())
}
