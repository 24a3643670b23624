//! Checks the promise about loss: any subset of packets renders, one packet changes its own blocks only, and
//! what packet loss costs without retransmission.

use anyhow::{Result, ensure};
use codec_core::{
    Gaussian,
    internals::{ids::Span, receiver::Content},
};
use dgs::{args::ProfileName, pipeline};
use rayon::prelude::*;
use render_host::{Backend, Renderer, Settings, Splats, metric};
use trainer_host::{
    Scene, Stream,
    encode::Protection,
    evaluator,
    stream::{PacketMap, Player},
    viewpoint::{Framing, Ring},
};

use crate::{
    figures::{Bench, Figure, bootstrap95, median},
    setup::{Setup, codec_args, load, spread, synth},
};

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (subsets, masks, size) = if setup.quick { (100, 10, 100) } else { (1000, 40, 256) };
    let mut bench = Bench::new(
        "loss",
        format!(
            "{subsets} random packet subsets per profile (each keeps a uniform share of packets), rendered \
                at 96x96; IID packet loss without \
             retransmission or repair: {masks} masks x 4 frames x 1 held-out camera at {size}x{size}, black \
             background, PSNR against the \
             uncompressed source's own render"
        ),
    );
    let samples = if setup.quick { 3000 } else { 20_000 };
    let found = setup.data("scenes/gltf-fox/Fox.glb", &mut bench)?;
    let mut scenes = vec![("synth-figure", synth("figure", samples, 40)?)];
    if let Some(path) = found {
        scenes.push(("fox", load(&path, samples)?));
    }
    for (name, scene) in &scenes {
        for profile in [ProfileName::Dgs1, ProfileName::Paper] {
            let options = pipeline::encode_options(&codec_args(profile), Protection::NONE);
            let stream = pipeline::encode(scene, &options, setup.quiet)?.stream;
            let key = format!("{name}.{}", pipeline::profile_name(options.profile));
            promise(&mut bench, &key, scene, &stream, subsets)?;
            loss(&mut bench, &key, scene, &stream, masks, size)?;
            if profile == ProfileName::Dgs1 {
                locality(&mut bench, &key, &stream)?;
            }
        }
    }
    Ok(bench)
}

/// A repeatable draw in 0..1 for (seed, packet).
fn draw(seed: u64, id: usize) -> f64 {
    let mut x =
        (seed + 1).wrapping_mul(0xd134_2543_de82_ef95) ^ (id as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// Whether every value of `gaussians` can be drawn.
pub(crate) fn valid(gaussians: &[Gaussian]) -> bool {
    gaussians.iter().all(|g| {
        let length = g.rotation.iter().map(|v| v * v).sum::<f32>();
        g.position.iter().chain(&g.scale).chain(&g.sh0).all(|v| v.is_finite())
            && (length - 1.0).abs() < 1e-3
            && (0.0..=1.0).contains(&g.opacity)
    })
}

fn promise(bench: &mut Bench, key: &str, scene: &Scene, stream: &Stream, subsets: u64) -> Result<()> {
    let map = PacketMap::of(stream)?;
    let received = stream.receive()?;
    let content = received.content();
    let camera = &Framing::of(scene).ring(Ring::HeldOut, 3, (96, 96))?[0];
    let settings = Settings { parallel: false, ..Settings::default() };
    let good: Result<Vec<bool>> = (0..subsets)
        .into_par_iter()
        .map_init(
            || (Player::new(content.manifest), Renderer::new()),
            |(player, renderer), seed| {
                let share = draw(seed, usize::MAX);
                let state = map.state(|id| draw(seed, id) < share);
                let frame = (draw(seed, usize::MAX - 1) * scene.frames() as f64) as u32;
                let shown = player.show(&content.with_state(&state), frame)?;
                let splats = Splats::new(shown.gaussians, shown.sh_rest, shown.sh_degree)?;
                let image = renderer.render(&splats, camera, &settings)?.image;
                Ok(valid(shown.gaussians) && image.rgb().iter().all(|v| v.is_finite()))
            },
        )
        .collect();
    let good = good?.into_iter().filter(|&g| g).count();
    ensure!(good as u64 == subsets, "{key}: {} of {subsets} states did not render", subsets as usize - good);
    bench.push(Figure::new(format!("{key}.valid_states"), good as f64, &format!("of {subsets}")));
    Ok(())
}

fn loss(bench: &mut Bench, key: &str, scene: &Scene, stream: &Stream, masks: u64, size: u32) -> Result<()> {
    let map = PacketMap::of(stream)?;
    let received = stream.receive()?;
    let content = received.content();
    let camera = &Framing::of(scene).ring(Ring::HeldOut, 3, (size, size))?[0];
    let settings = Settings { parallel: false, ..Settings::default() };
    let frames = spread(scene.frames(), 4);
    let references = evaluator::references(scene, &frames, camera, &settings, &Backend::Cpu)?;
    for percent in [0u32, 1, 5, 10, 20] {
        let seeds = if percent == 0 { 1 } else { masks };
        let psnr: Result<Vec<f64>> = (0..seeds)
            .into_par_iter()
            .map(|seed| {
                let state = map.state(|id| draw(seed ^ 0xff00, id) >= f64::from(percent) / 100.0);
                let shown: Vec<_> = frames.iter().map(|&f| (f, Some(state.as_slice()))).collect();
                let images = evaluator::renders(&content, &shown, camera, &settings, &Backend::Cpu)?;
                let psnr: Result<Vec<f64>, _> =
                    images.iter().zip(&references).map(|(a, b)| metric::psnr(a, b)).collect();
                Ok(crate::figures::mean(&psnr?).min(evaluator::PSNR_CAP_DB))
            })
            .collect();
        let psnr = psnr?;
        let mut figure =
            Figure::new(format!("{key}.psnr_at_{percent}_percent"), median(&psnr), "dB (median)");
        figure.ci95 = bootstrap95(&psnr, median, 7);
        bench.push(figure.runs(psnr.len()));
        let tail = evaluator::worst_tenth(&psnr);
        bench.push(Figure::new(format!("{key}.worst_tenth_at_{percent}_percent"), tail, "dB"));
    }
    Ok(())
}

/// Every single packet dropped in turn: Gaussians outside its blocks must not change in any bit.
fn locality(bench: &mut Bench, key: &str, stream: &Stream) -> Result<()> {
    let map = PacketMap::of(stream)?;
    let received = stream.receive()?;
    let content = received.content();
    let owner = owners(&content)?;
    let whole = map.state(|_| true);
    let count = stream.packets().len();
    let spilled: Result<Vec<usize>> = (0..count)
        .into_par_iter()
        .map_init(
            || (Player::new(content.manifest), Player::new(content.manifest)),
            |(a, b), lost| {
                let frame = (draw(9, lost) * f64::from(content.manifest.head().frames)) as u32;
                let state = map.state(|id| id != lost);
                let one = a.show(&content.with_state(&whole), frame)?;
                let two = b.show(&content.with_state(&state), frame)?;
                let epoch = one.decoded.epoch;
                let own: std::collections::BTreeSet<(u16, usize)> = map
                    .placements(lost)
                    .iter()
                    .filter_map(|m| {
                        let cell = content.cell(m.group.span, m.group.cluster)?;
                        let first = m.first_block - cell.blocks as usize;
                        Some((first..first + m.blocks).map(|b| (m.group.cluster.0, b)))
                    })
                    .flatten()
                    .collect();
                let changed = one.gaussians.iter().zip(two.gaussians).enumerate();
                let changed = changed.filter(|(_, (x, y))| x != y);
                Ok(changed.filter(|(i, _)| !own.contains(&owner[epoch.index()][*i])).count())
            },
        )
        .collect();
    let spilled: usize = spilled?.into_iter().sum();
    ensure!(spilled == 0, "{key}: {spilled} Gaussians changed outside the lost packet's blocks");
    bench.push(Figure::new(
        format!("{key}.gaussians_changed_outside_blocks"),
        0.0,
        &format!("over {count} single losses"),
    ));
    Ok(())
}

/// (cluster, block) of every decoded Gaussian, per epoch.
fn owners(content: &Content<'_>) -> codec_core::Result<Vec<Vec<(u16, usize)>>> {
    let mut owners = vec![Vec::new(); usize::from(content.manifest.head().epochs)];
    codec_core::internals::receiver::for_each_cell(content.manifest, |span, cluster, shape| {
        if let Span::Canonical(epoch) = span {
            let blocks = (0..shape.blocks())
                .flat_map(|b| std::iter::repeat_n((cluster.0, b), shape.block_gaussians(b)));
            owners[epoch.index()].extend(blocks);
        }
        Ok(())
    })?;
    Ok(owners)
}
