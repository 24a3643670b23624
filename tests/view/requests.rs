//! What is requested of a player holds, whenever it is requested, whatever becomes of the element.

use super::{PAGE_TIMEOUT_S, Page, SIDE};

#[test]
fn what_is_requested_before_a_stream_begins_holds_from_its_beginning() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=0.25", SIDE / 4) else {
        return;
    };
    let state =
        "[player.loop, player.playbackRate, player.quality, player.overlay, player.background].join()";
    assert_eq!(page.run(state), "true,1,3,none,#000000");
    // A new player, of which nothing has begun.
    page.run(
        "player.remove(); globalThis.heard = []; globalThis.player = document.createElement('dgs-player');\
         for (const name of ['loadedmetadata', 'play', 'playing', 'pause', 'ended'])\
             player.addEventListener(name, () => heard.push(name));\
         player.setAttribute('pixel-ratio', '0.25'); player.style.cssText = 'width:256px;height:256px';\
         document.body.append(player); player.src = 'streams/small.dgs'; player.play();\
         [player.loop, player.playbackRate, player.quality] = [false, 1.5, 1];\
         [player.overlay, player.background, player.currentTime] = ['levels', '#102030', 0.4];\
         player.impair({ loss: 0.3, seed: 5 }), 0",
    );
    page.browser.wait(PAGE_TIMEOUT_S, "heard.includes('ended')").unwrap();
    assert_eq!(page.run(state), "false,1.5,1,levels,#102030");
    assert_eq!(
        page.run("[player.session.rate, player.session.cap, player.session.looping].join()"),
        "1.5,1,false"
    );
    assert_eq!(page.run("[...new Set(heard)].join()"), "loadedmetadata,play,playing,pause,ended");
    let lost = "player.session.packets()[0] > player.session.packets()[1]";
    assert_eq!(page.run(lost), true, "the network is there from the beginning");
    // Of the next stream, too, but whether it plays and from when; and NaN is no rate.
    page.run(
        "globalThis.old = player.session; player.playbackRate = NaN; player.src = 'streams/large.dgs', 0",
    );
    page.browser.wait(PAGE_TIMEOUT_S, "player.session !== old && heard.at(-1) === 'loadedmetadata'").unwrap();
    assert_eq!(page.run(state), "false,1.5,1,levels,#102030");
    assert_eq!(page.run("player.paused && player.currentTime === 0 && player.session.rate === 1.5"), true);
    // Moved within the page it plays on; an attribute that goes is as if it had never been there.
    page.run("globalThis.old = player.session; document.body.prepend(player), 0");
    assert_eq!(page.run("player.session === old"), true);
    page.run("player.setAttribute('loop', 'false'); player.removeAttribute('loop'), 0");
    assert_eq!(page.run("player.loop && player.session.looping"), true);
    page.run("player.setAttribute('up', 'minus-z'), 0");
    assert_eq!(page.run("player.session.up"), "minus-z");
    // Keys of the open help are its own.
    page.run("globalThis.view = String(player.view); player.showHelp(), 0");
    page.browser.press("ArrowDown").unwrap();
    assert_eq!(page.run("view === String(player.view)"), true);
    page.run("player.showHelp(); player.shadowRoot.querySelector('canvas').focus(), 0");
    page.browser.press("ArrowDown").unwrap();
    assert_eq!(page.run("view === String(player.view)"), false);
    // Elsewhere than in a page there is nothing to play on.
    page.run("player.remove(), 0");
    let open = "(async () => { const file = await (await fetch('streams/small.dgs')).blob();\
        await player.open(file); return player.error.message; })()";
    assert_eq!(page.run(open), "The player is in no page");
    page.close();
}

/// Nobody need click before keys are heard; and who gives the player the focus gives it to the picture.
#[test]
fn keys_are_heard_on_a_page_where_nothing_has_the_focus() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=0.25", SIDE / 4) else {
        return;
    };
    assert_eq!(page.run("document.activeElement === document.body && player.paused"), true);
    page.browser.press(" ").unwrap();
    assert_eq!(page.run("player.paused"), false);
    page.browser.press("o").unwrap();
    assert_eq!(page.run("player.overlay"), "levels");
    page.browser.press("n").unwrap();
    assert_eq!(page.run("player.shadowRoot.querySelector('.network').hidden"), false);
    // A key that is let go is held no longer.
    page.run("globalThis.view = String(player.view), 0");
    page.browser.press("w").unwrap();
    assert_eq!(page.run("view === String(player.view)"), false);
    page.run("globalThis.view = String(player.view), globalThis.shown = 0, 0");
    page.run("requestAnimationFrame(() => requestAnimationFrame(() => (shown = 1))), 0");
    page.browser.wait(PAGE_TIMEOUT_S, "shown === 1").unwrap();
    assert_eq!(page.run("view === String(player.view)"), true);
    let help = "player.shadowRoot.querySelector('dialog').open";
    page.browser.press("?").unwrap();
    assert_eq!(page.run(help), true);
    page.browser.press("?").unwrap();
    assert_eq!(page.run(help), false);
    page.run("document.activeElement.blur(), player.focus(), 0");
    assert_eq!(page.run("player.shadowRoot.activeElement?.className"), "picture");
    page.close();
}

/// Attributes that `<video>` has as properties are properties.
#[test]
fn attributes_are_properties() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=0.25", SIDE / 4) else {
        return;
    };
    assert_eq!(page.run("[player.autoplay, player.controls, player.time].join()"), "false,true,0");
    page.run(
        "player.remove(); globalThis.player = document.createElement('dgs-player');\
         player.style.cssText = 'width:256px;height:256px'; player.setAttribute('pixel-ratio', '0.25');\
         [player.controls, player.loop, player.time] = [true, false, 0.4]; player.time = NaN;\
         document.body.append(player); player.src = 'streams/small.dgs', 0",
    );
    page.browser.wait(PAGE_TIMEOUT_S, "!!player.session").unwrap();
    assert_eq!(
        page.run("[player.getAttribute('time'), player.currentTime, player.paused].join()"),
        "0.4,0.4,true"
    );
    let bar = "getComputedStyle(player.shadowRoot.querySelector('.bar')).display";
    assert_eq!(page.run(bar), "flex");
    page.run(
        "globalThis.old = player.session; [player.controls, player.autoplay] = [false, true];\
        player.src = 'streams/large.dgs', 0",
    );
    assert_eq!(page.run(bar), "none");
    page.browser.wait(PAGE_TIMEOUT_S, "player.session !== old && !player.paused").unwrap();
    page.run("player.autoplay = false, 0");
    assert_eq!(page.run("player.hasAttribute('autoplay')"), false);
    page.close();
}

/// Keys to fly by are held together, faster with Shift, until they are let go or the focus goes.
#[test]
fn keys_that_fly_work_at_once() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=0.25", SIDE / 4) else {
        return;
    };
    page.run(
        "{ const session = player.session; const fly = session.fly.bind(session); globalThis.flown = [];\
           session.fly = (...way) => { flown.push(way); fly(...way); };\
           globalThis.key = (type, key, shiftKey = false) => player.dispatchEvent(\
             new KeyboardEvent(type, { key, shiftKey, bubbles: true, composed: true })); }\
         key('keydown', 'w'), key('keydown', 'd'), 0",
    );
    let both = "flown.some(([right, up, forward]) => right > 0 && up === 0 && forward > 0)";
    page.browser.wait(PAGE_TIMEOUT_S, both).unwrap();
    page.run("key('keyup', 'w'), flown.length = 0, 0");
    page.browser.wait(PAGE_TIMEOUT_S, "flown.length > 2").unwrap();
    assert_eq!(page.run("flown.slice(1).every(([right, , forward]) => right > 0 && forward === 0)"), true);
    page.run("key('keydown', 'D', true), key('keyup', 'D', true), flown.length = 0, 0");
    // One more picture, in which nothing flies.
    page.run(
        "globalThis.shown = 0, requestAnimationFrame(() => requestAnimationFrame(() => (shown = 1))), 0",
    );
    page.browser.wait(PAGE_TIMEOUT_S, "shown === 1").unwrap();
    assert_eq!(page.number("flown.length"), 0.0);
    page.run("key('keydown', 'q'), player.dispatchEvent(new FocusEvent('focusout')), 0");
    page.run("flown.length = 0, shown = 0, 0");
    page.run("requestAnimationFrame(() => requestAnimationFrame(() => (shown = 1))), 0");
    page.browser.wait(PAGE_TIMEOUT_S, "shown === 1").unwrap();
    assert_eq!(page.number("flown.length"), 0.0, "without the focus, keys are no longer held");
    page.close();
}

/// What is not allowed is refused by its name, and changes nothing.
#[test]
fn what_is_out_of_range_is_refused() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=0.25", SIDE / 4) else {
        return;
    };
    page.run(
        "globalThis.refused = async (act) => {\
             try { await act(); } catch ({ name, message }) { return `${name} ${message}`; } }, 0",
    );
    let levels = "whole numbers from 0 to 3 are allowed";
    let schedulers = "\"\" (the server's own), layered, dash, dependency, deadline-utility, \
                      deadline-utility-paper are allowed";
    for (act, name, found, allowed) in [
        ("player.quality = 'high'", "quality", "high", levels),
        ("player.quality = 4", "quality", "4", levels),
        ("player.session.cap = 1.5", "cap", "1.5", levels),
        ("player.impair({ scheduler: 'layerd' })", "scheduler", "layerd", schedulers),
        ("player.impair({ loss: 0.95 })", "loss", "0.95", "0 to 0.9 are allowed"),
        (
            "player.impair({ rate: 500 })",
            "rate",
            "500",
            "1000 to 1000000000 bit/s, or 0 for no limit, are allowed",
        ),
        ("player.session.impair({ burst: 101 })", "burst", "101", "1 to 100 packets are allowed"),
        ("player.session.setConditions({ delay: 2 })", "delay", "2", "0 to 1 seconds are allowed"),
    ] {
        let said = page.run(&format!("refused(() => {act})"));
        assert_eq!(said, format!("RangeError {name}: {found}; {allowed}"), "{act}");
    }
    page.run("player.setAttribute('quality', 'low'), 0");
    assert_eq!(page.run("player.error.message"), format!("quality: low; {levels}"));
    assert_eq!(page.run("[player.quality, player.session.cap].join()"), "3,3");
    assert_eq!(page.run("player.shadowRoot.querySelector('.loss').value"), "0");
    // A slider changes its own number alone, however coarse the others are.
    page.run(
        "{ const real = player.session.setConditions.bind(player.session);\
           player.session.setConditions = (given) => ((globalThis.wanted = given), real(given));\
         } player.impair({ loss: 0.705, burst: 60, rate: 123456789, delay: 1, seed: 1000 }).then(() => 0)",
    );
    page.run(
        "{ const delay = player.shadowRoot.querySelector('.delay'); globalThis.most = delay.value;\
           delay.value = 100; delay.dispatchEvent(new Event('input', { bubbles: true })); } 0",
    );
    assert_eq!(page.run("most"), "1000", "sliders reach what is allowed");
    // It is the delay of one way, and says what that makes of a round trip.
    let delay =
        "[...player.shadowRoot.querySelector('.delay').labels].map((label) => label.textContent).join()";
    assert_eq!(page.run(delay), "Delay, one way 100 ms\nRTT +100");
    let wanted = "['loss', 'burst', 'rate', 'delay', 'seed'].map((name) => wanted[name]).join()";
    assert_eq!(page.run(wanted), "0.705,60,123456789,0.1,1000");
    // So many are not lost in shorter runs.
    page.run("player.impair({ loss: 0.9, burst: 4 }).then(() => 0)");
    assert_eq!(page.run("player.shadowRoot.querySelector('.burst + output').textContent"), "9 packets");
    let url = format!("{}?transport=foo", page.served.url());
    page.browser.go(&url).unwrap();
    let failed = "(globalThis.player = document.querySelector('dgs-player'))?.error?.message ===\
        'transport: foo; live, streams, websocket, file are allowed'";
    page.browser.wait(PAGE_TIMEOUT_S, failed).unwrap();
    page.close();
}

/// A link to an instant goes there, as often as it is followed; without one nothing is gone to.
#[test]
fn a_time_that_is_set_again_is_gone_to_again() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=0.25", SIDE / 4) else {
        return;
    };
    for _ in 0..2 {
        page.run("player.currentTime = 0.8, 0");
        page.browser.wait(PAGE_TIMEOUT_S, "location.hash.includes('t=0.800')").unwrap();
        page.run("location.hash = 't=0.4', 0");
        page.browser.wait(PAGE_TIMEOUT_S, "player.currentTime === 0.4").unwrap();
    }
    page.run("player.removeAttribute('time'), 0");
    assert_eq!(page.run("[player.currentTime, player.time].join()"), "0.4,0");
    // A view that is kept is forgotten.
    page.run("player.view = player.view.map((number) => -number), player.view = null, player.remove(), 0");
    assert_eq!(page.run("player.session === null && player.view === null"), true);
    page.close();
}

/// A slider that was used has the focus, and its own keys alone; a list has all of them until something is
/// chosen from it by a pointer.
#[test]
fn keys_are_heard_where_a_control_has_the_focus() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=0.25", SIDE / 4) else {
        return;
    };
    page.run(
        "globalThis.part = (name) => player.shadowRoot.querySelector(`.${name}`);\
         player.style.width = '640px', part('time').focus(), globalThis.view = String(player.view), 0",
    );
    page.browser.press("o").unwrap();
    assert_eq!(page.run("player.overlay"), "levels");
    page.browser.press(" ").unwrap();
    assert_eq!(page.run("player.paused"), false);
    page.browser.press(" ").unwrap();
    assert_eq!(page.run("player.paused"), true);
    page.browser.press("ArrowRight").unwrap();
    assert_eq!(page.run("view === String(player.view)"), true);
    page.run("part('speed').focus(), 0");
    page.browser.press("o").unwrap();
    assert_eq!(page.run("player.overlay"), "levels");
    // Whether keys have chosen shows by the frame around the list.
    for (by_keys, focus) in [("true", "speed"), ("false", "picture")] {
        page.run(&format!(
            "{{ const list = part('speed'); list.matches = () => {by_keys}; list.value = '2';\
               list.dispatchEvent(new Event('change', {{ bubbles: true }})); }} 0"
        ));
        assert_eq!(page.run("player.shadowRoot.activeElement.className"), focus);
    }
    assert_eq!(page.run("player.playbackRate"), 2);
    page.close();
}

/// Whoever goes by frames has stopped the clip, and hears so.
#[test]
fn a_step_stops_the_clip() {
    let Some(mut page) = Page::open("src=streams/small.dgs&paused&pixel-ratio=0.25", SIDE / 4) else {
        return;
    };
    page.run(
        "globalThis.heard = []; for (const name of ['play', 'pause', 'seeked'])\
           player.addEventListener(name, () => heard.push(name));\
         player.play(), player.step(1), player.step(1), 0",
    );
    assert_eq!(page.run("heard.join()"), "play,seeked,pause,seeked");
    assert_eq!(page.run("player.paused"), true);
    page.close();
}
