//! Serves streams over QUIC, and a page over HTTP, until Ctrl-C: `dgs serve`.

mod offers;
mod ports;

use std::{
    collections::VecDeque,
    net::{IpAddr, Ipv4Addr, Ipv6Addr},
    time::Duration,
};

use anyhow::{Context, Result, bail};
use dgs_quic::{
    CongestionControl,
    http::{HttpReport, HttpServer, Site, SiteStream},
    socket::{
        Identity, Locator, Scheme, ServedStream, Server, ServerConfig, ServerLimits, ServerReport,
        ViewerReport, message::StreamChoice,
    },
};
pub(super) use offers::name;
use offers::{check_names, offers};
use ports::Ports;
use serde_json::json;
use tokio::sync::oneshot;

use super::{
    relay,
    socket::{asset, interruption, runtime, trust},
};
use crate::{
    args::{Serve, ServerController},
    files::LineLog,
    output::{self, VerbOutput},
    pipeline::{self, Quiet},
};

/// What an emulated link is not in front of.
const UNIMPAIRED: &str = "--impair is in front of UDP; pages that come by WebSocket (TCP, which repeats \
                          what is lost before anybody sees it) or fetch the file have no such link; \
                          ?transport=live holds them to WebTransport";

/// What the addresses that are printed are for.
const FOR_PROGRAMS: &str = "for dgs play, and for dgs view --window:";
const FOR_BROWSERS: &str = "for a browser, the page that plays it:";

/// Viewers of whom the report at the end tells one by one, the last ones; all are counted.
const MAX_REPORTED: usize = 4096;
/// What a server listens on says nothing of where viewers find it.
const EVERYWHERE: &str = "--listen is every address of this machine; the URLs below are for this machine \
                          alone: --host NAME names it for viewers elsewhere";

/// A page over HTTP is given no WebGPU and no WebTransport elsewhere.
const NOT_SECURE: &str = "browsers play the page over https or from localhost alone: viewers elsewhere need \
                          a server with a certificate in front of its port (or ssh -L); dgs play and dgs \
                          view --window need none";

/// Runs the verb.
pub fn run(args: &Serve, quiet: Quiet) -> Result<VerbOutput> {
    if let Some(relay) = &args.moq {
        return publish(args, relay, quiet);
    }
    let mut warnings = Vec::new();
    let impairment = args.impair.as_deref().map(pipeline::impairment).transpose()?.map(|impaired| {
        warnings.extend(impaired.notes);
        impaired.impairment
    });
    if impairment.is_some() && !args.no_http {
        warnings.push(UNIMPAIRED.to_owned());
    }
    let host = args.host.clone().unwrap_or_else(|| match args.listen.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.to_string(),
        IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.to_string(),
        ip => ip.to_string(),
    });
    if args.host.is_none() && args.listen.ip().is_unspecified() {
        warnings.push(EVERYWHERE.to_owned());
    }
    if !args.no_http && !is_this_machine(&host) {
        warnings.push(NOT_SECURE.to_owned());
    }
    let identity = match args.cert.as_deref().zip(args.key.as_deref()) {
        Some((certificate, key)) => Identity::read(certificate, key)?,
        None => Identity::self_signed(&[host.clone(), "localhost".to_owned()])
            .with_context(|| format!("--host is {host}"))?,
    };
    let log = args.log.as_deref().map(|path| LineLog::open(path, "address")).transpose()?;
    // Encoding may take minutes: what it would be in vain for is refused before.
    check_names(&args.inputs)?;
    let ports = Ports::open(args, || Ok(Server::open(args.listen)?))?;
    let (streams, damage) = offers(args, quiet, &mut warnings)?;
    let limits = ServerLimits {
        max_viewers: args.max_viewers,
        max_viewers_per_address: args.max_viewers_per_address,
        max_rate_bps: args.max_rate.map(|mbit| (mbit * 1e6) as u64),
        idle: Duration::from_secs(args.idle),
        ..ServerLimits::default()
    };
    let policy = pipeline::policy(args.policy);
    let config = ServerConfig {
        bind: args.listen,
        identity,
        limits,
        policy,
        congestion: congestion(args.controller),
        impairment,
        viewer_conditions: !args.fixed_conditions,
    };
    // At once: serving may take days.
    warnings.iter().for_each(|warning| output::print_status(&format!("warning: {warning}")));
    let served = runtime()?.block_on(serve((args, &host), ports, config, streams, log, quiet))?;
    let Served { urls, page, report, viewers, http } = served;
    let text = summary(&report, http.as_ref());
    let (damaged, at_the_end) = damage.until_now();
    warnings.extend(at_the_end.clone());
    let json = json!({
        "urls": urls, "page": page, "server": report, "http": http, "viewers": viewers, "warnings": warnings,
    });
    // The others were said when serving began.
    Ok(VerbOutput { text, json, warnings: at_the_end.into_iter().collect(), damaged })
}

/// Whether a browser takes `host` for this machine.
fn is_this_machine(host: &str) -> bool {
    let name = host.trim_end_matches('.').to_ascii_lowercase();
    name == "localhost"
        || name.ends_with(".localhost")
        || host.parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
}

/// The controller of a name.
fn congestion(name: ServerController) -> CongestionControl {
    match name {
        ServerController::Newreno => CongestionControl::NewReno,
        ServerController::Cubic => CongestionControl::Cubic,
        ServerController::Bbr => CongestionControl::Bbr,
        ServerController::Scream => CongestionControl::Scream,
    }
}

/// Publishes at a relay instead.
fn publish(args: &Serve, relay: &Locator, quiet: Quiet) -> Result<VerbOutput> {
    if relay.scheme != Scheme::Moq {
        bail!("--moq is {relay}; the address of a relay begins with moq+https://");
    }
    let trust = trust(relay, args.pin, args.ca.as_ref())?;
    check_names(&args.inputs)?;
    relay::check(relay, args.inputs.len())?;
    let mut warnings = Vec::new();
    let (streams, damage) = offers(args, quiet, &mut warnings)?;
    warnings.iter().for_each(|warning| output::print_status(&format!("warning: {warning}")));
    let VerbOutput { text, mut json, .. } = relay::publish(relay, trust, &streams, quiet)?;
    let (damaged, at_the_end) = damage.until_now();
    warnings.extend(at_the_end.clone());
    json["warnings"] = json!(warnings);
    Ok(VerbOutput { text, json, warnings: at_the_end.into_iter().collect(), damaged })
}

/// What was served, and to whom.
struct Served {
    urls: Vec<String>,
    page: Option<String>,
    report: ServerReport,
    /// The last ones, for JSON.
    viewers: VecDeque<ViewerReport>,
    http: Option<HttpReport>,
}

/// Serves until Ctrl-C.
async fn serve(
    (args, host): (&Serve, &str),
    ports: Ports,
    config: ServerConfig,
    offers: Vec<ServedStream>,
    mut log: Option<LineLog>,
    quiet: Quiet,
) -> Result<Served> {
    let mut streams: Vec<SiteStream> = offers.iter().map(site_stream).collect();
    let server = Server::on(ports.socket, config, offers)?;
    let listen = server.local_addr().context("--listen")?;
    let mut urls = Vec::new();
    for stream in &mut streams {
        let locator = Locator {
            scheme: Scheme::Dgs,
            host: host.to_owned(),
            port: listen.port(),
            stream: StreamChoice::Name(stream.name.clone()),
            pin: Some(server.pin()),
        };
        let url = locator.to_string();
        stream.address = Some(url.clone());
        // Browsers take no fragment there; a page knows the pin by itself.
        let web = Locator { scheme: Scheme::Https, pin: None, ..locator };
        stream.web_address = Some(web.to_string());
        urls.push(url);
    }
    let mut site = Site::new(asset, &streams, Some(server.pin()))?;
    if let Some(origin) = &args.allow_origin {
        site = site.with_allowed_origin(origin.clone());
    }
    let http = match ports.page {
        Some((listener, config)) => {
            Some(HttpServer::on(listener, &config, site)?.with_sessions(server.entrance()))
        }
        None => None,
    };
    let page = match &http {
        Some(http) => Some(page_url(host, http.local_addr().context("--http")?.port())),
        None => None,
    };
    // Whoever hears an address may interrupt what serves it.
    let interrupted = interruption();
    // At once: whoever started this waits for it. With --json standard output is for the end.
    // Standard output has addresses alone, for programs that read them.
    for (whom, addresses) in [(FOR_PROGRAMS, urls.as_slice()), (FOR_BROWSERS, page.as_slice())] {
        if !quiet.0 && !addresses.is_empty() {
            output::print_status(whom);
        }
        for address in addresses {
            if quiet.0 {
                output::print_status(&format!("serving {address}"));
            } else {
                output::print(&format!("{address}\n"))?;
            }
        }
    }
    let mut viewers = VecDeque::new();
    let ended = |viewer: &ViewerReport| {
        if let Some(log) = &mut log {
            log.add(viewer);
        }
        if !quiet.0 {
            // Where nobody reads any more, serving goes on.
            let _ = output::print(&line(viewer));
            return;
        }
        // Serving may take days.
        if viewers.len() == MAX_REPORTED {
            viewers.pop_front();
        }
        viewers.push_back(viewer.clone());
    };
    let (stop, stopped) = oneshot::channel::<()>();
    let stopping = async {
        interrupted.await;
        drop(stop);
    };
    let pages = async {
        match http {
            Some(http) => Some(http.run(async { drop(stopped.await) }).await),
            None => None,
        }
    };
    let (report, http) = tokio::join!(server.run(stopping, ended), pages);
    Ok(Served { urls, page, report, viewers, http })
}

/// A stream as a page lists it.
fn site_stream(offer: &ServedStream) -> SiteStream {
    SiteStream {
        name: offer.name().to_owned(),
        address: None,
        web_address: None,
        file: offer.file().cloned(),
    }
}

fn page_url(host: &str, port: u16) -> String {
    if host.contains(':') { format!("http://[{host}]:{port}/") } else { format!("http://{host}:{port}/") }
}

/// One viewer for people.
fn line(viewer: &ViewerReport) -> String {
    let ViewerReport { address, stream, scheduler, seconds, rounds, packets, .. } = viewer;
    let share = 100.0 * viewer.lost as f64 / (*packets).max(1) as f64;
    let rate = viewer.media_bytes as f64 * 8e-6 / seconds.max(1e-3);
    let camera = if viewer.located { ", camera reported" } else { "" };
    format!(
        "{address} {stream} by {scheduler}: {seconds:.1} s, {rounds} rounds, {packets} packets \
         ({rate:.2} Mbit/s), lost {share:.1} %, {} sent again, \
         {} receipts ({} refused){camera}, round trip {:.1} ms; {}\n",
        viewer.retransmitted, viewer.receipts, viewer.refused_receipts, viewer.rtt_ms, viewer.end
    )
}

/// The server's own counts for people.
fn summary(report: &ServerReport, http: Option<&HttpReport>) -> String {
    let refused: Vec<String> = report.refused.iter().map(|(code, count)| format!("{code} {count}")).collect();
    let refused = if refused.is_empty() { "none".to_owned() } else { refused.join(", ") };
    let mut text = format!(
        "{} viewers; {} handshakes failed, {} turned away, {} had to prove their address, {} datagrams were \
         no QUIC; refused: {refused}\n",
        report.viewers, report.failed_handshakes, report.turned_away, report.retried, report.stray_datagrams,
    );
    if let Some(http) = http {
        text += &format!(
            "page: {} requests on {} connections, {} turned away, {} slow, {} malformed\n",
            http.requests, http.connections, http.turned_away, http.slow, http.malformed
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use std::net::{TcpListener, UdpSocket};

    use clap::Parser as _;

    use super::*;
    use crate::args::{Cli, Verb};

    /// Nor is the first of these inputs a scene, which is found as it is read.
    #[test]
    fn an_input_that_is_not_there_is_refused_before_another_is_encoded() {
        for missing in ["none.ply", "none.dgs", "synth:none"] {
            let error = refused(&["Cargo.toml", missing, "--listen", "127.0.0.1:0"]);
            assert!(error.starts_with(missing), "{error}");
        }
    }

    #[test]
    fn pages_elsewhere_need_a_certificate() {
        for (host, is_here) in [
            ("localhost", true),
            ("127.0.0.1", true),
            ("::1", true),
            ("a.LOCALHOST.", true),
            ("example.org", false),
            ("192.168.1.2", false),
            ("localhost.example.org", false),
        ] {
            assert_eq!(is_this_machine(host), is_here, "{host}");
        }
    }

    /// What is typed after `dgs serve`.
    fn refused(typed: &[&str]) -> String {
        let typed = [&["dgs", "serve"], typed].concat();
        let Ok(Cli { verb: Verb::Serve(args), .. }) = Cli::try_parse_from(&typed) else {
            panic!("{typed:?}")
        };
        format!("{:#}", run(&args, Quiet(true)).unwrap_err())
    }

    /// Nothing is read or encoded before: the inputs of this test are not there.
    #[test]
    fn what_cannot_be_served_is_refused_before_anything_is_read() {
        let free = ["--listen", "127.0.0.1:0"];
        for (inputs, named) in [
            (["none.dgs", "a/none.dgs"], "two streams are called none, none.dgs and a/none.dgs"),
            (["synth:figure", "synth:figure:1000"], "dgs encode makes a file of a scene"),
            (["-", "live.dgs"], "two streams are called live, - and live.dgs"),
            (["-", "-"], "- is given twice"),
        ] {
            let error = refused(&[&inputs[..], &free].concat());
            assert!(error.contains(named), "{error}");
            let error =
                refused(&[&inputs[..], &["--moq", &format!("moq+https://host#{}", "0".repeat(64))]].concat());
            assert!(error.contains(named), "{error}");
        }
        let (udp, tcp) = (UdpSocket::bind("127.0.0.1:0").unwrap(), TcpListener::bind("127.0.0.1:0").unwrap());
        let (udp, tcp) = (udp.local_addr().unwrap().to_string(), tcp.local_addr().unwrap().to_string());
        let error = refused(&["none.dgs", "--listen", &udp]);
        assert!(error.contains(&format!("{udp}: cannot listen")), "{error}");
        let error = refused(&["none.dgs", "--listen", "127.0.0.1:0", "--http", &tcp]);
        assert!(error.contains(&format!("{tcp}: cannot listen for HTTP")), "{error}");
        let relay = format!("moq+https://host/name#{}", "0".repeat(64));
        let error = refused(&["none.dgs", "other.dgs", "--moq", &relay]);
        assert!(error.contains("--features moq") || error.contains("leave the name out"), "{error}");
    }
}
