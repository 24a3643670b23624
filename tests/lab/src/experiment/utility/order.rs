//! Compares orders of packets by what their beginnings show: by gain, and by the paper's utility.

use anyhow::Result;
use dgs::pipeline;
use emulator_host::{PacketGraph, policy::order_by_utility};
use rayon::prelude::*;
use render_host::{Backend, Camera, Image, Settings, metric};
use trainer_host::{
    Scene, Stream, evaluator,
    stream::PacketMap,
    utility::Table,
    viewpoint::{Framing, Ring},
};

use crate::{
    figures::{Bench, Figure, mean, student95},
    setup::spread,
};

/// Shares of the bytes that are there.
const SHARES: [f64; 8] = [0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95];
/// Held-out cameras, and frames of the clip.
const VIEWS: (usize, usize) = (3, 6);

/// How it is measured.
pub(super) const PROTOCOL: &str = "order: D of what the first 30 to 95 % of the bytes show, parity aside, \
     against the source's own render, 3 held-out cameras at 160x160, 6 frames; ratio of D ordered by gain to \
     D ordered by the paper's risk-adjusted utility of the same table, geometric mean, interval over frames";

/// Adds the row of `key`.
pub(super) fn measure(
    bench: &mut Bench,
    key: &str,
    scene: &Scene,
    stream: &Stream,
    table: &Table,
) -> Result<()> {
    let study = Study::new(scene, stream)?;
    let by_gain = pipeline::graph(stream, &study.map, Some(table))?;
    let mut parts = by_gain.parts().clone();
    parts.groups.iter_mut().for_each(|group| group.utility = group.risk_adjusted);
    let by_paper = PacketGraph::new(parts)?;
    let (gain, paper) = (study.distortions(&by_gain)?, study.distortions(&by_paper)?);
    // Of each frame, the mean over cameras and shares: cameras see the same at the same time.
    let frames = study.frames.len();
    let logs: Vec<f64> = (0..frames)
        .map(|frame| {
            let views = (0..VIEWS.0).map(|camera| camera * frames + frame);
            let log = |share: usize, view: usize| (gain[share][view] / paper[share][view]).ln();
            let all = views.flat_map(|view| (0..SHARES.len()).map(move |share| log(share, view)));
            mean(&all.collect::<Vec<_>>())
        })
        .collect();
    let mut figure =
        Figure::new(format!("{key}.order.gain"), mean(&logs).exp(), "of D by the paper's utility");
    figure.ci95 = student95(&logs).map(|interval| interval.map(f64::exp));
    bench.push(figure.runs(frames));
    Ok(())
}

/// A stream and the pictures that it should show.
struct Study<'a> {
    stream: &'a Stream,
    map: PacketMap,
    cameras: Vec<Camera>,
    frames: Vec<u32>,
    /// Per camera, per frame.
    references: Vec<Vec<Image>>,
}

impl<'a> Study<'a> {
    fn new(scene: &Scene, stream: &'a Stream) -> Result<Self> {
        let cameras = Framing::of(scene).ring(Ring::HeldOut, VIEWS.0, (160, 160))?;
        let frames = spread(scene.frames(), VIEWS.1);
        let references: Result<Vec<Vec<Image>>> = cameras
            .iter()
            .map(|camera| {
                Ok(evaluator::references(scene, &frames, camera, &Settings::default(), &Backend::Cpu)?)
            })
            .collect();
        Ok(Self { stream, map: PacketMap::of(stream)?, cameras, frames, references: references? })
    }

    /// Per share of the bytes of `graph`'s order, D of every view.
    fn distortions(&self, graph: &PacketGraph) -> Result<Vec<Vec<f64>>> {
        let media = graph.packets().iter().filter(|packet| packet.parity_of.is_none());
        let total: f64 = media.map(|packet| f64::from(packet.wire_bytes)).sum();
        let order = order_by_utility(graph);
        let received = self.stream.receive()?;
        let content = received.content();
        SHARES
            .par_iter()
            .map(|share| {
                let (mut have, mut bytes) = (vec![false; self.stream.packets().len()], 0.0);
                for packet in &order {
                    bytes += f64::from(graph.packets()[packet.at()].wire_bytes);
                    if bytes > share * total {
                        break;
                    }
                    have[graph.wire_id(*packet).index()] = true;
                }
                let state = self.map.state(|id| have[id]);
                let shown: Vec<(u32, Option<&[u8]>)> =
                    self.frames.iter().map(|frame| (*frame, Some(state.as_slice()))).collect();
                let mut distortions = Vec::new();
                for (camera, references) in self.cameras.iter().zip(&self.references) {
                    let settings = Settings::default();
                    let images = evaluator::renders(&content, &shown, camera, &settings, &Backend::Cpu)?;
                    for (image, reference) in images.iter().zip(references) {
                        distortions.push(metric::distortion(image, reference)?);
                    }
                }
                Ok(distortions)
            })
            .collect()
    }
}
