//! Measures one picture: milliseconds per frame and stage.

use std::time::Instant;

use anyhow::Result;
use render_host::{
    Camera, Settings, Splats,
    gpu::{Renderer, Scene},
    reference,
};

use super::{
    super::cloud::{CloudShape, camera, cloud},
    context::Context,
    peer,
};
use crate::figures::{Bench, Figure, median};

struct Case {
    name: String,
    renderer: Renderer,
    scene: Scene,
    camera: Camera,
    stages: Vec<(&'static str, Vec<f64>)>,
    wall: Vec<f64>,
    stream: Vec<f64>,
    peer: Option<peer::Peer>,
    peer_wall: Vec<f64>,
}

/// Measures.
pub(super) fn run(context: &Context, bench: &mut Bench) -> Result<()> {
    let (sides, counts, runs): (&[u32], &[usize], usize) =
        if context.quick { (&[128], &[4000], 3) } else { (&[400, 800], &[20_000, 100_000], 7) };
    // Frames in a train without waiting; on a CPU there is nothing to overlap with.
    let train = if context.is_cpu { 0 } else { 64 };
    let (device, settings) = (context.executor.device(), Settings::default());
    let mut cases = Vec::new();
    for &n in counts {
        let gaussians = cloud(CloudShape::Volume, n).gaussians;
        let splats = Splats::plain(&gaussians);
        for &side in sides {
            let camera = camera(side)?;
            let mut renderer = Renderer::new(&context.executor)?;
            let on_device = Scene::new(device, &splats)?;
            let got = renderer.render(&on_device, &camera, &settings)?;
            let exact = reference::render(&splats, &camera, &settings)?;
            let name = format!("forward.{n}.{side}");
            let mut push = |key: &str, value: f64, unit: &str| {
                bench.push(Figure::new(format!("{name}.{key}"), value, unit));
            };
            if let Some(d) = exact.difference(got.image.rgb()) {
                push("psnr_vs_f64", d.psnr_db, "dB");
                push("max_error_clear", d.max_clear, "");
                push("max_error_near_a_threshold", d.max_close, "");
                push("pixels_near_a_threshold", d.close_pixels as f64, "");
            }
            push("tile_entries", got.counters.intersections as f64, "");
            push("memory", (renderer.bytes() + on_device.bytes()) as f64 / 1e6, "MB");
            let peer = peer::Peer::new(device, &gaussians, &camera)?;
            if let Some(peer) = &peer {
                peer.draw()?;
                let (name, picture) = (format!("{name}.peer"), peer.picture()?);
                let errors = picture.rgb().iter().zip(&exact.rgb).map(|(a, b)| (f64::from(*a) - b).abs());
                bench.push(Figure::new(format!("{name}.max_error"), errors.fold(0.0, f64::max), ""));
                if let Some(d) = exact.difference(picture.rgb()) {
                    bench.push(Figure::new(format!("{name}.psnr_vs_f64"), d.psnr_db, "dB"));
                }
            }
            cases.push(Case {
                name,
                renderer,
                scene: on_device,
                camera,
                stages: Vec::new(),
                wall: Vec::new(),
                stream: Vec::new(),
                peer,
                peer_wall: Vec::new(),
            });
        }
    }
    for run in 0..=runs {
        for case in &mut cases {
            case.measure(&settings, train)?;
            if run == 0 {
                case.forget();
            }
        }
    }
    for case in &cases {
        let error = |key: &str| {
            let key = format!("{}.{key}", case.name);
            bench.figures.iter().find(|f| f.key == key).map_or(f64::NAN, |f| f.value)
        };
        let max = error("max_error_clear");
        let figure = |key: String, values: &[f64]| {
            let figure = Figure::new(format!("{}.{key}", case.name), median(values), "ms");
            figure.error(max, "max abs, clear pixels").runs(values.len())
        };
        let mut figures: Vec<Figure> =
            case.stages.iter().map(|(stage, ms)| figure(format!("stage.{stage}"), ms)).collect();
        let wall = figure("wall".into(), &case.wall);
        figures.push(match case.peer {
            Some(_) => wall.peer(peer::NAME, median(&case.peer_wall), true),
            None => wall,
        });
        if !case.stream.is_empty() {
            figures.push(figure("stream".into(), &case.stream));
        }
        figures.into_iter().for_each(|f| bench.push(f));
    }
    bench.skipped.extend(peer::absent());
    if cases.iter().all(|case| case.stages.is_empty()) {
        bench.skipped.push("stage times: the device has no timestamps".into());
    }
    Ok(())
}

impl Case {
    fn measure(&mut self, settings: &Settings, train: usize) -> Result<()> {
        let Self { renderer, scene, camera, peer, peer_wall, .. } = self;
        let device = renderer.device().clone();
        let frames = |renderer: &mut Renderer, frames: usize| -> Result<f64> {
            device.wait()?;
            let start = Instant::now();
            (0..frames).try_for_each(|_| renderer.draw(scene, camera, settings))?;
            device.wait()?;
            Ok(1000.0 * start.elapsed().as_secs_f64() / frames as f64)
        };
        renderer.time_stages(true)?;
        self.wall.push(frames(renderer, 1)?);
        for span in renderer.stage_times()? {
            match self.stages.iter_mut().find(|(name, _)| *name == span.name) {
                Some((_, values)) => values.push(span.ms),
                None => self.stages.push((span.name, vec![span.ms])),
            }
        }
        renderer.time_stages(false)?;
        if let Some(peer) = peer {
            device.wait()?;
            let start = Instant::now();
            peer.draw()?;
            device.wait()?;
            peer_wall.push(1000.0 * start.elapsed().as_secs_f64());
        }
        if train > 0 {
            self.stream.push(frames(renderer, train)?);
        }
        Ok(())
    }

    /// Drops what was measured while the device warmed up.
    fn forget(&mut self) {
        self.stages.clear();
        self.wall.clear();
        self.stream.clear();
        self.peer_wall.clear();
    }
}
