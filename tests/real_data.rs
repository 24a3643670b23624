//! Real scenes and traces through the whole walk. Where the data folder is missing this says so;
//! with `DGS_REQUIRE_DATA=1` that is a failure.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

use std::path::PathBuf;

use clap::Parser;
use dgs::{
    args::{Cli, Verb},
    command,
    pipeline::Quiet,
};

fn data(path: &str) -> Option<PathBuf> {
    let found = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(path);
    if found.exists() {
        return Some(found);
    }
    assert!(
        std::env::var("DGS_REQUIRE_DATA").is_err_and(|_| true)
            || std::env::var("DGS_REQUIRE_DATA").unwrap() != "1",
        "{path} is missing and DGS_REQUIRE_DATA=1"
    );
    println!("SKIPPED: {path} is not here");
    None
}

#[test]
fn a_real_clip_over_a_real_trace() {
    let Some(scene) = data("scenes/gltf-fox/Fox.glb") else { return };
    let Some(trace) = data("traces/ucc5g/driving/B_2020.01.16_07.26.43.csv") else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let typed = [
        "dgs",
        "demo",
        "--scene",
        scene.to_str().unwrap(),
        "--trace",
        trace.to_str().unwrap(),
        "--out",
        out,
        "--samples",
        "3000",
        "--clip",
        "Run",
        "--width",
        "96",
        "--height",
        "96",
        "--contexts",
        "1",
    ];
    let Ok(Cli { verb: Verb::Demo(args), .. }) = Cli::try_parse_from(typed) else { panic!("not a demo") };
    let page = command::demo_page(&args, Quiet(true)).unwrap();
    assert_eq!(page.runs.len(), 4);
    assert!(page.notes.iter().any(|n| n.contains("ping")), "{:?}", page.notes);
    // The complete state is what limits quality, not the codec.
    let worst = page.complete_psnr_db.iter().copied().fold(f64::MAX, f64::min);
    assert!(worst > 35.0, "worst complete frame {worst} dB");
    for run in &page.runs {
        assert_eq!(run.frames.len(), page.complete_psnr_db.len());
        assert!(
            run.mean_psnr_db <= page.complete_psnr_db.iter().sum::<f64>() / run.frames.len() as f64 + 0.1
        );
    }
}

/// What a stream is decoded to lies in the middle of two steps of `.4dgs` here and there.
#[test]
fn a_decoded_clip_is_written_as_4dgs() {
    let Some(scene) = data("scenes/gltf-fox/Fox.glb") else { return };
    let folder = tempfile::tempdir().unwrap();
    let scene = scene.canonicalize().unwrap();
    let encode = [
        "encode",
        scene.to_str().unwrap(),
        "-o",
        "fox.dgs",
        "--samples",
        "3000",
        "--clip",
        "Run",
        "--pictures",
        "0",
    ];
    for args in [&encode[..], &["convert", "fox.dgs", "fox.4dgs", "--frames", "0..1"]] {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_dgs"));
        let output = command.current_dir(folder.path()).args(args).output().unwrap();
        assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    }
}
