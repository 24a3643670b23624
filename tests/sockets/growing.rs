//! A stream that is read while it is made, by somebody who is late, pauses, and goes on.

use std::{
    io::{self, Read},
    sync::mpsc::{Receiver, Sender, channel},
    thread,
};

use codec_core::internals::{ids::Span, wire::file};
use dgs::pipeline::LiveReader;
use tokio::sync::watch;

use super::*;

/// Frames of a window, which is shown for a second and a half.
const WINDOW: u32 = 15;
/// Between two windows that are written: what a busy machine does a second late is still in time.
const HALF_A_SECOND: Duration = Duration::from_millis(500);

/// Reads what is sent, and waits for more.
struct Pipe(Receiver<Vec<u8>>, Vec<u8>);

impl Read for Pipe {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if self.1.is_empty() {
            self.1 = self.0.recv().unwrap_or_default();
        }
        let len = self.1.len().min(out.len());
        out[..len].copy_from_slice(&self.1[..len]);
        self.1.drain(..len);
        Ok(len)
    }
}

/// Says which frame is shown.
struct Saying(watch::Sender<u32>);

impl FrameSink for Saying {
    fn show(&mut self, _player: &mut Player, frame: u32) -> Result<(), String> {
        self.0.send_replace(frame);
        Ok(())
    }
}

/// Manifest and bytes of every window of a clip of so many frames, as who makes a stream writes them.
fn windows(frames: u32, per_second: &str) -> (Vec<u8>, Vec<Vec<u8>>) {
    let flags = [
        "dgs",
        "demo",
        "--window-frames",
        "15",
        "--pictures",
        "2",
        "--coarseness",
        "0.5",
        "--fps",
        per_second,
    ];
    let Ok(Cli { verb: Verb::Demo(args), .. }) = Cli::try_parse_from(flags) else { panic!("{flags:?}") };
    let scene = pipeline::import(&format!("synth:cloth:1000:{frames}"), &args.source).unwrap().scene;
    let options = pipeline::encode_options(&args.codec, Protection::NONE);
    let stream = pipeline::encode(&scene, &options, Quiet(true)).unwrap().stream;
    let (map, manifest) = (PacketMap::of(&stream).unwrap(), stream.manifest().unwrap());
    let window_of = |span: Span| match span {
        Span::Canonical(_) => 0,
        Span::Motion(id) => (manifest.window(id).unwrap().first_frame / WINDOW) as usize,
    };
    let mut windows = vec![Vec::new(); frames.div_ceil(WINDOW) as usize];
    for (id, packet) in stream.packets().iter().enumerate() {
        let window = map.placements(id).iter().map(|placement| window_of(placement.group.span)).max();
        let bytes = &mut windows[window.unwrap()];
        bytes.extend((packet.len() as u16).to_le_bytes());
        bytes.extend(packet);
    }
    let mut head = file::MAGIC.to_vec();
    head.extend((stream.message().len() as u32).to_le_bytes());
    head.extend(stream.message());
    (head, windows)
}

/// Reads what comes as `dgs serve -` does.
fn growing(input: Receiver<Vec<u8>>) -> ServedStream {
    let mut reader = LiveReader::new(Pipe(input, Vec::new())).unwrap();
    let graph = reader.graph().unwrap();
    let (offer, feed) = ServedStream::live("live", reader.stream(), graph, reader.newest()).unwrap();
    thread::spawn(move || {
        while reader.advance().unwrap() {
            feed.renew(reader.stream(), reader.graph().unwrap(), reader.newest()).unwrap();
        }
        assert!(reader.is_by_window() && reader.damaged() == 0);
    });
    offer
}

async fn produce(windows: &[Vec<u8>], to: &Sender<Vec<u8>>) {
    for window in windows {
        to.send(window.clone()).unwrap();
        tokio::time::sleep(HALF_A_SECOND).await;
    }
}

#[test]
fn a_viewer_ahead_of_a_stream_that_grows_waits_for_it() {
    let (head, windows) = windows(150, "10");
    within(async {
        let (to, from) = channel();
        to.send(head).unwrap();
        let server = Running::offering(growing(from));
        let mut config = server.client();
        // Long over when the first packet comes.
        config.startup.max_wait = Nanos::from_ms(100);
        let (says, mut shown) = watch::channel(0);
        let mut screen = Saying(says);
        let viewer = async { play(&config, &mut screen, std::future::pending()).await.whole().unwrap() };
        let producer = async {
            tokio::time::sleep(HALF_A_SECOND).await;
            // A window is whole when the next one begins: three of them.
            produce(&windows[..4], &to).await;
            // The fourth is shown before it is there, and nothing comes for longer than a viewer shows that.
            drop(shown.wait_for(|frame| *frame >= 3 * WINDOW).await.unwrap());
            tokio::time::sleep(HALF_A_SECOND * 5).await;
            shown.mark_unchanged();
            to.send(windows[4].clone()).unwrap();
            // The viewer has gone on with the fourth before there is more, unless it was busy for so long
            // that it takes the next for what is due.
            drop(tokio::time::timeout(HALF_A_SECOND * 2, shown.changed()).await);
            produce(&windows[5..], &to).await;
            drop(to);
        };
        let (report, ()) = tokio::join!(viewer, producer);
        let missed = report.shown.iter().filter(|shown| shown.base_miss == 1.0).count();
        // A second of frames, all of them empty, shows that nothing comes.
        assert!(missed <= 17, "{missed} frames of {} were empty", report.shown.len());
        // It has asked for what is new since.
        let after = report.shown.iter().filter(|shown| shown.round > 0);
        let after: Vec<f64> = after.map(|shown| shown.base_miss).collect();
        let mean = after.iter().sum::<f64>() / after.len() as f64;
        assert!(after.len() >= 60 && mean < 0.1, "{} frames, {mean} missed after the pause", after.len());
        let (_, viewers) = server.stop().await;
        assert_eq!(viewers.len(), 1);
        // What is there when the stream ends is sent to its end.
        let last = report.shown.last().unwrap();
        assert!(last.frame == 149 && last.levels > 3.9, "{last:?}");
    });
}

/// The last window comes when its frames are over, which take less time than what tells a viewer elsewhere
/// that nothing comes any more.
#[test]
fn the_end_of_a_stream_that_grows_is_waited_for() {
    let (head, windows) = windows(45, "30");
    within(async {
        let (to, from) = channel();
        to.send(head).unwrap();
        windows[..2].iter().for_each(|window| to.send(window.clone()).unwrap());
        let server = Running::offering(growing(from));
        let config = server.client();
        let (says, mut shown) = watch::channel(0);
        let mut screen = Saying(says);
        let viewer = async { play(&config, &mut screen, std::future::pending()).await.whole().unwrap() };
        let producer = async {
            drop(shown.wait_for(|frame| *frame == 44).await.unwrap());
            tokio::time::sleep(HALF_A_SECOND).await;
            to.send(windows[2].clone()).unwrap();
            drop(to);
        };
        let (report, ()) = tokio::join!(viewer, producer);
        let last = report.shown.last().unwrap();
        assert!(last.frame == 44 && last.round > 0 && last.base_miss == 0.0, "{last:?}");
        server.stop().await;
    });
}
