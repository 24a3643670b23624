//! A session shows what its packets allow, whatever the cap, the overlay and the network.

use codec_core::internals::wire::{crc::crc32, receipt::Receipt};

use render_host::{Gaussian, Settings, render};

use super::{overlay::SH0, *};

const FILE: &[u8] = include_bytes!("../../../../codec-core/tests/conformance/everything.dgs");
/// One without stand-ins: nothing of it is seen before a packet has come.
const BARE_FILE: &[u8] = include_bytes!("../../../../codec-core/tests/conformance/paper.dgs");

fn session() -> Session {
    let (session, damage) = Session::open(FILE).unwrap();
    assert!(damage.is_none());
    session
}

fn shown(session: &mut Session) -> Vec<Gaussian> {
    session.show().unwrap().splats.gaussians().to_vec()
}

#[test]
fn it_shows_what_a_player_decodes() {
    let (mut session, (mut player, _)) = (session(), Player::open(FILE).unwrap());
    let frames = player.info().frames;
    for frame in 0..frames {
        let time = (f64::from(frame) + 0.5) / f64::from(frames) * session.playback().duration_s();
        session.playback_mut().seek(time);
        assert_eq!(session.playback().frame(), frame);
        assert_eq!(shown(&mut session), player.frame(frame).unwrap().gaussians, "frame {frame}");
    }
}

#[test]
fn a_cap_leaves_finer_levels_out_and_gives_them_back() {
    let mut session = session();
    let whole = shown(&mut session);
    session.set_cap(0);
    let base = shown(&mut session);
    assert_eq!(base.len(), whole.len());
    assert_ne!(base, whole);
    session.set_cap(99);
    assert_eq!(shown(&mut session), whole);
    assert_eq!(session.cap(), 3);
}

#[test]
fn the_overlay_paints_blocks_and_moves_nothing() {
    let mut session = session();
    let plain = shown(&mut session);
    session.set_overlay(Overlay::Levels);
    let painted = shown(&mut session);
    assert!(plain.iter().zip(&painted).all(|(a, b)| a.position == b.position && a.opacity == b.opacity));
    let finest = LEVEL_COLOURS[LEVELS].map(|c| (c - 0.5) / SH0);
    assert!(painted.iter().any(|gaussian| gaussian.sh0 == finest));
    session.impair(Conditions { loss: 0.9, seed: 3, ..Conditions::default() }).unwrap();
    session.deliver(0.0);
    let proxy = LEVEL_COLOURS[0].map(|c| (c - 0.5) / SH0);
    assert!(shown(&mut session).iter().any(|gaussian| gaussian.sh0 == proxy));
}

fn painted(session: &mut Session, overlay: Overlay) -> Vec<[f32; 3]> {
    session.set_overlay(overlay);
    shown(session).iter().map(|gaussian| gaussian.sh0.map(|c| 0.5 + SH0 * c)).collect()
}

#[test]
fn what_has_just_come_is_bright_for_a_second() {
    let mut session = session();
    let is_bright = |colour: &&[f32; 3]| colour[0] > 0.9;
    let bright = |session: &mut Session| {
        let colours: Vec<_> = shown(session).iter().map(|g| g.sh0.map(|c| 0.5 + SH0 * c)).collect();
        colours.iter().filter(is_bright).count()
    };
    assert_eq!(painted(&mut session, Overlay::Arrivals).iter().filter(is_bright).count(), 0, "of old");
    assert!(!session.deliver(0.0));
    // Bases first, all else half a second later.
    let rate_bps = Some(8.0 * FILE.len() as f64);
    session.impair(Conditions { rate_bps, ..Conditions::default() }).unwrap();
    session.deliver(1.0);
    assert_eq!(bright(&mut session), 0, "what is there at first is no news");
    session.deliver(1.4);
    let grown = bright(&mut session);
    assert!(grown > 0);
    assert!(session.deliver(1.5), "colours change with time");
    let before = session.content();
    session.deliver(9.0);
    shown(&mut session);
    assert!(session.content() > before);
    session.deliver(11.0);
    assert_eq!(bright(&mut session), 0);
    assert!(!session.deliver(12.0));
}

#[test]
fn what_has_just_come_gets_dark_where_the_clip_stands() {
    let stream = Stream::from_bytes(FILE).unwrap().0;
    let mut session = Session::new(stream.message()).unwrap();
    session.set_live();
    let bright = |session: &mut Session| {
        shown(session).iter().filter(|gaussian| 0.5 + SH0 * gaussian.sh0[0] > 0.9).count()
    };
    session.set_overlay(Overlay::Arrivals);
    assert_eq!(bright(&mut session), 0);
    assert!(!session.fading());
    stream.packets().iter().for_each(|packet| session.push(packet));
    assert!(!session.deliver(5.0), "everything is through");
    assert!(bright(&mut session) > 0);
    // Nothing comes any more, and still there is something to show: up to a picture without any bright block.
    assert!(session.fading() && session.deliver(5.9));
    shown(&mut session);
    let before = session.content();
    assert!(session.fading() && session.deliver(7.0));
    assert!(session.content() > before);
    assert_eq!(bright(&mut session), 0);
    assert!(!session.fading() && !session.deliver(7.1));
}

#[test]
fn what_is_missing_is_bright_by_what_it_would_add_and_moves_nothing() {
    let mut session = session();
    let plain = shown(&mut session);
    let brightness = |colours: &[[f32; 3]]| -> Vec<f32> {
        colours.iter().map(|colour| colour.iter().sum::<f32>()).collect()
    };
    let most = |values: &[f32]| values.iter().copied().fold(0.0, f32::max);
    let dark = brightness(&painted(&mut session, Overlay::Missing));
    assert!((most(&dark) - 0.45).abs() < 1e-3, "nothing is missing: {}", most(&dark));
    let after = shown(&mut session);
    assert!(plain.iter().zip(&after).all(|(a, b)| a.position == b.position && a.scale == b.scale));
    // Half is lost: what misses more levels of the same block is brighter, and nothing is darker than before.
    session.impair(Conditions { loss: 0.5, seed: 2, ..Conditions::default() }).unwrap();
    session.deliver(0.0);
    let half = brightness(&painted(&mut session, Overlay::Missing));
    assert!(most(&half) > most(&dark) + 0.3, "{}", most(&half));
    session.impair(Conditions { loss: 1.0, ..Conditions::default() }).unwrap();
    session.deliver(0.0);
    let none = brightness(&painted(&mut session, Overlay::Missing));
    assert!((most(&none) - 2.53).abs() < 1e-3, "the block that covers most is at the end: {}", most(&none));
    session.impair(Conditions::default()).unwrap();
    assert_eq!(painted(&mut session, Overlay::None).len(), plain.len());
    assert_eq!(shown(&mut session), plain);
    assert_eq!(Overlay::ALL.map(Overlay::next)[3], Overlay::None);
}

#[test]
fn bytes_are_counted_where_the_network_lets_them_through() {
    let mut session = session();
    let all = session.delivered_bytes();
    assert!(all > 0);
    session.impair(Conditions { loss: 0.5, seed: 2, ..Conditions::default() }).unwrap();
    assert_eq!(session.delivered_bytes(), 0);
    session.deliver(0.0);
    assert!((1..all).contains(&session.delivered_bytes()));
}

#[test]
fn a_network_thins_and_its_end_gives_everything_back() {
    let mut session = session();
    let whole = shown(&mut session);
    let all = session.levels().unwrap();
    assert_eq!(all[0], 0, "{all:?}");
    session.impair(Conditions { loss: 0.6, seed: 5, ..Conditions::default() }).unwrap();
    assert!(!session.deliver(1.0), "without a rate everything is sent at once");
    let thinned = session.levels().unwrap();
    assert!(thinned[0] > 0 && thinned.iter().sum::<u32>() == all.iter().sum::<u32>(), "{thinned:?}");
    assert_ne!(shown(&mut session), whole);
    session.impair(Conditions::default()).unwrap();
    assert_eq!(shown(&mut session), whole);
}

#[test]
fn a_rate_delivers_over_time() {
    let mut session = session();
    let (came, _) = session.packets();
    session.impair(Conditions { rate_bps: Some(8.0 * FILE.len() as f64), ..Conditions::default() }).unwrap();
    assert!(session.deliver(10.0));
    assert!(session.deliver(10.5));
    let (_, decoded) = session.packets();
    assert!(decoded > 0 && decoded < came, "{decoded} of {came}");
    assert!(!session.deliver(11.5));
}

/// What a server sends takes as long as it would over the network, whenever it comes.
#[test]
fn a_network_delays_each_packet_of_a_server() {
    let stream = Stream::from_bytes(FILE).unwrap().0;
    let packets: Vec<_> = stream.packets().iter().filter(|packet| !packet.is_empty()).collect();
    let mut session = Session::new(stream.message()).unwrap();
    session.set_live();
    // It comes before there is a network: from its beginning on it is on its way.
    session.push(packets[0]);
    let delay_s = 0.25;
    session.impair(Conditions { delay_s, ..Conditions::default() }).unwrap();
    assert!(session.deliver(3.0) && session.deliver(3.2));
    assert!(!session.deliver(3.25));
    assert_eq!(session.packets(), (1, 1));
    session.push(packets[1]);
    assert!(session.deliver(10.0) && session.deliver(10.2));
    assert_eq!(session.packets(), (2, 1));
    assert!(!session.deliver(10.25));
    assert_eq!(session.packets(), (2, 2));
    // A rate that was not used is gone.
    let bits = |packets: &[&Vec<u8>]| 8.0 * packets.iter().map(|packet| packet.len()).sum::<usize>() as f64;
    let rate_bps = Some(bits(&packets[2..]));
    session.impair(Conditions { rate_bps, ..Conditions::default() }).unwrap();
    session.deliver(20.0);
    assert!(!session.deliver(25.0));
    packets[2..].iter().for_each(|packet| session.push(packet));
    assert!(session.deliver(30.0) && session.deliver(30.5));
    let came = session.packets().0;
    assert_eq!(came, packets.len());
    // What is on its way is not stored again when the server repeats it; what is lost has another chance.
    packets.iter().for_each(|packet| session.push(packet));
    assert_eq!(session.packets().0, came);
    assert!(!session.deliver(31.01));
    assert_eq!(session.levels().unwrap()[0], 0);
    session.impair(Conditions { loss: 0.9, ..Conditions::default() }).unwrap();
    packets.iter().for_each(|packet| session.push(packet));
    assert_eq!(session.packets().0, came);
    session.deliver(40.0);
    packets.iter().for_each(|packet| session.push(packet));
    assert!(session.packets().0 > came);
    // A server that begins anew finds nothing on its way.
    session.restart().unwrap();
    packets.iter().for_each(|packet| session.push(packet));
    assert_eq!(session.packets().0, packets.len());
}

#[test]
fn pieces_of_a_file_are_the_file_and_its_base_lets_the_clock_run() {
    let message = crate::message(FILE).unwrap().unwrap();
    let mut session = Session::new(message).unwrap();
    session.fetch(FILE.len() as u64);
    session.playback_mut().set_playing(true);
    assert!(session.advance(0.01).stalled, "no base is there");
    while let Wanted::Range(range) = session.wanted() {
        session.take(range.start, &FILE[range.start as usize..range.end as usize]);
    }
    assert_eq!(session.loaded(), 1.0);
    assert!(!session.advance(0.01).stalled);
    session.playback_mut().seek(0.0);
    assert_eq!(shown(&mut session), shown(&mut self::session()));
}

#[test]
fn what_only_moves_is_known_to() {
    let mut session = session();
    assert!(!session.show().unwrap().only_moved, "the first picture is new");
    assert!(session.show().unwrap().only_moved);
    session.set_overlay(Overlay::Levels);
    assert!(!session.show().unwrap().only_moved);
}

#[test]
fn packets_of_strangers_change_nothing() {
    let mut session = session();
    let whole = shown(&mut session);
    session.push(b"no packet");
    session.push(&[]);
    session.take(0, &[1, 2, 3]);
    assert_eq!(shown(&mut session), whole);
    assert!(session.take_whole(b"no file").is_err());
    assert!(Session::open(&FILE[..20]).is_err());
}

#[test]
fn a_server_learns_what_came_and_its_bases_have_a_moment() {
    let stream = Stream::from_bytes(FILE).unwrap().0;
    let mut session = Session::new(stream.message()).unwrap();
    session.set_live();
    session.playback_mut().set_playing(true);
    let none = session.receipt(0, 0).unwrap();
    assert!(session.advance(0.3).stalled && session.advance(0.3).stalled);
    assert!(!session.advance(0.01).stalled, "what does not come is not waited for any longer");
    stream.packets().iter().for_each(|packet| session.push(packet));
    assert!(session.receipt(1, 7).unwrap() != none);
    session.orbit_mut().turn(40.0, 0.0, 600.0);
    let bytes = session.receipt(2, 7).unwrap();
    let receipt = Receipt::parse(&bytes, crc32).unwrap();
    assert!(receipt.pose.is_some() && receipt.pose == session.orbit().pose());
    session.playback_mut().seek(0.0);
    assert!(!session.advance(0.01).stalled);
    let duration = session.playback().duration_s();
    for share in [0.0, 0.3, 0.7, 1.0] {
        let start = session.round_start_s(share * duration);
        assert!(start >= 0.0 && start <= share * duration, "{share}: {start}");
    }
}

#[test]
fn of_a_stream_that_grows_it_is_known_whether_a_window_has_come() {
    let stream = Stream::from_bytes(FILE).unwrap().0;
    let mut session = Session::new(stream.message()).unwrap();
    assert!(session.has_come(), "of a file all comes");
    session.set_live();
    let frames = session.player().info().frames;
    let come = |session: &mut Session| {
        let has_come = |frame: &u32| {
            session.playback_mut().seek(f64::from(*frame) / 10.0);
            assert_eq!(session.playback().frame(), *frame);
            session.has_come()
        };
        (0..frames).filter(has_come).count()
    };
    let mut counts = vec![come(&mut session)];
    for packet in stream.packets().iter().filter(|packet| !packet.is_empty()) {
        session.push(packet);
        counts.push(come(&mut session));
    }
    let all = frames as usize;
    assert!(counts[0] == 0 && counts.is_sorted() && counts.last() == Some(&all), "{counts:?}");
    assert!(counts.iter().any(|&count| count > 0 && count < all), "window after window: {counts:?}");
}

/// What a person or an address has chosen stays.
#[test]
fn a_camera_before_there_is_anything_to_see_is_placed_again_unless_somebody_moved_it() {
    let (mut whole, _) = Session::open(BARE_FILE).unwrap();
    whole.look_at_all(1.5, Up::default()).unwrap();
    let (expected, up) = (*whole.orbit(), Up::named("minus-z").unwrap());
    whole.look_again(1.0).unwrap();
    assert_eq!(*whole.orbit(), expected, "it was sure");
    let packets: Vec<_> = {
        let stream = Stream::from_bytes(BARE_FILE).unwrap().0;
        stream.packets().iter().filter(|packet| !packet.is_empty()).cloned().collect()
    };
    for is_chosen in [false, true] {
        let mut session = Session::new(crate::message(BARE_FILE).unwrap().unwrap()).unwrap();
        session.fetch(BARE_FILE.len() as u64);
        session.look_at_all(1.5, Up::default()).unwrap();
        let nowhere = *session.orbit();
        assert_ne!(nowhere.numbers()[3..], expected.numbers()[3..]);
        session.look_again(1.5).unwrap();
        assert_eq!(*session.orbit(), nowhere);
        if is_chosen {
            session.orbit_mut().turn(40.0, 0.0, 600.0);
        } else {
            *session.orbit_mut() = nowhere.with_up(up);
        }
        let chosen = *session.orbit();
        while let Wanted::Range(range) = session.wanted() {
            session.take(range.start, &BARE_FILE[range.start as usize..range.end as usize]);
            session.look_again(1.5).unwrap();
        }
        if is_chosen {
            assert_eq!(session.orbit().numbers(), chosen.numbers());
            assert_eq!(session.orbit().home(1.5), expected, "the way back is to what has come");
        } else {
            assert_eq!(*session.orbit(), expected.with_up(up));
        }
        session.orbit_mut().zoom(2.0);
        let moved = *session.orbit();
        session.look_again(1.5).unwrap();
        assert_eq!(*session.orbit(), moved, "framed for good");
    }
    // Of what a server sends: the first packets show something, the whole base is looked at once more.
    let mut session = Session::new(crate::message(BARE_FILE).unwrap().unwrap()).unwrap();
    session.set_live();
    session.look_at_all(1.5, Up::default()).unwrap();
    for packet in &packets {
        session.push(packet);
        session.look_again(1.5).unwrap();
    }
    assert!(session.levels().unwrap()[0] == 0 && session.orbit().numbers()[3..] != [0.0; 3]);
}

/// Ranks of values; those of equals are the mean of theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let below = |value: f64| values.iter().filter(|v| **v < value).count() as f64;
    let equal = |value: f64| values.iter().filter(|v| **v == value).count() as f64;
    values.iter().map(|v| below(*v) + 0.5 * equal(*v)).collect()
}

/// Spearman's rank correlation.
fn rank_correlation(one: &[f64], other: &[f64]) -> f64 {
    let (one, other) = (ranks(one), ranks(other));
    let mean = (one.len() - 1) as f64 / 2.0 + 0.5;
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>();
    product(&one, &other) / (product(&one, &one) * product(&other, &other)).sqrt()
}

#[test]
fn estimated_quality_follows_pictures() {
    let mut session = session();
    session.look_at_all(1.0, Up::default()).unwrap();
    let camera = session.orbit().camera(64, 64).unwrap();
    let picture = |session: &mut Session| {
        let shown = session.show().unwrap();
        render(&shown.splats, &camera, &Settings::default()).unwrap().image
    };
    let whole = picture(&mut session);
    assert_eq!(session.quality(), 1.0);
    let (mut estimates, mut errors) = (Vec::new(), Vec::new());
    for (seed, loss) in (0..60).zip([0.1, 0.2, 0.35, 0.5, 0.7].into_iter().cycle()) {
        session.impair(Conditions { loss, seed, ..Conditions::default() }).unwrap();
        session.deliver(0.0);
        let thinned = picture(&mut session);
        let error = thinned.rgb().iter().zip(whole.rgb()).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        estimates.push(f64::from(session.quality()));
        errors.push(-error);
    }
    let correlation = rank_correlation(&estimates, &errors);
    assert!(correlation > 0.8, "{correlation}");
}
