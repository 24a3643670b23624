//! `--device`: the graphics device shows what the processor shows, and what is missing is named.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

use std::{
    path::Path,
    process::{Command, Output},
};

use render_host::{Backend, Image};

/// Share of 8-bit channels that may differ by more than one step: where rounding decides about a cut-off.
const NEAR_CUTOFFS: f64 = 0.005;

/// `dgs render` of a small scene to `out`, with `more` options and environment.
fn render(out: &Path, more: &[&str], environment: &[(&str, &str)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
    command.args(["render", "synth:figure:1500:2", "--width", "96", "--height", "80", "--out"]).arg(out);
    command.args(more).env_remove("DGS_GPU").envs(environment.iter().copied());
    command.output().unwrap()
}

/// The channels of `a` and `b` that differ by more than one step of 8 bits, as a share of all.
fn differing(a: &Image, b: &Image) -> f64 {
    assert_eq!((a.width(), a.height()), (b.width(), b.height()));
    let far = a.rgb().iter().zip(b.rgb()).filter(|(a, b)| (*a - *b).abs() > 1.5 / 255.0).count();
    far as f64 / a.rgb().len() as f64
}

fn read(path: &Path) -> Image {
    Image::read(path, [0.0; 3]).unwrap()
}

#[test]
fn a_device_shows_what_the_processor_shows() {
    let folder = tempfile::tempdir().unwrap();
    let [cpu, gpu, auto] = ["cpu.png", "gpu.png", "auto.png"].map(|name| folder.path().join(name));
    for (out, device) in [(&cpu, "cpu"), (&auto, "auto")] {
        let output = render(out, &["--device", device], &[]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let output = render(&gpu, &["--device", "gpu", "--json"], &[]);
    let errors = String::from_utf8_lossy(&output.stderr);
    if !Backend::HAS_GPU {
        assert!(!output.status.success() && errors.contains("--features gpu"), "{errors}");
        assert_eq!(std::fs::read(&cpu).unwrap(), std::fs::read(&auto).unwrap());
        return;
    }
    if errors.contains("no graphics adapter") {
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "{errors}");
        eprintln!("SKIPPED: {errors}");
        return;
    }
    assert!(output.status.success(), "{errors}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_ne!(report["device"], "cpu");
    let (on_cpu, on_gpu) = (read(&cpu), read(&gpu));
    assert!(differing(&on_cpu, &on_gpu) <= NEAR_CUTOFFS);
    assert!(differing(&on_cpu, &read(&auto)) <= NEAR_CUTOFFS);
    // The comparison sees another picture.
    let another = folder.path().join("another.png");
    assert!(render(&another, &["--camera", "1"], &[]).status.success());
    assert!(differing(&on_cpu, &read(&another)) > NEAR_CUTOFFS);
}

#[test]
fn a_device_that_is_not_there_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("none.png");
    let environment = [("DGS_GPU", "no adapter of this name")];
    let output = render(&out, &["--device", "gpu"], &environment);
    let errors = String::from_utf8_lossy(&output.stderr);
    let named = if Backend::HAS_GPU { "no adapter of this name" } else { "--features gpu" };
    assert!(!output.status.success() && errors.contains(named), "{errors}");
    assert!(!out.exists());
    // Where a device is only preferred, the processor does it.
    assert!(render(&out, &["--device", "auto"], &environment).status.success() && out.exists());
    let output = render(&out, &["--device", "tpu"], &[]);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && errors.contains("cpu, gpu, auto"), "{errors}");
}

/// Bytes of a small scene encoded to `out` as fine as `fineness` says, with `more` options; or what was said.
fn encoded(out: &Path, fineness: [&str; 2], more: &[&str]) -> Result<Vec<u8>, String> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
    command.args(["encode", "synth:figure:1500:2", "--out"]).arg(out).args(fineness);
    let output = command.args(more).env_remove("DGS_GPU").output().unwrap();
    match output.status.success() {
        true => Ok(std::fs::read(out).unwrap()),
        false => Err(String::from_utf8_lossy(&output.stderr).into_owned()),
    }
}

#[test]
fn an_encoding_chosen_on_a_device_is_nearly_that_chosen_on_the_processor() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.dgs");
    let steps = ["--coarseness", "1.5"];
    let cpu = encoded(&out, steps, &[]).unwrap();
    assert_eq!(encoded(&out, steps, &["--device", "cpu"]).unwrap(), cpu);
    let gpu = match encoded(&out, steps, &["--device", "gpu"]) {
        Ok(bytes) => bytes,
        Err(error) if !Backend::HAS_GPU => return assert!(error.contains("--features gpu"), "{error}"),
        Err(error) => {
            assert!(error.contains("no graphics adapter"), "{error}");
            assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "{error}");
            eprintln!("SKIPPED: {error}");
            return;
        }
    };
    let off = |bytes: &[u8], cpu: &[u8]| (bytes.len() as f64 / cpu.len() as f64 - 1.0).abs();
    assert!(off(&gpu, &cpu) < 0.002, "{} {}", gpu.len(), cpu.len());
    // A target is met within a third of a dB, by which bytes differ the more.
    let [target, lower] = [["--target-psnr", "40"], ["--target-psnr", "36"]];
    let cpu = encoded(&out, target, &[]).unwrap();
    let gpu = encoded(&out, target, &["--device", "gpu"]).unwrap();
    assert!(off(&gpu, &cpu) < 0.05, "{} {}", gpu.len(), cpu.len());
    assert!(off(&encoded(&out, lower, &[]).unwrap(), &cpu) > 0.1);
}
