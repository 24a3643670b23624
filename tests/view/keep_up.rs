//! A player whose pictures come late leaves something out, says what, and shows all where nothing moves.

use super::{
    MIN_DB, PAGE_TIMEOUT_S, Page, SIDE,
    served::{SMALL, stream},
};

/// A page that has too much to do: each turn of it takes a ninth of a second.
const BUSY: &str = "globalThis.busy = true; { const turn = () => { const end = performance.now() + 110;\
    while (performance.now() < end); if (busy) requestAnimationFrame(turn); }; turn(); } 0";
/// What is said on the picture.
const SAID: &str = "player.shadowRoot.querySelector('.reduced').textContent";
const WIDTH: &str = "player.shadowRoot.querySelector('canvas').width";

#[test]
fn it_keeps_up_by_drawing_less_and_shows_the_whole_where_it_stands() {
    let Some(mut page) = Page::open_alone("src=streams/small.dgs&paused", SIDE) else { return };
    assert_eq!(page.run(SAID), "");
    page.run(BUSY);
    page.run("player.play(), 0");
    // Pixels come first: how many of them, the machine says.
    let pixels = format!("/^Keeping up with (56|25) % of the pixels$/.test({SAID}) && {WIDTH} < {SIDE}");
    page.browser.wait(PAGE_TIMEOUT_S, &pixels).unwrap();
    // Its Gaussians have one colour from all sides, so the steps of harmonics are none.
    let last = "'Keeping up with 25 % of the pixels, levels up to 1, 25 % of the Gaussians'";
    page.browser.wait(PAGE_TIMEOUT_S, &format!("{SAID} === {last}")).unwrap();
    page.browser.wait(PAGE_TIMEOUT_S, &format!("{WIDTH} === {}", SIDE / 2)).unwrap();
    assert_eq!(page.run("player.quality"), 3, "what is requested stays");
    // What stands is whole.
    page.run("player.pause(), player.currentTime = 0.5, 0");
    page.browser.wait(PAGE_TIMEOUT_S, &format!("{SAID} === '' && {WIDTH} === {SIDE}")).unwrap();
    let mut player = stream(SMALL).receive().unwrap();
    let db = page.agreement(&mut player, [0.0; 3]);
    assert!(db >= MIN_DB, "{db} dB");
    page.run("player.play(), 0");
    page.browser.wait(PAGE_TIMEOUT_S, &format!("{SAID} === {last}")).unwrap();
    // Whoever wants all of it has it, by a key and by a button.
    let pressed = "player.shadowRoot.querySelector('.adapt').getAttribute('aria-pressed')";
    page.browser.press("r").unwrap();
    page.browser.wait(PAGE_TIMEOUT_S, &format!("{SAID} === '' && {WIDTH} === {SIDE}")).unwrap();
    assert_eq!(
        page.run(&format!("[player.adaptive, player.getAttribute('adapt'), {pressed}].join()")),
        "false,off,false"
    );
    page.run("globalThis.begun = performance.now(), 0");
    page.browser.wait(PAGE_TIMEOUT_S, "performance.now() > begun + 3000").unwrap();
    assert_eq!(page.run(SAID), "");
    page.run("player.shadowRoot.querySelector('.adapt').click(), 0");
    assert_eq!(page.run(&format!("[player.adaptive, {pressed}].join()")), "true,true");
    page.browser.wait(PAGE_TIMEOUT_S, &format!("{SAID} !== ''")).unwrap();
    page.run("busy = false, 0");
    page.close();
}

/// A fixed number of pixels stays; all else may be left out. A camera that moves counts as what plays does.
#[test]
fn pixels_that_are_fixed_stay_and_a_moving_camera_counts_as_playing() {
    let Some(mut page) = Page::open_alone("src=streams/small.dgs&paused&pixel-ratio=0.5", SIDE / 2) else {
        return;
    };
    page.run(BUSY);
    page.run(
        "globalThis.turning = setInterval(() => {\
             player.session.turn(3, 0, 256); player.engine.request(); }, 20), 0",
    );
    page.browser.wait(PAGE_TIMEOUT_S, &format!("{SAID}.endsWith('25 % of the Gaussians')")).unwrap();
    assert_eq!(page.run(SAID), "Keeping up with levels up to 1, 25 % of the Gaussians");
    assert_eq!(page.number(WIDTH), f64::from(SIDE / 2));
    page.run("clearInterval(turning), busy = false, 0");
    page.browser.wait(PAGE_TIMEOUT_S, &format!("{SAID} === '' && player.session.settled")).unwrap();
    assert_eq!(page.run("player.session.drawn.share"), 1);
    page.close();
}
