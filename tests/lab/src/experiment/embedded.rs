//! Measures the receiver on small targets, and checks that all of them decode to the same bits.
//!
//! One [`Fixture`] goes to a Cortex-M4F in QEMU, to WebAssembly under node (plain and with simd128) and
//! to a C program; their digests must be this host's. Flash, static memory, stack and instructions
//! are held to `codec-core/budget.toml`. The receiver must link without a panic, and with one
//! planted it must not. Needs the source tree; what is missing is reported absent by name.

mod budget;
mod elf;
mod tools;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use self::{
    budget::Budget,
    tools::{Lines, Tool},
};
use crate::{
    figures::{Bench, Figure},
    fixture::Fixture,
    setup::Setup,
};

const THUMB: &str = "thumbv7em-none-eabihf";
const WASM: &str = "wasm32-unknown-unknown";

/// Where things lie.
struct Place {
    /// Of the source tree.
    root: PathBuf,
    /// Of what is built here, apart from other builds.
    target: PathBuf,
    /// Of the fixture.
    fixture: PathBuf,
}

/// The bench as it grows, and what is wrong so far.
struct Report<'k> {
    bench: Bench,
    fixture: &'k Fixture,
    budget: Budget,
    wrong: Vec<String>,
}

impl Report<'_> {
    fn figure(&mut self, key: String, value: f64, unit: &str) {
        let mut figure = Figure::new(key.clone(), value, unit);
        if let Some(most) = self.budget.of(&key) {
            figure = figure.peer("budget", most, true);
            if value > most {
                self.wrong.push(format!("{key} is {value}; the budget is {most}"));
            }
        }
        self.bench.push(figure);
    }

    /// Takes what a target printed: its digest must be the host's.
    fn digest(&mut self, target: &str, lines: &Lines) -> Result<()> {
        let digest = lines.text("digest")?;
        let equal = digest == format!("{:016x}", self.fixture.answer.digest);
        self.bench.push(Figure::new(format!("{target}.digest_equals_host"), f64::from(equal), digest));
        let counters = self.fixture.answer.counters;
        for (key, wanted) in [
            ("count.media", counters.media),
            ("count.parity", counters.parity),
            ("count.recovered", counters.recovered),
        ] {
            let found = lines.number(key)?;
            if found != f64::from(wanted) {
                self.wrong.push(format!("{target}: {key} is {found}, on the host {wanted}"));
            }
        }
        if !equal {
            let host = self.fixture.answer.digest;
            self.wrong.push(format!("{target} gives digest {digest}, the host {host:016x}"));
        }
        Ok(())
    }

    /// Whether `tools` are all here; those that are not are reported.
    fn has(&mut self, what: &str, tools: &[Tool<'_>]) -> bool {
        let absent: Vec<String> = tools.iter().filter_map(Tool::absent).collect();
        for name in &absent {
            self.bench.skipped.push(format!("{what}: {name} is absent"));
        }
        absent.is_empty()
    }
}

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let mut bench = Bench::new(
        "embedded",
        "1,000 Gaussians, 24 frames, two windows; packets shuffled, two lost and repaired, one lost for \
            good, one \
         doubled, one damaged; five frames decoded. thumbv7em: QEMU mps2-an386 with icount, instructions, \
         not cycles; \
         opt-level 2, fat LTO; flash and static RAM are those of the receiver alone, no stream in it",
    );
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    if !root.join("codec-core/embedded/Cargo.toml").is_file() {
        bench.skipped.push("the source tree is absent".into());
        return Ok(bench);
    }
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    let target = std::path::absolute(target)?.join("embedded");
    let place = Place { root, fixture: target.join("fixture"), target };
    let fixture = Fixture::make()?;
    fixture
        .write(&place.fixture)
        .with_context(|| format!("{}: cannot write the fixture", place.fixture.display()))?;
    let budget = Budget::read(&place.root.join("codec-core/budget.toml"))?;
    let host = format!("{:016x}", fixture.answer.digest);
    let mut report = Report { bench, fixture: &fixture, budget, wrong: Vec::new() };
    report.bench.push(Figure::new("host.digest_equals_host", 1.0, &host));
    if report.has("the host's other targets", &[Tool::Program("cargo")]) {
        c(&place, &mut report)?;
        wasm(&place, &mut report, setup.quick)?;
        thumb(&place, &mut report)?;
    }
    if !report.wrong.is_empty() {
        bail!("{}\n{}", report.wrong.join("\n"), report.bench.table());
    }
    Ok(report.bench)
}

/// Frames to show, as arguments.
fn frames(fixture: &Fixture) -> Vec<String> {
    fixture.frames.iter().map(u32::to_string).collect()
}

/// A C program linked with the static library.
fn c(place: &Place, report: &mut Report<'_>) -> Result<()> {
    if !report.has("C", &[Tool::Program("cc")]) {
        return Ok(());
    }
    let library = tools::cargo(&place.root, &place.target)
        .args(["rustc", "-p", "codec-capi", "--profile", "small", "--crate-type", "staticlib"])
        .run()?;
    library.success("cargo rustc -p codec-capi")?;
    let folder = place.root.join("codec-core/capi");
    let program = place.target.join("decode-c");
    tools::program("cc")
        .args(["-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Werror", "-I"])
        .arg(folder.join("include"))
        .arg(folder.join("tests/decode.c"))
        .arg(place.target.join("small/libcodec_capi.a"))
        .args(["-lpthread", "-lm", "-ldl", "-o"])
        .arg(&program)
        .run()?
        .success("cc decode.c")?;
    let output = tools::program(&program)
        .arg(place.fixture.join("manifest.dgsm"))
        .arg(place.fixture.join("packets.bin"))
        .args(frames(report.fixture))
        .run()?;
    output.success("the C program")?;
    let lines = output.lines();
    report.digest("c", &lines)?;
    report.figure("c.block_bytes".into(), lines.number("block_bytes")?, "B");
    Ok(())
}

/// The C ABI as a WebAssembly module under node: the smallest, without `paper-context`.
fn wasm(place: &Place, report: &mut Report<'_>, quick: bool) -> Result<()> {
    if !report.has(WASM, &[Tool::Target(WASM), Tool::Program("node")]) {
        return Ok(());
    }
    for (name, flags, folder) in
        [("wasm32", "", "embedded-plain"), ("wasm32_simd128", "-Ctarget-feature=+simd128", "embedded-simd")]
    {
        let target = place.target.join(folder);
        tools::cargo(&place.root, &target)
            .env("CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_RUSTFLAGS", flags)
            .args([
                "rustc",
                "-p",
                "codec-capi",
                "--profile",
                "small",
                "--no-default-features",
                "--features",
                "panic-handler",
                "--crate-type",
                "cdylib",
                "--target",
                WASM,
            ])
            .run()?
            .success(name)?;
        let output = tools::program("node")
            .arg(place.root.join("codec-core/capi/tests/decode.mjs"))
            .arg(target.join(WASM).join("small/codec_capi.wasm"))
            .arg(place.fixture.join("manifest.dgsm"))
            .arg(place.fixture.join("packets.bin"))
            .arg(if quick { "3" } else { "15" })
            .args(frames(report.fixture))
            .run()?;
        output.success("decode.mjs")?;
        let lines = output.lines();
        report.digest(name, &lines)?;
        report.figure(format!("{name}.module_bytes"), lines.number("module_bytes")?, "B");
        // `Report::digest` has compared every bit; a difference fails the bench.
        let frame =
            Figure::new(format!("{name}.frame_ms"), lines.number("frame_ms")?, "ms per 1,000 Gaussians");
        report.bench.push(frame.error(0.0, "digests differ from the host's, else the bench fails"));
    }
    Ok(())
}

/// The Cortex-M4F: panic link test, sizes, and a run in QEMU.
fn thumb(place: &Place, report: &mut Report<'_>) -> Result<()> {
    if !report.has(THUMB, &[Tool::Target(THUMB)]) {
        return Ok(());
    }
    let folder = place.root.join("codec-core/embedded");
    let build_with = |binary: &str, features: &str| {
        tools::cargo(&folder, &place.target)
            .env("DGS_FIXTURE", &place.fixture)
            .args(["build", "--release", "--target", THUMB, "--bin", binary, "--features", features])
            .run()
    };
    let build = |binary: &str| build_with(binary, "");
    let binary = |name: &str| place.target.join(THUMB).join("release").join(name);
    // Last the one without `paper-context`: its sizes are held to the budget.
    for (name, features) in
        [("links_without_panic_paper_context", "paper-context"), ("links_without_panic", "")]
    {
        let panicless = build_with("panicless", features)?;
        report.figure(format!("thumbv7em.{name}"), f64::from(panicless.is_success()), "1 = yes");
        panicless.success("the panic link test: a panic can be reached, or the receiver does not build")?;
    }
    let planted = build("planted")?;
    let found = !planted.is_success() && planted.errors.contains("undefined symbol: a_panic_can_be_reached");
    report.figure("thumbv7em.planted_panic_found".into(), f64::from(found), "1 = yes");
    if !found {
        report.wrong.push(format!("a planted panic is not found by the linker: {}", planted.errors));
    }
    let sections = elf::Sizes::of(&std::fs::read(binary("panicless"))?).context("panicless")?;
    report.figure("thumbv7em.flash_bytes".into(), sections.flash as f64, "B");
    report.figure("thumbv7em.static_ram_bytes".into(), sections.ram as f64, "B");
    for size in report.fixture.sizes()?.into_iter().filter(|s| s.bytes > 0) {
        let key = format!("thumbv7em.static_ram.{}", size.name.to_lowercase());
        report.figure(key, size.bytes as f64, "B");
    }
    build("receive")?.success("cargo build --bin receive")?;
    if !report.has(THUMB, &[Tool::Program("qemu-system-arm")]) {
        return Ok(());
    }
    let output = tools::program("qemu-system-arm")
        .args(["-machine", "mps2-an386", "-cpu", "cortex-m4", "-nographic", "-icount", "shift=0"])
        .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
        .arg(binary("receive"))
        .run()?;
    let lines = output.lines();
    report.digest("thumbv7em", &lines)?;
    output.success("qemu-system-arm")?;
    run_figures(report, &lines)
}

/// Stack and instructions of a run on the Cortex-M4F.
fn run_figures(report: &mut Report<'_>, lines: &Lines) -> Result<()> {
    let mut deepest = 0f64;
    for law in &report.fixture.bodies {
        let number = |what: &str| lines.number(&format!("{}.{what}", law.name));
        let bits = 8.0 * law.bytes.len() as f64 / law.symbols.len() as f64;
        let unit = format!("instructions/symbol at {bits:.2} bit");
        for form in ["slots", "compact"] {
            let key = format!("thumbv7em.{}.{form}", law.name);
            let per_symbol = number(&format!("{form}.instructions"))? / number("symbols")?;
            deepest = deepest.max(number(&format!("{form}.stack"))?);
            report.figure(key.clone(), per_symbol, &unit);
            report.figure(format!("{key}_fill"), number(&format!("{form}.fill"))?, "instructions");
        }
    }
    report.figure("thumbv7em.stack.coder_bytes".into(), deepest, "B");
    for phase in ["control", "media", "frame"] {
        report.figure(
            format!("thumbv7em.stack.{phase}_bytes"),
            lines.number(&format!("{phase}.stack"))?,
            "B, callees included",
        );
    }
    let packets: usize = report.fixture.arrivals.iter().map(Vec::len).sum();
    for (key, phase, per, unit) in [
        ("control.per_byte", "control", report.fixture.message().len(), "instructions/byte of manifest"),
        ("media.per_byte", "media", packets, "instructions/byte of packet"),
    ] {
        let value = lines.number(&format!("{phase}.instructions"))? / per as f64;
        report.figure(format!("thumbv7em.{key}"), value, unit);
    }
    let per = lines.number("frame.instructions")? / lines.number("frame.gaussians")?;
    report.figure("thumbv7em.frame.per_gaussian".into(), per, "instructions/Gaussian and frame");
    Ok(())
}
