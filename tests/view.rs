//! Promises of the player in a browser: its pictures are the renderer's, loss thins them and never breaks
//! them, and a lost device, a slow start or a page 390 pixels wide are no reason to stop.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

#[path = "lab/src/browser.rs"]
#[allow(dead_code, reason = "bench `view` uses the rest")]
mod browser;
#[path = "view/hands.rs"]
mod hands;
#[path = "view/keep_up.rs"]
mod keep_up;
#[path = "view/live.rs"]
mod live;
#[path = "view/requests.rs"]
mod requests;
#[path = "view/served.rs"]
mod served;
#[path = "view/sources.rs"]
mod sources;

use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use browser::Browser;
use dgs_player::Player;
use render_host::{Camera, Image, Intrinsics, Settings, Splats, metric::psnr, render};
use serde_json::Value;
use served::{LARGE, SMALL, Served, stream};

/// Side of the pictures that are compared, pixels.
const SIDE: u32 = 256;
/// Least agreement with the renderer of this machine, dB: nearly all channels equal in 8 bits.
const MIN_DB: f64 = 50.0;
/// Longest wait for a page, seconds: a software adapter on a busy machine takes many for a frame.
const PAGE_TIMEOUT_S: u32 = 300;
/// What a player says.
const MESSAGE: &str = "player.shadowRoot.querySelector('.message').textContent";
/// Held alone by tests in which time counts, shared by the others: a software adapter compiles kernels in
/// one thread.
static MACHINE: RwLock<()> = RwLock::new(());

/// A page's part in the machine, for as long as it is open.
enum Part {
    Shared { _part: RwLockReadGuard<'static, ()> },
    Whole { _all: RwLockWriteGuard<'static, ()> },
}

/// A page that plays, or `None` on a machine without a browser; in CI that is a failure.
struct Page {
    browser: Browser,
    served: Served,
    _part: Part,
}

impl Page {
    /// A page with a picture of `side` pixels.
    fn open(query: &str, side: u32) -> Option<Self> {
        Self::blank().map(|page| page.with(query, side))
    }

    /// As [`Page::open`], with the machine to itself.
    fn open_alone(query: &str, side: u32) -> Option<Self> {
        Self::blank_alone().map(|page| page.with(query, side))
    }

    fn with(mut self, query: &str, side: u32) -> Self {
        let url = format!("{}?{query}", self.served.url());
        self.play(&url, side);
        self
    }

    /// Opens `url` and waits for a picture of `side` pixels.
    fn play(&mut self, url: &str, side: u32) {
        self.browser.go(url).unwrap();
        let playing = "(globalThis.player = document.querySelector('dgs-player'))?.engine?.frames > 0";
        self.browser.wait(PAGE_TIMEOUT_S, playing).unwrap();
        self.run("player.style.cssText = 'flex:none;width:256px;height:256px', 0");
        let is_sized = format!("player.shadowRoot.querySelector('canvas').width === {side}");
        self.browser.wait(PAGE_TIMEOUT_S, &is_sized).unwrap();
    }

    fn blank() -> Option<Self> {
        Self::in_browser(|| Part::Shared { _part: MACHINE.read().unwrap_or_else(PoisonError::into_inner) })
    }

    fn blank_alone() -> Option<Self> {
        Self::in_browser(|| Part::Whole { _all: MACHINE.write().unwrap_or_else(PoisonError::into_inner) })
    }

    fn in_browser(part: impl FnOnce() -> Part) -> Option<Self> {
        if Browser::program().is_none() {
            assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "chromium is missing");
            eprintln!("no chromium here: the player is not tested");
            return None;
        }
        let part = part();
        let served = Served::start();
        // As small as the pictures that are compared: a software adapter takes longer for a larger window.
        Some(Self { browser: Browser::open(SIDE, SIDE).unwrap(), served, _part: part })
    }

    fn run(&mut self, script: &str) -> Value {
        self.browser.run(script).unwrap()
    }

    fn number(&mut self, script: &str) -> f64 {
        self.run(script).as_f64().unwrap_or_else(|| panic!("{script} is no number"))
    }

    /// What is on the canvas.
    fn picture(&mut self) -> Image {
        let script = "(async () => { await player.engine.drawNow();\
             const from = player.shadowRoot.querySelector('canvas');\
             const to = document.createElement('canvas'); [to.width, to.height] = [from.width, from.height];\
             const pen = to.getContext('2d', { willReadFrequently: true }); pen.drawImage(from, 0, 0);\
             return [...pen.getImageData(0, 0, to.width, to.height).data].filter((_, k) => k % 4 < 3); })()";
        let values = self.run(script);
        let rgb: Vec<f32> =
            values.as_array().unwrap().iter().map(|v| v.as_f64().unwrap() as f32 / 255.0).collect();
        Image::new(SIDE, SIDE, rgb).unwrap()
    }

    /// What the renderer of this machine draws of `player` from the page's camera.
    fn expected(&mut self, player: &mut Player, background: [f32; 3]) -> Image {
        let numbers = self.run(&format!("[...player.session.camera({SIDE}, {SIDE})]"));
        let n: Vec<f64> = numbers.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        let rotation = [[n[0], n[1], n[2]], [n[3], n[4], n[5]], [n[6], n[7], n[8]]];
        let intrinsics = Intrinsics { width: SIDE, height: SIDE, fx: n[12], fy: n[13], cx: n[14], cy: n[15] };
        let camera =
            Camera::new(intrinsics, rotation, [n[9], n[10], n[11]]).unwrap().with_near(n[16]).unwrap();
        let frame = self.number("player.session.frame") as u32;
        let footprint = player.info().footprint;
        let shown = player.frame(frame).unwrap();
        let splats = Splats::new(shown.gaussians, shown.sh_rest, shown.sh_degree).unwrap();
        let settings = Settings::over(background).with_footprint(footprint);
        let image = render(&splats, &camera, &settings).unwrap().image;
        let rgb = image.to_rgb8().iter().map(|&v| f32::from(v) / 255.0).collect();
        Image::new(SIDE, SIDE, rgb).unwrap()
    }

    fn agreement(&mut self, player: &mut Player, background: [f32; 3]) -> f64 {
        let (shown, expected) = (self.picture(), self.expected(player, background));
        psnr(&shown, &expected).unwrap()
    }

    /// Ends the page, which must not have complained.
    fn close(self) {
        assert!(self.browser.complaints.is_empty(), "{:?}", self.browser.complaints);
    }
}

#[test]
fn its_pictures_are_those_of_the_renderer() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=1", SIDE) else { return };
    let mut player = stream(SMALL).receive().unwrap();
    let black = [0.0; 3];
    for time in ["0", "0.5", "0.98"] {
        page.run(&format!("player.currentTime = {time}, 0"));
        let db = page.agreement(&mut player, black);
        assert!(db >= MIN_DB, "time {time}: {db} dB");
    }
    page.run("player.session.turn(40, 8, 256), player.session.zoom(1.6), player.background = '#4080c0', 0");
    let blue = [64.0, 128.0, 192.0].map(|v: f32| v / 255.0);
    let db = page.agreement(&mut player, blue);
    assert!(db >= MIN_DB, "turned: {db} dB");
    // The comparison can fail: another frame, another background.
    let before = page.picture();
    page.run("player.currentTime = 0.2, 0");
    assert!(psnr(&before, &page.expected(&mut player, blue)).unwrap() < MIN_DB);
    assert!(page.agreement(&mut player, black) < MIN_DB);
    // The base alone.
    let mut base = Player::new(stream(SMALL).message(), &dgs_player::Caps::HOST).unwrap();
    let map = trainer_host::stream::PacketMap::of(&stream(SMALL)).unwrap();
    let is_base = |id: usize| {
        let placed = map.placements(id);
        !placed.is_empty() && placed.iter().all(|placement| placement.group.level.get() == 0)
    };
    let all = stream(SMALL);
    let packets = all.packets().iter().enumerate().filter(|&(id, _)| is_base(id)).map(|(_, p)| p.as_slice());
    base.push_all(packets);
    page.run("player.quality = 0, 0");
    let db = page.agreement(&mut base, blue);
    assert!(db >= MIN_DB, "base alone: {db} dB");
    page.close();
}

#[test]
fn it_plays_scrubs_loops_and_ends() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=0.25", SIDE / 4) else {
        return;
    };
    page.run(
        "globalThis.heard = []; for (const name of ['loop', 'ended', 'timeupdate', 'play', 'pause'])\
        player.addEventListener(name, () => heard.push(name)); 0",
    );
    page.run("player.play(), 0");
    page.browser.wait(PAGE_TIMEOUT_S, "heard.includes('loop')").unwrap();
    page.run("player.loop = false, player.currentTime = player.duration - 0.1, 0");
    page.browser.wait(PAGE_TIMEOUT_S, "heard.includes('ended') && player.paused && player.ended").unwrap();
    page.run("player.currentTime = 0.31, 0");
    assert_eq!(page.number("player.session.frame"), 9.0);
    page.run("player.step(1), player.step(1), 0");
    assert_eq!(page.number("player.session.frame"), 11.0);
    // The slider and the keys.
    page.run(
        "{ const slider = player.shadowRoot.querySelector('.time'); slider.value = 0.5;\
        slider.dispatchEvent(new Event('input')); } 0",
    );
    assert_eq!(page.number("player.session.frame"), 15.0);
    page.run("player.shadowRoot.querySelector('canvas').focus(), 0");
    page.browser.press(",").unwrap();
    assert_eq!(page.number("player.session.frame"), 14.0);
    page.browser.press("o").unwrap();
    assert_eq!(page.run("player.overlay"), "levels");
    // Colours stand beside what they mean.
    let legend = "[...player.shadowRoot.querySelectorAll('.painted li')].map((item) =>\
        `${item.textContent} ${getComputedStyle(item.firstChild).backgroundColor}`).join('; ')";
    let colours: Vec<_> = dgs_viewer::LEVEL_COLOURS
        .iter()
        .zip(["stand-ins", "base", "level 1", "level 2", "level 3"])
        .map(|(colour, name)| {
            let [r, g, b] = colour.map(|c| (255.0 * f64::from(c)).round());
            format!("{name} rgb({r}, {g}, {b})")
        })
        .collect();
    assert_eq!(page.run(legend), colours.join("; "));
    page.browser.press("o").unwrap();
    page.browser.press("o").unwrap();
    assert_eq!(page.run("player.overlay"), "missing");
    let painted = "player.shadowRoot.querySelector('.painted').textContent";
    assert!(page.run(painted).to_string().contains("utility of what is missing"));
    let title = "player.shadowRoot.querySelector('.paint').title";
    assert_eq!(page.run(title), "Paint blocks: missing (O)");
    page.browser.press("o").unwrap();
    assert_eq!(page.run("player.overlay"), "none");
    // On so small a picture the bar is one row, and it goes where nothing is moved while the clip plays.
    let bar = "player.shadowRoot.querySelector('.bar')";
    assert!(page.number(&format!("{bar}.getBoundingClientRect().height")) <= 72.0);
    page.run("player.loop = true, player.play(), 0");
    page.browser.wait(PAGE_TIMEOUT_S, &format!("getComputedStyle({bar}).opacity === '0'")).unwrap();
    page.run("player.pause(), 0");
    page.browser.wait(PAGE_TIMEOUT_S, &format!("getComputedStyle({bar}).opacity === '1'")).unwrap();
    page.close();
}

#[test]
fn pointers_move_the_camera_and_the_address_keeps_it() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused", SIDE) else { return };
    let view = |page: &mut Page| -> Vec<f64> {
        page.run("player.view").as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
    };
    let start = view(&mut page);
    let path = [[100.0, 30.0], [140.0, 40.0]];
    page.browser.drag(&path, "left").unwrap();
    let turned = view(&mut page);
    assert!(turned[0] != start[0] && turned[1] != start[1] && turned[3..] == start[3..], "{turned:?}");
    page.browser.drag(&path, "right").unwrap();
    let panned = view(&mut page);
    assert!(panned[..3] == turned[..3] && panned[3..] != turned[3..], "{panned:?}");
    page.browser.wait(PAGE_TIMEOUT_S, "location.hash.includes('view=')").unwrap();
    page.run("player.currentTime = 0.4, 0");
    page.browser.wait(PAGE_TIMEOUT_S, "location.hash.includes('t=0.400')").unwrap();
    let hash = page.run("location.hash");
    let url = format!("{}?src=streams/small.dgs{}", page.served.url(), hash.as_str().unwrap());
    page.browser.go("about:blank").unwrap();
    page.browser.go(&url).unwrap();
    page.browser
        .wait(
            PAGE_TIMEOUT_S,
            "(globalThis.player = document.querySelector('dgs-player'))?.engine?.frames > 0",
        )
        .unwrap();
    let again = view(&mut page);
    assert!(again.iter().zip(&panned).all(|(a, b)| (a - b).abs() < 1e-4 * b.abs().max(1.0)), "{again:?}");
    assert_eq!(page.number("player.currentTime"), 0.4);
    assert_eq!(page.run("player.paused"), true);
    page.close();
}

#[test]
fn ranges_bring_a_file_and_loss_thins_it() {
    let Some(mut page) = Page::open("src=streams/large.dgs&paused&pixel-ratio=1", SIDE) else { return };
    page.browser
        .wait(PAGE_TIMEOUT_S, "player.dataset.transport === 'ranges' && player.buffered === 1")
        .unwrap();
    let whole = page.picture();
    let mut player = stream(LARGE).receive().unwrap();
    let db = page.agreement(&mut player, [0.0; 3]);
    assert!(db >= MIN_DB, "what came in pieces: {db} dB");
    let stand_ins = |page: &mut Page| {
        page.number("player.session.levels()[0] / player.session.levels().reduce((a, b) => a + b)")
    };
    assert_eq!(stand_ins(&mut page), 0.0);
    page.run("globalThis.complete = String(player.session.levels()), 0");
    let mut before = f64::INFINITY;
    for (loss, least_db) in [(0.1, 20.0), (0.5, 12.0), (0.9, 8.0)] {
        page.run(&format!("player.impair({{ loss: {loss}, burst: 4, seed: 7 }}), 0"));
        page.browser.wait(PAGE_TIMEOUT_S, "player.session.packets()[1] > 0").unwrap();
        // The emulated network delivers when the display next takes a frame.
        page.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(0))))");
        let thinned = page.picture();
        let db = psnr(&thinned, &whole).unwrap();
        let seen = thinned.rgb().iter().filter(|&&v| v > 0.05).count();
        assert!(db > least_db && db < before, "{loss}: {db} dB after {before}");
        assert!(seen > 1000, "{loss}: only {seen} values are seen");
        before = db;
    }
    assert!(stand_ins(&mut page) > 0.3);
    // At a bounded rate everything comes in the end.
    page.run("player.impair({ rate: 4e6 }), 0");
    page.browser.wait(PAGE_TIMEOUT_S, "String(player.session.levels()) === complete").unwrap();
    page.run("player.impair({}), 0");
    assert!(psnr(&page.picture(), &whole).unwrap().is_infinite());
    // The panel has the same sliders and draws its plot.
    page.run("player.toggleNetwork(), 0");
    page.browser
        .wait(PAGE_TIMEOUT_S, "/decoded/.test(player.shadowRoot.querySelector('.numbers').textContent)")
        .unwrap();
    page.close();
}

#[test]
fn a_lost_device_is_another_device_a_moment_later() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=1", SIDE) else { return };
    page.run("player.currentTime = 0.5, 0");
    let before = page.picture();
    for _ in 0..2 {
        page.run(
            "globalThis.restored = false; player.addEventListener('devicerestored', () => (restored = true));\
            player.engine.screen.destroy(), 0",
        );
        page.browser.wait(PAGE_TIMEOUT_S, "restored").unwrap();
    }
    assert_eq!(page.number("player.currentTime"), 0.5);
    assert!(psnr(&page.picture(), &before).unwrap().is_infinite());
    page.close();
}

/// Where a page decodes is said on its element.
fn decoding(page: &mut Page) -> String {
    page.run("player.dataset.decoding").as_str().unwrap().to_owned()
}

#[test]
fn a_worker_decodes_and_where_there_is_none_the_page() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=1", SIDE) else { return };
    assert_eq!(decoding(&mut page), "worker");
    let mut player = stream(SMALL).receive().unwrap();
    page.run("player.currentTime = 0.5, 0");
    let by_worker = page.picture();
    let db = page.agreement(&mut player, [0.0; 3]);
    assert!(db >= MIN_DB, "{db} dB");
    for (query, broken, said) in [
        ("&worker=off", "0", "page: as requested"),
        ("", "globalThis.Worker = undefined", "page: no workers here"),
        ("", "globalThis.Worker = class { constructor() { throw new Error('refused') } }", "page: refused"),
    ] {
        page.browser.go("about:blank").unwrap();
        page.browser.before_pages(broken).unwrap();
        let url = format!("{}?src=streams/small.dgs&paused&pixel-ratio=1{query}", page.served.url());
        page.play(&url, SIDE);
        assert_eq!(decoding(&mut page), said);
        page.run("player.currentTime = 0.5, 0");
        assert!(psnr(&page.picture(), &by_worker).unwrap().is_infinite(), "{said}");
    }
    page.close();
}

#[test]
fn a_decoder_decodes_the_newest_frame_of_the_newest_stream() {
    let Some(mut page) = Page::open("src=streams/large.dgs&paused&pixel-ratio=1", SIDE) else { return };
    page.browser.wait(PAGE_TIMEOUT_S, "player.buffered === 1").unwrap();
    page.picture();
    let uploads = page.number("player.session.uploads");
    page.run("{ for (let k = 29; k > 10; k--) player.currentTime = (k + 0.5) / 30; } 0");
    let mut player = stream(LARGE).receive().unwrap();
    let db = page.agreement(&mut player, [0.0; 3]);
    assert!(db >= MIN_DB, "{db} dB");
    let decoded = page.number("player.session.uploads") - uploads;
    assert!((1.0..=2.0).contains(&decoded), "{decoded} frames of 19 were decoded");
    // A device is lost, and another stream is wanted, while frames are under way.
    page.run(
        "globalThis.restored = false; player.addEventListener('devicerestored', () => (restored = true));\
        player.play(), player.engine.screen.destroy(), player.src = 'streams/small.dgs', 0",
    );
    page.browser.wait(PAGE_TIMEOUT_S, "restored && player.session.info()[2] < 2000").unwrap();
    page.run("globalThis.old = player.session, player.src = 'streams/large.dgs', 0");
    page.run("player.src = 'streams/small.dgs', 0");
    let shown = "player.session !== old && player.buffered === 1 && player.session.info()[2] < 2000 &&\
        player.session.uploads > 0";
    page.browser.wait(PAGE_TIMEOUT_S, shown).unwrap();
    page.run("player.pause(), player.currentTime = 0.5, 0");
    let db = page.agreement(&mut stream(SMALL).receive().unwrap(), [0.0; 3]);
    assert!(db >= MIN_DB, "after all that: {db} dB");
    assert_eq!(page.run("player.error"), Value::Null);
    page.close();
}

#[test]
fn files_are_chosen_refused_and_removed() {
    let Some(mut page) = Page::blank() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (good, bad) = (folder.path().join("good.dgs"), folder.path().join("bad.dgs"));
    std::fs::write(&good, stream(SMALL).to_bytes().unwrap()).unwrap();
    std::fs::write(&bad, b"no stream at all").unwrap();
    let url = format!("{}plain/?pixel-ratio=0.25", page.served.url());
    page.browser.go(&url).unwrap();
    page.browser
        .wait(PAGE_TIMEOUT_S, "!!(globalThis.player = document.querySelector('dgs-player'))?.engine?.screen")
        .unwrap();
    // A busy machine may ask when the sentence has passed: the page keeps what was said.
    page.run(&format!(
        "globalThis.said = [], new MutationObserver(() => said.push({MESSAGE}))\
         .observe(player.shadowRoot.querySelector('.message'), {{ childList: true }}), 0"
    ));
    page.browser.choose_file("#pick", &bad).unwrap();
    let said = "said.includes('bad.dgs is no .dgs stream: `dgs encode` makes one')";
    page.browser.wait(PAGE_TIMEOUT_S, said).unwrap();
    // Once that was read, the page asks again.
    let asks = format!("{MESSAGE} === '' && !document.getElementById('welcome').hidden");
    page.browser.wait(PAGE_TIMEOUT_S, &asks).unwrap();
    page.browser.choose_file("#pick", &good).unwrap();
    page.browser.wait(PAGE_TIMEOUT_S, "player.engine.frames > 0 && player.error === null").unwrap();
    // On a telephone nothing hangs over the edge, and every control has a name.
    page.browser.resize(390, 844).unwrap();
    page.browser
        .wait(PAGE_TIMEOUT_S, "innerWidth === 390 && document.documentElement.scrollWidth <= 390")
        .unwrap();
    let controls = "[...player.shadowRoot.querySelectorAll('.bar > *')]";
    let inside = format!(
        "{controls}.map((c) => c.getBoundingClientRect()).every((r) => r.right <= 390 && r.left >= 0)"
    );
    assert_eq!(page.run(&inside), true);
    page.run("player.shadowRoot.querySelector('.net').click(), 0");
    let parts = ".network :is(label, input, select, output, canvas)";
    let panel = format!(
        "[...player.shadowRoot.querySelectorAll('{parts}')].filter((c) => c.checkVisibility())\
            .map((c) => c.getBoundingClientRect())"
    );
    page.browser.wait(PAGE_TIMEOUT_S, &format!("{panel}.length > 5")).unwrap();
    let over = format!("{panel}.filter((r) => r.right > 390 || r.left < 0).length");
    assert_eq!(page.number(&over), 0.0);
    // The panel covers the lower half of the picture, and not the bar.
    let edges = "(() => { const of = (part) => player.shadowRoot.querySelector(part).getBoundingClientRect();\
        const [panel, bar, all] = [of('.network'), of('.bar'), player.getBoundingClientRect()];\
        return [panel.top - (all.top + all.bottom) / 2, bar.top - panel.bottom, panel.height]; })()";
    let is_clear = format!("{edges}[2] > 100 && {edges}.every((v) => v >= -0.5)");
    page.browser.wait(PAGE_TIMEOUT_S, &is_clear).unwrap();
    page.run("player.toggleNetwork(), 0");
    // Keys are listed in one column, from the first.
    page.browser.resize(390, 400).unwrap();
    page.browser.wait(PAGE_TIMEOUT_S, "innerHeight === 400").unwrap();
    page.browser.press("?").unwrap();
    let list = "(() => { const dialog = player.shadowRoot.querySelector('dialog');\
        const columns = getComputedStyle(dialog.querySelector('dl')).gridTemplateColumns.split(' ').length;\
        const isLonger = dialog.scrollHeight > dialog.clientHeight;\
        return [dialog.open, dialog.scrollTop, isLonger, columns].join(); })()";
    assert_eq!(page.run(list), "true,0,true,1");
    page.browser.press("?").unwrap();
    page.browser.press("b").unwrap();
    page.browser.press("b").unwrap();
    assert_eq!(page.run("player.background"), "#bfbfbf");
    let nameless = "[...player.shadowRoot.querySelectorAll('button, input, select, canvas.picture')].filter(\
        (c) =>\
        !c.ariaLabel && !c.closest('label') && !c.textContent.trim()).length";
    assert_eq!(page.number(nameless), 0.0);
    page.run("player.remove(), 0");
    assert_eq!(page.run("player.session === null && player.engine === null"), true);
    page.close();
}

#[test]
fn without_webgpu_there_is_a_sentence() {
    let Some(mut page) = Page::blank() else { return };
    page.browser
        .before_pages("Object.defineProperty(Navigator.prototype, 'gpu', { get: () => undefined })")
        .unwrap();
    let url = format!("{}?src=streams/small.dgs", page.served.url());
    page.browser.go(&url).unwrap();
    let said = "document.querySelector('dgs-player')?.shadowRoot.querySelector('.message')\
        .textContent.includes('WebGPU')";
    page.browser.wait(PAGE_TIMEOUT_S, said).unwrap();
}

/// Writes the picture of the crate's README.
#[test]
#[ignore = "writes a committed file"]
fn the_picture_of_the_readme() {
    let Some(mut page) = Page::open("src=streams/large.dgs&paused&pixel-ratio=1", SIDE) else { return };
    page.browser.resize(800, 600).unwrap();
    page.run("player.style.cssText = '', player.toggleNetwork(), player.quality = 3, 0");
    page.run("player.impair({ loss: 0.35, burst: 3, seed: 3 }), player.overlay = 'levels', player.home(), 0");
    std::thread::sleep(std::time::Duration::from_secs(20));
    let picture = page.browser.picture(80).unwrap();
    assert!(picture.len() <= 150_000, "{} bytes", picture.len());
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/render-host/viewer/screenshot.jpg");
    std::fs::write(path, picture).unwrap();
}
