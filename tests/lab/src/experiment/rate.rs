//! Measures rate and quality of the complete decoded state: `dgs1` beside the paper's format, known methods
//! and public formats, on real and synthetic scenes; what a stream spends on overhead.
//!
//! `--out DIR` writes `rate.csv` and a rate–distortion drawing per scene.

mod bjontegaard;
mod codec;
mod coded;
mod context;
mod dgs1;
mod facts;
mod fourdgs;
mod lattice;
mod overhead;
mod plain;
mod rans;
mod scenes;
mod spz;
mod table;
mod uniform;

use anyhow::Result;
use dgs::output::print;
use rayon::prelude::*;

use self::{
    codec::{Codec, CodecKind},
    scenes::{Evaluator, Named},
    table::Measurement,
};
use crate::{
    figures::{Bench, Figure, mean},
    setup::Setup,
};

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (size, shown) = if setup.quick { (96, 2) } else { (400, 3) };
    let codecs = codec::all(setup.quick);
    let mut bench = Bench::new(
        "rate",
        format!(
            "complete decoded state against the uncompressed source's own render; 3 held-out ring cameras at \
                {size}x{size}, black background, \
             up to {shown} frames spread over the clip, PSNR of a picture capped at 99 dB, FLIP from the \
             first camera; \
             bits per Gaussian: all bytes sent over the Gaussians of the source (all epochs); no repair; \
             every codec decodes its own bytes and those Gaussians are rendered; \
             comparisons: Bjøntegaard rate (PCHIP of log rate over PSNR, efficient points only) over the \
             PSNR both reach, \
             or at a peer's own points where it has no curve; negative: dgs1 needs fewer bits; \
             times alone: wall time with all cores, of decoding all frames to Gaussians (ply-zstd, spz over \
             frames and 4dgs: to their attributes)"
        ),
    );
    for codec in &codecs {
        bench.protocol += &format!("; {}: {} in {:?}", codec.name, codec.knob, codec.settings);
    }
    let mut rows: Vec<Measurement> = Vec::new();
    let mut compared = Vec::new();
    let mut shares = Vec::new();
    scenes::for_each(setup, &mut bench, |bench, named| {
        let these = measure(bench, &named, &codecs, size, shown)?;
        if !setup.quiet.0 {
            print(&format!("{}\n", table::text(&these)))?;
        }
        push(bench, &these);
        shares.push(overhead::measure(bench, &named.key, &named.scene)?.share());
        compared.extend(table::compare(bench, &these));
        table::draw(setup, &these)?;
        rows.extend(these);
        Ok(())
    })?;
    table::means(&mut bench, &compared);
    bench.push(Figure::new("mean.overhead", 100.0 * mean(&shares), "% of the wire, without repair"));
    setup.write("rate.csv", &table::csv(&rows))?;
    if let Some(ours) = codecs.iter().find(|c| c.kind == CodecKind::Ours) {
        facts::run(&mut bench, setup, size, ours)?;
    }
    Ok(bench)
}

/// All codecs at all settings on one scene. One setting of each is timed alone, the others run in parallel.
fn measure(
    bench: &mut Bench,
    named: &Named,
    codecs: &[Codec],
    size: u32,
    shown: usize,
) -> Result<Vec<Measurement>> {
    let scene = &named.scene;
    let evaluator = Evaluator::of(scene, size, shown)?;
    let gaussians: usize = scene.epochs().iter().map(|e| e.count()).sum();
    let one = |codec: &Codec, setting: f32, timed: bool| -> Result<Measurement> {
        let coded = (codec.code)(scene, setting, codec.level, &evaluator.frames)?;
        Ok(Measurement {
            scene: named.key.clone(),
            counts: named.counts,
            dynamic: scene.epochs().iter().any(|e| e.frames() > 1),
            codec: codec.name,
            kind: codec.kind,
            setting,
            bits: 8.0 * coded.bytes as f64 / gaussians.max(1) as f64,
            bytes_per_frame: coded.bytes as f64 / scene.frames() as f64,
            marks: evaluator.marks(&coded.shown)?,
            encode_s: coded.encode_s,
            decode_ms: 1000.0 * coded.decode_s / scene.frames() as f64,
            timed,
        })
    };
    let mut jobs: Vec<(usize, &Codec, f32)> = Vec::new();
    let mut found: Vec<(usize, Measurement)> = Vec::new();
    for codec in codecs {
        let timed = codec.settings.iter().position(|&s| s >= 1.0).unwrap_or(0);
        for (k, &setting) in codec.settings.iter().enumerate() {
            let place = found.len() + jobs.len();
            if k != timed {
                jobs.push((place, codec, setting));
                continue;
            }
            match one(codec, setting, true) {
                Ok(row) => found.push((place, row)),
                Err(why) => {
                    bench.skipped.push(format!("{}.{}: absent: {why:#}", named.key, codec.name));
                    jobs.retain(|j| j.1.name != codec.name);
                    break;
                }
            }
        }
    }
    let rest: Result<Vec<(usize, Measurement)>> = jobs
        .par_iter()
        .with_max_len(1)
        .map(|&(place, codec, setting)| Ok((place, one(codec, setting, false)?)))
        .collect();
    found.extend(rest?);
    found.sort_by_key(|f| f.0);
    Ok(found.into_iter().map(|f| f.1).collect())
}

/// The rows timed alone, and the ends of each codec's range, as figures.
fn push(bench: &mut Bench, rows: &[Measurement]) {
    for row in rows.iter().filter(|r| r.timed) {
        let key = |what: &str| format!("{}.{}.{what}", row.scene, row.codec);
        bench.push(Figure::new(key("bits_per_gaussian"), row.bits, "bit"));
        bench.push(Figure::new(key("bytes_per_frame"), row.bytes_per_frame, "byte"));
        bench.push(Figure::new(key("psnr_mean"), row.marks.psnr, "dB"));
        bench.push(Figure::new(key("psnr_min"), row.marks.psnr_min, "dB"));
        bench.push(Figure::new(key("ssim"), row.marks.ssim, ""));
        bench.push(Figure::new(key("flip"), row.marks.flip, ""));
        bench.push(Figure::new(key("encode"), row.encode_s, "s").error(row.marks.psnr, "dB mean PSNR"));
        bench.push(
            Figure::new(key("decode"), row.decode_ms, "ms/frame").error(row.marks.psnr, "dB mean PSNR"),
        );
    }
}
