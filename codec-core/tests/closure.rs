//! What can be shown of a state, against a closure that follows every need one step at a time, on the
//! golden streams in random states.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

use std::path::Path;

use codec_core::internals::{
    closure::{Arrived, Needs, coefficient_level, initial},
    ids::{ClusterId, Level, Span},
    layout::Shape,
    receiver::for_each_cell,
    wire::{
        crc::crc32,
        file,
        manifest::{self, Manifest, ManifestHead},
    },
};

fn bodies() -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conformance");
    let mut bodies = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "dgs") {
            let bytes = std::fs::read(&path).unwrap();
            let (message, _) = file::manifest(&bytes).unwrap();
            let mut raw = vec![0; ManifestHead::parse(message).unwrap().raw_len];
            manifest::open(message, crc32, &mut raw).unwrap();
            bodies.push((path.display().to_string(), raw));
        }
    }
    assert!(bodies.len() > 10);
    bodies
}

/// A random state: a mask per block, and where each cell's blocks begin.
struct State<'m> {
    manifest: Manifest<'m>,
    first: Vec<usize>,
    masks: Vec<u8>,
}

impl<'m> State<'m> {
    fn random(raw: &'m [u8], seed: u64) -> Self {
        let manifest = Manifest::parse(raw).unwrap();
        let (mut first, mut masks) = (Vec::new(), Vec::new());
        let mut state = seed;
        for_each_cell(&manifest, |_, _, shape| {
            first.push(masks.len());
            for _ in 0..shape.blocks() {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                // Two draws together: most levels are there, so that gaps lie at every level.
                masks.push(initial(&shape).0 | ((state >> 60 | state >> 40) & 0xf) as u8);
            }
            Ok(())
        })
        .unwrap();
        Self { manifest, first, masks }
    }

    fn mask(&self, span: Span, cluster: ClusterId, block: usize) -> Arrived {
        let cell = self.manifest.cell(span, cluster).unwrap();
        Arrived(self.masks[self.first[cell.index()] + block])
    }

    /// Whether `level` of a block counts: it has arrived, and so has all that it needs.
    fn naive(&self, span: Span, cluster: ClusterId, block: usize, level: Level) -> bool {
        let needs = Needs::in_manifest(&self.manifest, span, cluster, level).unwrap();
        let below = needs.below.is_none_or(|below| self.naive(span, cluster, block, below));
        let base = |epoch| self.naive(Span::Canonical(epoch), cluster, block, Level::BASE);
        self.mask(span, cluster, block).has(level) && below && needs.base.is_none_or(base)
    }
}

/// Levels with symbols of a block that count, by masks: what decoders do.
fn shown(state: &State<'_>, span: Span, cluster: ClusterId, shape: &Shape, block: usize) -> Vec<Level> {
    let own = state.mask(span, cluster, block);
    let usable = match span {
        Span::Canonical(_) => own.usable(),
        Span::Motion(_) => {
            let epoch = state.manifest.epoch_of(span).unwrap();
            let bends = coefficient_level(own, state.mask(Span::Canonical(epoch), cluster, block));
            bends.map_or(usize::from(own.has(Level::BASE)), |level| level.index() + 1)
        }
    };
    Level::ALL.into_iter().take(usable).filter(|&level| shape.level_len(level) > 0).collect()
}

/// Compares both on every block; returns how many levels were seen and how many were hidden.
fn compare(name: &str, state: &State<'_>) -> (usize, usize) {
    let (mut seen, mut hidden) = (0, 0);
    for_each_cell(&state.manifest, |span, cluster, shape| {
        for block in 0..shape.blocks() {
            let levels = Level::ALL.into_iter().filter(|&level| shape.level_len(level) > 0);
            let naive: Vec<Level> = levels.filter(|&l| state.naive(span, cluster, block, l)).collect();
            let shown = shown(state, span, cluster, &shape, block);
            assert_eq!(shown, naive, "{name}: {span:?}, cluster {cluster}, block {block}");
            seen += shown.len();
            hidden += usize::from(shown.len() < state.mask(span, cluster, block).0.count_ones() as usize);
        }
        Ok(())
    })
    .unwrap();
    (seen, hidden)
}

#[test]
fn masks_show_what_the_naive_closure_allows() {
    for (name, raw) in bodies() {
        let counts = (0..8).map(|seed| compare(&name, &State::random(&raw, seed)));
        let (seen, hidden) = counts.fold((0, 0), |all, one| (all.0 + one.0, all.1 + one.1));
        assert!(seen > 0 && hidden > 0, "{name}: {seen} levels count, {hidden} do not");
    }
}

/// The comparison sees a closure that forgets one need.
#[test]
fn a_forgotten_need_is_seen() {
    let differs = |(name, raw): &(String, Vec<u8>)| {
        let state = State::random(raw, 1);
        let mut differs = false;
        for_each_cell(&state.manifest, |span, cluster, shape| {
            if matches!(span, Span::Motion(_)) {
                for block in 0..shape.blocks() {
                    let forgetful = state.mask(span, cluster, block).usable();
                    let levels = Level::ALL.into_iter().take(forgetful);
                    let levels = levels.filter(|&level| shape.level_len(level) > 0).count();
                    differs |= levels != shown(&state, span, cluster, &shape, block).len();
                }
            }
            Ok(())
        })
        .unwrap();
        assert!(!name.is_empty());
        differs
    };
    assert!(bodies().iter().any(differs));
}
