//! A file comes from every kind of server: with byte ranges, without, with faults.

use super::{PAGE_TIMEOUT_S, Page, served};

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
        if (kind === 'damages' && from <= 20000 && from + bytes.length > 20000) bytes[20000 - from] ^= 1;\
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
    page.browser.before_pages(SERVERS).unwrap();
    let url = format!("{}?src=streams/large.dgs&paused&pixel-ratio=0.25", page.served.url());
    page.browser.go(&url).unwrap();
    page.browser
        .wait(PAGE_TIMEOUT_S, "!!(globalThis.player = document.querySelector('dgs-player'))?.session")
        .unwrap();
    let packets = served::stream(served::LARGE).packets().len();
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
    page.browser.before_pages(SERVERS).unwrap();
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
