//! `fuzz` knows **lies**: plain functions that take any bytes and hold every parser to its promises.
//!
//! A body never fails on bad input; it fails (by assertion) when code under test panics, accepts
//! what it cannot write back, depends on the order of arrival, or decodes to something that cannot
//! be drawn. [`TARGETS`] names them all. `fuzz_targets/NAME.rs` is one line per body, for
//! `CARGO_PROFILE_RELEASE_LTO=off cargo +nightly fuzz run NAME`. `tests/replay.rs` runs the
//! committed `corpus/NAME/` and thousands of seeded mutations of it on stable.
//! `cargo test -p fuzz --test seed -- --ignored` writes the corpus anew.
//!
//! CRCs are made to fit inside the bodies, of archives too, so that a fuzzer gets behind the door.
//!
//! Two bodies compare ways to the same place: `receiver` any order of arrival with another, `sliced` a
//! scene cut into small packets with the same in large ones. Kernels that differ by machine belong
//! beside `lanes`, against its slow twin.
//!
//! Deliberately absent: allocation limits of the process (the fuzzer's `-rss_limit_mb` has them)
//! and anything that needs a file.

mod coding;
mod control;
mod forged;
mod imports;
mod input;
mod parity;
mod seal;
mod session;
mod streams;
mod traces;
mod wire;

pub use coding::{bytes, lanes, pack, tables};
pub use control::control;
pub use forged::forged;
pub use imports::{
    compressed_ply, deformation, dynamic_npz, fourdgs, gltf, gltf_splats, ksplat, ply, points_npz, sog,
    splat, splatv, spz, unity, unity_planes,
};
pub use parity::{cauchy, repair};
pub use session::{closure, decode, receiver, sliced, slices};
pub use streams::{fixture, small};
pub use traces::trace;
pub use wire::{file, manifest, packet, receipt};

/// A fuzz body.
pub type Body = fn(&[u8]);

/// All bodies by name: wire, control, coding, session, imports, traces.
pub const TARGETS: [(&str, Body); 32] = [
    ("packet", packet),
    ("manifest", manifest),
    ("receipt", receipt),
    ("control", control),
    ("file", file),
    ("tables", tables),
    ("lanes", lanes),
    ("bytes", bytes),
    ("pack", pack),
    ("slices", slices),
    ("sliced", sliced),
    ("decode", decode),
    ("repair", repair),
    ("cauchy", cauchy),
    ("closure", closure),
    ("receiver", receiver),
    ("forged", forged),
    ("ply", ply),
    ("compressed_ply", compressed_ply),
    ("spz", spz),
    ("splat", splat),
    ("sog", sog),
    ("points_npz", points_npz),
    ("gltf", gltf),
    ("gltf_splats", gltf_splats),
    ("ksplat", ksplat),
    ("splatv", splatv),
    ("fourdgs", fourdgs),
    ("dynamic_npz", dynamic_npz),
    ("deformation", deformation),
    ("unity", unity),
    ("trace", trace),
];
