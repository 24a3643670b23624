//! Measures what each skip of the CPU renderer removes, saves and changes.

mod frames;
mod paired;

use anyhow::{Result, ensure};
use codec_core::ShDegree;
use render_host::{Camera, Counters, Renderer, Settings, Splats, reference};
use trainer_host::{
    Instant, Scene,
    viewpoint::{Framing, Ring},
};

use self::paired::{max_abs, pair, pays, serial, share, time, verdict};
use crate::{
    figures::{Bench, Figure},
    setup::{Setup, load, synth},
};

/// A skip of a single render.
struct Skip {
    name: &'static str,
    /// Switches the skip on or off.
    set: fn(&mut Settings, bool),
    /// Work it is about.
    unit: &'static str,
    /// Share of that work it removes, from the counts with it on and off.
    removed: fn(&Counters, &Counters) -> f64,
}

const SKIPS: [Skip; 9] = [
    Skip {
        name: "frustum",
        set: |s, on| s.cull_frustum = on,
        unit: "% of Gaussians, shape not computed",
        removed: |on, _| share(on.culled, on.gaussians),
    },
    Skip {
        name: "sub_pixel",
        set: |s, on| s.cull_sub_pixel = on,
        unit: "% of splats in the image, not drawn",
        removed: |on, off| share(off.drawn.saturating_sub(on.drawn), off.drawn),
    },
    Skip {
        name: "opacity_bounds",
        set: |s, on| s.opacity_bounds = on,
        unit: "% of tile entries",
        removed: |on, off| share(off.intersections.saturating_sub(on.intersections), off.intersections),
    },
    Skip {
        name: "exact_tiles",
        set: |s, on| s.exact_tiles = on,
        unit: "% of tile entries",
        removed: |on, off| share(off.intersections.saturating_sub(on.intersections), off.intersections),
    },
    Skip {
        name: "cull_entries",
        set: |s, on| s.cull_entries = on,
        unit: "% of tile entries (off by default)",
        removed: |on, off| share(off.intersections.saturating_sub(on.intersections), off.intersections),
    },
    Skip {
        name: "empty_tiles",
        set: |s, on| s.skip_empty_tiles = on,
        unit: "% of tiles",
        removed: |on, _| share(on.tiles - on.tiles_touched, on.tiles),
    },
    Skip {
        name: "row_reach",
        set: |s, on| s.row_reach = on,
        unit: "% of tile rows in boxes",
        removed: |on, _| share(on.rows_unreached, on.rows),
    },
    Skip {
        name: "sh_by_need",
        set: |s, on| s.sh_by_need = on,
        unit: "% of SH coefficients",
        removed: |on, _| share(on.sh_skipped, on.sh_coefficients),
    },
    Skip {
        name: "early_stop",
        set: |s, on| s.early_stop = on,
        unit: "% of tile rows to blend",
        removed: |on, off| share(blended(off).saturating_sub(blended(on)), blended(off)),
    },
];

fn blended(c: &Counters) -> u64 {
    c.rows - c.rows_unreached - c.rows_finished
}

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (size, runs) = if setup.quick { (160, 3) } else { (400, 7) };
    let mut bench = Bench::new(
        "skips",
        format!(
            "CPU renderer, {size}x{size} (garden: its own first camera), held-out ring camera, black \
                background, default settings; each skip alone \
             switched off (cull_entries: on), paired runs in turn, medians of {runs}, ms of processor time \
             on one thread, ratio = off / on with its 95 % interval; a skip pays if the \
             interval lies above 1; error = max abs between on and off; sequences: consecutive frames after \
             the first, one camera, against a fresh \
             render of each; states: one frame while the packets of a dgs1 stream arrive (biker, garden: \
             while its Gaussians do)"
        ),
    );
    let samples = if setup.quick { 3000 } else { 20_000 };
    let mut scenes: Vec<(&str, Scene)> = Vec::new();
    for (name, path) in [
        ("fox", "scenes/gltf-fox/Fox.glb"),
        ("cesium-man", "scenes/gltf-cesium-man/CesiumMan.glb"),
        ("biker", "scenes/splat-biker/biker.spz"),
        ("garden", "scenes/gsplat-garden-points/test_garden.npz"),
        ("playbot-sh2", "scenes/splat-playbot-lod/2_0/meta.json"),
        ("human", "scenes/splat-seq-human"),
    ] {
        if let Some(path) = setup.data(path, &mut bench)? {
            if setup.quick && !matches!(name, "fox" | "cesium-man") {
                bench.skipped.push(format!("{name}: left out by --quick"));
                continue;
            }
            scenes.push((name, load(&path, samples)?));
        }
    }
    let frames = if setup.quick { 4 } else { 9 };
    scenes.push(("synth-balls", synth("balls", samples, frames)?));
    scenes.push(("synth-figure", synth("figure", samples, frames)?));
    for (name, scene) in &scenes {
        let camera = match scene.cameras.first() {
            Some(camera) => camera.clone(),
            None => Framing::of(scene).ring(Ring::HeldOut, 3, (size, size))?.swap_remove(0),
        };
        let mut instant = scene.instant(scene.frames() / 2).unwrap_or_default();
        single(&mut bench, name, &instant, &camera, runs)?;
        if instant.sh_degree > ShDegree::ZERO {
            // As a stream has it while refinements are on their way: three blocks of four hold no bands.
            let each = 64 * instant.sh_degree.rest_len();
            let blocks = instant.sh_rest.chunks_mut(each).enumerate().filter(|(i, _)| i % 4 > 0);
            blocks.for_each(|(_, block)| block.fill(0.0));
            single(&mut bench, &format!("{name}-partly"), &instant, &camera, runs)?;
        }
        if scene.frames() > 1 {
            frames::consecutive(&mut bench, name, scene, &camera, frames, runs)?;
        }
        match *name {
            "biker" | "garden" => frames::arrivals(&mut bench, name, scene, &camera, runs)?,
            "playbot-sh2" | "human" => {}
            _ => frames::states(&mut bench, name, scene, &camera, runs, setup.quiet)?,
        }
    }
    Ok(bench)
}

/// Every skip of a single render, alone.
fn single(bench: &mut Bench, name: &str, instant: &Instant, camera: &Camera, runs: usize) -> Result<()> {
    let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
    let bands = splats.used_bands();
    let splats = splats.with_bands(&bands)?;
    let mut failing = Vec::new();
    for skip in &SKIPS {
        let (mut on, mut off) = (serial(), serial());
        (skip.set)(&mut on, true);
        (skip.set)(&mut off, false);
        let (mut with, mut without) = (Renderer::new(), Renderer::new());
        let (a, b) = (with.render(&splats, camera, &on)?, without.render(&splats, camera, &off)?);
        let error = max_abs(&a.image, &b.image);
        ensure!(
            error == 0.0 || skip.name == "early_stop",
            "{name}: {} changes the picture by {error}",
            skip.name
        );
        let (mut fast, mut slow) = (Vec::new(), Vec::new());
        let (mut to_a, mut to_b) = (a.clone(), b.clone());
        for run in 0..runs {
            let mut one = |first: bool| -> Result<()> {
                if first {
                    fast.push(time(|| Ok(with.render_into(&splats, camera, &on, &mut to_a)?))?);
                } else {
                    slow.push(time(|| Ok(without.render_into(&splats, camera, &off, &mut to_b)?))?);
                }
                Ok(())
            };
            // Whichever goes first has the colder caches.
            one(run % 2 == 0)?;
            one(run % 2 == 1)?;
        }
        let figure = pair(format!("{name}.{}", skip.name), &fast, &slow).error(error, "max abs to off");
        let removed = (skip.removed)(&a.counters, &b.counters);
        // What removes nothing cannot pay, whatever the noise says.
        if removed == 0.0 || !pays(&figure) {
            failing.push(skip.name);
        }
        bench.push(figure);
        bench.push(Figure::new(format!("{name}.{}.removed", skip.name), removed, skip.unit));
        if skip.name == "early_stop" {
            let exact = reference::render(&splats, camera, &off)?;
            for (what, image) in [("on", &a.image), ("off", &b.image)] {
                let errors = image.rgb().iter().zip(&exact.rgb).map(|(a, b)| (f64::from(*a) - b).abs());
                let max = errors.fold(0.0, f64::max);
                let clear = exact.difference(image.rgb()).map_or(f64::NAN, |d| d.max_clear);
                let key = format!("{name}.early_stop.{what}_vs_f64");
                bench.push(
                    Figure::new(key, max, "max abs, f64 never stops").error(clear, "away from thresholds"),
                );
            }
            let stopped = share(a.counters.pixels_stopped, a.counters.pixels);
            bench.push(Figure::new(format!("{name}.early_stop.pixels"), stopped, "% of pixels stopped"));
            let unread = share(a.counters.entries_unread, a.counters.intersections);
            bench.push(Figure::new(
                format!("{name}.early_stop.entries"),
                unread,
                "% of tile entries never read",
            ));
        }
    }
    bench.push(verdict(name, &failing));
    Ok(())
}
