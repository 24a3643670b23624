//! The page plays what `dgs serve` sends while it sends it, over every transport, and changes the conditions
//! of its session there.

use serde_json::Value;

use super::{
    MESSAGE, MIN_DB, PAGE_TIMEOUT_S, Page, SIDE,
    served::{self, SMALL, stream},
};

/// A page that lets every transport take the time that it takes on a busy machine: another is tried only once
/// one has failed, and media requested in streams only where datagrams are swallowed. Timers are known by
/// the page's names for what they do: after a head start, without a manifest, without media. `met` holds
/// those that were set.
const UNHURRIED: &str = "{ const real = setTimeout; globalThis.met = new Set();\
    globalThis.setTimeout = (act, ms, ...given) => {\
        const names = globalThis.swallows ? ['next', 'end'] : ['next', 'end', 'quiet'];\
        if (!names.includes(act.name)) return real(act, ms, ...given);\
        met.add(act.name);\
        return real(act, 1e9, ...given); }; }";

/// A page that counts what it asks for.
const COUNTS_FETCHES: &str = "globalThis.fetches = 0; { const real = fetch;\
    globalThis.fetch = (...given) => ((fetches += 1), real(...given)); }";

/// A path that carries sessions of WebTransport and none of their datagrams.
const SWALLOWS_DATAGRAMS: &str = "globalThis.swallows = true; if (globalThis.WebTransport) {\
    const real = Object.getOwnPropertyDescriptor(WebTransport.prototype, 'datagrams').get;\
    const get = function () { return { readable: new ReadableStream(), writable: new WritableStream(),\
        maxDatagramSize: real.call(this).maxDatagramSize }; };\
    Object.defineProperty(WebTransport.prototype, 'datagrams', { get }); }";

/// Which transport was the first, as a page remembers it for the next ones, and since when, milliseconds.
const REMEMBERED: &str = "JSON.parse(localStorage.getItem('dgs-transport')).name";
const REMEMBERED_AT: &str = "JSON.parse(localStorage.getItem('dgs-transport')).at";

/// A page whose turns wait until `letGo()`: meanwhile its clock stands as where a picture takes long.
const WITHOUT_TURNS: &str = "{ const real = requestAnimationFrame.bind(globalThis); const turns = [];\
    globalThis.requestAnimationFrame = (turn) => turns.push(turn);\
    globalThis.letGo = () => { globalThis.requestAnimationFrame = real; turns.splice(0).forEach(real); }; }";

/// Share of blocks that are shown by stand-ins.
const STAND_INS: &str = "(player.session.levels()[0] / player.session.levels().reduce((a, b) => a + b, 0))";

/// A server as `dgs serve` is one, with an emulated link: the page receives live, and repeats the clip.
#[test]
fn packets_come_live_over_a_lossy_link() {
    let Some(mut page) = Page::blank_alone() else { return };
    page.browser.before_pages(UNHURRIED).unwrap();
    // As below, the page is held up at its first picture; a server that thinks it gone sees it come again.
    let live = served::Live::start(&["--impair", "loss=5%,delay=10ms", "--idle", "120"]);
    page.browser.go(&format!("{}?transport=live&pixel-ratio=0.25", live.page)).unwrap();
    let playing = "(globalThis.player = document.querySelector('dgs-player'))?.engine?.frames > 0";
    page.browser.wait(PAGE_TIMEOUT_S, playing).unwrap();
    assert_eq!(page.run("player.dataset.transport"), "live");
    page.run("globalThis.loops = 0; player.addEventListener('loop', () => (loops += 1)); 0");
    page.browser.wait(PAGE_TIMEOUT_S, "loops >= 1 && player.session.packets()[1] > 10").unwrap();
    // What was lost comes when the clip is repeated.
    page.browser.wait(PAGE_TIMEOUT_S, "player.session.levels()[0] === 0").unwrap();
    page.close();
    let report = live.stop();
    assert!(report.contains("1 viewers;") && report.contains("(0 refused), camera reported"), "{report}");
}

#[test]
fn every_transport_brings_the_same_picture() {
    let Some(mut page) = Page::blank_alone() else { return };
    // A software adapter holds up the page at its first picture until servers think it gone: first the file.
    page.browser.resize(SIDE, SIDE).unwrap();
    page.browser.before_pages(UNHURRIED).unwrap();
    let live = served::Live::start(&["--idle", "120"]);
    let mut player = stream(SMALL).receive().unwrap();
    for transport in ["file", "live", "streams", "websocket"] {
        page.browser.go("about:blank").unwrap();
        page.play(&format!("{}?transport={transport}&pixel-ratio=1", live.page), SIDE);
        let names = if transport == "file" { "whole ranges" } else { transport };
        let is_known = format!("'{names}'.split(' ').includes(player.dataset.transport)");
        page.browser.wait(PAGE_TIMEOUT_S, &is_known).unwrap();
        page.run("player.play(), 0");
        // What did not come in time comes when the clip is repeated.
        let mut db = 0.0;
        for _ in 0..60 {
            page.browser.wait(PAGE_TIMEOUT_S, "player.session.levels()[0] === 0").unwrap();
            page.run("player.pause(), player.currentTime = 0.5, 0");
            db = page.agreement(&mut player, [0.0; 3]);
            if db >= MIN_DB {
                break;
            }
            page.run("player.play(), 0");
            std::thread::sleep(std::time::Duration::from_secs(1));
        }
        assert!(db >= MIN_DB, "{transport}: {db} dB");
        let error = page.run("player.error?.message ?? null");
        if error != Value::Null {
            panic!("{transport}: {error}; {}", live.stop());
        }
    }
    // Where datagrams never arrive the same session goes on in streams, and a page remembers that.
    page.browser.go("about:blank").unwrap();
    page.browser.before_pages(SWALLOWS_DATAGRAMS).unwrap();
    page.play(&format!("{}?pixel-ratio=1&switch", live.page), SIDE);
    page.browser.wait(PAGE_TIMEOUT_S, "player.dataset.transport === 'streams'").unwrap();
    page.run("player.play(), 0");
    page.browser.wait(PAGE_TIMEOUT_S, "player.session.packets()[1] > 10").unwrap();
    assert_eq!(page.run(REMEMBERED), "streams");
    // For a day, which trying it first does not make longer: what let nothing through may do so again.
    let names = "(async () => { const { rungsOf } = await import('./ladder.js');\
        return rungsOf({ name: 'small', web_address: 'https://a' }).map(({ name }) => name).join(); })()";
    assert_eq!(page.run(names), "streams,live,websocket");
    page.run(
        "{ const kept = JSON.parse(localStorage.getItem('dgs-transport')); kept.at -= 25 * 3600e3;\
         localStorage.setItem('dgs-transport', JSON.stringify(kept)); } 0",
    );
    assert_eq!(page.run(names), "live,websocket");
    page.run("localStorage.clear(), 0");
    // Unless one is requested the best that works plays, and a page remembers it.
    page.browser.go("about:blank").unwrap();
    page.browser.before_pages("delete globalThis.WebTransport").unwrap();
    page.play(&format!("{}?pixel-ratio=1", live.page), SIDE);
    assert_eq!(page.run("player.dataset.transport"), "websocket");
    assert_eq!(page.run(REMEMBERED), "websocket");
    let at = page.number(REMEMBERED_AT);
    page.browser.go("about:blank").unwrap();
    page.play(&format!("{}?pixel-ratio=1&again", live.page), SIDE);
    assert_eq!(page.run("player.dataset.transport"), "websocket");
    assert_eq!(page.number(REMEMBERED_AT), at, "its day goes on");
    page.browser.go("about:blank").unwrap();
    let report = live.stop();
    assert!(report.contains("(0 refused)"), "{report}");
    page.close();
}

#[test]
fn a_page_changes_the_link_and_the_scheduler_of_its_session() {
    let Some(mut page) = Page::blank_alone() else { return };
    page.browser.before_pages(UNHURRIED).unwrap();
    let is_whole = format!("{STAND_INS} === 0 && player.session.estimatedQuality > 0.99");
    let free = ["--idle", "120"];
    // A server that grants nothing sends nothing again either: a page that forgot its packets would never
    // have them again.
    let fixed = ["--idle", "120", "--fixed-conditions"];
    let cases = [
        (&free[..], "live", "at the server"),
        (&free[..], "websocket", "in this page"),
        (&fixed[..], "live", "in this page"),
    ];
    for (flags, transport, place) in cases {
        let live = served::Live::start(flags);
        page.play(&format!("{}?transport={transport}&pixel-ratio=0.25", live.page), SIDE / 4);
        page.run("player.toggleNetwork(), player.play(), 0");
        page.browser.wait(PAGE_TIMEOUT_S, &is_whole).unwrap();
        // A round that begins anew has nothing at first, and what is lost comes with later ones.
        page.run(
            "globalThis.least = 1, setInterval(() => (least = Math.min(least, player.buffered || 1)), 20), 0",
        );
        page.run("player.impair({ loss: 0.7, burst: 4, rate: 1e6, scheduler: 'layered' }).then(() => 0)");
        let said = page.run("player.shadowRoot.querySelector('.where').textContent");
        assert_eq!(said, format!("emulated {place}"), "{flags:?}, {transport}");
        // Of one moment: what is lost comes with a later round.
        let is_damaged = format!("{STAND_INS} > 0 && player.session.estimatedQuality < 0.99");
        page.browser.wait(PAGE_TIMEOUT_S, &is_damaged).unwrap();
        page.browser.wait(PAGE_TIMEOUT_S, "least < 0.9").unwrap();
        page.run("player.impair({}).then(() => 0)");
        page.browser.wait(PAGE_TIMEOUT_S, &format!("{is_whole} && player.buffered > 0.9")).unwrap();
        page.browser.go("about:blank").unwrap();
        let report = live.stop();
        assert!(report.contains("1 viewers;") && report.contains("(0 refused)"), "{report}");
    }
    page.close();
}

/// A clock that stands has no deadlines: what playing had left out comes, and nothing that is shown goes,
/// even where rounds begin with nothing.
#[test]
fn a_paused_page_goes_on_refining() {
    let Some(mut page) = Page::blank_alone() else { return };
    page.browser.before_pages(UNHURRIED).unwrap();
    let live = served::Live::start(&["--idle", "120"]);
    page.play(&format!("{}?transport=live&pixel-ratio=0.25&paused", live.page), SIDE / 4);
    page.run(&format!(
        "globalThis.held = null; player.loop = false; player.addEventListener('pause', () => {{\
           globalThis.least = player.session.packets()[1]; held = [{STAND_INS}, least];\
           setInterval(() => (least = Math.min(least, player.session.packets()[1])), 20); }}); 0"
    ));
    // The base takes several times as long as the clip: its end, where the clock stops, comes before.
    page.run("player.impair({ rate: 1e4 }).then(() => 0)");
    page.run("player.play(), 0");
    page.browser.wait(PAGE_TIMEOUT_S, "held !== null && player.ended").unwrap();
    assert!(page.number("held[0]") > 0.0, "the base was there before the clock stopped");
    page.browser.wait(PAGE_TIMEOUT_S, &format!("{STAND_INS} === 0")).unwrap();
    assert_eq!(page.run("least === held[1]"), true, "what was shown is forgotten");
    page.browser.go("about:blank").unwrap();
    page.close();
    let report = live.stop();
    assert!(report.contains("(0 refused)"), "{report}");
}

/// A clock that waits for its first base has shown nothing. A server that took the first frame for shown
/// would count its deadlines from there, and leave out what comes after them.
#[test]
fn what_a_clock_waits_for_is_not_late() {
    let Some(mut page) = Page::blank_alone() else { return };
    page.browser.before_pages(UNHURRIED).unwrap();
    let live = served::Live::start(&["--impair", "rate=20kbit", "--idle", "120"]);
    page.browser.before_pages(WITHOUT_TURNS).unwrap();
    page.browser.go(&format!("{}?transport=live&pixel-ratio=0.25", live.page)).unwrap();
    let playing = "(globalThis.player = document.querySelector('dgs-player'))?.session && !player.paused";
    page.browser.wait(PAGE_TIMEOUT_S, &format!("Boolean({playing})")).unwrap();
    // The clip has a second; all of its base comes in three.
    std::thread::sleep(std::time::Duration::from_secs(12));
    // The share of stand-ins once the page has decoded anything.
    page.run(&format!(
        "globalThis.first = null; const look = () => {{\
           if (player.session.packets()[1] > 0) first = {STAND_INS};\
           else setTimeout(look, 1); }}; look(), letGo(), 0"
    ));
    page.browser.wait(PAGE_TIMEOUT_S, "first !== null").unwrap();
    assert_eq!(page.number("first"), 0.0);
    page.browser.go("about:blank").unwrap();
    page.close();
    live.stop();
}

/// Who comes while a stream is written begins at its newest window.
#[test]
fn the_page_plays_what_is_still_being_written() {
    let Some(mut page) = Page::blank_alone() else { return };
    page.browser.before_pages(UNHURRIED).unwrap();
    let bytes = served::encoded("synth:figure:1000:30", &["--window-frames", "10", "--pictures", "2"]);
    let live = served::Live::growing(&bytes);
    // The third window of ten frames. Until a busy server has read it, who comes begins before it.
    let mut viewers = 0;
    loop {
        page.play(&format!("{}?transport=live&pixel-ratio=0.25&paused", live.page), SIDE / 4);
        viewers += 1;
        let begun = page.browser.wait(5, "player.session.frame === 20");
        if begun.is_ok() {
            break;
        }
        assert!(viewers < 20, "{begun:?}");
        page.browser.go("about:blank").unwrap();
    }
    page.browser.wait(PAGE_TIMEOUT_S, &format!("{STAND_INS} === 0")).unwrap();
    // A round begins there, too; but who pauses stays.
    page.run(
        "globalThis.stands = null; player.addEventListener('timeupdate', () => {\
           if (player.paused || player.session.frame < 25) return;\
           player.pause(), stands = player.session.frame; }); player.play(), 0",
    );
    page.browser.wait(PAGE_TIMEOUT_S, "stands !== null").unwrap();
    std::thread::sleep(std::time::Duration::from_secs(1));
    assert_eq!(page.run("player.paused && player.session.frame === stands"), true);
    page.browser.go("about:blank").unwrap();
    page.close();
    let report = live.stop();
    assert!(report.contains(&format!("{viewers} viewers;")), "{report}");
}

/// A server that was restarted has another certificate, and knows nothing of the page.
#[test]
fn a_server_that_comes_back_is_found_again() {
    let Some(mut page) = Page::blank_alone() else { return };
    page.browser.before_pages(UNHURRIED).unwrap();
    page.browser.before_pages(COUNTS_FETCHES).unwrap();
    let gone = format!("{MESSAGE} === 'The server is gone; trying again'");
    let mut live = served::Live::start(&["--idle", "120"]);
    page.play(&format!("{}?transport=live&pixel-ratio=0.25&paused", live.page), SIDE / 4);
    page.run("player.currentTime = 0.4, player.session.turn(40, 8, 256), 0");
    page.run("globalThis.old = player.session, globalThis.view = String(player.view), 0");
    let pin = page.run("(async () => (await fetch('certificate.sha256')).text())()");
    let address = live.address();
    live.stop();
    page.browser.wait(PAGE_TIMEOUT_S, &gone).unwrap();
    // It is tried more than once, and what is there stays.
    page.run("fetches = 0, 0");
    page.browser.wait(PAGE_TIMEOUT_S, "fetches >= 2").unwrap();
    assert_eq!(page.run("player.session === old && player.error === null"), true);
    live = served::Live::at(&address);
    page.browser.wait(PAGE_TIMEOUT_S, &format!("player.session !== old && {MESSAGE} === ''")).unwrap();
    assert_ne!(page.run("(async () => (await fetch('certificate.sha256')).text())()"), pin);
    assert_eq!(
        page.run("[player.currentTime, player.paused, player.dataset.transport].join()"),
        "0.4,true,live"
    );
    assert_eq!(page.run("view === String(player.view)"), true);
    page.run("player.play(), 0");
    page.browser.wait(PAGE_TIMEOUT_S, &format!("{STAND_INS} === 0")).unwrap();
    // Whoever opens something else, or removes the player, does not wait for it any more.
    page.run(
        "(async () => globalThis.file = await (await fetch('streams/small.dgs')).blob())().then(() => 0)",
    );
    for end in ["player.open(file).then(() => 0)", "player.remove(), 0"] {
        live.stop();
        page.browser.wait(PAGE_TIMEOUT_S, &gone).unwrap();
        page.run(end);
        page.run("fetches = 0, 0");
        // The third pause has two seconds.
        std::thread::sleep(std::time::Duration::from_secs(4));
        assert_eq!(page.number("fetches"), 0.0, "{end}");
        live = served::Live::at(&address);
        page.play(&format!("{}?transport=live&pixel-ratio=0.25&paused", live.page), SIDE / 4);
    }
    live.stop();
    // What a browser says of servers that are not there.
    page.browser.complaints.retain(|complaint| !complaint.contains("net::ERR_"));
    page.close();
}

/// A file needs fewer round trips than a session, and is asked for again and again where a session is not: it
/// must not win because a server was away.
#[test]
fn a_page_is_live_again_after_its_server_was_gone() {
    let Some(mut page) = Page::blank_alone() else { return };
    page.browser.before_pages(UNHURRIED).unwrap();
    page.browser.before_pages(COUNTS_FETCHES).unwrap();
    let live = served::Live::start(&["--idle", "120"]);
    page.play(&format!("{}?pixel-ratio=0.25&paused", live.page), SIDE / 4);
    page.browser.wait(PAGE_TIMEOUT_S, "player.dataset.transport === 'live'").unwrap();
    // Under other names nothing would take its time.
    page.browser.wait(PAGE_TIMEOUT_S, "['next', 'end', 'quiet'].every((name) => met.has(name))").unwrap();
    page.run("globalThis.old = player.session, 0");
    let address = live.address();
    live.stop();
    let gone = format!("{MESSAGE} === 'The server is gone; trying again'");
    page.browser.wait(PAGE_TIMEOUT_S, &gone).unwrap();
    // Each climb asks for a certificate and a file: two have failed, the next is some seconds away, and what
    // is asked for again and again would be under way.
    page.run("fetches = 0, 0");
    page.browser.wait(PAGE_TIMEOUT_S, "fetches >= 4").unwrap();
    let live = served::Live::at(&address);
    page.browser.wait(PAGE_TIMEOUT_S, &format!("player.session !== old && {MESSAGE} === ''")).unwrap();
    assert_eq!(page.run(&format!("[player.dataset.transport, {REMEMBERED}].join()")), "live,live");
    page.browser.go("about:blank").unwrap();
    live.stop();
    // What a browser says of servers that are not there.
    page.browser.complaints.retain(|complaint| !complaint.contains("net::ERR_"));
    page.close();
}

/// What is played goes on when somebody drops a scan or a picture on it.
#[test]
fn a_file_that_is_no_stream_ends_nothing() {
    let Some(mut page) = Page::blank_alone() else { return };
    page.browser.before_pages(UNHURRIED).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let (good, bad) = (folder.path().join("good.dgs"), folder.path().join("scan.ply"));
    std::fs::write(&good, stream(SMALL).to_bytes().unwrap()).unwrap();
    std::fs::write(&bad, b"ply\nformat binary_little_endian 1.0\n").unwrap();
    let live = served::Live::start(&["--idle", "120"]);
    page.play(&format!("{}?transport=websocket&pixel-ratio=0.25", live.page), SIDE / 4);
    page.run("globalThis.old = player.session, 0");
    // A busy machine may ask when the sentence has passed: the page keeps what was said.
    page.run(&format!(
        "globalThis.said = [], new MutationObserver(() => said.push({MESSAGE}))\
         .observe(player.shadowRoot.querySelector('.message'), {{ childList: true }}), 0"
    ));
    // A first picture that comes late has nothing to say, and takes nothing back.
    page.run(
        "player.addEventListener('error', () => player.engine.dispatchEvent(new Event('firstframe'))), 0",
    );
    page.browser.choose_file("#pick", &bad).unwrap();
    let sentence = "scan.ply is no .dgs stream: `dgs encode` makes one";
    page.browser.wait(PAGE_TIMEOUT_S, "said.length === 2").unwrap();
    assert_eq!(page.run("said.join('|')"), format!("{sentence}|"));
    assert_eq!(page.run("player.session === old && player.session.server !== null && !player.paused"), true);
    // Bytes have no name.
    let unnamed = "player.open(new Uint8Array([80, 75, 3, 4])).then(() => player.error.message)";
    assert_eq!(page.run(unnamed), "This is no .dgs stream: `dgs encode` makes one");
    page.browser.choose_file("#pick", &good).unwrap();
    page.browser.wait(PAGE_TIMEOUT_S, "player.session !== old && player.error === null").unwrap();
    assert_eq!(page.run(MESSAGE), "");
    // A WebSocket that closes is given nothing more.
    let closed = "(async () => { const { openWebSocket } = await import('./links.js');\
        const link = await openWebSocket(new AbortController().signal); link.close();\
        await link.send(new Uint8Array(1));\
        return link.write(new Uint8Array(1)).catch((error) => error.message); })()";
    assert_eq!(page.run(closed), "The WebSocket is closed");
    page.close();
    live.stop();
}
