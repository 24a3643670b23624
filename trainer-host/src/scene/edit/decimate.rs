//! Fewer Gaussians that look alike: neighbours become one where that changes pictures least.
//!
//! In each of a few rounds every group of Gaussians, at first each alone, is paired with its nearest
//! neighbours; pairs are priced, and the cheapest that have no group in common become one each. A group has
//! the mean and the covariance of its members, weighed by opacity times projected area, the mean of their
//! colours, harmonics included, and the opacity that keeps the integral of their opacities over the
//! projected area, at most 1.
//!
//! What moves is priced at up to [`FRAMES`] frames, so that what drifts apart stays apart. A group's
//! covariance is that of the first of them; it turns with its heaviest member, and grows as its members do.

mod nodes;
mod shape;
mod tracks;

use std::cmp::Ordering;

use rayon::prelude::*;

use self::nodes::Nodes;
use super::{EditError, edited};
use crate::scene::{Epoch, Scene, SceneError, import::nearest::Tree};

/// Neighbours that a group may become one with. More make pairs cheaper, and groups less even.
const NEIGHBOURS: usize = 8;
/// Of them, those that a group offers: the cheapest.
const OFFERED: usize = 4;
/// Least share of groups that a round leaves. One that had to leave half would take pairs at any price.
const LEFT: f64 = 0.55;
/// Frames that motion is compared at.
const FRAMES: usize = 4;

/// About `share` (above 0, at most 1) of each epoch's Gaussians, which look like all of them: neighbours
/// become one, as the module says. What does not become one with another stays bit for bit. The same scene
/// gives the same result on any number of threads, in O(n log n) steps. `progress` hears before each round
/// the share of the work that is done, 0 to 1.
///
/// # Errors
/// A share out of range.
pub fn decimate(scene: &Scene, share: f64, progress: &mut dyn FnMut(f64)) -> Result<Scene, EditError> {
    if !(share > 0.0 && share <= 1.0) {
        let allowed = "above 0, at most 1";
        return Err(EditError::Range { field: "share of Gaussians", found: share, allowed });
    }
    let all = scene.epochs().iter().map(Epoch::count).sum::<usize>().max(1) as f64;
    let mut before = 0;
    edited(scene, |epoch| {
        let n = epoch.count();
        let left = ((n as f64 * share).round() as usize).clamp(n.min(1), n);
        let mut heard = |done: f64| progress((before as f64 + n as f64 * done) / all);
        let made = if left == n { Ok(epoch.clone()) } else { thinned(epoch, left, &mut heard) };
        before += n;
        made
    })
}

/// An epoch of `left` Gaussians, at least one and fewer than there are. `progress` hears the share done.
fn thinned(epoch: &Epoch, left: usize, progress: &mut dyn FnMut(f64)) -> Result<Epoch, SceneError> {
    let n = epoch.count();
    let last = if epoch.attributes().is_constant() { 0 } else { epoch.frames() - 1 };
    let looked_at = FRAMES.min(last + 1);
    let frames = (0..looked_at).map(|k| k * last / (looked_at - 1).max(1)).collect();
    let mut nodes = Nodes::new(epoch, frames);
    // What each group has become a part of: itself, or one with a lower number.
    let mut parts: Vec<u32> = (0..n as u32).collect();
    let mut groups = parts.clone();
    // As many rounds as needed, each leaving the same share.
    let share = left as f64 / n as f64;
    let rounds = (share.ln() / LEFT.ln()).ceil().max(1.0);
    let leaves = share.powf(1.0 / rounds);
    while groups.len() > left {
        // A round takes what its groups do, and each leaves the same share of them.
        progress((n - groups.len()) as f64 / (n - left) as f64);
        let wanted = ((groups.len() as f64 * leaves) as usize).clamp(left, groups.len() - 1);
        for (i, j) in chosen(&nodes, &groups, groups.len() - wanted) {
            nodes.join(i as usize, j as usize);
            parts[j as usize] = i;
        }
        groups.retain(|&group| parts[group as usize] == group);
    }
    for i in 0..n {
        parts[i] = parts[parts[i] as usize];
    }
    tracks::of_groups(epoch, &nodes, &groups, &parts)
}

/// A pair of groups, the lower number first, and its price.
type Pair = (f64, u32, u32);

/// The cheaper first, and of equally cheap ones that of lower numbers.
fn by_price(a: &Pair, b: &Pair) -> Ordering {
    a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2)))
}

/// Up to `most` (at least 1) pairs of `groups` that are to become one each; no group is in two.
fn chosen(nodes: &Nodes<'_>, groups: &[u32], most: usize) -> Vec<(u32, u32)> {
    let positions: Vec<[f32; 3]> = groups.iter().map(|&group| nodes.position(group as usize)).collect();
    let tree = Tree::new(&positions);
    let offers = |at: usize| {
        let near = tree.nearest(positions[at], NEIGHBOURS, |other| other != at);
        let priced = near.into_iter().map(|(_, other)| {
            let (i, j) = (groups[at].min(groups[other]), groups[at].max(groups[other]));
            (nodes.price(i as usize, j as usize), i, j)
        });
        let mut offered: Vec<Pair> = priced.collect();
        offered.sort_unstable_by(by_price);
        offered.truncate(OFFERED);
        offered
    };
    let mut pairs: Vec<Pair> = (0..groups.len()).into_par_iter().flat_map_iter(offers).collect();
    pairs.par_sort_unstable_by(by_price);
    let mut taken = vec![false; nodes.count()];
    let mut chosen = Vec::new();
    let mut take = |(i, j): (u32, u32)| {
        if chosen.len() < most && !taken[i as usize] && !taken[j as usize] {
            (taken[i as usize], taken[j as usize]) = (true, true);
            chosen.push((i, j));
        }
    };
    pairs.into_iter().for_each(|(_, i, j)| take((i, j)));
    if chosen.len() >= most / 4 {
        return chosen;
    }
    // Where very many lie in one place, few are neighbours of all others: the rest goes together as it lies.
    let mut rest: Vec<usize> = (0..groups.len()).filter(|&at| !taken[groups[at] as usize]).collect();
    let key = |at: usize| positions[at].map(f32::to_bits);
    rest.sort_unstable_by(|&a, &b| key(a).cmp(&key(b)).then(a.cmp(&b)));
    let pairs = rest.chunks_exact(2).map(|pair| (groups[pair[0]], groups[pair[1]]));
    chosen.extend(pairs.map(|(i, j)| (i.min(j), i.max(j))).take(most - chosen.len()));
    chosen
}

#[cfg(test)]
mod tests;
