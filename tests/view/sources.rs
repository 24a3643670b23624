//! A file comes from every kind of server: with byte ranges, without, with faults. It may be a part of a
//! stream, or lack stand-ins; or it is not finished.

#[path = "growing.rs"]
mod growing;

use codec_core::internals::wire::file;
use dgs_player::Stream;
use dgs_viewer::Session;

use super::{
    MESSAGE, PAGE_TIMEOUT_S, Page, SIDE,
    served::{self, Served},
};

/// Makes a server of another `kind` of this page's server, by what its scripts see of it.
const SERVERS: &str = "const real = globalThis.fetch; globalThis.kind = ''; globalThis.requests = 0;\
    globalThis.fetch = async (url, options) => {\
        if (!/large/.test(String(url))) return real(url, options);\
        requests += 1;\
        const range = options?.headers?.Range;\
        if (kind === 'is gone' || (kind === 'refuses ranges' && range)) throw new TypeError('refused');\
        const answer = await real(url, options);\
        if (answer.status !== 206) return answer;\
        const bytes = new Uint8Array(await answer.arrayBuffer());\
        const headers = { 'Content-Range': answer.headers.get('Content-Range'), ETag: 'first' };\
        const from = Number(/=(\\d+)/.exec(range)[1]);\
        const here = DAMAGED - from;\
        if (kind === 'damages' && here in bytes) bytes[here] ^= 1;\
        if (kind === 'hides lengths') return new Response(bytes, { status: 206 });\
        if (kind === 'cuts one short' && requests === 2) {\
            const cut = new ReadableStream({ pull: (to) => to.error(new TypeError('cut')) });\
            return new Response(cut, { status: 206, headers });\
        }\
        const other = { 'gets shorter': '/30000', 'gets longer': '/900000000' }[kind];\
        const place = (by, to) => (headers['Content-Range'] = headers['Content-Range'].replace(by, to));\
        if (other && requests > 1) place(/\\/.*/, other);\
        if (kind === 'is replaced' && requests > 1) headers.ETag = 'second';\
        if (kind === 'sends another part') place(/\\d+/, '7');\
        const length = kind === 'sends less' && bytes.length > 4000 ? bytes.length >> 1 : bytes.length;\
        return new Response(bytes.subarray(0, length), { status: 206, headers });\
    };";

#[test]
fn a_file_comes_from_servers_of_every_kind() {
    let Some(mut page) = Page::blank() else { return };
    // Of the first packet, which is of a base and so has parity, some byte is damaged.
    let large = served::stream(served::LARGE);
    let damaged = file::MAGIC.len() + 4 + large.message().len() + 2 + large.packets()[0].len() / 2;
    page.browser.before_pages(&SERVERS.replace("DAMAGED", &damaged.to_string())).unwrap();
    let url = format!("{}?src=streams/large.dgs&paused&pixel-ratio=0.25", page.served.url());
    page.browser.go(&url).unwrap();
    page.browser
        .wait(PAGE_TIMEOUT_S, "!!(globalThis.player = document.querySelector('dgs-player'))?.session")
        .unwrap();
    let packets = large.packets().len();
    let came = "player.buffered === 1 && player.session !== old && player.session.settled";
    for (kind, transport, damage) in [
        ("hides lengths", "whole", ""),
        ("cuts one short", "ranges", ""),
        ("sends less", "ranges", ""),
        ("refuses ranges", "whole", ""),
        ("damages", "ranges", "1 packet is damaged"),
        ("", "ranges", ""),
    ] {
        page.run(&format!(
            "globalThis.old = player.session; [kind, requests] = ['{kind}', 0];\
             player.dataset.transport = ''; player.src = null; player.src = 'streams/large.dgs', 0"
        ));
        page.browser
            .wait(PAGE_TIMEOUT_S, &format!("player.dataset.transport === '{transport}' && {came}"))
            .unwrap();
        assert_eq!(page.run("player.session.damage"), damage, "{kind}");
        let said = "player.shadowRoot.querySelector('.message').textContent";
        let expected =
            if damage.is_empty() { "" } else { "Damaged, shown as far as it goes: 1 packet is damaged" };
        assert_eq!(page.run(said), expected, "{kind}");
        assert_eq!(page.number("player.session.packets()[0]") as usize, packets, "{kind}");
        // What parity has repaired is not missed.
        let whole = "player.session.levels().slice(0, 4).every((blocks) => blocks === 0)";
        assert_eq!(page.run(whole), true, "{kind}");
        eprintln!("{kind}: {} requests", page.number("requests"));
    }
    page.close();
}

/// What cannot be played names the address, and why.
#[test]
fn a_file_that_changes_or_is_none_is_refused_with_its_address() {
    let Some(mut page) = Page::blank() else { return };
    page.browser.before_pages(&SERVERS.replace("DAMAGED", "NaN")).unwrap();
    let url = format!("{}?paused&pixel-ratio=0.25&src=index.html", page.served.url());
    page.browser.go(&url).unwrap();
    let failed = "!!(globalThis.player = document.querySelector('dgs-player'))?.error";
    page.browser.wait(PAGE_TIMEOUT_S, failed).unwrap();
    let refused = |name: &str, why: &str| format!("{}{name}{why}", page.served.url());
    let no_stream = refused("index.html", " is no .dgs stream: `dgs encode` makes one");
    let changed = refused(
        "streams/large.dgs",
        ": the file has changed on the server since it was opened; open it again",
    );
    let elsewhere = refused("streams/large.dgs", ": bytes from 7 on came; from 0 on were asked for");
    let gone = refused(
        "streams/large.dgs",
        ": no answer (server gone, or it does not allow pages of this origin: CORS)",
    );
    assert_eq!(page.run("player.error.message"), no_stream);
    for (kind, expected) in [
        ("gets shorter", &changed),
        ("gets longer", &changed),
        ("is replaced", &changed),
        ("sends another part", &elsewhere),
        ("is gone", &gone),
    ] {
        page.run(&format!(
            "globalThis.said = null, player.addEventListener('error', ({{ message }}) => (said = message),\
             {{ once: true }}), [kind, requests] = ['{kind}', 0],\
             player.src = null, player.src = 'streams/large.dgs', 0"
        ));
        page.browser.wait(PAGE_TIMEOUT_S, "said !== null").unwrap();
        assert_eq!(page.run("said"), *expected, "{kind}");
        let most = if kind == "is gone" { 4.0 } else { 2.0 };
        assert!(page.number("requests") <= most, "{kind}");
    }
    page.close();
}

/// `dgs cut` leaves packets out, and a file without them is whole.
#[test]
fn packets_that_somebody_left_out_are_no_damage() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=0.25", SIDE / 4) else {
        return;
    };
    let mut bytes = served::stream(served::SMALL).with_packets(|id| id % 3 != 1).to_bytes().unwrap();
    let (_, damage) = Stream::from_bytes(&bytes).unwrap();
    assert!(damage.is_none() && damage.missing_packets > 0, "{damage:?}");
    let folder = tempfile::tempdir().unwrap();
    let open = |page: &mut Page, name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        page.run("globalThis.old = player.session, 0");
        page.browser.choose_file("#pick", &path).unwrap();
        page.browser.wait(PAGE_TIMEOUT_S, "player.session !== old && player.session.settled").unwrap();
        [page.run("player.session.damage"), page.run(MESSAGE)]
    };
    assert_eq!(open(&mut page, "cut.dgs", &bytes), ["", ""]);
    // The comparison can fail.
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    let [damage, said] = open(&mut page, "damaged.dgs", &bytes);
    let damage = damage.as_str().unwrap();
    assert!(damage.contains("damaged byte ranges"), "{damage}");
    assert_eq!(said, format!("Damaged, shown as far as it goes: {damage}"));
    page.close();
}

/// Without stand-ins there is nothing to look at in the first bytes: the camera finds what comes then, unless
/// an address says where it is.
#[test]
fn the_camera_finds_a_stream_without_stand_ins() {
    let Some(mut page) = Page::blank() else { return };
    let bytes = served::encoded("synth:figure:1000:30", &["--profile", "paper"]);
    let (mut whole, _) = Session::open(&bytes).unwrap();
    let up = whole.up_of_stream();
    whole.look_at_all(1.0, up).unwrap();
    let expected = whole.orbit().numbers();
    page.served = Served::files([("bare", bytes)]);
    let url = format!("{}?src=streams/bare.dgs&paused&pixel-ratio=0.25", page.served.url());
    page.play(&url, SIDE / 4);
    let is_there = "player.dataset.transport === 'ranges' && player.buffered === 1 && player.session.settled";
    page.browser.wait(PAGE_TIMEOUT_S, is_there).unwrap();
    // Around nothing it would be half as far away.
    page.browser.wait(PAGE_TIMEOUT_S, &format!("player.view[2] > {}", 0.8 * expected[2])).unwrap();
    let is_near = format!("(player.home(), Math.abs(player.view[2] / {} - 1) < 0.05)", expected[2]);
    page.browser.wait(PAGE_TIMEOUT_S, &is_near).unwrap();
    let view = |page: &mut Page| -> Vec<f64> {
        page.run("player.view").as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
    };
    let found = view(&mut page);
    let near = |(a, b): (&f64, &f64)| (a - b).abs() < 0.05 * expected[2];
    assert!(found.iter().zip(&expected).all(near), "{found:?} of {expected:?}");
    page.browser.go("about:blank").unwrap();
    page.play(&format!("{url}#view=1,0.25,3.5,0.5,0.25,0.125"), SIDE / 4);
    page.browser.wait(PAGE_TIMEOUT_S, is_there).unwrap();
    assert_eq!(view(&mut page), [1.0, 0.25, 3.5, 0.5, 0.25, 0.125]);
    page.close();
}
