//! What is served is played: whole over a clean path, in part over a bad one, from anywhere, by several.

use codec_core::Gaussian;
use emulator_host::session::StartupRule;

use super::*;

/// Compares what is shown with the frames of the file.
struct Decoded {
    /// Gaussians and harmonics of every frame of the file. They are decoded before anything is played: while
    /// a frame is shown nothing is received.
    expected: Vec<(Vec<Gaussian>, Vec<f32>)>,
    frames: Vec<u32>,
    /// The last frame that was shown otherwise.
    differs: Option<u32>,
}

impl Decoded {
    fn new() -> Self {
        let mut whole = stream().receive().unwrap();
        let decoded = |frame| {
            let frame = whole.frame(frame).unwrap();
            (frame.gaussians.to_vec(), frame.sh_rest.to_vec())
        };
        Self { expected: (0..30).map(decoded).collect(), frames: Vec::new(), differs: None }
    }
}

impl FrameSink for Decoded {
    fn show(&mut self, player: &mut Player, frame: u32) -> Result<(), String> {
        self.frames.push(frame);
        let (gaussians, sh_rest) = &self.expected[frame as usize];
        let shown = player.frame(frame).map_err(|error| error.to_string())?;
        let same = shown.gaussians == gaussians.as_slice() && shown.sh_rest == sh_rest.as_slice();
        self.differs = if same { self.differs } else { Some(frame) };
        Ok(())
    }
}

#[test]
fn over_a_clean_path_every_frame_is_shown_and_decodes_as_the_file_does() {
    within(async {
        let mut screen = Decoded::new();
        let server = Running::start(ServerLimits::default(), None);
        let mut config = server.client();
        // Otherwise the first frames may lack a twentieth of their base.
        config.startup.rule = StartupRule::BaseGroups(1.0);
        let report = play(&config, &mut screen, std::future::pending()).await.whole().unwrap();
        assert_eq!(screen.frames, (0..30).collect::<Vec<_>>());
        assert_eq!((report.shown_count, report.connections, report.rounds), (30, 1, 1));
        assert!(report.startup_reached && report.base_miss_rate == 0.0, "{report:?}");
        assert_eq!((report.refused, report.recovered), (0, 0), "{report:?}");
        // By the end everything has come; the first frames may be coarser.
        assert_eq!(screen.differs.filter(|frame| *frame >= 20), None, "{report:?}");
        let (counts, viewers) = server.stop().await;
        assert_eq!((counts.viewers, counts.failed_handshakes), (1, 0), "{counts:?}");
        assert_eq!(viewers[0].stream, "figure");
        assert!(viewers[0].packets >= report.packets && viewers[0].receipts > 0, "{viewers:?}");
        assert_eq!(viewers[0].refused_receipts, 0);
    });
}

/// Looks from somewhere, and says so.
struct Located(ViewerPose);

impl FrameSink for Located {
    fn show(&mut self, _: &mut Player, _: u32) -> Result<(), String> {
        Ok(())
    }

    fn pose(&mut self) -> Option<ViewerPose> {
        Some(self.0)
    }
}

#[test]
fn a_server_knows_where_a_viewer_is_who_says_so_and_shows_it_all_the_same() {
    within(async {
        let server = Running::start(ServerLimits::default(), Some(lossy(0.02)));
        let aside = ViewerPose { position: [0.0, 0.0, 9.0], rotation: [1.0, 0.0, 0.0, 0.0] };
        let nowhere = ViewerPose { rotation: [0.0; 4], ..aside };
        for (pose, located) in [(aside, true), (nowhere, false)] {
            let mut screen = Located(pose);
            let report = play(&server.client(), &mut screen, std::future::pending()).await.whole().unwrap();
            assert_eq!(report.shown_count, 30);
            assert!(report.base_miss_rate < 0.1, "{located}: {report:?}");
        }
        let silent = server.play(&server.client()).await.unwrap();
        assert_eq!(silent.shown_count, 30);
        let (_, viewers) = server.stop().await;
        let located: Vec<bool> = viewers.iter().map(|viewer| viewer.located).collect();
        assert_eq!(located, [true, false, false]);
        assert!(viewers.iter().all(|viewer| viewer.refused_receipts == 0), "{viewers:?}");
    });
}

#[test]
fn a_tenth_lost_still_shows_every_frame_with_nearly_all_bases() {
    within(async {
        let server = Running::start(ServerLimits::default(), Some(lossy(0.1)));
        let report = server.play(&server.client()).await.unwrap();
        assert_eq!(report.shown_count, 30);
        assert!(report.base_miss_rate < 0.1, "{report:?}");
        let (_, viewers) = server.stop().await;
        assert!(viewers[0].lost > 0, "{viewers:?}");
    });
}

#[test]
fn every_controller_shows_every_frame_over_a_bad_link() {
    within(async {
        let served = async |congestion: CongestionControl| {
            let server = Running::governed(congestion, lossy(0.05));
            let report = server.play(&server.client()).await.unwrap();
            assert_eq!(report.shown_count, 30, "{congestion:?}");
            assert!(report.base_miss_rate < 0.1, "{congestion:?}: {report:?}");
            let (_, viewers) = server.stop().await;
            assert!(viewers[0].lost > 0, "{congestion:?}: {viewers:?}");
        };
        tokio::join!(
            served(CongestionControl::NewReno),
            served(CongestionControl::Cubic),
            served(CongestionControl::Bbr),
            served(CongestionControl::Scream)
        );
    });
}

/// Remembers what it shows, and says once when that is as many frames as are wanted.
struct Enough {
    watching: Watching,
    wanted: usize,
    shown: Arc<Semaphore>,
}

impl FrameSink for Enough {
    fn show(&mut self, player: &mut Player, frame: u32) -> Result<(), String> {
        self.watching.show(player, frame)?;
        if self.watching.frames.len() == self.wanted {
            self.shown.add_permits(1);
        }
        Ok(())
    }
}

#[test]
fn playout_begins_in_the_window_of_the_time_and_repeats_from_the_start() {
    within(async {
        let server = Running::start(ServerLimits::default(), None);
        let late = ClientConfig { start_us: 3_000_000, ..server.client() };
        let mut screen = Watching::default();
        play(&late, &mut screen, std::future::pending()).await.whole().unwrap();
        // Three seconds are frame 15, in the window of frames 10 to 19.
        assert_eq!(screen.frames, (10..30).collect::<Vec<_>>());
        assert!(screen.packets < stream().packets().len(), "what is over is not sent");
        let looped = ClientConfig { loops: true, ..server.client() };
        // It ends when the second round is well under way, however long a busy machine takes until then.
        let shown = Arc::new(Semaphore::new(0));
        let mut screen = Enough { watching: Watching::default(), wanted: 41, shown: shown.clone() };
        let over = async { shown.acquire().await.unwrap().forget() };
        let report = play(&looped, &mut screen, over).await.whole().unwrap();
        let frames = screen.watching.frames;
        assert!(report.rounds >= 2 && frames.len() > 40, "{report:?}");
        assert_eq!(frames[..35], [(0..30).collect::<Vec<_>>(), (0..5).collect()].concat());
        let repeated = report.shown.iter().filter(|shown| shown.round == 1);
        assert!(repeated.clone().count() > 0 && repeated.clone().all(|shown| shown.base_miss == 0.0));
        server.stop().await;
    });
}

#[test]
fn two_viewers_watch_two_streams_and_a_third_finds_no_place() {
    within(async {
        let server = Running::start(ServerLimits { max_viewers: 2, ..ServerLimits::default() }, None);
        let other = |name: &str| {
            let mut config = server.client();
            config.locator.stream = StreamChoice::Name(name.to_owned());
            config
        };
        let (first, second) = (other("figure"), other("again"));
        let repeated = |config: &ClientConfig| ClientConfig { loops: true, ..config.clone() };
        let (looped, also) = (repeated(&first), repeated(&second));
        let (shown, done) = (Arc::new(Semaphore::new(0)), Semaphore::new(0));
        let (mut one, mut two) = (FirstFrame::new(&shown), FirstFrame::new(&shown));
        let third = async {
            // Both places are taken once both have shown something, until this is over.
            shown.acquire_many(2).await.unwrap().forget();
            let played = server.play(&first).await;
            done.add_permits(2);
            played
        };
        let over = || async { done.acquire().await.unwrap().forget() };
        let (one, two, three) =
            tokio::join!(play(&looped, &mut one, over()), play(&also, &mut two, over()), third);
        assert!(one.whole().unwrap().shown_count > 0 && two.whole().unwrap().shown_count > 0);
        let error = three.unwrap_err().to_string();
        assert!(error.contains("all 2 places are taken"), "{error}");
        let unknown = server.play(&other("fox")).await.unwrap_err().to_string();
        assert!(unknown.contains("no stream called fox; there are figure, again"), "{unknown}");
        let (counts, viewers) = server.stop().await;
        let names: std::collections::BTreeSet<_> = viewers.iter().map(|v| v.stream.as_str()).collect();
        assert_eq!(names, ["again", "figure"].into());
        assert_eq!(counts.refused, [("full".to_owned(), 1), ("unknown stream".to_owned(), 1)].into());
    });
}

#[test]
fn no_viewer_gets_more_than_the_bound() {
    within(async {
        let limits = ServerLimits { max_rate_bps: Some(200_000), ..ServerLimits::default() };
        let server = Running::start(limits, None);
        let report = server.play(&server.client()).await.unwrap();
        let (_, viewers) = server.stop().await;
        let bits = viewers[0].media_bytes as f64 * 8.0;
        assert!(bits > 0.0 && bits <= 200_000.0 * viewers[0].seconds + 30_000.0, "{viewers:?} {report:?}");
    });
}

#[test]
fn who_serves_is_checked_by_pin_and_by_authority() {
    within(async {
        let folder = tempfile::tempdir().unwrap();
        let (certificate, key) = (folder.path().join("cert.pem"), folder.path().join("key.pem"));
        let other = folder.path().join("other.pem");
        let make = || rcgen::generate_simple_self_signed(["127.0.0.1".to_owned()]).unwrap();
        let (made, stranger) = (make(), make());
        std::fs::write(&certificate, made.cert.pem()).unwrap();
        std::fs::write(&key, made.signing_key.serialize_pem()).unwrap();
        std::fs::write(&other, stranger.cert.pem()).unwrap();
        let identity = Identity::read(&certificate, &key).unwrap();
        let pin = identity.pin();
        let server = Running::with(identity, ServerLimits::default(), None);
        // In the last of its windows.
        let config = |trust| ClientConfig { trust, start_us: 5_400_000, ..server.client() };
        assert_eq!(server.play(&config(Trust::Authority(certificate))).await.unwrap().shown_count, 10);
        let wrong = Identity::self_signed(&["127.0.0.1".to_owned()]).unwrap();
        let error = server.play(&config(Trust::Pin(wrong.pin()))).await.unwrap_err();
        let said = error.to_string();
        assert!(matches!(error, PlayError::WrongPin { .. }), "{said}");
        assert!(said.contains(&pin.to_string()) && said.contains(&wrong.pin().to_string()));
        let error = server.play(&config(Trust::Authority(other))).await.unwrap_err();
        assert!(matches!(error, PlayError::Handshake(_)), "{error}");
        let (counts, _) = server.stop().await;
        assert_eq!(counts.failed_handshakes, 2);
    });
}

/// `openssl req -x509` makes such certificates unless it is asked for others.
#[test]
fn a_server_with_the_certificate_of_an_authority_is_refused_in_words() {
    within(async {
        let folder = tempfile::tempdir().unwrap();
        let (certificate, key) = (folder.path().join("cert.pem"), folder.path().join("key.pem"));
        let mut params = rcgen::CertificateParams::new(["127.0.0.1".to_owned()]).unwrap();
        params.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
        let pair = rcgen::KeyPair::generate().unwrap();
        std::fs::write(&certificate, params.self_signed(&pair).unwrap().pem()).unwrap();
        std::fs::write(&key, pair.serialize_pem()).unwrap();
        let identity = Identity::read(&certificate, &key).unwrap();
        let server = Running::with(identity, ServerLimits::default(), None);
        let config = ClientConfig { trust: Trust::Authority(certificate), ..server.client() };
        let said = server.play(&config).await.unwrap_err().to_string();
        assert!(said.contains("authority (CA:TRUE)") && said.contains("pin"), "{said}");
        server.stop().await;
    });
}

#[test]
fn a_server_that_closes_says_so() {
    within(async {
        let server = Running::start(ServerLimits::default(), None);
        let config = ClientConfig { loops: true, ..server.client() };
        let shown = Arc::new(Semaphore::new(0));
        let mut screen = FirstFrame::new(&shown);
        let stop = async {
            shown.acquire().await.unwrap().forget();
            server.stop().await
        };
        let (played, (counts, viewers)) =
            tokio::join!(play(&config, &mut screen, std::future::pending()), stop);
        let shown = played.report.shown_count;
        let error = played.whole().unwrap_err();
        assert!(shown > 0);
        assert!(error.to_string().contains("the server is closing (closing)"), "{error}");
        assert_eq!((counts.viewers, viewers.len()), (1, 1));
        assert!(viewers[0].end.contains("closing"), "{viewers:?}");
    });
}
