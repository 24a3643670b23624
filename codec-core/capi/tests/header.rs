//! `include/dgs.h` says what the Rust sources say: it is written from them and compared.
//!
//! `cargo test -p codec-capi --test header -- --ignored` writes it anew. The reader knows as much
//! Rust as `src/types.rs` and `src/ffi.rs` use, formatted by rustfmt, and refuses the rest.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test's helpers fail like tests")]

use std::{fmt::Write, path::PathBuf};

const TOP: &str = "\
/* Player of dynamic Gaussian splat streams (dgs): packets in, Gaussians out.
 *
 * Written from src/types.rs and src/ffi.rs by tests/header.rs: do not edit.
 *
 * Memory   One block per player, the caller's: dgs_memory_bytes says how large one is that holds every
 *          stream within caps, dgs_required what one stream needs. dgs_open makes a player in the block,
 *          which stays where it is, touched by nobody else, until dgs_close. Nothing is allocated.
 * Pointers are used during the call only, the block excepted. dgs_error.field is a constant; what
 *          dgs_frame points to lies in the block and is good until the next call with the player.
 * Streams  Those of the profile paper-context are played by libraries with the feature of that name, which
 *          is on by default; others refuse them with DGS_UNKNOWN.
 * Threads  A player may move between threads; no two calls with one player at once.
 * Errors   Calls return DGS_OK or another status and fill *error, which may be NULL. Pointers that are
 *          null or misaligned, buffers that are short or overlap the block are refused (DGS_MISUSE, and
 *          no *error, where it is error itself that is misaligned or overlaps); lengths that lie cannot
 *          be. A refused packet leaves the player usable.
 */
#ifndef DGS_H
#define DGS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern \"C\" {
#endif
";

const BOTTOM: &str = "
#ifdef __cplusplus
}
#endif

#endif
";

fn source(name: &str) -> String {
    std::fs::read_to_string(PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("src").join(name)).unwrap()
}

/// `CamelCase` to `snake_case`.
fn snake(name: &str) -> String {
    let mut out = String::new();
    for c in name.chars() {
        if c.is_ascii_uppercase() && !out.is_empty() {
            out.push('_');
        }
        out.push(c.to_ascii_lowercase());
    }
    out
}

/// A C declaration of `name` with the Rust type `kind`.
fn declare(kind: &str, name: &str) -> String {
    if let Some(inner) = kind.strip_prefix("*const ") {
        return declare(inner, "").trim_end().to_owned() + " const *" + name;
    }
    if let Some(inner) = kind.strip_prefix("*mut ") {
        let inner = declare(inner, "");
        let space = if inner.trim_end().ends_with('*') { "" } else { " " };
        return format!("{}{space}*{name}", inner.trim_end());
    }
    if let Some((inner, len)) = kind.strip_prefix('[').and_then(|k| k.strip_suffix(']')?.split_once("; ")) {
        return format!("{}[{len}]", declare(inner, name));
    }
    let plain = match kind {
        "u8" => "uint8_t",
        "u32" => "uint32_t",
        "u64" => "uint64_t",
        "i32" => "int32_t",
        "usize" => "size_t",
        "f32" => "float",
        "c_void" => "void",
        other if other.starts_with("Dgs") => return format!("{} {name}", snake(other)),
        other => panic!("{other} has no C type here"),
    };
    format!("{plain} {name}")
}

fn comment(lines: &[&str], indent: &str) -> String {
    let text = lines.join(&format!("\n{indent} * ")).replace('`', "");
    let text = text.replace("[DGS_", "DGS_");
    if text.is_empty() { String::new() } else { format!("{indent}/* {text} */\n") }
}

/// Doc lines and the item that follows each, joined to one line up to its brace or semicolon.
fn items(source: &str) -> Vec<(Vec<&str>, Vec<&str>)> {
    let mut found = Vec::new();
    let (mut docs, mut lines) = (Vec::new(), source.lines());
    while let Some(line) = lines.next() {
        if let Some(doc) = line.strip_prefix("///") {
            docs.push(doc.trim());
        } else if line.starts_with("#[") {
        } else if line.starts_with("pub ") {
            let mut body = vec![line];
            // A struct ends at its brace, an argument list at its bracket; the rest is one line.
            let is_whole = line.ends_with(';') || line.contains(')');
            while !is_whole && !body.last().unwrap().starts_with(['}', ')']) {
                body.push(lines.next().unwrap());
            }
            found.push((std::mem::take(&mut docs), body));
        } else {
            docs.clear();
        }
    }
    found
}

fn header() -> String {
    let mut out = String::from(TOP);
    let (types, functions) = (source("types.rs"), source("ffi.rs"));
    out.push('\n');
    for (docs, body) in items(&types) {
        if let Some(rest) = body[0].strip_prefix("pub const ") {
            let (name, rest) = rest.split_once(": ").unwrap();
            let value = rest.split_once(" = ").unwrap().1.trim_end_matches(';').replace('_', "");
            let value = if value.len() > 11 { format!("UINT64_C({value})") } else { value };
            let mark = if rest.starts_with("u32") { "u" } else { "" };
            writeln!(out, "{}#define {name} {value}{mark}", comment(&docs, "")).unwrap();
        } else if let Some(name) = body[0].strip_prefix("pub struct ") {
            let name = snake(name.trim_end_matches(" {"));
            writeln!(out, "\n{}typedef struct {name} {{", comment(&docs, "")).unwrap();
            let mut docs = Vec::new();
            for line in &body[1..body.len() - 1] {
                let line = line.trim();
                if let Some(doc) = line.strip_prefix("///") {
                    docs.push(doc.trim());
                } else {
                    let (field, kind) =
                        line.trim_start_matches("pub ").trim_end_matches(',').split_once(": ").unwrap();
                    writeln!(out, "{}    {};", comment(&docs, "    "), declare(kind, field)).unwrap();
                    docs.clear();
                }
            }
            writeln!(out, "}} {name};").unwrap();
        } else {
            panic!("{} has no C form here", body[0]);
        }
    }
    for (docs, body) in items(&functions) {
        let text = body.iter().map(|l| l.trim()).collect::<Vec<_>>().join(" ");
        if text.starts_with("pub struct DgsPlayer ") {
            writeln!(out, "\n{}typedef struct dgs_player dgs_player;", comment(&docs, "")).unwrap();
            continue;
        }
        let (_, rest) = text.split_once("extern \"C\" fn ").unwrap();
        let (name, rest) = rest.split_once('(').unwrap();
        let (arguments, result) = rest.rsplit_once(')').unwrap();
        let arguments: Vec<String> = arguments
            .split(", ")
            .map(|a| a.trim().trim_end_matches(','))
            .filter(|a| !a.is_empty())
            .map(|a| a.split_once(": ").map(|(name, kind)| declare(kind, name)).unwrap())
            .collect();
        let arguments = if arguments.is_empty() { "void".to_owned() } else { arguments.join(", ") };
        let result = result.trim().trim_start_matches("-> ").trim_end_matches('{').trim();
        let result =
            if result.is_empty() { "void".to_owned() } else { declare(result, "").trim().to_owned() };
        writeln!(out, "\n{}{result} {name}({arguments});", comment(&docs, "")).unwrap();
    }
    out.push_str(BOTTOM);
    out
}

fn path() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("include/dgs.h")
}

#[test]
fn the_header_is_what_the_sources_say() {
    let committed = std::fs::read_to_string(path()).unwrap();
    let (found, wanted) = (committed.lines(), header());
    for (i, (found, wanted)) in found.zip(wanted.lines()).enumerate() {
        assert_eq!(found, wanted, "include/dgs.h:{}: write it anew (see the top of this file)", i + 1);
    }
    assert_eq!(committed.len(), wanted.len());
}

#[test]
fn declarations_are_written_as_c_writes_them() {
    for (kind, wanted) in [
        ("u32", "uint32_t x"),
        ("*const u8", "uint8_t const *x"),
        ("*mut c_void", "void *x"),
        ("*mut *mut DgsPlayer", "dgs_player **x"),
        ("[f32; 3]", "float x[3]"),
        ("[u32; DGS_REFUSALS]", "uint32_t x[DGS_REFUSALS]"),
    ] {
        assert_eq!(declare(kind, "x"), wanted);
    }
    let every = header();
    for function in source("ffi.rs").split("extern \"C\" fn ").skip(1) {
        let name = function.split('(').next().unwrap();
        assert!(every.contains(&format!(" {name}(")), "{name} is declared");
    }
}

#[test]
#[ignore = "writes include/dgs.h"]
fn write_the_header() {
    std::fs::write(path(), header()).unwrap();
}
