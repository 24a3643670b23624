//! Publishes streams to a relay, window after window on the clock of the display, or as they come, for as
//! long as it is let.

use std::{
    future::poll_fn,
    task::Poll,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use emulator_host::Nanos;
use moq_net::{Client, origin, time};
use serde::Serialize;
use tokio::time::{sleep, sleep_until};

use super::{
    broadcast::{BroadcastReport, ChannelError},
    channel::Channel,
    growing::GrowingChannel,
    numbering::LEAD,
    relay::{Relay, close, origin},
};
use crate::socket::{
    ClientConfig, Locator, PlayError, ServedStream, Trust, message::StreamChoice, printable,
};

/// Longest wait before a lost relay is tried again; the first is a second, each the double of the last.
const MAX_PAUSE: Duration = Duration::from_secs(16);

/// Where to publish, and how.
#[derive(Clone, Debug)]
pub struct PublishConfig {
    /// The relay; the name, if it has one, is that of the broadcast.
    pub relay: Locator,
    /// By what the relay is known.
    pub trust: Trust,
    /// For how long the relay may say nothing.
    pub silence: Duration,
}

impl PublishConfig {
    /// Publishes at `relay`.
    pub fn new(relay: Locator, trust: Trust) -> Self {
        Self { relay, trust, silence: Duration::from_secs(10) }
    }
}

/// Why nothing is published.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    /// The relay cannot be reached.
    #[error(transparent)]
    Relay(#[from] PlayError),
    /// Several streams cannot share one name.
    #[error("the address names {name}, and {streams} streams are to be published; leave the name out")]
    Name {
        /// The name.
        name: String,
        /// How many.
        streams: usize,
    },
    /// A stream cannot be published.
    #[error(transparent)]
    Channel(#[from] ChannelError),
}

/// What happens while a broadcast is published.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PublishEvent {
    /// The relay takes broadcasts, by this version of the protocol.
    Connected {
        /// Its name.
        version: String,
    },
    /// The relay is gone and will be tried again.
    Lost {
        /// Why.
        reason: String,
        /// After so long.
        pause: Duration,
    },
}

/// What was published.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PublishReport {
    /// One entry per stream.
    pub broadcasts: Vec<BroadcastReport>,
    /// Connections made.
    pub connections: u32,
    /// The version of the protocol, of the last connection.
    pub version: Option<String>,
}

/// Publishes `offers` until `stop` ends. A relay that was there and is lost is tried again.
///
/// # Errors
/// A relay that is not reached the first time, and what cannot be published.
pub async fn publish(
    config: &PublishConfig,
    offers: &[ServedStream],
    stop: impl Future<Output = ()>,
    news: impl FnMut(&PublishEvent),
) -> Result<PublishReport, PublishError> {
    let (origin, driver) = origin();
    let (mut channels, mut growing) = (Vec::new(), Vec::new());
    for offer in offers {
        let name = name(config, offer, offers.len())?;
        if offer.grows() {
            growing.push(GrowingChannel::new(&name, offer, &origin)?);
        } else {
            channels.push(Channel::new(&name, offer, &origin)?);
        }
    }
    let mut report = PublishReport::default();
    let ended = tokio::select! {
        ended = connections(config, &origin, news, &mut report) => ended,
        ended = repeat(&mut channels) => ended,
        ended = follow(&mut growing) => ended,
        error = time::run(driver) => Err(PlayError::Relay(error.to_string()).into()),
        () = stop => Ok(()),
    };
    ended?;
    let repeated = channels.iter().map(Channel::report);
    report.broadcasts = repeated.chain(growing.iter().map(GrowingChannel::report)).collect();
    Ok(report)
}

/// What the broadcast of `offer` is called.
fn name(config: &PublishConfig, offer: &ServedStream, streams: usize) -> Result<String, PublishError> {
    match &config.relay.stream {
        StreamChoice::Name(name) if streams == 1 => Ok(name.clone()),
        StreamChoice::Name(name) => Err(PublishError::Name { name: name.clone(), streams }),
        StreamChoice::Index(_) => Ok(offer.name().to_owned()),
    }
}

/// Keeps a connection to the relay.
async fn connections(
    config: &PublishConfig,
    origin: &origin::Producer,
    mut news: impl FnMut(&PublishEvent),
    report: &mut PublishReport,
) -> Result<(), PublishError> {
    let silence = config.silence;
    let client = ClientConfig { silence, ..ClientConfig::new(config.relay.clone(), config.trust.clone()) };
    let mut pause = Duration::from_secs(1);
    loop {
        let reason = match Relay::connect(&client, Client::new().with_publisher(origin)).await {
            Ok(relay) => {
                let version = relay.session.version().as_str().to_owned();
                news(&PublishEvent::Connected { version: version.clone() });
                report.connections += 1;
                report.version = Some(version);
                pause = Duration::from_secs(1);
                let closing = OnDrop(&relay.connection);
                let error = time::run(relay.driver).await;
                drop(closing);
                close(&relay.endpoint, &relay.connection).await;
                printable(error)
            }
            Err(error) if report.connections == 0 => return Err(error.into()),
            Err(error) => error.to_string(),
        };
        news(&PublishEvent::Lost { reason, pause });
        sleep(pause).await;
        pause = (2 * pause).min(MAX_PAUSE);
    }
}

/// Closes the connection when publishing is stopped, so that the relay hears of it at once.
struct OnDrop<'c>(&'c quinn::Connection);

impl Drop for OnDrop<'_> {
    fn drop(&mut self) {
        self.0.close(0u32.into(), b"bye");
    }
}

/// Publishes what comes of streams that grow, for ever.
async fn follow(growing: &mut [GrowingChannel]) -> Result<(), PublishError> {
    let mut following: Vec<_> = growing.iter_mut().map(|channel| Box::pin(channel.follow())).collect();
    let ended = poll_fn(|cx| {
        let mut ended = following.iter_mut().map(|following| following.as_mut().poll(cx));
        ended.find(Poll::is_ready).unwrap_or(Poll::Pending)
    });
    Ok(ended.await?)
}

/// Publishes what is due, for ever.
async fn repeat(channels: &mut [Channel]) -> Result<(), PublishError> {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let (began, now) = (Instant::now(), nanos(since_1970));
    channels.iter_mut().for_each(|channel| channel.begin(now));
    loop {
        // In time order, whichever broadcast it is of.
        let Some(channel) = channels.iter_mut().min_by_key(|channel| channel.next_begins()) else {
            return std::future::pending().await;
        };
        let wait = (channel.next_begins() - LEAD) - now;
        sleep_until((began + Duration::from_nanos(wait.0)).into()).await;
        channel.advance()?;
    }
}

fn nanos(time: Duration) -> Nanos {
    Nanos(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX))
}
