//! Turns points into comparisons: CSV, drawings, Bjøntegaard rates per scene and over scenes.

use std::fmt::Write as _;

use anyhow::Result;
use trainer_host::evaluator::PSNR_CAP_DB;

use super::{
    bjontegaard::{Difference, RateCurve, RatePoint, Refused, difference, difference_cubic, efficient},
    codec::CodecKind,
    scenes::QualityScores,
};
use crate::{
    draw::curves::{Curve, Curves},
    figures::{Bench, Figure, mean, student95},
    setup::Setup,
};

/// One codec on one scene at one setting.
#[derive(Clone, Debug)]
pub struct Measurement {
    /// Scene.
    pub scene: String,
    /// Whether means over scenes count it.
    pub counts: bool,
    /// Whether it has more than one frame of the same Gaussians.
    pub dynamic: bool,
    /// Codec.
    pub codec: &'static str,
    /// What the codec is.
    pub kind: CodecKind,
    /// Setting of the knob.
    pub setting: f32,
    /// Bits per Gaussian of the source.
    pub bits: f64,
    /// Bytes per frame.
    pub bytes_per_frame: f64,
    /// Quality.
    pub marks: QualityScores,
    /// Encoding, seconds; with others at the same time unless `timed`.
    pub encode_s: f64,
    /// Decoding, ms per frame; likewise.
    pub decode_ms: f64,
    /// Whether nothing else ran.
    pub timed: bool,
}

/// All rows as CSV.
pub fn csv(rows: &[Measurement]) -> String {
    let mut out = String::from(
        "scene,codec,setting,bits_per_gaussian,bytes_per_frame,psnr_mean_db,psnr_min_db,ssim,flip,encode_s,decode_ms_per_frame,alone\n",
    );
    for r in rows {
        let QualityScores { psnr, psnr_min, ssim, flip } = r.marks;
        let _ = writeln!(
            out,
            "{},{},{},{:.3},{:.1},{psnr:.3},{psnr_min:.3},{ssim:.6},{flip:.6},{:.3},{:.4},{}",
            r.scene, r.codec, r.setting, r.bits, r.bytes_per_frame, r.encode_s, r.decode_ms, r.timed
        );
    }
    out
}

/// The rows of one scene as a table for people.
pub fn text(rows: &[Measurement]) -> String {
    let mut out = String::new();
    for r in rows {
        let _ = writeln!(
            out,
            "  {:12} {:15} {:>5}  {:9.1} bit/G {:10.0} B/frame  {:6.2} dB (min {:6.2})  ssim {:.5}  flip \
                {:.5}  enc {:7.2} s  dec {:7.2} ms/frame{}",
            r.scene,
            r.codec,
            r.setting,
            r.bits,
            r.bytes_per_frame,
            r.marks.psnr,
            r.marks.psnr_min,
            r.marks.ssim,
            r.marks.flip,
            r.encode_s,
            r.decode_ms,
            if r.timed { " alone" } else { "" }
        );
    }
    out
}

/// `dgs1` against one codec on one scene.
#[derive(Clone, Debug)]
pub struct Compared {
    /// Scene.
    pub scene: String,
    counts: bool,
    dynamic: bool,
    /// The codec compared with.
    pub codec: &'static str,
    kind: CodecKind,
    /// ln(bits of `dgs1` / bits of the codec) at equal PSNR.
    pub log_ratio: f64,
}

/// Points of `codec` in `rows` below the cap of PSNR.
fn points(rows: &[Measurement], codec: &str) -> Vec<RatePoint> {
    let these = rows.iter().filter(|r| r.codec == codec && r.marks.psnr < PSNR_CAP_DB - 1e-6);
    these.map(|r| (r.bits, r.marks.psnr)).collect()
}

/// Compares `dgs1` with every other codec of `rows`, which are those of one scene.
pub fn compare(bench: &mut Bench, rows: &[Measurement]) -> Vec<Compared> {
    let mut out = Vec::new();
    let Some(first) = rows.first() else { return out };
    let scene = &first.scene;
    let ours = match RateCurve::new(&efficient(&points(rows, "dgs1"))) {
        Ok(curve) => curve,
        Err(why) => {
            bench.skipped.push(format!("{scene}.dgs1: {why}"));
            return out;
        }
    };
    for psnr in [40.0, 45.0, 50.0] {
        if let Some(bits) = ours.rate_at(psnr) {
            bench.push(Figure::new(format!("{scene}.dgs1.bits_at_{psnr}_db"), bits, "bit/Gaussian"));
        }
    }
    let mut names: Vec<(&'static str, CodecKind)> = Vec::new();
    for row in rows.iter().filter(|r| r.kind != CodecKind::Ours) {
        if !names.contains(&(row.codec, row.kind)) {
            names.push((row.codec, row.kind));
        }
    }
    for (codec, kind) in names {
        let theirs = efficient(&points(rows, codec));
        let key = format!("{scene}.dgs1_against.{codec}");
        match against(&theirs, &ours) {
            Ok((found, how)) => {
                let [low, high] = found.overlap;
                let mut figure = Figure::new(&key, found.percent(), "% bits at equal PSNR");
                figure.error = Some(high - low);
                figure.error_unit = Some(format!("dB wide: {low:.1} to {high:.1} dB, {how}"));
                bench.push(figure);
                let cubic = RateCurve::new(&theirs).and_then(|t| difference_cubic(&t, &ours));
                if let Ok(cubic) = cubic {
                    bench.push(Figure::new(format!("{key}.cubic"), cubic.percent(), "% (cross-check)"));
                }
                if kind == CodecKind::Paper {
                    let times = (-found.log_ratio).exp();
                    bench.push(Figure::new(format!("{scene}.paper_over_dgs1"), times, "× at equal PSNR"));
                }
                let (counts, dynamic) = (first.counts, first.dynamic);
                let log_ratio = found.log_ratio;
                out.push(Compared { scene: scene.clone(), counts, dynamic, codec, kind, log_ratio });
            }
            Err(why) => bench.skipped.push(format!("{key}: {why}")),
        }
    }
    let best = |public: bool| {
        let fit = out.iter().filter(|c| if public { c.kind == CodecKind::Public } else { c.kind.is_peer() });
        fit.max_by(|a, b| a.log_ratio.total_cmp(&b.log_ratio))
    };
    for (what, best) in [("best_public", best(true)), ("best_peer", best(false))] {
        if let Some(best) = best {
            let percent = 100.0 * (best.log_ratio.exp() - 1.0);
            let mut figure =
                Figure::new(format!("{scene}.dgs1_against.{what}"), percent, "% bits at equal PSNR");
            figure.peer = Some(best.codec.to_owned());
            figure.peer_value = Some(0.0);
            bench.push(figure);
        }
    }
    out
}

/// The Bjøntegaard difference where the codec has a curve that overlaps; else the mean difference at its
/// points that lie in our range.
fn against(theirs: &[RatePoint], ours: &RateCurve) -> Result<(Difference, String), Refused> {
    if theirs.len() >= 2 {
        let curve = RateCurve::new(theirs)?;
        if let Ok(found) = difference(&curve, ours) {
            return Ok((found, format!("{} points", theirs.len())));
        }
    }
    let inside: Vec<(f64, f64)> =
        theirs.iter().filter_map(|&(bits, psnr)| Some(((ours.rate_at(psnr)? / bits).ln(), psnr))).collect();
    if inside.is_empty() {
        let [low, high] = ours.range();
        let gap = |p: &RatePoint| (p.1 - high).max(low - p.1);
        let nearest = theirs.iter().map(gap).fold(f64::INFINITY, f64::min);
        return Err(Refused::NoOverlap(-nearest));
    }
    let log_ratio = mean(&inside.iter().map(|i| i.0).collect::<Vec<_>>());
    let low = inside.iter().map(|i| i.1).fold(f64::INFINITY, f64::min);
    let high = inside.iter().map(|i| i.1).fold(f64::NEG_INFINITY, f64::max);
    Ok((Difference { log_ratio, overlap: [low, high] }, format!("at {} of its points", inside.len())))
}

/// Means over scenes with intervals over scenes by Student's t: a bootstrap of so few is too narrow.
pub fn means(bench: &mut Bench, all: &[Compared]) {
    let mut names: Vec<&'static str> = Vec::new();
    all.iter().for_each(|c| {
        if !names.contains(&c.codec) {
            names.push(c.codec);
        }
    });
    let percent = |log: f64| 100.0 * (log.exp() - 1.0);
    let mut push = |key: String, logs: &[f64]| {
        if logs.is_empty() {
            return;
        }
        let mut figure = Figure::new(key, percent(mean(logs)), "% bits at equal PSNR, mean over scenes");
        figure.ci95 = student95(logs).map(|ends| ends.map(percent));
        figure.runs = Some(logs.len());
        bench.push(figure);
    };
    let counted: Vec<&Compared> = all.iter().filter(|c| c.counts).collect();
    for name in names {
        let logs: Vec<f64> = counted.iter().filter(|c| c.codec == name).map(|c| c.log_ratio).collect();
        push(format!("mean.dgs1_against.{name}"), &logs);
    }
    let mut scenes: Vec<&str> = counted.iter().map(|c| c.scene.as_str()).collect();
    scenes.dedup();
    for (what, public) in [("best_public", true), ("best_peer", false)] {
        let fit = |c: &&&Compared| if public { c.kind == CodecKind::Public } else { c.kind.is_peer() };
        let best = |scene: &&str| {
            let these = counted.iter().filter(|c| c.scene == **scene).filter(fit);
            these.map(|c| c.log_ratio).max_by(f64::total_cmp)
        };
        let logs: Vec<f64> = scenes.iter().filter_map(best).collect();
        push(format!("mean.dgs1_against.{what}"), &logs);
    }
    let paper: Vec<f64> =
        counted.iter().filter(|c| c.kind == CodecKind::Paper && c.dynamic).map(|c| -c.log_ratio).collect();
    if !paper.is_empty() {
        let mut figure = Figure::new("mean.paper_over_dgs1.dynamic", mean(&paper).exp(), "× at equal PSNR");
        figure.ci95 = student95(&paper).map(|ends| ends.map(f64::exp));
        figure.runs = Some(paper.len());
        bench.push(figure);
    }
}

/// Draws the rate–distortion curves of one scene.
///
/// # Errors
/// If the drawing cannot be written.
pub fn draw(setup: &Setup, rows: &[Measurement]) -> Result<()> {
    let Some(first) = rows.first() else { return Ok(()) };
    let mut curves: Vec<Curve> = Vec::new();
    for row in rows {
        let point = (row.bits, row.marks.psnr);
        match curves.iter_mut().find(|c| c.name == row.codec) {
            Some(curve) => curve.points.push(point),
            None => curves.push(Curve { name: row.codec.to_owned(), points: vec![point] }),
        }
    }
    let title = format!("{}: quality of the decoded state against its size", first.scene);
    let drawing = Curves {
        title: &title,
        subtitle: "mean over held-out cameras and frames against the uncompressed source's pictures; up and \
            left is better",
        x_label: "bits per Gaussian, all frames and everything sent",
        y_label: "PSNR, dB",
        curves,
    };
    setup.write(&format!("rate-{}.svg", first.scene), &drawing.svg())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(codec: &'static str, kind: CodecKind, bits: f64, psnr: f64) -> Measurement {
        let marks = QualityScores { psnr, psnr_min: psnr, ssim: 1.0, flip: 0.0 };
        Measurement {
            scene: "s".into(),
            counts: true,
            dynamic: true,
            codec,
            kind,
            setting: 1.0,
            bits,
            bytes_per_frame: bits,
            marks,
            encode_s: 0.0,
            decode_ms: 0.0,
            timed: false,
        }
    }

    #[test]
    fn peers_with_curves_points_and_neither() {
        let mut rows = Vec::new();
        for (i, psnr) in [40.0, 45.0, 50.0, 55.0].into_iter().enumerate() {
            rows.push(row("dgs1", CodecKind::Ours, 100.0 * 2f64.powi(i as i32), psnr));
            rows.push(row("paper", CodecKind::Paper, 2000.0 * 2f64.powi(i as i32), psnr));
        }
        rows.push(row("one", CodecKind::Public, 800.0, 50.0));
        rows.push(row("lossless", CodecKind::Public, 5000.0, PSNR_CAP_DB));
        rows.push(row("beyond", CodecKind::Public, 5000.0, 70.0));
        let mut bench = Bench::new("rate", "test");
        let found = compare(&mut bench, &rows);
        let ratio = |name: &str| found.iter().find(|c| c.codec == name).map(|c| c.log_ratio.exp());
        assert!((ratio("paper").unwrap() - 0.05).abs() < 1e-9);
        assert!((ratio("one").unwrap() - 0.5).abs() < 1e-9);
        assert_eq!((ratio("lossless"), ratio("beyond")), (None, None));
        assert_eq!(bench.skipped.len(), 2, "{:?}", bench.skipped);
        means(&mut bench, &found);
        let value = |key: &str| bench.figures.iter().find(|f| f.key == key).map(|f| f.value);
        assert!((value("mean.paper_over_dgs1.dynamic").unwrap() - 20.0).abs() < 1e-9);
        assert!((value("mean.dgs1_against.best_public").unwrap() + 50.0).abs() < 1e-9);
        assert!((value("s.dgs1.bits_at_45_db").unwrap() - 200.0).abs() < 1e-9);
    }

    #[test]
    fn every_row_is_a_line() {
        let rows = [row("dgs1", CodecKind::Ours, 1.0, 30.0), row("paper", CodecKind::Paper, 2.0, 31.0)];
        assert_eq!((csv(&rows).lines().count(), text(&rows).lines().count()), (3, 2));
    }
}
