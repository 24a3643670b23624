//! What is committed in `dist/` was made from the sources that lie beside it.

#[path = "support/mod.rs"]
mod sources;

use std::{fs, path::Path};

fn folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn the_webassembly_is_that_of_the_sources() {
    let digest = sources::digest(&sources::root(folder())).unwrap();
    let noted = fs::read_to_string(folder().join("dist").join(sources::FILE)).unwrap();
    assert_eq!(
        noted.trim(),
        digest,
        "the sources have changed: cargo run -p dgs-viewer --features pack --bin pack-viewer"
    );
}

#[test]
fn comments_and_tests_change_nothing_and_code_does() {
    let lines = |text: &str| sources::code(text).map(str::to_owned).collect::<Vec<_>>();
    let text = "//! What.\n\nfn a() {}\n\n#[cfg(test)]\nmod tests {\n    fn b() {}\n}\n";
    assert_eq!(lines(text), ["fn a() {}"]);
    assert_eq!(lines("fn a() {}"), lines(text));
    assert_ne!(lines("fn a() { b() }"), lines(text));
}

#[test]
fn no_place_of_one_machine_is_in_it() {
    let wasm = fs::read(folder().join("dist").join("dgs_viewer_bg.wasm")).unwrap();
    let home = std::env::var("HOME").unwrap_or_default();
    let places = [sources::root(folder()).to_string_lossy().into_owned(), home];
    for place in places.iter().filter(|place| place.len() > 1) {
        assert!(!wasm.windows(place.len()).any(|found| found == place.as_bytes()), "{place}");
    }
}
