//! Sweeps from the command line: the same bytes on any number of threads and shards, and after a kill.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    time::{Duration, Instant, SystemTime},
};

fn quick() -> String {
    Path::new("tests/sweeps/quick.toml").canonicalize().unwrap().to_str().unwrap().to_owned()
}

fn command(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
    command.args(args);
    command
}

fn ok(args: &[&str]) -> String {
    let Output { status, stdout, stderr } = command(args).output().unwrap();
    assert!(status.success(), "dgs {args:?}: {}", String::from_utf8_lossy(&stderr));
    String::from_utf8(stdout).unwrap()
}

fn refused(args: &[&str]) -> String {
    let output = command(args).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "dgs {args:?}");
    String::from_utf8(output.stderr).unwrap()
}

/// What was said, and on standard error, by a command that did not do all of it.
fn incomplete(args: &[&str]) -> (String, String) {
    let output = command(args).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "dgs {args:?}");
    (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
}

/// Every file of a folder of results by its name.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(at) = open.pop() {
        for entry in fs::read_dir(at).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                found.insert(path.strip_prefix(folder).unwrap().to_owned(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

fn at(folder: &tempfile::TempDir, name: &str) -> String {
    folder.path().join(name).to_str().unwrap().to_owned()
}

#[test]
fn threads_and_shards_change_no_byte() {
    let folder = tempfile::tempdir().unwrap();
    let (quick, one) = (quick(), at(&folder, "one"));
    let text = ok(&["sweep", &quick, "-o", &one, "--threads", "1"]);
    assert!(text.contains("72 simulations of 60 frames in 3 batches"), "{text}");
    assert!(text.contains("72 of 72 simulations took") && text.contains("deadline-utility"), "{text}");
    let expected = contents(Path::new(&one));
    assert_eq!(expected.len(), 1 + 2 * 3 + 2, "{:?}", expected.keys());
    let runs = String::from_utf8(expected[Path::new("runs.jsonl")].clone()).unwrap();
    assert_eq!(runs.lines().count(), 72);

    let four = at(&folder, "four");
    ok(&["sweep", &quick, "-o", &four, "--threads", "4"]);
    assert!(contents(Path::new(&four)) == expected, "four threads give other bytes");

    let shards: Vec<String> = (1..=3).map(|shard| at(&folder, &format!("shard{shard}"))).collect();
    for (number, shard) in (1..).zip(&shards) {
        let text = ok(&["sweep", &quick, "-o", shard, "--shard", &format!("{number}/3")]);
        assert!(text.contains("24 of 72 simulations took") && text.contains("no summary yet"), "{text}");
    }
    let merged = at(&folder, "merged");
    let text = incomplete(&["sweep", "merge", &shards[2], &shards[0], "-o", &merged]).0;
    assert!(text.contains("no summary yet: 1 batches are missing"), "{text}");
    ok(&["sweep", "merge", &shards[1], "-o", &merged]);
    assert!(contents(Path::new(&merged)) == expected, "merged shards give other bytes");

    // A batch that differs is named, not taken.
    let batch = Path::new(&shards[0]).join("runs/00000.jsonl");
    fs::write(&batch, fs::read_to_string(&batch).unwrap().replacen("layered", "Layered", 1)).unwrap();
    let error = refused(&["sweep", "merge", &shards[0], "-o", &merged]);
    assert!(error.contains("00000.jsonl") && error.contains("are the same batch and differ"), "{error}");
}

#[test]
fn a_batch_that_was_cut_is_made_again_or_named() {
    let folder = tempfile::tempdir().unwrap();
    let (quick, out) = (quick(), at(&folder, "out"));
    ok(&["sweep", &quick, "-o", &out]);
    let expected = contents(Path::new(&out));
    let cut = |name: &str| {
        fs::OpenOptions::new().write(true).open(Path::new(&out).join(name)).unwrap().set_len(1000)
    };
    cut("runs/00000.jsonl").unwrap();
    cut("trajectories/00001.parquet").unwrap();
    let text = ok(&["sweep", &quick, "-o", &out]);
    assert!(text.contains("1 of 3 batches of this share were there"), "{text}");
    assert!(text.contains("48 of 72 simulations took") && !text.contains("missing"), "{text}");
    assert!(contents(Path::new(&out)) == expected, "a batch that is made again has other bytes");

    // Lines that lack a quantity count as cut, too: made again here, refused by `merge`.
    let batch = Path::new(&out).join("runs/00001.jsonl");
    let lacking: String = fs::read_to_string(&batch)
        .unwrap()
        .lines()
        .map(|line| {
            let mut trial: serde_json::Value = serde_json::from_str(line).unwrap();
            assert!(trial.as_object_mut().unwrap().remove("positive_miss").unwrap().is_number());
            format!("{trial}\n")
        })
        .collect();
    fs::write(&batch, lacking).unwrap();
    let error = refused(&["sweep", "merge", &out, "-o", &at(&folder, "merged")]);
    assert!(
        error.contains("00001.jsonl: line 1: not a simulation") && error.contains("positive_miss"),
        "{error}"
    );
    let text = ok(&["sweep", &quick, "-o", &out]);
    assert!(text.contains("2 of 3 batches of this share were there"), "{text}");
    assert!(contents(Path::new(&out)) == expected, "a batch that is made again has other bytes");

    // A table that is not asked for is not made again either.
    cut("trajectories/00002.parquet").unwrap();
    let error = refused(&["sweep", &quick, "-o", &out, "--no-trajectories"]);
    assert!(
        error.contains("1 of 3 batches are not whole") && error.contains("00002.parquet: 1000 bytes"),
        "{error}"
    );
}

/// The quick design with one replicate over the trace `file`, as `name` in `folder`.
fn over_file(folder: &tempfile::TempDir, name: &str, file: &str) -> String {
    let config = at(folder, name);
    let text = fs::read_to_string(quick()).unwrap().replace("replicates = 3", "replicates = 2");
    fs::write(&config, text.replace("constant_mbps = 5.0", &format!("file = {file:?}"))).unwrap();
    config
}

#[test]
fn results_over_a_trace_that_has_changed_are_refused_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let config = over_file(&folder, "a.toml", "phone.columns");
    let trace = folder.path().join("phone.columns");
    let [one, two, merged] = ["one", "two", "merged"].map(|name| at(&folder, name));
    fs::write(&trace, "0 4\n1 6\n").unwrap();
    ok(&["sweep", &config, "-o", &one, "--shard", "1/2", "--no-trajectories"]);
    ok(&["sweep", &config, "-o", &one, "--shard", "1/2", "--no-trajectories"]);
    fs::write(&trace, "0 4\n1 8\n").unwrap();
    let error = refused(&["sweep", &config, "-o", &one]);
    assert!(error.contains("traces.txt: results over another phone.columns"), "{error}");
    ok(&["sweep", &config, "-o", &two, "--shard", "2/2"]);
    let error = refused(&["sweep", "merge", &one, &two, "-o", &merged]);
    assert!(error.contains("two: results over another phone.columns than"), "{error}");
    assert!(!Path::new(&merged).exists(), "nothing is made of refused results");

    // The right shards are merged without the trace; those without trajectories are said.
    fs::write(&trace, "0 4\n1 6\n").unwrap();
    fs::remove_dir_all(&two).unwrap();
    ok(&["sweep", &config, "-o", &two, "--shard", "2/2"]);
    fs::remove_file(&trace).unwrap();
    let output = command(&["sweep", "merge", &one, &two, "-o", &merged]).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(said.contains("1 of 2 batches have no trajectories"), "{said}");

    // A batch that is cut short is named by its own name.
    let batch = Path::new(&merged).join("runs/00000.jsonl");
    let lines = fs::read_to_string(&batch).unwrap();
    for (bytes, count) in [("", 0), (&lines[..=lines.find('\n').unwrap()], 1)] {
        fs::write(&batch, bytes).unwrap();
        let error = refused(&["sweep", "merge", &merged, "-o", &at(&folder, "again")]);
        assert!(error.contains(&format!("runs/00000.jsonl: {count} simulations, allowed are 24")), "{error}");
    }

    // Results without digests, as older ones are.
    fs::remove_file(Path::new(&one).join("traces.txt")).unwrap();
    let error = refused(&["sweep", "merge", &one, "-o", &at(&folder, "older")]);
    assert!(error.contains("traces.txt: is not there"), "{error}");
    fs::write(&trace, "0 4\n1 6\n").unwrap();
    let error = refused(&["sweep", &config, "-o", &one]);
    assert!(error.contains("traces.txt: is not there"), "{error}");
}

#[test]
fn a_killed_sweep_loses_nothing_that_was_finished() {
    let folder = tempfile::tempdir().unwrap();
    let config = at(&folder, "long.toml");
    let text = fs::read_to_string(quick()).unwrap().replace("replicates = 3", "replicates = 40");
    fs::write(&config, text).unwrap();
    let (killed, whole) = (at(&folder, "killed"), at(&folder, "whole"));
    let args = ["sweep", &config, "-o", &killed, "--threads", "1"];
    let runs = Path::new(&killed).join("runs");
    let finished = || -> Vec<PathBuf> {
        let Ok(entries) = fs::read_dir(&runs) else { return Vec::new() };
        let paths = entries.map(|entry| entry.unwrap().path());
        paths.filter(|path| path.extension().is_some_and(|extension| extension == "jsonl")).collect()
    };
    let mut left = 5;
    let cut = loop {
        let mut child = command(&args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let start = Instant::now();
        while finished().len() < 3 && child.try_wait().unwrap().is_none() {
            assert!(start.elapsed() < Duration::from_secs(300), "no batch was finished");
            std::thread::sleep(Duration::from_millis(2));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        let batches = finished();
        left -= 1;
        // A busy machine may let this process wait until all of them are there: then it begins again.
        if batches.len() < 40 || left == 0 {
            break batches;
        }
        fs::remove_dir_all(&killed).unwrap();
    };
    let written: Vec<(PathBuf, SystemTime)> = cut
        .into_iter()
        .map(|path| {
            let time = fs::metadata(&path).unwrap().modified().unwrap();
            (path, time)
        })
        .collect();
    assert!((3..40).contains(&written.len()), "{} of 40 batches were there", written.len());
    let said = ok(&["sweep", &config, "-o", &killed]);
    assert!(said.contains(&format!("{} of 40 batches of this share were there", written.len())), "{said}");
    for (path, time) in written {
        assert_eq!(fs::metadata(&path).unwrap().modified().unwrap(), time, "{path:?} was made again");
    }
    ok(&["sweep", &config, "-o", &whole]);
    let clean = |folder: &str| -> BTreeMap<PathBuf, Vec<u8>> {
        contents(Path::new(folder)).into_iter().filter(|(name, _)| !is_hidden(name)).collect()
    };
    assert!(clean(&killed) == clean(&whole), "a resumed sweep gives other bytes");
}

/// What a killed process leaves under a temporary name.
fn is_hidden(name: &Path) -> bool {
    name.file_name().unwrap().to_str().unwrap().starts_with('.')
}

#[test]
fn what_cannot_be_used_is_named_with_file_key_found_and_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let (config, out) = (at(&folder, "bad.toml"), at(&folder, "out"));
    let text = fs::read_to_string(quick()).unwrap();
    fs::write(&config, text.replace("delay_ms = 20", "delay_ms = 90000")).unwrap();
    let error = refused(&["sweep", &config, "-o", &out]);
    assert!(error.contains("bad.toml: link.delay_ms is 90000, allowed 0 to 60000"), "{error}");
    assert!(!Path::new(&out).exists(), "nothing is made of a refused configuration");
    fs::write(&config, "controllers = [").unwrap();
    let error = refused(&["sweep", &config, "-o", &out]);
    assert!(error.contains("bad.toml") && error.contains("line 1"), "{error}");
    let error = refused(&["sweep", &at(&folder, "none.toml"), "-o", &out]);
    assert!(error.contains("none.toml"), "{error}");

    ok(&["sweep", &quick(), "-o", &out, "--shard", "1/3", "--no-trajectories"]);
    fs::write(&config, text.replace("seed = 1", "seed = 2")).unwrap();
    let error = refused(&["sweep", &config, "-o", &out]);
    assert!(error.contains("sweep.toml: results of another configuration"), "{error}");
    let error = refused(&["sweep", "merge", folder.path().to_str().unwrap(), "-o", &out]);
    assert!(error.contains("no results of a sweep here"), "{error}");
}

/// Files called as those of a sweep, in a folder that is none's, stay as they are.
#[test]
fn files_that_are_not_of_a_sweep_are_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let (quick, shard) = (quick(), at(&folder, "shard"));
    ok(&["sweep", &quick, "-o", &shard, "--shard", "1/3", "--no-trajectories"]);
    for name in ["runs.jsonl", "summary.json"] {
        let other = at(&folder, name);
        fs::create_dir(&other).unwrap();
        fs::write(Path::new(&other).join(name), "as before").unwrap();
        let before = contents(Path::new(&other));
        for typed in [&["sweep", &quick, "-o", &other][..], &["sweep", "merge", &shard, "-o", &other]] {
            let error = refused(typed);
            assert!(error.contains(name) && error.contains("no sweep.toml beside it"), "{error}");
        }
        assert_eq!(contents(Path::new(&other)), before);
        assert_eq!(fs::read_dir(&other).unwrap().count(), 1, "no folder is made in it");
    }
}

/// The committed design is the paper's.
#[test]
fn the_papers_design_has_as_many_simulations_as_the_paper() {
    let text = fs::read_to_string("tests/sweeps/paper.toml").unwrap();
    let tables = |name: &str| text.lines().filter(|line| *line == format!("[[{name}]]")).count();
    assert_eq!((tables("conditions"), tables("traces")), (8, 7));
    assert!(text.contains("replicates = 100") && text.contains("frames = 151"));
    assert_eq!(2 * 4 * 8 * 7 * 100, 44_800);
}
