//! A server that is killed and comes back is found again at once, and no frame is shown twice.

use emulator_host::PacketGraph;

use super::*;

/// As [`super::stream`], of fewer Gaussians: there is time for a server to come back in the middle. Encoded
/// once, for the first server: the next one only opens its socket, while the client waits for it.
fn slow() -> ServedStream {
    static ENCODED: OnceLock<(Stream, PacketGraph)> = OnceLock::new();
    let (stream, graph) = ENCODED.get_or_init(|| {
        let flags =
            ["dgs", "demo", "--window-frames", "10", "--pictures", "2", "--coarseness", "0.2", "--fps", "5"];
        let Ok(Cli { verb: Verb::Demo(args), .. }) = Cli::try_parse_from(flags) else { panic!("{flags:?}") };
        let scene = pipeline::import("synth:cloth:2000:30", &args.source).unwrap().scene;
        let options = pipeline::encode_options(&args.codec, Protection::STANDARD);
        let stream = pipeline::encode(&scene, &options, Quiet(true)).unwrap().stream;
        let graph = pipeline::graph(&stream, &PacketMap::of(&stream).unwrap(), None).unwrap();
        (stream, graph)
    });
    ServedStream::new("figure", stream, graph.clone()).unwrap()
}

/// Remembers frames; says when three of the second window have been shown.
struct Counting {
    frames: Vec<u32>,
    in_the_middle: Option<oneshot::Sender<()>>,
}

impl FrameSink for Counting {
    fn show(&mut self, _player: &mut Player, frame: u32) -> Result<(), String> {
        self.frames.push(frame);
        if frame == 12
            && let Some(said) = self.in_the_middle.take()
        {
            let _ = said.send(());
        }
        Ok(())
    }
}

#[test]
fn a_server_that_is_killed_and_back_is_found_at_once_where_playout_is() {
    let folder = tempfile::tempdir().unwrap();
    let (certificate, key) = (folder.path().join("cert.pem"), folder.path().join("key.pem"));
    let made = rcgen::generate_simple_self_signed(["127.0.0.1".to_owned()]).unwrap();
    std::fs::write(&certificate, made.cert.pem()).unwrap();
    std::fs::write(&key, made.signing_key.serialize_pem()).unwrap();
    let at = |address: SocketAddr| {
        let identity = Identity::read(&certificate, &key).unwrap();
        let config = config(identity, ServerLimits::default(), None);
        Running::bound(ServerConfig { bind: address, ..config }, vec![slow()])
    };
    let victims = Runtime::new().unwrap();
    let first = victims.block_on(async { at((Ipv4Addr::LOCALHOST, 0).into()) }).unwrap();
    let (address, client) = (first.address, first.client());
    within(async {
        let (said, in_the_middle) = oneshot::channel();
        let mut screen = Counting { frames: Vec::new(), in_the_middle: Some(said) };
        let back = async {
            in_the_middle.await.unwrap();
            // Without a farewell: its tasks are gone, and its socket.
            victims.shutdown_background();
            loop {
                if let Ok(server) = at(address) {
                    return server;
                }
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
        };
        let (played, server) = tokio::join!(play(&client, &mut screen, std::future::pending()), back);
        let report = played.whole().unwrap();
        assert_eq!((report.connections, report.shown_count), (2, 30), "{report:?}");
        assert_eq!(screen.frames, (0..30).collect::<Vec<_>>());
        let (counts, _) = server.stop().await;
        assert_eq!(counts.viewers, 1, "{counts:?}");
    });
}
