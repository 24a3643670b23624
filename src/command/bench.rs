//! Runs the laboratory, package `dgs-lab`, with what was typed after `dgs bench`.
//!
//! In the source tree cargo builds it first, so that figures are those of the code at hand; an installed
//! `dgs` runs the `dgs-lab` beside it.

use std::{
    ffi::OsString,
    path::Path,
    process::{Command, ExitCode},
};

use anyhow::{Context, Result, bail};

use crate::{args::Bench, output};

/// Runs the verb; its exit status is the laboratory's.
pub fn run(args: &Bench, json: bool) -> Result<ExitCode> {
    let program = std::env::current_exe().context("bench: where this program lies is not known")?;
    let mut command = laboratory(&program)?;
    command.args(typed(args, json));
    let status = command.status().with_context(|| {
        let name = Path::new(command.get_program());
        format!("bench: {} does not start", name.display())
    })?;
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    Ok(ExitCode::from(code.unwrap_or(1)))
}

/// How to start the laboratory that belongs to `program`.
fn laboratory(program: &Path) -> Result<Command> {
    let tree = program.ancestors().skip(1).find(|folder| folder.join("tests/lab/Cargo.toml").is_file());
    if let Some(root) = tree {
        output::print_status(
            "bench: cargo builds the laboratory first (profile dist); once, that takes minutes",
        );
        let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo.args(["run", "--quiet", "--profile", "dist", "--package", "dgs-lab", "--manifest-path"]);
        cargo.arg(root.join("Cargo.toml")).arg("--");
        return Ok(cargo);
    }
    let beside = program.with_file_name(format!("dgs-lab{}", std::env::consts::EXE_SUFFIX));
    if !beside.is_file() {
        bail!(
            "bench: the laboratory is not installed: no {}; in the source tree \
             `cargo run --profile dist --package dgs-lab -- NAME` runs it",
            beside.display()
        );
    }
    Ok(Command::new(beside))
}

/// The arguments of the laboratory, which are those of the verb.
fn typed(args: &Bench, json: bool) -> Vec<OsString> {
    let mut typed = Vec::new();
    for (flag, on) in [("--list", args.list), ("--quick", args.quick), ("--json", json)] {
        if on {
            typed.push(flag.into());
        }
    }
    for (option, folder) in [("--data", &args.data), ("--out", &args.out), ("--lpips", &args.lpips)] {
        if let Some(folder) = folder {
            typed.extend([option.into(), folder.into()]);
        }
    }
    if let Some(states) = args.perceptual_states {
        typed.extend(["--perceptual-states".into(), states.to_string().into()]);
    }
    if let Some(only) = &args.only {
        // One argument, so that a name that begins with a dash is none of another option.
        typed.push(format!("--only={only}").into());
    }
    if let Some(name) = &args.name {
        typed.extend(["--".into(), name.into()]);
    }
    typed
}
