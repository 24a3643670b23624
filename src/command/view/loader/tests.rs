//! What a session says reaches the window.

use std::sync::mpsc::{channel, sync_channel};

use clap::Parser as _;
use dgs_quic::{
    CongestionControl,
    socket::{Identity, Scheme, ServedStream, Server, ServerConfig, ServerLimits, message::StreamChoice},
};
use tokio::sync::oneshot;

use super::*;
use crate::{
    args::{Cli, Verb},
    command::view::opened::opened,
    pipeline::{LiveReader, Quiet},
};

/// A session's end after its manifest.
fn forwarding(
    arrivals: SyncSender<Arrival>,
    requests: Receiver<FeedRequest>,
    stop: &AtomicBool,
) -> Forwarding<'_> {
    let (wanted_us, conditions, round_at, pose) = (None, None, None, None);
    let waiting = VecDeque::new();
    Forwarding { arrivals, requests, stop, early: None, wanted_us, conditions, round_at, pose, waiting }
}

#[test]
fn a_content_range_says_where_a_part_lies() {
    assert_eq!(content_range("bytes 5-9/200"), Some((5, 200)));
    for field in ["", "bytes 5-9/*", "bytes */200", "5-9/200", "bytes 5/200"] {
        assert_eq!(content_range(field), None, "{field}");
    }
}

#[test]
fn what_must_arrive_waits_for_room_and_packets_do_not() {
    let (arrivals, window) = sync_channel(1);
    let (_requested, requests) = channel();
    let stop = AtomicBool::new(false);
    let mut screen = forwarding(arrivals, requests, &stop);
    screen.media(&[1]);
    screen.media(&[2]);
    screen.forget();
    screen.forget();
    screen.media(&[3]);
    assert!(matches!(window.recv().unwrap(), Arrival::Packet(packet) if packet == [1]));
    screen.send_waiting();
    assert!(matches!(window.recv().unwrap(), Arrival::Anew));
    screen.begun(500_000);
    assert!(matches!(window.recv().unwrap(), Arrival::Begin(time_s) if (time_s - 0.5).abs() < 1e-9));
    screen.media(&[4]);
    assert!(matches!(window.recv().unwrap(), Arrival::Packet(packet) if packet == [4]));
    assert!(window.try_recv().is_err());
}

#[test]
fn a_session_ends_when_the_window_shows_something_else() {
    let (Feeder { arrivals, requests }, window) = feed();
    let stop = AtomicBool::new(false);
    let mut screen = forwarding(arrivals, requests, &stop);
    assert_eq!(screen.requested_round(), None);
    assert!(!stop.load(Ordering::Relaxed));
    drop(window);
    screen.media(&[1]);
    assert_eq!(screen.requested_round(), None);
    assert!(stop.load(Ordering::Relaxed));
}

/// The clock of a window that joins late must not be at the beginning of the clip, of which nothing comes.
#[test]
fn a_stream_that_grows_begins_at_its_newest_window() {
    let typed = ["dgs", "view", "synth:cloth:1000:40", "--window-frames", "10", "--pictures", "2"];
    let Ok(Cli { verb: Verb::View(args), .. }) = Cli::try_parse_from(typed) else { panic!("{typed:?}") };
    let bytes = opened(&args.inputs[0], &args, Quiet(true), &mut |_| ()).unwrap().bytes;
    let mut reader = LiveReader::new(&bytes[..]).unwrap();
    while reader.advance().unwrap() {}
    let (stream, newest) = (reader.stream(), reader.newest());
    let frames_per_second = stream.manifest().unwrap().frames_per_second();
    let (offer, _feed) = ServedStream::live("live", stream, reader.graph().unwrap(), newest).unwrap();
    let config = ServerConfig {
        bind: ([127, 0, 0, 1], 0).into(),
        identity: Identity::self_signed(&["localhost".to_owned()]).unwrap(),
        limits: ServerLimits::default(),
        policy: PolicyKind::ALL[0],
        congestion: CongestionControl::default(),
        impairment: None,
        viewer_conditions: false,
    };
    let (says, said) = channel();
    let (stop, stopped) = oneshot::channel::<()>();
    let serving = thread::spawn(move || {
        runtime().unwrap().block_on(async {
            let server = Server::bind(config, vec![offer]).unwrap();
            says.send((server.local_addr().unwrap().port(), server.pin())).unwrap();
            server.run(async { drop(stopped.await) }, |_| ()).await
        })
    });
    let (port, pin) = said.recv().unwrap();
    let stream = StreamChoice::Name("live".to_owned());
    let locator = Locator { scheme: Scheme::Dgs, host: "127.0.0.1".to_owned(), port, stream, pin: Some(pin) };
    let config = ClientConfig::new(locator, Trust::Pin(pin));
    let (arrivals, window) = sync_channel(1 << 16);
    let (_requested, requests) = channel();
    let ends = Arc::new(AtomicBool::new(false));
    let heard = Arc::clone(&ends);
    let session = thread::spawn(move || load_session(&config, Feeder { arrivals, requests }, &heard));
    let begins = |arrival| if let Arrival::Begin(time_s) = arrival { Some(time_s) } else { None };
    let time_s: f64 = window.iter().find_map(begins).unwrap();
    assert_eq!(((time_s * frames_per_second) as u32, newest), (30, 30), "{time_s} s");
    ends.store(true, Ordering::Relaxed);
    session.join().unwrap();
    drop(stop);
    assert_eq!(serving.join().unwrap().viewers, 1);
}
