//! Measures how long a page waits for its first picture over a slow link.

use std::{net::Ipv4Addr, thread};

use anyhow::{Context, Result};
use dgs::pipeline;
use dgs_player::Stream;
use dgs_quic::{
    CongestionControl,
    http::{HttpConfig, HttpLimits, HttpServer, Site, SiteStream},
    socket::{
        Identity, Impairment, Locator, Scheme, ServedStream, Server, ServerConfig, ServerLimits,
        message::StreamChoice,
    },
};
use emulator_host::{
    Nanos, PolicyKind, Rate,
    link::{Capacity, PathConfig, QueueLimit},
};
use tokio::{runtime::Runtime, sync::oneshot};

use crate::{
    browser::Browser,
    figures::{Bench, Figure, median},
};

/// What the protocol says of it.
pub const PROTOCOL: &str = "; over 2 Mbit/s and 40 ms: live, packets alone over the link of `dgs serve \
     --impair rate=2mbit,delay=40ms` by WebTransport, page from loopback; ranges, everything, the player's \
     code too, over a browser that is held to it; each in a browser that has nothing, from the start of \
     navigation; base: until no block is a stand-in";
const HOST: &str = "127.0.0.1";
const MBIT: u64 = 2;
const DELAY_MS: u64 = 40;
const TIMEOUT_S: u32 = 180;

/// When the page has the base of every block, milliseconds since it began.
const BASE: &str = "(async () => { const player = document.querySelector('dgs-player');\
    for (;;) { const levels = player.session?.levels() ?? [1];\
        if (player.firstFrameMs !== null && levels[0] === 0) return performance.now();\
        await new Promise((done) => setTimeout(done, 10)); } })()";

/// Enters medians of `runs` pages of `size`, one after the other.
pub fn run(bench: &mut Bench, gaussians: usize, stream: &Stream, size: [u32; 2], runs: usize) -> Result<()> {
    let served = Served::start(stream)?;
    for (kind, query) in [("live", "transport=live"), ("ranges", "transport=file")] {
        let (mut firsts, mut bases) = (Vec::new(), Vec::new());
        for _ in 0..runs {
            let mut browser = Browser::open(size[0], size[1])?;
            if kind == "ranges" {
                browser.hold_to(MBIT as f64 * 1e6, DELAY_MS as f64)?;
            }
            browser.go(&format!("{}?{query}&pixel-ratio=1&adapt=off", served.page))?;
            browser.wait(TIMEOUT_S, "document.querySelector('dgs-player')?.engine?.frames > 0")?;
            let base = browser.run(BASE)?;
            let first = browser.run("document.querySelector('dgs-player').firstFrameMs")?;
            firsts.push(first.as_f64().context("no first picture")?);
            bases.push(base.as_f64().context("no base")?);
        }
        for (what, values) in [("first_picture_ms", &firsts), ("base_ms", &bases)] {
            let key = format!("{gaussians}.{kind}_2mbit.{what}");
            bench.push(Figure::new(key, median(values), "ms").runs(runs));
        }
    }
    Ok(())
}

/// A server of one stream behind a slow link, and of its page. It stops when this is dropped.
struct Served {
    page: String,
    _stop: [oneshot::Sender<()>; 2],
}

impl Served {
    fn start(stream: &Stream) -> Result<Self> {
        let map = trainer_host::stream::PacketMap::of(stream)?;
        let offer = ServedStream::new("scene", stream, pipeline::graph(stream, &map, None)?)?;
        let file = offer.file().cloned();
        let path = PathConfig {
            capacity: Capacity::Constant(Rate::from_mbps(MBIT)),
            queue: QueueLimit { bytes: 62_500, ..QueueLimit::default() },
            delay: Nanos::from_ms(DELAY_MS),
            ..PathConfig::default()
        };
        let config = ServerConfig {
            bind: (Ipv4Addr::LOCALHOST, 0).into(),
            identity: Identity::self_signed(&[HOST.to_owned(), "localhost".to_owned()])?,
            limits: ServerLimits::default(),
            policy: PolicyKind::DeadlineUtility,
            congestion: CongestionControl::default(),
            impairment: Some(Impairment { path, seed: 1 }),
            viewer_conditions: false,
        };
        let runtime = Runtime::new()?;
        let server = runtime.block_on(async { Server::bind(config, vec![offer]) })?;
        let stream = StreamChoice::Name("scene".to_owned());
        let port = server.local_addr()?.port();
        let web = Locator { scheme: Scheme::Https, host: HOST.to_owned(), port, stream, pin: None };
        let web_address = Some(web.to_string());
        let stream = SiteStream { name: "scene".to_owned(), address: None, web_address, file };
        let page = |path: &str| dgs_viewer::asset(path).map(|asset| (asset.bytes, asset.content_type));
        let site = Site::new(page, &[stream], Some(server.pin()))?;
        let config = HttpConfig { bind: (Ipv4Addr::LOCALHOST, 0).into(), limits: HttpLimits::default() };
        let http = runtime.block_on(async { HttpServer::bind(&config, site) })?;
        let http = http.with_sessions(server.entrance());
        let page = format!("http://{HOST}:{}/", http.local_addr()?.port());
        let ([stop, stop_http], [stopped, stopped_http]) = {
            let ((a, b), (c, d)) = (oneshot::channel::<()>(), oneshot::channel::<()>());
            ([a, c], [b, d])
        };
        thread::spawn(move || {
            runtime.block_on(async {
                let ends = async { drop(stopped.await) };
                let ends_http = async { drop(stopped_http.await) };
                tokio::join!(server.run(ends, |_| ()), http.run(ends_http))
            })
        });
        Ok(Self { page, _stop: [stop, stop_http] })
    }
}
