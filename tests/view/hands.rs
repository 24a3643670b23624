//! What a hand does: fingers on the picture, a file dropped on the page.

use std::path::Path;

use super::{MESSAGE, PAGE_TIMEOUT_S, Page, SIDE};

/// A stream that is committed: its pictures are those of the format's conformance.
const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/codec-core/tests/conformance/everything.dgs");

/// Azimuth, elevation, distance, target.
fn view(page: &mut Page) -> Vec<f64> {
    page.run("player.view").as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

#[test]
fn one_finger_turns_and_two_pan_and_pinch() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=0.25", SIDE / 4) else {
        return;
    };
    let start = view(&mut page);
    page.browser.touch(&[&[[100.0, 60.0]], &[[120.0, 70.0]], &[[140.0, 80.0]]]).unwrap();
    let turned = view(&mut page);
    assert!(turned[0] != start[0] && turned[1] != start[1] && turned[2..] == start[2..], "{turned:?}");
    // Twice as far apart is twice as near.
    page.browser.touch(&[&[[100.0, 60.0], [140.0, 60.0]], &[[80.0, 60.0], [160.0, 60.0]]]).unwrap();
    let pinched = view(&mut page);
    assert!((2.0 * pinched[2] / turned[2] - 1.0).abs() < 1e-6, "{pinched:?} after {turned:?}");
    assert_eq!(pinched[..2], turned[..2]);
    // Side by side they pan.
    page.browser.touch(&[&[[100.0, 60.0], [140.0, 60.0]], &[[120.0, 80.0], [160.0, 80.0]]]).unwrap();
    let panned = view(&mut page);
    assert!((panned[2] / pinched[2] - 1.0).abs() < 1e-6, "{panned:?} after {pinched:?}");
    assert!(panned[..2] == pinched[..2] && panned[3..] != pinched[3..], "{panned:?}");
    page.close();
}

/// Drops the file at `path` until `condition` holds.
fn drop_until(page: &mut Page, path: &Path, condition: &str) {
    for _ in 0..PAGE_TIMEOUT_S {
        page.browser.drop_file([128.0, 100.0], path).unwrap();
        // A busy page takes a drop some time later, and another where none came.
        if page.browser.wait(5, condition).is_ok() {
            return;
        }
    }
    panic!("after {PAGE_TIMEOUT_S} drops still not: {condition}");
}

#[test]
fn a_file_that_is_dropped_is_played() {
    let Some(mut page) = Page::blank() else { return };
    let folder = tempfile::tempdir().unwrap();
    let bad = folder.path().join("bad.dgs");
    std::fs::write(&bad, b"no stream at all").unwrap();
    let url = format!("{}plain/?pixel-ratio=0.25", page.served.url());
    page.browser.go(&url).unwrap();
    let ready = "!!(globalThis.player = document.querySelector('dgs-player'))?.engine?.screen";
    page.browser.wait(PAGE_TIMEOUT_S, ready).unwrap();
    let said = format!("{MESSAGE} === 'bad.dgs is no .dgs stream: `dgs encode` makes one'");
    drop_until(&mut page, &bad, &said);
    drop_until(&mut page, Path::new(GOLDEN), "player.session !== null && player.error === null");
    page.browser.wait(PAGE_TIMEOUT_S, "player.engine.frames > 0").unwrap();
    let bytes = std::fs::read(GOLDEN).unwrap();
    let (session, _) = dgs_viewer::Session::open(&bytes).unwrap();
    assert_eq!(page.number("player.session.info()[0]"), f64::from(session.player().info().frames));
    assert_eq!(
        page.run("[document.getElementById('welcome').hidden, document.body.className].join()"),
        "true,"
    );
    page.close();
}
