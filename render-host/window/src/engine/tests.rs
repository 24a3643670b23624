//! An engine is fed, steered and drawn without a window.

use std::fs;

use dgs_viewer::{FIRST_BYTES, Overlay};
use render_host::{
    Image,
    gpu::{Device, DeviceOptions},
};

use super::*;
use crate::feed;

const SIZE: [u32; 2] = [64, 48];

fn file() -> Vec<u8> {
    let path = format!("{}/../../codec-core/tests/conformance/everything.dgs", env!("CARGO_MANIFEST_DIR"));
    fs::read(path).unwrap()
}

/// A file without stand-ins: nothing of it is seen before its base has come.
fn bare_file() -> Vec<u8> {
    let path = format!("{}/../../codec-core/tests/conformance/paper.dgs", env!("CARGO_MANIFEST_DIR"));
    fs::read(path).unwrap()
}

fn options() -> WindowOptions {
    WindowOptions {
        name: "fox".into(),
        size: SIZE,
        background: [0.0; 3],
        up: None,
        cap: 3,
        overlay: Overlay::None,
        time_s: 0.0,
        playing: true,
        fullscreen: false,
        closes: false,
        schedulers: vec!["layered", "deadline-utility"],
    }
}

#[test]
fn the_clock_follows_time_and_stands_while_nothing_is_seen() {
    let mut engine = Engine::new(options(), Feed::file(file()));
    assert!(engine.tick(0.0, None, SIZE).unwrap().is_some());
    let interval = 1.0 / engine.session.as_ref().unwrap().player().manifest().frames_per_second();
    engine.tick(0.5 * interval, None, SIZE).unwrap();
    let time = |engine: &Engine| engine.session.as_ref().unwrap().playback().time_s();
    assert!((time(&engine) - 0.5 * interval).abs() < 1e-9);
    engine.hide(SIZE).unwrap();
    engine.tick(100.0, None, SIZE).unwrap();
    assert!((time(&engine) - 0.5 * interval).abs() < 1e-9);
    engine.act(Act::Toggle, SIZE).unwrap();
    assert_eq!(engine.tick(101.0, None, SIZE).unwrap(), None, "a paused window sleeps");
}

#[test]
fn a_file_comes_in_pieces_as_it_is_wished_for() {
    let file = file();
    let (feeder, feed) = feed();
    let mut engine = Engine::new(options(), feed);
    let first = file[..file.len().min(FIRST_BYTES as usize) / 2].to_vec();
    let length = file.len() as u64;
    feeder.arrivals.send(Arrival::Front { bytes: first, length }).unwrap();
    engine.tick(0.0, None, SIZE).unwrap();
    let mut requests = 0;
    while let Ok(FeedRequest::Bytes(range)) = feeder.requests.try_recv() {
        let bytes = file[range.start as usize..range.end as usize].to_vec();
        feeder.arrivals.send(Arrival::Piece { at: range.start, bytes }).unwrap();
        engine.tick(0.0, None, SIZE).unwrap();
        requests += 1;
    }
    let session = engine.session.as_ref().unwrap();
    assert!(requests > 0 && session.loaded() == 1.0, "{requests} requests");
    assert_eq!(session.packets().0, Session::open(&file).unwrap().0.packets().0);
}

/// Where a stream that grows begins, its server says; and who pauses it stays.
#[test]
fn a_stream_that_grows_is_shown_from_where_it_begins_and_once() {
    let (feeder, feed) = feed();
    let mut engine = Engine::new(WindowOptions { playing: false, ..options() }, feed);
    let stream = dgs_player::Stream::from_bytes(&file()).unwrap().0;
    let begun = |engine: &mut Engine, time_s: f64| {
        feeder.arrivals.send(Arrival::Begin(time_s)).unwrap();
        engine.tick(0.0, None, SIZE).unwrap();
        engine.session.as_ref().map(|session| session.playback().time_s())
    };
    assert_eq!(begun(&mut engine, 0.5), None, "of no stream");
    feeder.arrivals.send(Arrival::Manifest(stream.message().to_vec())).unwrap();
    assert_eq!(begun(&mut engine, 0.5), Some(0.5));
    assert_eq!(begun(&mut engine, 0.7), Some(0.5), "paused");
    engine.act(Act::Toggle, SIZE).unwrap();
    assert_eq!(begun(&mut engine, 0.7), Some(0.7));
    assert!(!engine.session.as_ref().unwrap().playback().looping());
    // At its end nobody has paused it: what comes after all is shown.
    engine.session.as_mut().unwrap().playback_mut().seek(f64::MAX);
    engine.tick(0.1, None, SIZE).unwrap();
    assert!(!engine.session.as_ref().unwrap().playback().playing());
    assert_eq!(begun(&mut engine, 0.6), Some(0.6));
    assert!(engine.session.as_ref().unwrap().playback().playing());
    // Another one begins anew, and a file repeats.
    engine.play("other".into(), Feed::file(file()));
    engine.tick(0.0, None, SIZE).unwrap();
    let playback = engine.session.as_ref().unwrap().playback();
    assert!(playback.looping() && playback.time_s() == 0.0 && !engine.begun);
}

/// What there was nothing of at first is looked at when it has come.
#[test]
fn the_camera_finds_what_comes_in_pieces() {
    let file = bare_file();
    let (mut whole, _) = Session::open(&file).unwrap();
    options().apply(&mut whole, SIZE).unwrap();
    let (feeder, feed) = feed();
    let mut engine = Engine::new(options(), feed);
    let (first, length) = (file[..2000].to_vec(), file.len() as u64);
    feeder.arrivals.send(Arrival::Front { bytes: first, length }).unwrap();
    engine.tick(0.0, None, SIZE).unwrap();
    let view = |engine: &Engine| engine.session.as_ref().unwrap().orbit().numbers();
    assert_eq!(view(&engine)[3..], [0.0; 3]);
    while let Ok(FeedRequest::Bytes(range)) = feeder.requests.try_recv() {
        let bytes = file[range.start as usize..range.end as usize].to_vec();
        feeder.arrivals.send(Arrival::Piece { at: range.start, bytes }).unwrap();
        engine.tick(0.0, None, SIZE).unwrap();
    }
    assert_eq!(view(&engine), whole.orbit().numbers());
}

#[test]
fn a_feed_that_ends_before_anything_came_says_why_and_later_only_complains() {
    let (feeder, feed) = feed();
    let mut engine = Engine::new(options(), feed);
    feeder.arrivals.send(Arrival::End(Some("the server is gone".into()))).unwrap();
    let error = engine.tick(0.0, None, SIZE).unwrap_err();
    assert_eq!(error.to_string(), "the server is gone");
    feeder.arrivals.send(Arrival::File(file())).unwrap();
    feeder.arrivals.send(Arrival::End(Some("the server is gone".into()))).unwrap();
    engine.tick(0.0, None, SIZE).unwrap();
    assert_eq!(engine.complaints(), ["the server is gone"]);
    assert!(Engine::new(options(), Feed::file(b"no stream".to_vec())).tick(0.0, None, SIZE).is_err());
}

#[test]
fn less_is_drawn_where_pictures_come_late_and_all_of_it_where_nothing_moves() {
    let Some(mut screen) = screen() else { return };
    let mut engine = Engine::new(options(), Feed::file(file()));
    // A window whose turns come every fifth of a second.
    let mut now_s = 0.0;
    let mut turn = |engine: &mut Engine, times: u32| {
        for _ in 0..times {
            now_s += 0.2;
            engine.tick(now_s, Some(&mut screen), SIZE).unwrap();
            while screen.pending() > 0 {
                std::thread::yield_now();
            }
        }
    };
    turn(&mut engine, 21);
    assert!(engine.keep_up.reduction().scale < 1.0, "{:?}", engine.keep_up);
    assert!(engine.title().contains(" · keeping up with "), "{}", engine.title());
    turn(&mut engine, 80);
    assert_eq!(engine.keep_up.reduction().share, 0.25);
    // How many Gaussians are drawn, and how many there are in that frame.
    let drawn = |engine: &mut Engine| {
        let (mut whole, _) = Session::open(&file()).unwrap();
        let session = engine.session.as_mut().unwrap();
        whole.playback_mut().seek(session.playback().time_s());
        (session.show().unwrap().splats.len(), whole.show().unwrap().splats.len())
    };
    let is_whole = |(some, all): (usize, usize)| some == all;
    let is_quarter = |(some, all): (usize, usize)| some == all.div_ceil(4);
    assert!(is_quarter(drawn(&mut engine)));
    // What stands is whole, and what goes on again is not.
    engine.act(Act::Toggle, SIZE).unwrap();
    turn(&mut engine, 1);
    assert!(is_whole(drawn(&mut engine)));
    assert!(!engine.title().contains("keeping up"), "{}", engine.title());
    engine.act(Act::Toggle, SIZE).unwrap();
    turn(&mut engine, 1);
    assert!(is_quarter(drawn(&mut engine)));
    // Whoever wants all of it has it.
    engine.act(Act::KeepUp, SIZE).unwrap();
    turn(&mut engine, 20);
    assert!(is_whole(drawn(&mut engine)));
    assert!(engine.title().ends_with(" · always whole"), "{}", engine.title());
    // Another stream begins with all of it.
    engine.act(Act::KeepUp, SIZE).unwrap();
    turn(&mut engine, 20);
    engine.play("other".into(), Feed::file(file()));
    turn(&mut engine, 1);
    assert!(is_whole(drawn(&mut engine)));
}

#[test]
fn a_server_hears_where_the_camera_is_once_and_again_when_it_moves() {
    let (feeder, feed) = feed();
    let mut engine = Engine::new(options(), feed);
    let (session, _) = Session::open(&file()).unwrap();
    let stream = dgs_player::Stream::from_bytes(&file()).unwrap().0;
    feeder.arrivals.send(Arrival::Manifest(stream.message().to_vec())).unwrap();
    let said = |engine: &mut Engine, at: f64| -> Vec<ViewerPose> {
        engine.tick(at, None, SIZE).unwrap();
        let requests = feeder.requests.try_iter();
        requests
            .filter_map(|request| if let FeedRequest::Sight(pose) = request { Some(pose) } else { None })
            .collect()
    };
    let first = said(&mut engine, 0.0);
    assert_eq!((first.len(), said(&mut engine, 0.1).len()), (1, 0));
    engine.act(Act::Turn(30.0, 0.0), SIZE).unwrap();
    let second = said(&mut engine, 0.2);
    assert!(second.len() == 1 && second != first);
    // A file has no sender.
    assert!(!session.is_live());
}

#[test]
fn a_server_emulates_the_network_that_is_wished_for_or_the_window_does() {
    let (feeder, feed) = feed();
    let mut engine = Engine::new(options(), feed);
    let stream = dgs_player::Stream::from_bytes(&file()).unwrap().0;
    feeder.arrivals.send(Arrival::Manifest(stream.message().to_vec())).unwrap();
    let packets = stream.packets().iter().map(|packet| Arrival::Packet(packet.clone()));
    packets.for_each(|packet| feeder.arrivals.send(packet).unwrap());
    engine.tick(0.0, None, SIZE).unwrap();
    let here = |engine: &Engine| engine.session.as_ref().unwrap().conditions();
    let bytes = |engine: &Engine| engine.session.as_ref().unwrap().delivered_bytes();
    let all = bytes(&engine);
    for loss in [0.05, 0.1] {
        engine.act(Act::Loss(0.05), SIZE).unwrap();
        let requests: Vec<_> = feeder.requests.try_iter().collect();
        let requested = requests.iter().find_map(|request| {
            if let FeedRequest::Network { conditions, .. } = request { *conditions } else { None }
        });
        assert!(
            requested.is_some_and(|it| it.loss == loss) && requests.contains(&FeedRequest::From(0.0)),
            "{requests:?}"
        );
        assert!(engine.title().contains(&format!("{:.0} % of packets lost", 100.0 * loss)));
        assert!(here(&engine).is_perfect(), "until it has answered");
    }
    feeder.arrivals.send(Arrival::Network { by_server: true, by_scheduler: false }).unwrap();
    feeder.arrivals.send(Arrival::Anew).unwrap();
    engine.tick(0.0, None, SIZE).unwrap();
    assert!(here(&engine).is_perfect() && all > 0 && bytes(&engine) == 0);
    feeder.arrivals.send(Arrival::Network { by_server: false, by_scheduler: false }).unwrap();
    engine.tick(0.0, None, SIZE).unwrap();
    assert_eq!(here(&engine).loss, 0.1);
}

/// A key goes through the schedulers of the server, whose link stays as it is, and back to its own.
#[test]
fn a_server_may_choose_packets_by_another_scheduler() {
    let (feeder, feed) = feed();
    let mut engine = Engine::new(options(), feed);
    let stream = dgs_player::Stream::from_bytes(&file()).unwrap().0;
    feeder.arrivals.send(Arrival::Manifest(stream.message().to_vec())).unwrap();
    engine.tick(0.0, None, SIZE).unwrap();
    let act = Act::of(&winit::keyboard::Key::Character("p".into()), false).unwrap();
    let press = |engine: &mut Engine| {
        engine.act(act, SIZE).unwrap();
        let requests: Vec<_> = feeder.requests.try_iter().collect();
        assert!(requests.contains(&FeedRequest::From(0.0)), "{requests:?}");
        requests.into_iter().find(|request| matches!(request, FeedRequest::Network { .. })).unwrap()
    };
    let request = |scheduler| FeedRequest::Network { conditions: None, scheduler };
    for (scheduler, name) in [("layered", " · layered"), ("deadline-utility", " · deadline-utility")] {
        assert_eq!(press(&mut engine), request(Some(scheduler)));
        feeder.arrivals.send(Arrival::Network { by_server: true, by_scheduler: true }).unwrap();
        engine.tick(0.0, None, SIZE).unwrap();
        assert!(engine.title().ends_with(name), "{}", engine.title());
    }
    assert_eq!(press(&mut engine), request(None));
    assert!(engine.title().ends_with("frames/s"), "{}", engine.title());
    // What is not granted is said and no longer shown; a file has no server.
    press(&mut engine);
    feeder.arrivals.send(Arrival::Network { by_server: true, by_scheduler: false }).unwrap();
    engine.tick(0.0, None, SIZE).unwrap();
    assert!(engine.title().ends_with("frames/s") && engine.complaints[0].contains("does not grant layered"));
    let (feeder, feed) = crate::feed();
    let mut engine = Engine::new(options(), feed);
    feeder.arrivals.send(Arrival::File(file())).unwrap();
    engine.tick(0.0, None, SIZE).unwrap();
    feeder.requests.try_iter().for_each(drop);
    engine.act(act, SIZE).unwrap();
    assert_eq!(feeder.requests.try_iter().count(), 0);
}

/// A screen in memory; `None` on a machine without any driver, which in CI is a failure.
fn screen() -> Option<Screen> {
    match Device::open(&DeviceOptions::from_env()) {
        Ok(device) => Some(Screen::in_memory(device).unwrap()),
        Err(error) => {
            assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "{error}");
            eprintln!("SKIPPED: {error}");
            None
        }
    }
}

/// What is on `screen` once `engine` has nothing more to draw.
fn settled(engine: &mut Engine, screen: &mut Screen) -> Image {
    for _ in 0..4 {
        engine.tick(0.0, Some(screen), SIZE).unwrap();
        if let Some(image) = screen.read().unwrap() {
            return image;
        }
    }
    panic!("nothing was drawn")
}

#[test]
fn another_device_shows_what_the_lost_one_did_and_what_has_not_changed_is_drawn_once() {
    let Some(mut first) = screen() else { return };
    let mut engine = Engine::new(WindowOptions { playing: false, ..options() }, Feed::file(file()));
    let before = settled(&mut engine, &mut first);
    let frames = engine.frames();
    engine.tick(1.0, Some(&mut first), SIZE).unwrap();
    assert_eq!(engine.frames(), frames);
    first.destroy();
    let _ = first.pending();
    assert!(first.is_lost());
    let Some(mut second) = screen() else { return };
    engine.forget();
    assert_eq!(settled(&mut engine, &mut second).rgb(), before.rgb());
    // The comparison can fail: another background.
    engine.act(Act::Background, SIZE).unwrap();
    assert_ne!(settled(&mut engine, &mut second).rgb(), before.rgb());
}

/// Fewer pixels, scaled up, are the same picture but for what is between them.
#[test]
fn a_picture_of_fewer_pixels_fills_the_window() {
    let Some(mut screen) = screen() else { return };
    let (mut session, _) = Session::open(&file()).unwrap();
    options().apply(&mut session, SIZE).unwrap();
    let mut picture = |scale: f64| {
        let size = SIZE.map(|side| (f64::from(side) * scale) as u32);
        let look = DrawOptions { size, shown: SIZE, background: [0.0; 3], sh_degree: 3 };
        (0..4).find_map(|_| {
            screen.draw(&mut session, &mut None, &look).unwrap();
            screen.read().unwrap()
        })
    };
    let (whole, scaled) = (picture(1.0).unwrap(), picture(0.5).unwrap());
    assert_eq!([scaled.width(), scaled.height()], SIZE);
    let db = render_host::metric::psnr(&whole, &scaled).unwrap();
    assert!((20.0..60.0).contains(&db), "{db} dB");
}
