//! Decodes the versions in which states show each cluster, and renders all of them in one call.
//!
//! What a cluster looks like depends on which of its own blocks have arrived and on nothing else, so a state
//! names a version of every cluster; states that name versions already known cost no decode. Contexts that
//! are rendered together share one projection, one depth order and one set of tile lists.

use std::{collections::BTreeMap, ops::Range};

use codec_core::{
    Gaussian,
    internals::{
        ids::{ClusterId, EpochId, Span, WindowId},
        layout::Shape,
        receiver::Content,
    },
};
use render_host::{
    Settings, Splats,
    counterfactual::{self, Distortions, Engine, Variants},
};

use super::{error::UtilityError, references::View};
use crate::{stream::Player, train::PixelMask};

/// A cluster as some state shows it.
#[derive(Debug)]
struct Version {
    gaussians: Vec<Gaussian>,
    /// Their higher bands.
    sh_rest: Vec<f32>,
}

/// One cluster of the epoch.
#[derive(Debug)]
struct Cluster {
    /// Its Gaussians in a decoded frame.
    gaussians: Range<usize>,
    /// The blocks it depends on: its own, canonical and of every window of the epoch.
    blocks: Vec<Range<usize>>,
    versions: Vec<Version>,
    /// Version shown for what has arrived of the blocks.
    known: BTreeMap<Vec<u8>, u32>,
}

/// The clusters of one epoch at one frame.
#[derive(Debug)]
pub(super) struct Clusters<'a> {
    content: Content<'a>,
    frame: u32,
    player: Player,
    clusters: Vec<Cluster>,
    /// Values of the higher bands per Gaussian.
    rest_len: usize,
}

impl<'a> Clusters<'a> {
    /// The clusters of `epoch`, none of whose versions is known yet.
    pub(super) fn new(content: &Content<'a>, epoch: EpochId, frame: u32) -> Self {
        let manifest = content.manifest;
        let windows = (0..manifest.head().windows).map(WindowId);
        let windows = windows.filter(|&w| manifest.window(w).is_some_and(|w| w.epoch == epoch.0));
        let spans: Vec<Span> =
            std::iter::once(Span::Canonical(epoch)).chain(windows.map(Span::Motion)).collect();
        let mut clusters = Vec::new();
        let mut first = 0;
        for id in 0..manifest.epoch(epoch).map_or(0, |epoch| epoch.clusters) {
            let id = ClusterId(id as u16);
            let cell = |&span: &Span| blocks_of(content, span, id);
            let count = Shape::of(manifest, spans[0], id).map_or(0, |shape| shape.gaussians());
            clusters.push(Cluster {
                gaussians: first..first + count,
                blocks: spans.iter().filter_map(cell).collect(),
                versions: Vec::new(),
                known: BTreeMap::new(),
            });
            first += count;
        }
        let rest_len = manifest.sh_degree().rest_len();
        Self { content: *content, frame, player: Player::new(manifest), clusters, rest_len }
    }

    /// The version of each cluster that `state` shows.
    ///
    /// # Errors
    /// A frame that does not decode.
    pub(super) fn shown_by(&mut self, state: &[u8]) -> Result<Vec<u32>, UtilityError> {
        let arrived = |cluster: &Cluster| -> Vec<u8> {
            cluster.blocks.iter().flat_map(|blocks| &state[blocks.clone()]).copied().collect()
        };
        let keys: Vec<Vec<u8>> = self.clusters.iter().map(arrived).collect();
        if self.clusters.iter().zip(&keys).any(|(cluster, key)| !cluster.known.contains_key(key)) {
            let shown = self.player.show(&self.content.with_state(state), self.frame)?;
            for (cluster, key) in self.clusters.iter_mut().zip(&keys) {
                if !cluster.known.contains_key(key) {
                    let Range { start, end } = cluster.gaussians;
                    let rest = &shown.sh_rest[start * self.rest_len..end * self.rest_len];
                    cluster.learn(key.clone(), &shown.gaussians[start..end], rest);
                }
            }
        }
        let version = |(cluster, key): (&Cluster, &Vec<u8>)| cluster.known.get(key).copied();
        self.clusters.iter().zip(&keys).map(|pair| version(pair).ok_or(UtilityError::NoVersion)).collect()
    }

    /// Forgets all versions.
    pub(super) fn clear(&mut self) {
        for cluster in &mut self.clusters {
            cluster.versions.clear();
            cluster.known.clear();
        }
    }

    /// Numbers that the versions hold.
    pub(super) fn values(&self) -> usize {
        let each = self.rest_len + size_of::<Gaussian>() / size_of::<f32>();
        self.clusters.iter().map(|cluster| cluster.versions.len() * cluster.gaussians.len() * each).sum()
    }

    /// Distortion from a view's reference of every context, each a version per cluster, and of every version
    /// in it.
    ///
    /// # Errors
    /// Settings or a reference that the renderer refuses.
    pub(super) fn distortions(
        &self,
        contexts: &[Vec<u32>],
        View { camera, reference, counted, .. }: &View,
        settings: &Settings,
    ) -> Result<Distortions, UtilityError> {
        let counts: Vec<u32> = self.clusters.iter().map(|c| c.versions.len() as u32).collect();
        let versions = counterfactual::Versions::new(&counts).map_err(refused)?;
        let (gaussians, sh_rest, groups) = self.variants(&versions);
        let degree = self.content.manifest.sh_degree();
        let splats = Splats::new(&gaussians, &sh_rest, degree).map_err(refused)?;
        let variants = Variants::new(splats, &groups, versions.groups()).map_err(refused)?;
        let engine = Engine::new(&variants, camera, reference, settings).map_err(refused)?;
        let counted = counted.as_ref().map(PixelMask::values);
        engine.distortions_where(&versions, contexts, counted).map_err(refused)
    }

    /// Every version of every Gaussian, in order of Gaussians, so that equal depths are drawn in the order of
    /// a single render; their higher bands; and the group of each.
    fn variants(&self, versions: &counterfactual::Versions) -> (Vec<Gaussian>, Vec<f32>, Vec<u32>) {
        let (mut gaussians, mut rest, mut groups) = (Vec::new(), Vec::new(), Vec::new());
        for (index, cluster) in self.clusters.iter().enumerate() {
            for place in 0..cluster.gaussians.len() {
                for (number, version) in cluster.versions.iter().enumerate() {
                    // What is absent is drawn nowhere.
                    if version.gaussians[place].opacity <= 0.0 {
                        continue;
                    }
                    gaussians.push(version.gaussians[place]);
                    rest.extend_from_slice(&version.sh_rest[place * self.rest_len..][..self.rest_len]);
                    groups.push(versions.group(index, number) as u32);
                }
            }
        }
        (gaussians, rest, groups)
    }
}

impl Cluster {
    /// Notes that blocks of which `key` has arrived show `gaussians`.
    fn learn(&mut self, key: Vec<u8>, gaussians: &[Gaussian], sh_rest: &[f32]) {
        let is_same = |version: &Version| {
            let bands = version.sh_rest.iter().zip(sh_rest);
            version.gaussians.iter().zip(gaussians).all(|(a, b)| bits(a) == bits(b))
                && bands.map(|(a, b)| a.to_bits() ^ b.to_bits()).all(|differ| differ == 0)
        };
        let place = self.versions.iter().position(is_same).unwrap_or(self.versions.len());
        if place == self.versions.len() {
            self.versions.push(Version { gaussians: gaussians.to_vec(), sh_rest: sh_rest.to_vec() });
        }
        self.known.insert(key, place as u32);
    }
}

/// Blocks of a cell, counted over the whole state.
pub(super) fn blocks_of(content: &Content<'_>, span: Span, cluster: ClusterId) -> Option<Range<usize>> {
    let shape = Shape::of(content.manifest, span, cluster)?;
    let first = content.cell(span, cluster)?.blocks as usize;
    Some(first..first + shape.blocks())
}

fn refused(error: impl std::fmt::Display) -> UtilityError {
    UtilityError::Render(error.to_string())
}

fn bits(g: &Gaussian) -> [u32; 14] {
    let Gaussian { position: p, scale: s, rotation: q, opacity: o, sh0: c } = *g;
    [p[0], p[1], p[2], s[0], s[1], s[2], q[0], q[1], q[2], q[3], o, c[0], c[1], c[2]].map(f32::to_bits)
}
