//! A page plays a stream while it is made, by somebody who pauses and comes to an end.

use std::{thread::sleep, time::Duration};

use codec_core::internals::{ids::Span, wire::file};
use dgs_player::Stream;
use trainer_host::stream::PacketMap;

use crate::{
    PAGE_TIMEOUT_S, Page, SIDE,
    served::{Live, encoded},
};

/// Frames of a window, a third of a second.
const WINDOW: u32 = 10;
const WINDOWS: usize = 15;
/// A page that waits for its manifest as long as a busy machine takes for it.
const PATIENT: &str = "{ const real = setTimeout; globalThis.setTimeout = (act, ms, ...given) =>\
    real(act, act.name === 'end' ? 1e9 : ms, ...given); }";

/// Manifest and bytes of every window, as who makes a stream writes them.
fn windows() -> (Vec<u8>, Vec<Vec<u8>>) {
    let bytes = encoded("synth:figure:1000:150", &["--window-frames", "10", "--pictures", "2"]);
    let stream = Stream::from_bytes(&bytes).unwrap().0;
    let (map, manifest) = (PacketMap::of(&stream).unwrap(), stream.manifest().unwrap());
    let window_of = |span: Span| match span {
        Span::Canonical(_) => 0,
        Span::Motion(id) => (manifest.window(id).unwrap().first_frame / WINDOW) as usize,
    };
    let mut windows = vec![Vec::new(); WINDOWS];
    for (id, packet) in stream.packets().iter().enumerate() {
        let window = map.placements(id).iter().map(|placement| window_of(placement.group.span)).max();
        // What repairs others comes at the end.
        let bytes: &mut Vec<u8> = &mut windows[window.unwrap_or(WINDOWS - 1)];
        bytes.extend((packet.len() as u16).to_le_bytes());
        bytes.extend(packet);
    }
    let mut head = file::MAGIC.to_vec();
    head.extend((stream.message().len() as u32).to_le_bytes());
    head.extend(stream.message());
    (head, windows)
}

/// A clock that ran on would be over all that comes: then the server sends nothing any more.
#[test]
fn a_page_ahead_of_a_stream_that_grows_waits_for_it_and_shows_its_end_once() {
    let Some(mut page) = Page::blank_alone() else { return };
    let (head, windows) = windows();
    let mut live = Live::growing(&head);
    windows[..3].iter().for_each(|window| live.write(window));
    page.browser.before_pages(PATIENT).unwrap();
    page.play(&format!("{}?transport=live&pixel-ratio=0.25&paused", live.page), SIDE / 4);
    page.run(
        "globalThis.heard = []; for (const name of ['loop', 'pause', 'ended'])\
           player.addEventListener(name, () => heard.push(name)); player.play(), 0",
    );
    // Two windows are whole, and shown, and then nothing for a second.
    let is_ahead = "player.session.isAhead && player.engine.waiting && player.session.frame >= 20";
    page.browser.wait(PAGE_TIMEOUT_S, is_ahead).unwrap();
    let time = page.number("player.currentTime");
    // It asks for the newest window meanwhile, which it has seen.
    sleep(Duration::from_millis(2500));
    assert_eq!(page.number("player.currentTime"), time);
    assert_eq!(page.run("player.session.isAhead && !player.paused"), true);
    // A window is whole when the next one begins: the newest one is that of frame 50.
    windows[3..7].iter().for_each(|window| live.write(window));
    page.browser.wait(PAGE_TIMEOUT_S, "player.session.seenUntil > 50 / 30").unwrap();
    windows[7..WINDOWS - 1].iter().for_each(|window| live.write(window));
    // The last window is late: the page waits for it at the end.
    page.browser.wait(PAGE_TIMEOUT_S, "player.session.isAhead && player.session.frame >= 140").unwrap();
    assert_eq!(page.run("player.ended || player.session.seenUntil > 141 / 30"), false);
    live.write(&windows[WINDOWS - 1]);
    live.end();
    page.browser.wait(PAGE_TIMEOUT_S, "player.ended").unwrap();
    assert_eq!(page.run("player.session.seenUntil > 149 / 30"), true, "its last window is shown");
    sleep(Duration::from_millis(1500));
    assert_eq!(page.run("player.ended && heard.join() === 'pause,ended'"), true, "it is not shown again");
    // Who wants to see it again sees its newest window, once.
    page.run(
        "globalThis.frames = []; player.addEventListener('timeupdate', () =>\
           frames.push(player.session.frame)); player.play(), 0",
    );
    page.browser.wait(PAGE_TIMEOUT_S, "heard.join() === 'pause,ended,pause,ended'").unwrap();
    assert_eq!(page.run("frames.some((frame) => frame >= 100 && frame < 140)"), false);
    page.browser.go("about:blank").unwrap();
    page.close();
    let report = live.stop();
    assert!(report.contains("1 viewers;"), "{report}");
}
