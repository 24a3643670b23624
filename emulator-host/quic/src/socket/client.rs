//! Connects to a server, receives a stream, and shows its frames on time.

use std::{
    net::{Ipv4Addr, Ipv6Addr, SocketAddr},
    pin::pin,
    sync::Arc,
    time::{Duration, Instant},
};

use dgs_player::Player;
use quinn::{Connection, ConnectionError, Endpoint, TransportErrorCode};
use tokio::time::{sleep, timeout};
use url::Url;

use super::{
    channel::{Channel, Closed, Opened},
    control::Control,
    conversation::Conversation,
    identity::{Mismatch, Trust},
    limits::client_transport,
    locator::Locator,
    message::{Refusal, RefusalCode},
    playback::Playback,
    scheme::Scheme,
    screen::{FrameSink, PlayReport},
    settings::{ClientConfig, PlayError},
};

/// Addresses of a name that are tried.
const MAX_ADDRESSES: usize = 4;
/// Time that a session has to say bye.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(500);
/// Between a connection that was lost or not made and the next.
const BEFORE_RECONNECTING: Duration = Duration::from_millis(200);

/// What came of playing.
#[derive(Debug)]
pub struct Played {
    /// What was seen.
    pub report: PlayReport,
    /// What has arrived, if the manifest has.
    pub player: Option<Player>,
    /// Why it ended before the clip, its time or the caller did.
    pub error: Option<PlayError>,
}

impl Played {
    /// The report of a session that nothing ended early.
    ///
    /// # Errors
    /// What ended it.
    pub fn whole(self) -> Result<PlayReport, PlayError> {
        self.error.map_or(Ok(self.report), Err)
    }
}

/// Plays what `config` names on `screen`, until the clip is over, its time is up or `stop` ends.
pub async fn play(
    config: &ClientConfig,
    screen: &mut dyn FrameSink,
    stop: impl Future<Output = ()>,
) -> Played {
    play_over(config, screen, stop, session).await
}

/// Plays over connections that `session` makes, each from its handshake to the end of the clip.
pub(crate) async fn play_over(
    config: &ClientConfig,
    screen: &mut dyn FrameSink,
    stop: impl Future<Output = ()>,
    session: impl AsyncFn(&ClientConfig, &mut Playback, &mut dyn FrameSink) -> Result<(), PlayError>,
) -> Played {
    let began = Instant::now();
    let mut playback = match Playback::new(config, began) {
        Ok(playback) => playback,
        Err(error) => return Played { report: PlayReport::default(), player: None, error: Some(error) },
    };
    let up = async {
        match config.duration {
            Some(duration) => sleep(duration).await,
            None => std::future::pending().await,
        }
    };
    let leave = playback.leave();
    let (played, is_up) = {
        let mut playing = pin!(sessions(config, &mut playback, screen, session));
        let is_up = tokio::select! {
            played = &mut playing => Err(played),
            () = up => Ok(true),
            () = stop => Ok(false),
        };
        match is_up {
            Err(played) => (played, false),
            Ok(is_up) => {
                leave.send_replace(true);
                // Whatever comes of that, nothing has ended it early.
                let _ = timeout(CLOSE_TIMEOUT, playing).await;
                (Ok(()), is_up)
            }
        }
    };
    let nothing_came = is_up && !playback.has_manifest();
    let played =
        if nothing_came { Err(PlayError::TimeUp { ms: began.elapsed().as_millis() }) } else { played };
    let (report, player) = playback.end();
    Played { report, player, error: played.err() }
}

/// Connections until the clip is over or none can be made any more.
async fn sessions(
    config: &ClientConfig,
    playback: &mut Playback,
    screen: &mut dyn FrameSink,
    session: impl AsyncFn(&ClientConfig, &mut Playback, &mut dyn FrameSink) -> Result<(), PlayError>,
) -> Result<(), PlayError> {
    let mut left = config.reconnects;
    loop {
        let shown = playback.shown_count();
        let Err(error) = session(config, playback, screen).await else { return Ok(()) };
        if playback.shown_count() > shown {
            left = config.reconnects;
        }
        // Who was never let in is not let in the next time either; a server that was there may be on its way
        // back.
        let lost = matches!(
            error,
            PlayError::Lost(_) | PlayError::Ended(_) | PlayError::Silence { .. } | PlayError::Handshake(_)
        );
        let again = lost && playback.has_manifest() && left > 0;
        if !again {
            return Err(error);
        }
        left -= 1;
        sleep(BEFORE_RECONNECTING).await;
        playback.reconnect();
    }
}

/// One connection, from the handshake to the end of the clip.
async fn session(
    config: &ClientConfig,
    playback: &mut Playback,
    screen: &mut dyn FrameSink,
) -> Result<(), PlayError> {
    let (endpoint, connection) = connect(config).await?;
    playback.connected();
    let result = match open(config, &connection).await {
        Ok((channel, mut ending, (mut send, receive))) => {
            let ends = (&channel, &mut ending, &mut send);
            let result = match Conversation::begin(config, playback, screen, ends).await {
                Ok(conversation) => conversation.run(Control::new(receive)).await,
                Err(error) => Err(error),
            };
            ending.close(0, "bye").await;
            result
        }
        Err(error) => Err(error),
    };
    let result = result.map_err(|error| match closed(error, &connection) {
        // Both ends of the wait are the same: the transport's, and the one for a manifest or a grant.
        PlayError::Lost(Closed::Connection(ConnectionError::TimedOut))
            if !playback.has_manifest() || playback.awaits_grant() =>
        {
            PlayError::Silence { ms: config.silence.as_millis() }
        }
        error => error,
    });
    connection.close(0u32.into(), b"bye");
    // So that the server hears of it at once.
    let _ = timeout(Duration::from_millis(200), endpoint.wait_idle()).await;
    result
}

/// Opens the control stream.
async fn open(config: &ClientConfig, connection: &Connection) -> Result<Opened, PlayError> {
    let url = match config.locator.scheme {
        Scheme::Moq => return Err(PlayError::Nonsense("a relay speaks Media over QUIC".to_owned())),
        Scheme::Dgs => None,
        Scheme::Https => {
            let url = Locator { pin: None, ..config.locator.clone() }.to_string();
            Some(Url::parse(&url).map_err(|error| PlayError::Nonsense(format!("{url}: {error}")))?)
        }
    };
    let silence = PlayError::Silence { ms: config.silence.as_millis() };
    let opened = timeout(config.silence, Channel::open(connection, url)).await.map_err(|_| silence)?;
    opened.map_err(PlayError::Lost)
}

/// The server may have closed with a reason that is better than what was seen first.
fn closed(error: PlayError, connection: &Connection) -> PlayError {
    let reason = match &error {
        PlayError::Lost(reason) => Some(reason.clone()),
        PlayError::Nonsense(_) => connection.close_reason().map(Closed::from),
        _ => None,
    };
    reason.and_then(|reason| reason.refusal()).map_or(error, PlayError::Refused)
}

/// Connects to the server that `config` names.
pub(crate) async fn connect(config: &ClientConfig) -> Result<(Endpoint, Connection), PlayError> {
    let Locator { host, port, .. } = &config.locator;
    let unknown = || PlayError::Host { host: host.clone() };
    let found = tokio::net::lookup_host((host.as_str(), *port)).await.map_err(|_| unknown())?;
    let addresses: Vec<SocketAddr> = found.take(MAX_ADDRESSES).collect();
    // A name may stand for addresses at which nobody listens: each has its share of the patience.
    let share = config.silence / addresses.len().max(1) as u32;
    let mut result = Err(unknown());
    for address in addresses {
        result = connect_to(config, address, share).await;
        let silent = matches!(result, Err(PlayError::Silence { .. } | PlayError::Socket(_)));
        if !silent {
            break;
        }
    }
    result.map_err(|error| match error {
        PlayError::Silence { .. } => PlayError::Silence { ms: config.silence.as_millis() },
        error => error,
    })
}

/// Connects to one address, within `patience`.
async fn connect_to(
    config: &ClientConfig,
    address: SocketAddr,
    patience: Duration,
) -> Result<(Endpoint, Connection), PlayError> {
    let Locator { host, .. } = &config.locator;
    let (crypto, mismatch) = config.trust.client(config.locator.scheme)?;
    let mut client = quinn::ClientConfig::new(Arc::new(crypto));
    client.transport_config(client_transport(config.silence, config.locator.scheme, !config.streams));
    let any: SocketAddr = match address {
        SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
        SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
    };
    let endpoint = Endpoint::client(any).map_err(PlayError::Socket)?;
    let connecting = endpoint.connect_with(client, address, host);
    let connecting = connecting.map_err(|error| PlayError::Handshake(error.to_string()))?;
    let silence = PlayError::Silence { ms: patience.as_millis() };
    let connected = timeout(patience, connecting).await.map_err(|_| silence)?;
    Ok((endpoint, connected.map_err(|error| handshake(config, &mismatch, error))?))
}

/// What a failed handshake means.
fn handshake(config: &ClientConfig, mismatch: &Mismatch, error: ConnectionError) -> PlayError {
    match (&config.trust, mismatch.get(), error) {
        (Trust::Pin(wanted), Some(found), _) => PlayError::WrongPin { found: *found, wanted: *wanted },
        (_, _, ConnectionError::TimedOut) => PlayError::Silence { ms: config.silence.as_millis() },
        (_, _, ConnectionError::ConnectionClosed(close))
            if close.error_code == TransportErrorCode::CONNECTION_REFUSED =>
        {
            let sentence = "it has no room for another connection".to_owned();
            PlayError::Refused(Refusal { code: RefusalCode::Full, sentence })
        }
        (_, _, error) => PlayError::Handshake(explained(error.to_string())),
    }
}

/// What rustls says only by the name of an error in its code, in words.
fn explained(error: String) -> String {
    if error.contains("CaUsedAsEndEntity") {
        return "the server's certificate is itself one of an authority (CA:TRUE), which may sign others but \
                not be a server's: its pin is enough, or a certificate made with \
                -addext basicConstraints=critical,CA:FALSE"
            .to_owned();
    }
    error
}
