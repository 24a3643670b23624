//! Renders what schedulers delivered: D and PSNR of displayed frames, and whether utility follows them.

use anyhow::Result;
use dgs::{
    args::{ProfileName, TransportName},
    delivery::{ShownState, WireEndpoint},
    pipeline,
};
use emulator_host::{
    Nanos, PacketGraph, PolicyKind, Report, SessionConfig, bound::upper_bound, session::run_ideal,
};
use rayon::prelude::*;
use render_host::{Backend, Camera, Image, Settings, metric::Lpips};
use trainer_host::{
    Scene, Stream,
    encode::Protection,
    evaluator,
    stream::PacketMap,
    utility,
    viewpoint::{Framing, Ring},
};

use super::{
    ablations,
    channels::{Channel, MIN_BOUND, start},
    limits::{Limited, Limits, OURS, POLICIES, push_limits},
    optimum::{ARRIVED_PART, arrived_bound},
    paired::{Window, clustered, families, rank_correlation},
    schedulers,
    watched::{self, Frames, Seen},
};
use crate::{
    figures::{Bench, Figure},
    setup::{Setup, codec_args, load, spread, synth},
};

/// Steps of the solver of the bound.
const STEPS: u32 = 1500;
/// Side of the pictures, pixels.
const SIDE: u32 = 96;

/// How much is measured of encoded streams.
pub(super) struct Size {
    pub(super) windows: usize,
    pub(super) gaussians: usize,
    pub(super) frames: usize,
    pub(super) pictures: usize,
}

pub(super) fn size(setup: &Setup) -> Size {
    if setup.quick {
        Size { windows: 1, gaussians: 12_000, frames: 60, pictures: 8 }
    } else {
        Size { windows: 4, gaussians: 20_000, frames: 600, pictures: 20 }
    }
}

/// How it is measured.
pub(super) fn protocol(setup: &Setup) -> String {
    let Size { windows, gaussians, frames, pictures } = size(setup);
    format!(
        "rows of pictures: encoded streams of {gaussians} Gaussians (figure, {frames} frames; fox) through \
         the real receiver over {windows} windows of every trace, links as for the bound with 1 % loss; D = \
         MSE + 0.20 (1 - SSIM), PSNR (times the clip's length it is the area over the session), SSIM and, \
         with --lpips, LPIPS of {pictures} frames at {SIDE}x{SIDE} from a held-out camera against the \
         source's own render; flicker: change from every fourth of them to the next frame that the source \
         does not have; playout never waits once it has begun, so that what is missing shows as a freeze: \
         frames in a row, two at least and for 150 ms, of whose base less than half is there; rank \
         correlation over all runs of utility with -D; ideal transport: the same plan where the link is \
         always filled, nothing is lost and its rate is known; arrived_bound: the bound over the bytes that \
         the run's receiver got, in any order ({} of {STEPS} steps)",
        STEPS / ARRIVED_PART
    )
}

/// Adds the rows.
pub(super) fn run(bench: &mut Bench, setup: &Setup, channels: &[Channel]) -> Result<()> {
    let Size { gaussians, frames, .. } = size(setup);
    measure(bench, setup, channels, "figure", &synth("figure", gaussians, frames)?)?;
    if let Some(path) = setup.data("scenes/gltf-fox/Fox.glb", bench)? {
        measure(bench, setup, channels, "fox", &load(&path, gaussians)?)?;
    }
    Ok(())
}

/// What stays the same over the runs of one stream.
pub(super) struct Study {
    stream: Stream,
    map: PacketMap,
    table: utility::Table,
    graph: PacketGraph,
    camera: Camera,
    frames: Frames,
    references: Vec<Image>,
    network: Option<Lpips>,
}

impl Study {
    /// `scene` as a stream, of which `pictures` frames are rated.
    pub(super) fn make(scene: &Scene, setup: &Setup, pictures: usize) -> Result<Self> {
        let options = pipeline::encode_options(&codec_args(ProfileName::Dgs1), Protection::STANDARD);
        let stream = pipeline::encode(scene, &options, setup.quiet)?.stream;
        let map = PacketMap::of(&stream)?;
        let table = schedulers::utilities(scene, &stream, setup)?;
        let graph = pipeline::graph(&stream, &map, Some(&table))?;
        let camera = Framing::of(scene).ring(Ring::HeldOut, 1, (SIDE, SIDE))?.remove(0);
        let frames = Frames::new(&spread(scene.frames(), pictures), scene.frames() as u32);
        let settings = Settings::default();
        let references = evaluator::references(scene, &frames.all, &camera, &settings, &Backend::Cpu)?;
        let network = watched::network(setup)?;
        Ok(Self { stream, map, table, graph, camera, frames, references, network })
    }

    /// The stream with the gains of its bases as they were measured one by one.
    fn graph_of_unscaled_gains(&self) -> Result<PacketGraph> {
        let mut table = self.table.clone();
        table.groups.iter_mut().for_each(|group| group.together = None);
        pipeline::graph(&self.stream, &self.map, Some(&table))
    }

    /// Bytes of the stream, parity included, and the length of its clip.
    pub(super) fn extent(&self) -> (u64, Nanos) {
        let graph = &self.graph;
        (graph.total_bytes(), graph.frame_interval().times(u64::from(graph.frames())))
    }

    /// What every scheduler shows in `windows` windows of every channel.
    ///
    /// # Errors
    /// A window that cannot be cut, or what delivering and rendering refuse.
    pub(super) fn compare(&self, channels: &[Channel], windows: usize) -> Result<Vec<Limited>> {
        self.each_link(channels, windows, |link| self.compare_over(link))
    }

    /// What every scheduler shows over `link`.
    fn compare_over(&self, link: &LiveLink) -> Result<Limited> {
        let session = &link.session;
        let (mut runs, mut arrived) = (Vec::new(), Vec::new());
        for policy in POLICIES {
            let (seen, report) = self.see(session, policy)?;
            runs.push(seen);
            arrived.push(arrived_bound(&self.graph, &report, STEPS, link.bound));
        }
        Ok((link.window(runs), Limits { bound: link.bound, arrived, ideal: self.see_ideal(session)? }))
    }

    /// `run` over the link of every window that is not dead.
    fn each_link<T: Send>(
        &self,
        channels: &[Channel],
        windows: usize,
        run: impl Fn(&LiveLink) -> Result<T> + Sync,
    ) -> Result<Vec<T>> {
        let jobs: Vec<(usize, usize)> =
            (0..channels.len()).flat_map(|trace| (0..windows).map(move |window| (trace, window))).collect();
        let results: Result<Vec<Option<T>>> = jobs
            .par_iter()
            .map(|&(trace, window)| {
                let seed = 77_000 + 1000 * trace as u64 + window as u64;
                let channel = &channels[trace];
                let Some(session) = channel.session(&self.graph, (window, windows), seed, 0.01)? else {
                    return Ok(None);
                };
                let bound = upper_bound(&self.graph, &session.forward, start(&self.graph), STEPS).utility;
                if bound < MIN_BOUND {
                    return Ok(None);
                }
                run(&LiveLink { family: channel.family, trace, session, bound }).map(Some)
            })
            .collect();
        Ok(results?.into_iter().flatten().collect())
    }

    /// Delivers over one link and renders what was shown.
    fn see(&self, session: &SessionConfig, policy: PolicyKind) -> Result<(Seen, Report)> {
        let (report, states) =
            pipeline::deliver(&self.stream, &self.map, &self.graph, session, policy, TransportName::Model)?;
        Ok((self.rendered(&report, &states)?, report))
    }

    /// The same of our plan over a transport that fills the link and loses nothing.
    fn see_ideal(&self, session: &SessionConfig) -> Result<Seen> {
        let early_bytes = session.buffer_limit * codec_core::internals::limits::MAX_PACKET_BYTES;
        let mut endpoint = WireEndpoint::new(early_bytes, &self.stream, &self.map, &self.graph)?;
        let mut plan = POLICIES[OURS].build(&self.graph);
        let report = run_ideal(&self.graph, session, &mut *plan, &mut endpoint)?;
        self.rendered(&report, &endpoint.shown)
    }

    /// Renders the `states` that were shown in a run, and rates the pictures.
    fn rendered(&self, report: &Report, states: &[ShownState]) -> Result<Seen> {
        let received = self.stream.receive()?;
        let state_of = |frame: u32| states.iter().find(|state| state.frame == frame);
        let shown: Vec<(u32, Option<&[u8]>)> = self
            .frames
            .all
            .iter()
            .map(|frame| (*frame, state_of(*frame).map(|state| state.state.as_slice())))
            .collect();
        let settings = Settings::default();
        let images = evaluator::renders(&received.content(), &shown, &self.camera, &settings, &Backend::Cpu)?;
        let pictures = (&images[..], &self.references[..]);
        Seen::new(report, &self.frames, pictures, (self.graph.frame_interval(), self.network.as_ref()))
    }
}

/// The link of one window of a trace.
struct LiveLink {
    family: &'static str,
    trace: usize,
    session: SessionConfig,
    /// The most utility that any schedule shows over it.
    bound: f64,
}

impl LiveLink {
    /// The window with one value per scheduler.
    fn window<T>(&self, runs: Vec<T>) -> Window<T> {
        Window { family: self.family, trace: self.trace, runs }
    }
}

fn measure(bench: &mut Bench, setup: &Setup, channels: &[Channel], name: &str, scene: &Scene) -> Result<()> {
    let Size { windows, pictures, .. } = size(setup);
    let study = Study::make(scene, setup, pictures)?;
    let variants = ablations::variants(&study.graph, study.graph_of_unscaled_gains()?)?;
    let both = study.each_link(channels, windows, |link| {
        let without = link.window(ablations::runs(&variants, &study.graph, &link.session)?);
        Ok((study.compare_over(link)?, without))
    })?;
    let (results, without): (Vec<Limited>, Vec<_>) = both.into_iter().unzip();
    push(bench, &format!("pictures.{name}"), &results);
    push_verdicts(bench, &format!("pictures.{name}.deadline-utility"), &results);
    ablations::push(bench, name, &variants, &without);
    Ok(())
}

/// Adds all rows of one stream, their keys after `key`.
pub(super) fn push(bench: &mut Bench, key: &str, results: &[Limited]) {
    let windows: Vec<Window<Seen>> = results.iter().map(|(window, _)| window.clone()).collect();
    push_rows(bench, key, &windows);
    push_limits(bench, key, results);
}

/// Adds in how many families the default scheduler is better than each other.
fn push_verdicts(bench: &mut Bench, key: &str, results: &[Limited]) {
    let windows: Vec<Window<Seen>> = results.iter().map(|(window, _)| window.clone()).collect();
    for (at, policy) in POLICIES.iter().enumerate().filter(|(at, _)| *at != OURS) {
        push_families(bench, &windows, key, (at, policy.name()));
    }
}

fn push_rows(bench: &mut Bench, prefix: &str, windows: &[Window<Seen>]) {
    let mut push = |key: String, (value, ci): (f64, [f64; 2]), unit: &str| {
        let mut figure = Figure::new(format!("{prefix}.{key}"), value, unit).runs(windows.len());
        figure.ci95 = Some(ci);
        bench.push(figure);
    };
    let mean = |of: &dyn Fn(&Window<Seen>) -> f64| {
        clustered(windows, &|all| all.iter().map(|window| of(window)).sum::<f64>() / all.len() as f64)
    };
    for (at, policy) in POLICIES.iter().enumerate() {
        let name = policy.name();
        push(format!("{name}.utility"), mean(&|window| window.runs[at].utility), "");
        push(format!("{name}.base_miss"), mean(&|window| 100.0 * window.runs[at].base_miss), "%");
        push(format!("{name}.distortion"), mean(&|window| 1000.0 * window.runs[at].distortion), "x 10^-3");
        push(format!("{name}.psnr"), mean(&|window| window.runs[at].psnr_db), "dB");
        push(format!("{name}.worst_tenth"), mean(&|window| window.runs[at].worst_tenth_db), "dB");
        push(format!("{name}.ssim"), mean(&|window| window.runs[at].ssim), "");
        push(format!("{name}.flicker"), mean(&|window| 1000.0 * window.runs[at].flicker), "x 10^-3");
        push(format!("{name}.freezes"), mean(&|window| window.runs[at].freezes), "per minute");
        push(format!("{name}.frozen"), mean(&|window| 100.0 * window.runs[at].frozen), "% of frames");
        if windows.iter().any(|window| window.runs[at].lpips.is_finite()) {
            push(format!("{name}.lpips"), mean(&|window| window.runs[at].lpips), "");
        }
    }
    for (at, policy) in POLICIES.iter().enumerate().filter(|(at, _)| *at != OURS) {
        let name = policy.name();
        let utility = |w: &Window<Seen>| w.runs[OURS].utility - w.runs[at].utility;
        let distortion = |w: &Window<Seen>| w.runs[at].distortion - w.runs[OURS].distortion;
        push(format!("deadline-utility.less_{name}.utility"), mean(&utility), "paired");
        let saved = |w: &Window<Seen>| 1000.0 * distortion(w);
        push(format!("deadline-utility.less_{name}.distortion_saved"), mean(&saved), "x 10^-3, paired");
        let psnr = |w: &Window<Seen>| w.runs[OURS].psnr_db - w.runs[at].psnr_db;
        push(format!("deadline-utility.less_{name}.psnr"), mean(&psnr), "dB, paired");
        let worst = |w: &Window<Seen>| w.runs[OURS].worst_tenth_db - w.runs[at].worst_tenth_db;
        push(format!("deadline-utility.less_{name}.worst_tenth"), mean(&worst), "dB, paired");
        let similar = |w: &Window<Seen>| w.runs[OURS].ssim - w.runs[at].ssim;
        push(format!("deadline-utility.less_{name}.ssim"), mean(&similar), "paired");
        let flicker = |w: &Window<Seen>| 1000.0 * (w.runs[OURS].flicker - w.runs[at].flicker);
        push(format!("deadline-utility.less_{name}.flicker"), mean(&flicker), "x 10^-3, paired");
        if windows.iter().any(|window| window.runs[at].lpips.is_finite()) {
            let distance = |w: &Window<Seen>| w.runs[OURS].lpips - w.runs[at].lpips;
            push(format!("deadline-utility.less_{name}.lpips"), mean(&distance), "paired");
        }
        let freezes = |w: &Window<Seen>| w.runs[OURS].freezes - w.runs[at].freezes;
        push(format!("deadline-utility.less_{name}.freezes"), mean(&freezes), "per minute, paired");
        let frozen = |w: &Window<Seen>| 100.0 * (w.runs[OURS].frozen - w.runs[at].frozen);
        push(format!("deadline-utility.less_{name}.frozen"), mean(&frozen), "% of frames, paired");
        let missed = |w: &Window<Seen>| 100.0 * (w.runs[OURS].base_miss - w.runs[at].base_miss);
        push(format!("deadline-utility.less_{name}.base_miss"), mean(&missed), "%, paired");
    }
    let runs = || windows.iter().flat_map(|window| &window.runs);
    let utility: Vec<f64> = runs().map(|run| run.utility).collect();
    let negative: Vec<f64> = runs().map(|run| -run.distortion).collect();
    let correlation = rank_correlation(&utility, &negative);
    let figure = Figure::new(format!("{prefix}.rank_correlation"), correlation, "Spearman");
    bench.push(figure.runs(utility.len()));
}

/// In how many families the default scheduler shows better pictures than the scheduler `at`.
fn push_families(bench: &mut Bench, windows: &[Window<Seen>], key: &str, (at, name): (usize, &str)) {
    type Gain<'g> = &'g dyn Fn(&Seen, &Seen) -> f64;
    let measures: [(&str, &str, Gain<'_>); 3] = [
        ("families", "D", &|ours, theirs| theirs.distortion - ours.distortion),
        ("psnr_families", "PSNR", &|ours, theirs| ours.psnr_db - theirs.psnr_db),
        ("worst_tenth_families", "worst tenth", &|ours, theirs| ours.worst_tenth_db - theirs.worst_tenth_db),
    ];
    for (part, what, gain) in measures {
        let gain = |window: &Window<Seen>| gain(&window.runs[OURS], &window.runs[at]);
        let [better, surely, worse, of] = families(windows, &gain);
        let words =
            format!("of {of} families better {what}, {surely} beyond doubt, {worse} worse beyond doubt");
        bench.push(Figure::new(format!("{key}.{part}_over_{name}"), better as f64, &words));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_paired_with_each_other_policy() {
        let seen = |flicker: f64, freezes: f64| Seen { flicker, freezes, ..Seen::of_utility(0.5) };
        let windows = [0, 1].map(|trace| {
            let mut runs = vec![seen(2e-3, 3.0); POLICIES.len()];
            runs[OURS] = seen(1e-3, 1.0 + trace as f64);
            Window { family: "made", trace, runs }
        });
        let mut bench = Bench::new("t", "");
        push_rows(&mut bench, "p", &windows);
        for (at, policy) in POLICIES.iter().enumerate().filter(|(at, _)| *at != OURS) {
            let key = |what: &str| format!("p.deadline-utility.less_{}.{what}", policy.name());
            let figure = |what: &str| bench.figures.iter().find(|figure| figure.key == key(what));
            let (flicker, freezes) = (figure("flicker").unwrap(), figure("freezes").unwrap());
            assert!((flicker.value + 1.0).abs() < 1e-9 && flicker.ci95.is_some(), "{at}: {flicker:?}");
            assert!((freezes.value + 1.5).abs() < 1e-9, "{at}: {freezes:?}");
            assert_eq!(freezes.ci95, Some([-2.0, -1.0]));
            assert!(figure("lpips").is_none(), "no weights, no row");
        }
    }
}
