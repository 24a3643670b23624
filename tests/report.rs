//! The page of a made-up session: what it says, that its tags balance, and that gaps do not stop it.
//!
//! `DGS_REPORT_HTML=/tmp/report.html cargo test --test report` also writes it for a look.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail like tests")]

use dgs::{
    figures::Machine,
    report::{Page, Picture, SchedulerRun, Shown, Strip, html},
};
use emulator_host::{
    Nanos,
    report::{FrameRow, Report, SenderCounts, Waste},
};
use render_host::{Image, metric};
use trainer_host::encode::{Ledger, Share};

const NAMES: [&str; 4] = ["layered", "dash", "dependency", "deadline-utility"];
const FRAMES: u32 = 90;
/// Where to write the page for a look; images are larger then.
const LOOK: &str = "DGS_REPORT_HTML";

/// A repeatable number in 0..1.
fn noise(n: u32) -> f64 {
    let mut h = n.wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b;
    h = (h ^ h >> 15).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ h >> 12).wrapping_mul(0x297a_2d39);
    f64::from(h ^ h >> 15) / f64::from(u32::MAX)
}

/// Soft discs; `detail` of them, the more the better.
fn image(frame: u32, detail: u32) -> Image {
    let (side, mut rgb) = (if std::env::var_os(LOOK).is_some() { 192u32 } else { 24 }, Vec::new());
    let discs: Vec<[f64; 6]> = (0..detail)
        .map(|i| {
            let [a, b, c, d, e] = [1, 2, 3, 4, 5].map(|k| noise(9 * i + k));
            let turn = f64::from(frame) * 0.03 + 6.3 * a;
            let reach = 0.36 * b.sqrt();
            [0.5 + reach * turn.cos(), 0.5 + reach * turn.sin(), 0.02 + 0.06 * c, d, e, a]
        })
        .collect();
    for y in 0..side {
        for x in 0..side {
            let (x, y) = (f64::from(x) / f64::from(side), f64::from(y) / f64::from(side));
            let mut colour = [0.93, 0.94, 0.95];
            for [u, v, r, red, green, blue] in &discs {
                let a = 0.8 * (-((x - u).powi(2) + (y - v).powi(2)) / (r * r)).exp();
                for (c, to) in colour.iter_mut().zip([red, green, blue]) {
                    *c += a * (0.15 + 0.75 * to - *c);
                }
            }
            rgb.extend(colour.map(|c| c as f32));
        }
    }
    Image::new(side, side, rgb).unwrap()
}

fn delivery(i: usize) -> Report {
    let rank = i as f64;
    let frames = (0..FRAMES)
        .map(|f| {
            let dip = if (35..60).contains(&f) { 0.35 - 0.08 * rank } else { 0.02 };
            let arrived = (1.0 - (-f64::from(f) / (18.0 - 3.0 * rank)).exp()) * (0.8 + 0.06 * rank);
            let utility = (arrived - dip * noise(f / 5 + 31 * i as u32)).clamp(-0.1, 1.0);
            FrameRow {
                time_ns: Nanos((0.42e9 + 0.21e9 * (3.0 - rank)) as u64 + u64::from(f) * 33_333_333),
                frame: f,
                usable_bytes: (1200.0 * f64::from(f) * (0.7 + 0.1 * rank)) as u64,
                utility,
                miss: (1.0 - utility).clamp(0.0, 1.0) * 0.7,
                base_miss: if (40..52).contains(&f) && i < 3 { 0.12 / (rank + 1.0) } else { 0.0 },
            }
        })
        .collect();
    Report {
        policy: NAMES[i].into(),
        controller: "cubic".into(),
        seed: 7,
        startup_ms: Some(1050.0 - 210.0 * rank),
        startup_reached: i != 1,
        miss_rate: 0.4137 - 0.08 * rank,
        base_miss_rate: 0.031 - 0.01 * rank,
        positive_miss_rate: 0.38 - 0.08 * rank,
        utility: 0.611 + 0.091 * rank,
        duration_ns: Nanos(4_321_000_000),
        goodput_bps: 2.31e6,
        usable_goodput_bps: 1.17e6 + 0.3e6 * rank,
        media_bytes: 812_345,
        buffered_before_manifest: 3,
        recovered: 11,
        waste: Waste {
            late_bytes: 40_000 - 9_000 * i as u64,
            outside_closure_bytes: 22_222,
            duplicate_bytes: 1_500,
            unused_repair_bytes: 7_777,
            refused_bytes: 0,
        },
        sender: SenderCounts {
            datagrams: 12_345,
            media: 700,
            retransmitted: 41,
            lost: 57,
            ..Default::default()
        },
        forecast: None,
        frames,
        arrived_bytes: Vec::new(),
        samples: Vec::new(),
        boxes: Vec::new(),
        one_way_delay: None,
        digest: 0xfeed_face_0000_0000 + i as u64,
    }
}

fn run(i: usize) -> SchedulerRun {
    let delivery = delivery(i);
    let frames = delivery
        .frames
        .iter()
        .map(|row| Shown {
            time_s: (i > 0 || row.frame != 50).then_some(row.time_ns.as_s()),
            frame: row.frame,
            psnr_db: 17.0 + 22.0 * row.utility.max(0.0) + 0.6 * noise(row.frame + 977),
            ssim: 0.9,
        })
        .collect();
    let rank = i as f64;
    SchedulerRun {
        name: NAMES[i].into(),
        delivery,
        limit: ["link", "congestion control"][i % 2].into(),
        utility_bound: Some(0.97),
        freezes: i as u64,
        frozen_frames: 9 * i as u64,
        frames,
        mean_psnr_db: 28.314 + 1.7 * rank,
        tail_psnr_db: 19.271 + 2.3 * rank,
        mean_ssim: 0.8412 + 0.0311 * rank,
        flicker: 0.012_34 - 0.002 * rank,
        distortion: 0.023_45 - 0.004 * rank,
    }
}

fn ledger() -> Ledger {
    let attributes = [
        ("position", 260e3),
        ("scale", 190e3),
        ("rotation", 210e3),
        ("opacity", 80e3),
        ("sh0", 170e3),
        ("sh1", 120e3),
        ("track", 40e3),
        ("position motion", 310e3),
        ("rotation motion", 60e3),
    ];
    let share = |attribute, bits: f64, level: u8| Share {
        attribute,
        level,
        bits: bits * [0.42, 0.33, 0.25][level as usize],
    };
    Ledger {
        gaussians: 8_000,
        frames: u64::from(FRAMES),
        symbols: 412_345,
        raw_symbols: 824_690.0,
        empirical_entropy: 171_234.0,
        monolithic: 181_456.0,
        payload: 186_789.0,
        headers: 6_543.0,
        dependencies: 1_234.0,
        crc: 876.0,
        parity: 9_999.0,
        manifest: 4_321.0,
        packets: 219,
        parity_packets: 12,
        saturated: 5,
        shares: attributes.iter().flat_map(|(a, b)| (0..3).map(|l| share(*a, *b, l))).collect(),
        ..Ledger::default()
    }
}

fn strip(frame: u32) -> Strip {
    let reference = image(frame, 90);
    let shown = (0..4u32).map(|i| {
        let image = image(frame, (18 + 20 * i + frame / 8).min(90));
        let error = metric::heat(&image, &reference, 0.25).unwrap();
        let psnr_db = metric::psnr(&image, &reference).unwrap().min(99.0);
        Picture { caption: NAMES[i as usize].into(), image, error: Some(error), psnr_db: Some(psnr_db) }
    });
    let shown = shown.collect();
    let reference = Picture { caption: "source".into(), image: reference, error: None, psnr_db: None };
    Strip { frame, reference, shown }
}

fn sample() -> Page {
    let text = |a: &str, b: &str| (a.to_owned(), b.to_owned());
    Page {
        title: "synth:figure:8000:90 over a <lossy> & bursty link".into(),
        machine: Machine { cpu: "Example CPU @ 2.0 GHz".into(), cores: 2, device: None },
        protocol: vec![
            text("scene", "synth figure, 8,000 Gaussians, 90 frames at 30 fps"),
            text("link", "trace \"walk\", 40 ms, drop-tail 64 KiB"),
            text("quality", "camera held out from every choice, 512×512, background [1, 1, 1]"),
        ],
        ledger: ledger(),
        complete_psnr_db: (0..FRAMES).map(|f| 40.2 + 0.8 * noise(f)).collect(),
        capacity_mbps: (0..44)
            .map(|i| (f64::from(i) * 0.1, if (17..27).contains(&i) { 0.6 } else { 2.2 + 0.7 * noise(i / 2) }))
            .collect(),
        runs: (0..4).map(run).collect(),
        strips: [11, 33, 56, 78].map(strip).into(),
        notes: vec!["Gaussian identity is not stored; it was recovered by order.".into()],
        damaged: false,
    }
}

/// Every tag is closed, in order. Style and script are skipped.
fn balanced(html: &str) {
    let (mut open, mut rest) = (Vec::new(), html);
    while let Some(at) = rest.find('<') {
        let end =
            at + rest[at..].find('>').unwrap_or_else(|| panic!("a tag without end: {:.60}", &rest[at..]));
        let tag = &rest[at + 1..end];
        rest = &rest[end + 1..];
        let name = tag.trim_start_matches('/').split([' ', '/']).next().unwrap();
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "closed by </{name}>");
        } else if !tag.starts_with('!')
            && !tag.ends_with('/')
            && !["meta", "img", "input", "br"].contains(&name)
        {
            open.push(name);
            if ["style", "script"].contains(&name) {
                rest = &rest[rest.find(&format!("</{name}>")).unwrap()..];
            }
        }
    }
    assert!(open.is_empty(), "left open: {open:?}");
}

/// The page without images, style and script.
fn text(html: &str) -> String {
    let (mut out, mut rest) = (String::new(), html);
    for (from, to) in [("<style>", "</style>"), ("<script>", "</script>")] {
        let (before, after) = rest.split_once(from).unwrap();
        out += before;
        rest = after.split_once(to).unwrap().1;
    }
    out += rest;
    out.split("base64,").map(|part| part.split_once('"').map_or(part, |p| p.1)).collect()
}

#[test]
fn the_page_has_every_name_and_every_number() {
    let html = html::page(&sample());
    if let Ok(path) = std::env::var(LOOK) {
        std::fs::write(path, &html).unwrap();
    }
    balanced(&html);
    assert_eq!(html, html::page(&sample()), "equal pages give equal bytes");
    let text = text(&html);
    for name in NAMES {
        assert!(text.matches(name).count() > 8, "{name}");
    }
    for words in ["no freeze", "1 freeze of 9 frames", "2 freezes of 18 frames in all"] {
        assert!(text.contains(words), "{words}");
    }
    let numbers = [
        // Headline.
        "1,050",
        "420",
        "41.4",
        "17.4",
        "3.1",
        "0.611",
        "0.884",
        "28.31",
        "33.41",
        "19.27",
        "26.17",
        "0.8412",
        "0.9345",
        "12.34",
        "23.45",
        "11.45",
        "6.34",
        "1.17",
        "2.07",
        "69.8",
        "43.5",
        // Waste by kind and the sender's counters.
        "39.1",
        "21.7",
        "1.5 KiB",
        "7.6",
        "12,345",
        "700",
        "41",
        "57",
        "793.3",
        "2.31",
        "4.321",
        "feedface00000003",
        "89 / 90",
        // Rate.
        "824,690",
        "171,234",
        "181,456",
        "186,789",
        "6,543",
        "1,234",
        "876",
        "9,999",
        "4,321",
        "209,762",
        "15.6",
        "209.76",
        "2,330.7",
        "8,000",
        "412,345",
        "219",
        "12",
        "4.4",
        // Shares, protocol, notes, machine.
        "310.0 kbit",
        "109.2 kbit",
        "camera held out",
        "identity is not stored",
        "Example CPU",
    ];
    for number in numbers {
        assert!(text.contains(number), "{number} is missing");
    }
    // Pictures come first, then what stood still, then startup, misses and utility.
    let headings = [
        "Mean PSNR",
        "Worst 10 %",
        "D",
        "SSIM",
        "Flicker",
        "Frozen",
        "Startup",
        "Deadline miss",
        "Base miss",
        "Utility",
        "Wasted",
    ];
    let head = text.split_once("<thead>").unwrap().1.split_once("</thead>").unwrap().0;
    let found: Vec<&str> =
        head.split("<th").skip(2).map(|cell| cell.split(['>', '<']).nth(1).unwrap()).collect();
    assert_eq!(found, headings);
    let json = serde_json::to_value(sample()).unwrap();
    assert_eq!(json["runs"][0]["d"], 0.023_45);
    assert!(json["runs"][0]["flicker"].is_number() && json["runs"][0]["mean_psnr_db"].is_number());
    assert!(text.contains("a &lt;lossy&gt; &amp; bursty link") && !text.contains("<lossy>"));
    assert!(!text.contains("NaN") && !text.contains("inf "));
    assert_eq!(html.matches("<img").count(), 4 * (1 + 2 * 4));
    for outside in ["http://", "https://", "<link", "src=\"//", "url("] {
        assert!(!html.contains(outside), "{outside} would ask the network");
    }
}

#[test]
fn gaps_print_as_dashes_and_stop_nothing() {
    let empty = Page {
        title: String::new(),
        machine: Machine { cpu: String::new(), cores: 0, device: None },
        protocol: Vec::new(),
        ledger: Ledger::default(),
        complete_psnr_db: Vec::new(),
        capacity_mbps: Vec::new(),
        runs: Vec::new(),
        strips: Vec::new(),
        notes: Vec::new(),
        damaged: false,
    };
    balanced(&html::page(&empty));

    let mut gaps = sample();
    gaps.strips.truncate(1);
    gaps.strips[0].shown[0] = Picture {
        caption: "x".into(),
        image: Image::default(),
        error: Some(Image::default()),
        psnr_db: Some(f64::NAN),
    };
    gaps.complete_psnr_db = vec![f64::NAN, f64::INFINITY];
    gaps.capacity_mbps = vec![(0.0, f64::NAN), (f64::NAN, 1.0)];
    gaps.ledger.payload = f64::NAN;
    gaps.ledger.shares[0].bits = f64::INFINITY;
    for run in &mut gaps.runs {
        run.mean_psnr_db = f64::NAN;
        run.flicker = f64::INFINITY;
        run.delivery.startup_ms = None;
        run.delivery.frames.truncate(1);
        run.frames.iter_mut().for_each(|f| (f.time_s, f.psnr_db) = (None, f64::NAN));
    }
    let html = html::page(&gaps);
    balanced(&html);
    let text = text(&html);
    assert!(text.contains("<td>—</td>") && text.contains("playout never started"));
    assert!(!text.contains("NaN") && !text.contains(">inf"));
}

#[test]
fn one_frame_and_equal_values_are_drawn() {
    let mut page = sample();
    page.runs.truncate(2);
    page.strips.clear();
    page.complete_psnr_db = vec![30.0];
    for run in &mut page.runs {
        run.frames.truncate(1);
        run.delivery.frames.truncate(1);
        run.delivery.frames[0] = FrameRow {
            time_ns: Nanos::ZERO,
            frame: 0,
            usable_bytes: 0,
            utility: 0.0,
            miss: 0.0,
            base_miss: 0.0,
        };
        run.frames[0].time_s = Some(0.0);
        run.frames[0].psnr_db = 30.0;
        (run.mean_psnr_db, run.mean_ssim) = (30.0, 1.0);
    }
    let html = html::page(&page);
    balanced(&html);
    assert!(!text(&html).contains("NaN"));
}
