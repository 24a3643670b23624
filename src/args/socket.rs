//! Parses what serving and playing over sockets take.

use std::{
    net::{IpAddr, SocketAddr},
    path::PathBuf,
};

use clap::{Args, ValueEnum};
use dgs_quic::{
    http::Origin,
    socket::{DEFAULT_PORT, Locator, Pin},
};

use super::{
    CameraArgs, CodecArgs, PolicyName, SceneArgs, ViewArgs,
    number::{name, not_negative, positive, whole},
};
use crate::pictures::VideoCodec;

/// An IP address and a port.
fn address(text: &str) -> Result<SocketAddr, String> {
    text.parse()
        .map_err(|_| "an IP address and a port, such as 127.0.0.1:4640 or [::1]:4640, is allowed".to_owned())
}

/// Where it listens when nothing is said: here alone.
fn here() -> SocketAddr {
    ([127, 0, 0, 1], DEFAULT_PORT).into()
}

/// `dgs serve`.
#[derive(Debug, Args)]
pub struct Serve {
    /// .dgs files or scenes (which are encoded first), each called by its file name without extension (other
    /// characters than a to z, A to Z, digits, `.`, `_` and `-` become `-`); `-` is a stream from standard
    /// input, called `live`, served while it is written.
    #[arg(required = true, value_name = "STREAM|SCENE|-", value_parser = name())]
    pub inputs: Vec<String>,
    /// Publish at a relay of Media over QUIC instead, for all who play the same address, again and again, and
    /// `-` window by window as it comes, once: `moq+https://HOST[:PORT][/NAME][#PIN]`; without a name each
    /// stream is called as here. In builds with `--features moq`.
    #[arg(
        long, value_name = "URL",
        conflicts_with_all = [
            "listen", "http", "no_http", "host", "cert", "key", "policy", "controller", "max_viewers",
            "max_viewers_per_address", "max_rate", "idle", "impair", "fixed_conditions", "log",
        ]
    )]
    pub moq: Option<Locator>,
    /// With --moq, SHA-256 of the relay's certificate, 64 hexadecimal digits.
    #[arg(long, value_name = "SHA256", requires = "moq", conflicts_with = "ca")]
    pub pin: Option<Pin>,
    /// With --moq, certificate authority of the relay (PEM), in place of any pin.
    #[arg(long, value_name = "FILE", requires = "moq")]
    pub ca: Option<PathBuf>,
    /// Address and UDP port to listen on; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS:PORT", default_value_t = here(), value_parser = address)]
    pub listen: SocketAddr,
    /// Address and TCP port of the page over HTTP, with the streams as files, /streams/NAME.dgs [default:
    /// that of --listen].
    #[arg(long, value_name = "ADDRESS:PORT", conflicts_with = "no_http", value_parser = address)]
    pub http: Option<SocketAddr>,
    /// Serve no page.
    #[arg(long)]
    pub no_http: bool,
    /// Let pages of this origin read the streams over HTTP, such as `https://example.org`, or `*` for any;
    /// else browsers show them to the page of this server alone.
    #[arg(long, value_name = "ORIGIN", conflicts_with = "no_http")]
    pub allow_origin: Option<Origin>,
    /// DNS name or IP address that viewers use, for the URL and the certificate; the port is that of --listen
    /// [default: the address listened on]. Browsers play the page over https or from localhost alone: for
    /// others put a server that has a certificate in front of its port; what comes through one counts as one
    /// address (--max-viewers-per-address).
    #[arg(long, value_name = "NAME", value_parser = host)]
    pub host: Option<String>,
    /// Certificate chain (PEM) [default: a new one, signed by itself; the URL has its pin].
    #[arg(long, value_name = "FILE", requires = "key")]
    pub cert: Option<PathBuf>,
    /// Key of the certificate (PEM).
    #[arg(long, value_name = "FILE", requires = "cert")]
    pub key: Option<PathBuf>,
    /// Scheduler of every viewer. For a scene that is encoded here, what this one goes by is measured; a
    /// viewer who asks for deadline-utility-paper instead gets its rule over gains.
    #[arg(long, value_enum, default_value_t = PolicyName::DeadlineUtility)]
    pub policy: PolicyName,
    /// Congestion controller of every viewer by QUIC; over a WebSocket it is that of TCP.
    #[arg(long, value_enum, default_value_t = ServerController::Cubic)]
    pub controller: ServerController,
    /// Viewers at once, 1 to 10000.
    #[arg(long, default_value_t = 100, value_parser = whole::<usize>(1..=10_000, "viewers"))]
    pub max_viewers: usize,
    /// Viewers at once from one address (of IPv6 its first 64 bits), 1 to 10000: many who share a connection
    /// share it, and so do all who come through a proxy in front of the page.
    #[arg(long, default_value_t = 32, value_parser = whole::<usize>(1..=10_000, "viewers"))]
    pub max_viewers_per_address: usize,
    /// Most media for each viewer, Mbit/s, above 0 [default: what the path takes].
    #[arg(long, value_name = "MBIT", value_parser = positive, allow_negative_numbers = true)]
    pub max_rate: Option<f64>,
    /// A viewer from whom nothing comes for so long is gone, 1 to 3600 seconds.
    #[arg(
        long, value_name = "SECONDS", default_value_t = 10,
        value_parser = whole::<u64>(1..=3600, "seconds")
    )]
    pub idle: u64,
    /// An emulated link before every viewer: a capacity trace, or a list of loss=5%, burst=PACKETS,
    /// rate=5mbit, delay=40ms, jitter=5ms, queue=250ms, trace=FILE, light=40mbit/15kB/100ms (the first 15 kB
    /// after a pause of 100 ms pass at 40 Mbit/s, as on cellular links), seed=1. Traces begin with each
    /// viewer. What viewers send is left alone.
    #[arg(long, value_name = "LINK")]
    pub impair: Option<String>,
    /// Add a line of JSON to this file for every viewer that has left, at once: it outlives this process
    /// however that ends. `viewers` of --json has the same rows, the newest of them.
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// Refuse viewers another scheduler and another emulated link. Otherwise each may ask for them in its own
    /// session, as the page's network panel does.
    #[arg(long)]
    pub fixed_conditions: bool,
    /// How to read a scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// How to encode a scene.
    #[command(flatten)]
    pub codec: CodecArgs,
}

/// Parses a name or an address of a host, without brackets around one of IPv6.
fn host(text: &str) -> Result<String, String> {
    let inside = text.strip_prefix('[').and_then(|text| text.strip_suffix(']')).unwrap_or(text);
    if let Ok(ip) = inside.parse::<IpAddr>() {
        return Ok(ip.to_string());
    }
    let legal = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
    let is_label = |label: &str| (1..=63).contains(&label.len()) && label.chars().all(legal);
    let name = text.strip_suffix('.').unwrap_or(text);
    let last = name.rsplit('.').next().unwrap_or_default();
    // A name that ends in a number is read as an address.
    let is_name = !last.chars().all(|c| c.is_ascii_digit());
    if is_name && text.len() <= 253 && name.split('.').all(is_label) {
        return Ok(text.to_owned());
    }
    Err("a DNS name or an IP address is allowed, without scheme or port: the port is that of --listen".into())
}

/// A congestion controller of a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ServerController {
    /// RFC 9002, of quinn: the one that the emulator's figures are about; every loss halves it.
    Newreno,
    /// RFC 8312, of quinn: as fair as TCP, and faster than newreno again after a loss on long paths.
    Cubic,
    /// BBR of quinn, experimental: goes on where much is lost at random; fills and overflows queues.
    Bbr,
    /// SCReAMv2, as in the emulator: for links with long queues, bounds the delay that it causes itself;
    /// slower beside other flows.
    Scream,
}

/// `dgs play`.
#[derive(Debug, Args)]
pub struct Play {
    /// `dgs://HOST[:PORT][/NAME][#PIN]`, as `dgs serve` prints it; `https://…` plays over WebTransport,
    /// `moq+https://…` what `dgs serve --moq` publishes, from where it is now.
    pub url: Locator,
    /// SHA-256 of the server's certificate, 64 hexadecimal digits.
    #[arg(long, value_name = "SHA256", conflicts_with = "ca")]
    pub pin: Option<Pin>,
    /// Certificate authority of the server (PEM), in place of any pin: leave out what is from # on in the
    /// URL.
    #[arg(long, value_name = "FILE")]
    pub ca: Option<PathBuf>,
    /// Write the frames as they were shown, once playing is over: PNG in a folder, or .apng, .gif, .mp4 or
    /// .webm. Without it nothing is drawn.
    #[arg(short, long, value_name = "FILE|FOLDER")]
    pub out: Option<PathBuf>,
    /// How pictures of an .mp4 are coded [default: av1].
    #[arg(long, value_enum)]
    pub video_codec: Option<VideoCodec>,
    /// Replace a folder of images that is there already; a file is replaced without it.
    #[arg(long)]
    pub overwrite: bool,
    /// Add a line of JSON to this file for every frame that is shown, at once: it outlives this process
    /// however that ends. `report.shown` of --json has the same rows, the newest of them.
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// The file that is served, no other: what was shown is compared with its complete frames (PSNR).
    #[arg(long, value_name = "FILE.dgs")]
    pub reference: Option<PathBuf>,
    /// Begin at the window of this time, at least 0 seconds. A stream that grows (`dgs serve -`) begins at
    /// its newest window instead; from a relay a clip is played from where it is now.
    #[arg(
        long, value_name = "SECONDS", default_value_t = 0.0, value_parser = not_negative,
        allow_negative_numbers = true
    )]
    pub seek: f64,
    /// Receive media in streams of QUIC in place of datagrams from the start; otherwise that begins once none
    /// have come for a second. From a relay it always comes so.
    #[arg(long)]
    pub streams: bool,
    /// Ask the server for another scheduler in this session [default: its own].
    #[arg(long, value_enum)]
    pub policy: Option<PolicyName>,
    /// Ask the server for an emulated link before this session: a list of loss=5%, burst=PACKETS, rate=5mbit,
    /// delay=40ms, seed=1; delay to 1000ms, rate to 1000mbit. What the server grants, the report says.
    #[arg(long, value_name = "LINK")]
    pub impair: Option<String>,
    /// Begin again when the clip is over; a stream that grows has no beginning to go back to.
    #[arg(long = "loop")]
    pub repeat: bool,
    /// Stop after so many seconds, above 0; that nothing has come by then is an error.
    #[arg(long, value_name = "SECONDS", value_parser = positive, allow_negative_numbers = true)]
    pub duration: Option<f64>,
    /// Which way is up in the pictures [default: as the stream says].
    #[arg(long, value_enum)]
    pub up: Option<super::Up>,
    /// Where to look from; where that is typed, the server is told and sends first what is seen from there.
    #[command(flatten)]
    pub cameras: CameraArgs,
    /// How large.
    #[command(flatten)]
    pub view: ViewArgs,
}

#[cfg(test)]
mod tests {
    use dgs_quic::socket::{Scheme, message::StreamChoice};

    use super::*;

    /// Whatever is taken makes a URL that players take.
    #[test]
    fn a_host_is_a_name_or_an_address_alone() {
        for (text, taken) in [
            ("example.org", "example.org"),
            ("a-b.Example.org.", "a-b.Example.org."),
            ("localhost", "localhost"),
            ("192.168.1.2", "192.168.1.2"),
            ("::1", "::1"),
            ("[2001:db8::1]", "2001:db8::1"),
        ] {
            let host = host(text).unwrap();
            assert_eq!(host, taken);
            let (port, stream) = (DEFAULT_PORT, StreamChoice::Index(0));
            let url = Locator { scheme: Scheme::Dgs, host, port, stream, pin: None };
            assert_eq!(url.to_string().parse::<Locator>().unwrap(), url, "{text}");
        }
        let long = format!("{}.org", "a".repeat(64));
        for text in [
            "example.org:4640",
            "https://example.org",
            "exa mple",
            "",
            ".",
            "a..b",
            "[example.org]",
            "[::1]:1",
            "::1%eth0",
            "300.1.1.1",
            "1.2",
            "exämple.org",
            "example.org/a",
            &long,
        ] {
            assert!(host(text).unwrap_err().contains("that of --listen"), "{text}");
        }
    }
}
