//! Encodes the scene that parameters make, and shows it as a receiver in any state does.
//!
//! What the encoder chooses is chosen once; afterwards the scene is written with the same choices, so blocks,
//! levels and states keep their meaning. Between two encodings a decoded Gaussian moves by what its
//! parameters have changed.

mod posed;

use std::ops::Range;

use codec_core::{
    Gaussian, ShDegree,
    internals::{
        closure::Arrived,
        ids::{ClusterId, EpochId, Level, Span},
        layout::Shape,
        receiver::Content,
    },
};
use render_host::{Splats, SplatsError, adjoint::SplatGradient};

pub(super) use self::posed::BlockVersion;
use super::{
    error::DeliveryError,
    gradient::Gradient,
    parameters::{Anchor, Follows, Parameters, Values},
    steps::{self, LEARNED},
};
use crate::{
    encode::{self, Decisions, Encoded},
    scene::{Epoch, Scene},
    stream::Player,
};

/// A block of an epoch: what is lost or arrives together.
#[derive(Clone, Debug)]
pub(super) struct Block {
    /// Its Gaussians in a decoded frame.
    pub gaussians: Range<usize>,
    /// Place of its canonical mask in a state.
    canonical: usize,
    cluster: ClusterId,
    /// Which block of its cluster.
    index: usize,
    /// Which row of its epoch's quantisers it is coded with.
    quantisers: usize,
}

/// An encoded scene with what it was made from.
pub(super) struct Coded {
    pub encoded: Encoded,
    received: dgs_player::Player,
    /// The parameters that were encoded.
    parameters: Parameters,
    /// Per epoch and decoded Gaussian, the source axis that each of its axes is.
    axes: Vec<Vec<[u8; 3]>>,
    /// Per epoch.
    blocks: Vec<Vec<Block>>,
}

impl Coded {
    /// Encodes `source`, choosing everything.
    ///
    /// # Errors
    /// What the encoder refuses.
    pub(super) fn first(source: &Scene, options: &encode::EncodeOptions) -> Result<Self, DeliveryError> {
        let encoded = encode::encode(source, options, &crate::encode::no_progress)?;
        Self::new(source, encoded, no_change(source))
    }

    /// Writes `source` with `parameters` by `decisions`.
    ///
    /// # Errors
    /// Parameters that are not finite, or a block that no longer fits a packet.
    pub(super) fn rewrite(
        source: &Scene,
        parameters: &Parameters,
        decisions: &Decisions,
    ) -> Result<Self, DeliveryError> {
        let scene = parameters.applied(source)?;
        let decisions = with_proxies(decisions, parameters);
        Self::new(source, encode::write(&scene, &decisions, &crate::encode::no_progress)?, parameters.clone())
    }

    /// As [`Coded::rewrite`], with entropy tables, at most `table_choices` to a set, for what is coded now.
    ///
    /// # Errors
    /// As [`Coded::rewrite`].
    pub(super) fn with_tables(
        source: &Scene,
        parameters: &Parameters,
        decisions: &Decisions,
        table_choices: usize,
    ) -> Result<Self, DeliveryError> {
        let scene = parameters.applied(source)?;
        let decisions = with_proxies(decisions, parameters);
        let encoded =
            encode::with_levels(&scene, &decisions, &[], table_choices, &crate::encode::no_progress)?;
        Self::new(source, encoded, parameters.clone())
    }

    /// Parameters of `source` and of the proxies of this encoding of it, all unchanged.
    ///
    /// # Errors
    /// A frame that does not decode.
    pub(super) fn parameters(&self, source: &Scene) -> Result<Parameters, DeliveryError> {
        let has_proxies = matches!(&self.encoded.decisions, Decisions::Dgs1(decisions) if decisions.proxies);
        if !has_proxies {
            return Ok(no_change(source));
        }
        let content = self.received.content();
        let nothing = vec![0u8; content.blocks.len()];
        let mut player = self.player();
        let (mut sizes, mut first_frame) = (Vec::new(), 0);
        for (epoch, blocks) in source.epochs().iter().zip(&self.blocks) {
            let shown = player.show(&content.with_state(&nothing), first_frame)?;
            let size = |block: &Block| {
                let scale = shown.gaussians.get(block.gaussians.start).map_or([1.0; 3], |g| g.scale);
                scale.iter().product::<f32>().cbrt()
            };
            sizes.push(blocks.iter().map(size).collect());
            first_frame += epoch.frames() as u32;
        }
        Ok(no_change(source).with_proxies(sizes))
    }

    fn new(source: &Scene, encoded: Encoded, parameters: Parameters) -> Result<Self, DeliveryError> {
        let received = encoded.stream.receive()?;
        let mut coded = Self { encoded, received, parameters, axes: Vec::new(), blocks: Vec::new() };
        let content = coded.received.content();
        let complete = content.blocks.to_vec();
        let epochs = source.epochs().len();
        let of_epoch = |e: usize| blocks(&content, EpochId(e as u16), &coded.encoded.decisions);
        coded.blocks = (0..epochs).map(of_epoch).collect();
        let mut player = Player::new(content.manifest);
        let mut axes = Vec::new();
        let mut first_frame = 0;
        for (epoch, order) in source.epochs().iter().zip(&coded.encoded.order) {
            let shown = player.show(&content.with_state(&complete), first_frame)?;
            let of = |(&i, g): (&u32, &Gaussian)| Anchor::of(epoch, i as usize, 0).axes(g);
            axes.push(order.iter().zip(shown.gaussians).map(of).collect());
            first_frame += epoch.frames() as u32;
        }
        coded.axes = axes;
        Ok(coded)
    }

    /// The same encoding, of which `parameters` are those that were encoded.
    pub(super) fn with_parameters(self, parameters: Parameters) -> Self {
        Self { parameters, ..self }
    }

    /// Where to show states of it, with `parameters` as they are now.
    pub(super) fn moving<'a>(&'a self, source: &'a Scene, parameters: &'a Parameters) -> Moving<'a> {
        let changed = |list: usize| {
            let pairs = parameters.epoch(list).iter().zip(self.parameters.epoch(list));
            pairs.map(|(now, then)| -> Values { std::array::from_fn(|c| now[c] - then[c]) })
        };
        let is_changed = *parameters != self.parameters;
        // Gaussians and proxies.
        let lists = 2 * source.epochs().len();
        let drift = if is_changed { (0..lists).flat_map(changed).collect() } else { Vec::new() };
        Moving { coded: self, content: self.received.content(), source, parameters, drift }
    }

    /// A decoder for its frames.
    pub(super) fn player(&self) -> Player {
        Player::new(self.received.content().manifest)
    }
}

/// Parameters of `source` itself.
pub(super) fn no_change(source: &Scene) -> Parameters {
    Parameters::zeros(&source.epochs().iter().map(Epoch::count).collect::<Vec<_>>())
}

fn blocks(content: &Content<'_>, epoch: EpochId, decisions: &Decisions) -> Vec<Block> {
    let (span, mut first) = (Span::Canonical(epoch), 0);
    let mut blocks = Vec::new();
    let Some(clusters) = content.manifest.clusters_of(span) else { return blocks };
    for cluster in (0..clusters).map(|c| ClusterId(c as u16)) {
        let Some(shape) = Shape::of(content.manifest, span, cluster) else { continue };
        let Some(cell) = content.cell(span, cluster) else { continue };
        let end = first + shape.gaussians();
        let quantisers = steps::row(decisions, usize::from(epoch.0), usize::from(cluster.0));
        for index in 0..shape.blocks() {
            let count = if shape.blocks() == 1 { shape.gaussians() } else { shape.block_gaussians(index) };
            let gaussians = first..(first + count).min(end);
            first = gaussians.end;
            let canonical = cell.blocks as usize + index;
            blocks.push(Block { gaussians, canonical, cluster, index, quantisers });
        }
        first = end;
    }
    blocks
}

/// An encoded scene whose parameters may have moved on.
pub(super) struct Moving<'a> {
    coded: &'a Coded,
    content: Content<'a>,
    source: &'a Scene,
    /// Parameters as they are now.
    parameters: &'a Parameters,
    /// What parameters have changed since, in their order; empty if nothing has.
    drift: Vec<Values>,
}

/// The Gaussians that a state shows.
#[derive(Clone, Debug, Default)]
pub(super) struct Shown {
    pub gaussians: Vec<Gaussian>,
    pub sh_rest: Vec<f32>,
    pub degree: ShDegree,
}

impl Shown {
    /// As the renderer takes them.
    ///
    /// # Errors
    /// Bands that do not fit the Gaussians.
    pub(super) fn splats(&self) -> Result<Splats<'_>, SplatsError> {
        Splats::new(&self.gaussians, &self.sh_rest, self.degree)
    }
}

impl Moving<'_> {
    /// The encoding that it shows.
    pub(super) fn coded(&self) -> &Coded {
        self.coded
    }

    /// Epoch and its number of `frame`; the first if there is no such frame.
    fn place(&self, frame: u32) -> (usize, usize) {
        self.source.locate(frame as usize).unwrap_or((0, 0))
    }

    /// Blocks of the epoch of `frame`.
    pub(super) fn blocks(&self, frame: u32) -> &[Block] {
        self.coded.blocks.get(self.place(frame).0).map_or(&[], Vec::as_slice)
    }

    /// What a receiver in `state` shows at `frame`.
    ///
    /// # Errors
    /// A frame past the end.
    pub(super) fn shown(
        &self,
        player: &mut Player,
        state: &[u8],
        frame: u32,
    ) -> Result<Shown, DeliveryError> {
        let shown = player.show(&self.content.with_state(state), frame)?;
        let degree = shown.sh_degree;
        let mut out = Shown { gaussians: shown.gaussians.to_vec(), sh_rest: shown.sh_rest.to_vec(), degree };
        if !self.drift.is_empty() {
            self.each(state, frame, |(_, decoded), parameter, follows| {
                let gaussian = &mut out.gaussians[decoded];
                *gaussian = follows.moved(gaussian, &self.drift[parameter]);
            });
        }
        Ok(out)
    }

    /// Adds the gradient by the Gaussians of `shown` to that by their parameters, in the order of parameters,
    /// and to that by the steps that they are coded with, where these are learned.
    pub(super) fn pull(
        &self,
        shown: &Shown,
        by: &[SplatGradient],
        (state, frame): (&[u8], u32),
        gradient: &mut Gradient,
    ) {
        let (e, t) = self.place(frame);
        let Some(epoch) = self.source.epochs().get(e) else { return };
        let (first, values) = (self.parameters.first_of(e), self.parameters.epoch(e));
        let blocks = self.blocks(frame);
        // What is missing of motion is no error of quantisation.
        let moves_whole = |block: &Block| {
            let arrived = |mask: usize| Arrived(state.get(mask).copied().unwrap_or(0));
            self.motion_mask(block, frame).is_none_or(|mask| arrived(mask).usable() == Level::COUNT)
        };
        let is_learned = !gradient.steps.is_empty();
        let counts: Vec<bool> = blocks.iter().map(|block| is_learned && moves_whole(block)).collect();
        self.each(state, frame, |(block, decoded), parameter, follows| {
            let shown = &shown.gaussians[decoded];
            let pulled = follows.pulled(&by[decoded], shown);
            let sums = &mut gradient.parameters[parameter];
            sums.iter_mut().zip(pulled).for_each(|(sum, value)| *sum += f64::from(value));
            let Follows::Source(anchor, axes) = follows else { return };
            if !counts[block] {
                return;
            }
            let source = parameter - first;
            let intended = anchor.moved(&epoch.gaussian(source, t), [0, 1, 2], &values[source]);
            let error = anchor.error(&intended, shown, axes);
            let sums = &mut gradient.steps[blocks[block].quantisers];
            for (sum, (_, components)) in sums.iter_mut().zip(&LEARNED) {
                let product = |c: usize| f64::from(pulled[c]) * f64::from(error[c]);
                *sum += components.clone().map(product).sum::<f64>();
            }
        });
    }

    /// Calls `visit` with each Gaussian that `state` shows and that has parameters: the number of its block
    /// and its index in a decoded frame, the index of its parameters, and how it follows them.
    fn each(&self, state: &[u8], frame: u32, mut visit: impl FnMut((usize, usize), usize, Follows)) {
        let (e, t) = self.place(frame);
        let Coded { encoded, parameters, axes, .. } = self.coded;
        let (Some(epoch), Some(order)) = (self.source.epochs().get(e), encoded.order.get(e)) else {
            return;
        };
        let first = parameters.first_of(e);
        let (first_proxy, sizes) = (parameters.first_of(parameters.proxies_of(e)), parameters.proxy_sizes(e));
        for (number, block) in self.blocks(frame).iter().enumerate() {
            let arrived = Arrived(state.get(block.canonical).copied().unwrap_or(0));
            if arrived.usable() > 0 {
                // Parameters are carried to the world by the pose that is shown.
                let t = self.pose_frame(block.cluster, (frame, t), state);
                for decoded in block.gaussians.clone() {
                    let source = order[decoded] as usize;
                    let follows = Follows::Source(Anchor::of(epoch, source, t), axes[e][decoded]);
                    visit((number, decoded), first + source, follows);
                }
            } else if let Some(&size) = sizes.get(number).filter(|_| !block.gaussians.is_empty()) {
                visit((number, block.gaussians.start), first_proxy + number, Follows::Proxy(size));
            }
        }
    }
}

/// `decisions` with the proxies of `parameters`, where it trains them.
fn with_proxies(decisions: &Decisions, parameters: &Parameters) -> Decisions {
    let mut decisions = decisions.clone();
    if let Decisions::Dgs1(decisions) = &mut decisions {
        for (e, epoch) in decisions.epochs.iter_mut().enumerate() {
            if !parameters.proxy_sizes(e).is_empty() {
                epoch.proxy_changes = parameters.proxy_changes(e);
            }
        }
    }
    decisions
}

#[cfg(test)]
mod tests;
