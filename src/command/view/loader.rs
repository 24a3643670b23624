//! Brings a stream from a server to a window: packets of a session, or a file by byte ranges.

#[cfg(test)]
mod tests;

use std::{
    collections::VecDeque,
    io::{self, Read as _},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, SyncSender, TryRecvError, TrySendError},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail};
use codec_core::internals::wire::receipt::ViewerPose;
use dgs_quic::socket::{
    ClientConfig, Conditions, FrameSink, Granted, Locator, RoundRequest, Trust, ViewerLink, play,
};
use dgs_viewer::{Conditions as Network, FIRST_BYTES};
use dgs_window::{Arrival, Feed, FeedRequest, Feeder, feed};
use emulator_host::{PolicyKind, Rate};
use ureq::{Agent, Body, http::Response};

use crate::command::socket::runtime;

/// Largest file, bytes.
const MAX_FILE_BYTES: u64 = 4 << 30;
/// Longest wait for a connection or an answer; the bytes of a part may take as long again, and besides what
/// they need at [`SLOWEST_BYTES_PER_S`].
const TIMEOUT: Duration = Duration::from_secs(30);
/// Bytes per second of the slowest path over which parts of a file are waited for.
const SLOWEST_BYTES_PER_S: u64 = 4 << 10;
/// Tries of one request, and what lies between two.
const TRIES: u32 = 4;
const PAUSE: Duration = Duration::from_millis(200);
/// Rounds are this far apart at least: a server takes five seeks a second.
const ROUND_EVERY: Duration = Duration::from_millis(250);
/// Packets that wait for their manifest.
const EARLY_PACKETS: usize = 128;
/// How soon the end of the window is noticed.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// How long the end waits for the thread: longer than a session takes to say bye, and no longer, since a
/// file's server may not answer.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// Whether `input` is an address and no path.
pub(super) fn is_address(input: &str) -> bool {
    ["dgs://", "https://", "http://"].iter().any(|scheme| input.starts_with(scheme))
}

/// What brings a stream, on a thread of its own.
pub(super) struct StreamLoader {
    thread: JoinHandle<()>,
    stop: Arc<AtomicBool>,
}

impl StreamLoader {
    /// Begins to bring what lies at `address`, of which the time `start_s`, seconds, is shown first.
    ///
    /// # Errors
    /// It is no address, or nothing says by what the server is known.
    pub fn begin(address: &str, start_s: f64) -> Result<(Self, Feed)> {
        let (feeder, feed) = feed();
        let stop = Arc::new(AtomicBool::new(false));
        let heard = Arc::clone(&stop);
        let path = address.split(['#', '?']).next().unwrap_or(address);
        let is_file = address.starts_with("http://") || path.ends_with(".dgs");
        let thread = if is_file && !address.starts_with("dgs://") {
            let url = address.to_owned();
            named("dgs-ranges", move || load_file(&url, &feeder, &heard))?
        } else {
            let locator: Locator = address.parse()?;
            let Some(pin) = locator.pin else { bail!("{address}: its #PIN is missing; dgs serve prints it") };
            let start_us = (start_s * 1e6) as u64;
            let new = ClientConfig::new(locator, Trust::Pin(pin));
            let config = ClientConfig { start_us, loops: true, ..new };
            named("dgs-session", move || load_session(&config, feeder, &heard))?
        };
        Ok((Self { thread, stop }, feed))
    }

    /// Ends it.
    pub fn end(self) {
        self.stop.store(true, Ordering::Relaxed);
        // So that a server hears of it. A thread that waits for a file ends with the process.
        let begun = Instant::now();
        while !self.thread.is_finished() && begun.elapsed() < LAST_WORDS {
            thread::sleep(POLL_INTERVAL / 10);
        }
    }
}

fn named(name: &str, act: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>> {
    thread::Builder::new().name(name.to_owned()).spawn(act).context("cannot receive beside the window")
}

/// The session's end: packets go to the window.
struct Forwarding<'s> {
    arrivals: SyncSender<Arrival>,
    requests: Receiver<FeedRequest>,
    /// Ends the session.
    stop: &'s AtomicBool,
    /// Packets that came before the manifest; `None` after it.
    early: Option<Vec<Vec<u8>>>,
    /// The round that is wanted, and when the last was begun.
    wanted_us: Option<u64>,
    /// Conditions that it is to begin under.
    conditions: Option<Conditions>,
    round_at: Option<Instant>,
    pose: Option<ViewerPose>,
    /// What must arrive and found no room.
    waiting: VecDeque<Arrival>,
}

impl Forwarding<'_> {
    /// A window that is slow or hidden loses packets as a network does, and nothing else.
    fn send(&mut self, arrival: Arrival) {
        self.send_waiting();
        if matches!(arrival, Arrival::Packet(_)) {
            if self.waiting.is_empty() {
                let _ = self.arrivals.try_send(arrival);
            }
            return;
        }
        // Twice anew is anew.
        if !matches!((&arrival, self.waiting.back()), (Arrival::Anew, Some(Arrival::Anew))) {
            self.waiting.push_back(arrival);
        }
        self.send_waiting();
    }

    fn send_waiting(&mut self) {
        while let Some(arrival) = self.waiting.pop_front() {
            if let Err(TrySendError::Full(arrival)) = self.arrivals.try_send(arrival) {
                self.waiting.push_front(arrival);
                return;
            }
        }
    }
}

impl FrameSink for Forwarding<'_> {
    fn show(&mut self, _: &mut dgs_player::Player, _: u32) -> Result<(), String> {
        self.send_waiting();
        Ok(())
    }

    fn manifest(&mut self, message: &[u8]) {
        self.send(Arrival::Manifest(message.to_vec()));
        for packet in self.early.take().into_iter().flatten() {
            self.send(Arrival::Packet(packet));
        }
    }

    fn begun(&mut self, time_us: u64) {
        self.send(Arrival::Begin(time_us as f64 * 1e-6));
    }

    fn media(&mut self, packet: &[u8]) {
        match &mut self.early {
            Some(early) if early.len() < EARLY_PACKETS => early.push(packet.to_vec()),
            Some(_) => {}
            None => self.send(Arrival::Packet(packet.to_vec())),
        }
    }

    fn requested_round(&mut self) -> Option<RoundRequest> {
        loop {
            match self.requests.try_recv() {
                Ok(FeedRequest::From(seconds)) => self.wanted_us = Some((seconds * 1e6) as u64),
                Ok(FeedRequest::Network { conditions: network, scheduler }) => {
                    self.conditions = Some(conditions(network.as_ref(), scheduler));
                }
                Ok(FeedRequest::Sight(pose)) => self.pose = Some(pose),
                Ok(FeedRequest::Bytes(_) | FeedRequest::Whole) => {}
                Err(TryRecvError::Empty) => break,
                // The window shows something else, or is gone.
                Err(TryRecvError::Disconnected) => {
                    self.stop.store(true, Ordering::Relaxed);
                    return None;
                }
            }
        }
        if self.round_at.is_some_and(|at| at.elapsed() < ROUND_EVERY) {
            return None;
        }
        let start_us = self.wanted_us.take()?;
        self.round_at = Some(Instant::now());
        Some(RoundRequest { start_us, conditions: self.conditions.take() })
    }

    fn granted(&mut self, granted: Granted) {
        self.send(Arrival::Network { by_server: granted.link, by_scheduler: granted.scheduler });
    }

    fn forget(&mut self) {
        self.send(Arrival::Anew);
    }

    fn pose(&mut self) -> Option<ViewerPose> {
        self.pose
    }
}

/// What a window asks for, as a server is asked for it: from then on each round begins with nothing, since
/// of a scene that is all there no packet is lost.
fn conditions(network: Option<&Network>, scheduler: Option<&str>) -> Conditions {
    let wanted = Conditions::NONE.with_rounds_anew();
    let kind = PolicyKind::ALL.into_iter().find(|kind| Some(kind.name()) == scheduler);
    let wanted = kind.map_or(wanted, |kind| wanted.with_scheduler(kind));
    let Some(network) = network else { return wanted.with_link_as_it_is() };
    let Network { loss, burst, rate_bps, delay_s, seed } = *network;
    let rate = rate_bps.map(|bps| Rate(bps.round() as u64));
    let delay = Duration::from_secs_f64(delay_s.clamp(0.0, 1.0));
    let link = ViewerLink { rate, delay, loss, burst, seed: seed as u32 };
    // What keys ask for is in range.
    wanted.behind(&link).unwrap_or(wanted)
}

/// Receives until `stop`.
fn load_session(config: &ClientConfig, feeder: Feeder, stop: &AtomicBool) {
    let Feeder { arrivals, requests } = feeder;
    let last = arrivals.clone();
    let mut screen = Forwarding {
        arrivals,
        requests,
        stop,
        early: Some(Vec::new()),
        wanted_us: None,
        conditions: None,
        round_at: None,
        pose: None,
        waiting: VecDeque::new(),
    };
    let stopped = async {
        while !stop.load(Ordering::Relaxed) {
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    };
    let why = match runtime() {
        Ok(runtime) => runtime.block_on(play(config, &mut screen, stopped)).error.map(|e| e.to_string()),
        Err(error) => Some(format!("{error:#}")),
    };
    // The window takes these when it is shown again, or is gone.
    let end = Arrival::End(why.map(|why| format!("{}: {why}", config.locator)));
    for arrival in screen.waiting.into_iter().chain([end]) {
        let _ = last.send(arrival);
    }
}

/// Fetches a file, what is asked for first, until all of it is there or `stop`.
fn load_file(url: &str, feeder: &Feeder, stop: &AtomicBool) {
    let patient = Agent::config_builder()
        .timeout_resolve(Some(TIMEOUT))
        .timeout_connect(Some(TIMEOUT))
        .timeout_recv_response(Some(TIMEOUT));
    let agent = Agent::new_with_config(patient.build());
    let end = match fetch(&agent, url, feeder, stop) {
        Ok(()) => None,
        Err(error) => Some(format!("{url}: {error:#}")),
    };
    let _ = feeder.arrivals.send(Arrival::End(end));
}

fn fetch(agent: &Agent, url: &str, feeder: &Feeder, stop: &AtomicBool) -> Result<()> {
    let front = match ask(agent, url, Some((0, FIRST_BYTES)))? {
        Answer::Whole(bytes) => {
            feeder.arrivals.send(Arrival::File(bytes))?;
            return Ok(());
        }
        Answer::Part { bytes, file } => (bytes, file),
    };
    let (mut bytes, file) = front;
    let length = file.length;
    if let Err(needed) = dgs_viewer::message(&bytes)? {
        match ask(agent, url, Some((0, needed.min(length))))? {
            Answer::Whole(whole) => {
                feeder.arrivals.send(Arrival::File(whole))?;
                return Ok(());
            }
            Answer::Part { bytes: longer, file: now } => {
                now.check_unchanged(&file)?;
                bytes = longer;
            }
        }
    }
    feeder.arrivals.send(Arrival::Front { bytes, length })?;
    while !stop.load(Ordering::Relaxed) {
        let arrival = match feeder.requests.try_recv() {
            Ok(FeedRequest::Bytes(range)) => match ask(agent, url, Some((range.start, range.end)))? {
                Answer::Part { bytes, file: now } => {
                    now.check_unchanged(&file)?;
                    Arrival::Piece { at: range.start, bytes }
                }
                Answer::Whole(bytes) => Arrival::File(bytes),
            },
            Ok(FeedRequest::Whole) => match ask(agent, url, None)? {
                Answer::Whole(bytes) => Arrival::File(bytes),
                Answer::Part { .. } => bail!("a part came where the whole was asked for"),
            },
            // A file is fetched in its own order.
            Ok(FeedRequest::From(_) | FeedRequest::Network { .. } | FeedRequest::Sight(_)) => continue,
            Err(TryRecvError::Empty) => {
                thread::sleep(POLL_INTERVAL / 10);
                continue;
            }
            Err(TryRecvError::Disconnected) => return Ok(()),
        };
        let whole = matches!(arrival, Arrival::File(_));
        feeder.arrivals.send(arrival)?;
        if whole {
            return Ok(());
        }
    }
    Ok(())
}

/// What a server answers.
enum Answer {
    Part { bytes: Vec<u8>, file: ServedFile },
    Whole(Vec<u8>),
}

/// The file of which a part was answered.
struct ServedFile {
    length: u64,
    /// What names this version of it (RFC 9110, 8.8.3), if the server says.
    etag: Option<String>,
}

impl ServedFile {
    /// # Errors
    /// That parts of `before` and of this one do not belong together.
    fn check_unchanged(&self, before: &Self) -> Result<()> {
        if self.length != before.length || self.etag != before.etag {
            bail!("the file has changed on the server since it was opened; open it again");
        }
        Ok(())
    }
}

/// Bytes `from` to `past` of `url`, or all of it; tried again while the server is to blame.
fn ask(agent: &Agent, url: &str, part: Option<(u64, u64)>) -> Result<Answer> {
    let mut tried = 1;
    loop {
        match ask_once(agent, url, part) {
            Err(error) if tried < TRIES && may_pass(&error) => thread::sleep(PAUSE * 2u32.pow(tried)),
            answer => return answer,
        }
        tried += 1;
    }
}

/// Whether another try may do better: not when the server says that there is nothing, or what means nothing.
fn may_pass(error: &anyhow::Error) -> bool {
    match error.downcast_ref::<ureq::Error>() {
        Some(ureq::Error::StatusCode(status)) => *status >= 500,
        Some(_) => true,
        // A connection that was cut while bytes came.
        None => error.is::<io::Error>(),
    }
}

fn ask_once(agent: &Agent, url: &str, part: Option<(u64, u64)>) -> Result<Answer> {
    let mut request = agent.get(url);
    if let Some((from, past)) = part {
        request = request.header("Range", format!("bytes={from}-{}", past.saturating_sub(1)));
        let longest = TIMEOUT + Duration::from_secs((past - from) / SLOWEST_BYTES_PER_S);
        request = request.config().timeout_recv_body(Some(longest)).build();
    }
    let response = request.call()?;
    let Some((from, past)) = part.filter(|_| response.status() == 206) else {
        return Ok(Answer::Whole(body(response, MAX_FILE_BYTES)?));
    };
    let field = |name: &str| response.headers().get(name).and_then(|field| field.to_str().ok());
    let (range, etag) = (field("Content-Range").unwrap_or(""), field("ETag").map(str::to_owned));
    let (first, length) = content_range(range)
        .with_context(|| format!("Content-Range is {range:?}; bytes FIRST-LAST/LENGTH is needed"))?;
    if first != from {
        bail!("bytes from {first} on came; from {from} on were asked for");
    }
    let bytes = body(response, past - from)?;
    let wanted = past.min(length).saturating_sub(from);
    if (bytes.len() as u64) < wanted {
        let short = format!("{} bytes of {wanted} came", bytes.len());
        return Err(io::Error::new(io::ErrorKind::UnexpectedEof, short).into());
    }
    Ok(Answer::Part { bytes, file: ServedFile { length, etag } })
}

/// First byte and length of the file, of `bytes FIRST-LAST/LENGTH` (RFC 9110, 14.4).
fn content_range(field: &str) -> Option<(u64, u64)> {
    let (range, length) = field.strip_prefix("bytes ")?.split_once('/')?;
    let (first, _) = range.split_once('-')?;
    Some((first.trim().parse().ok()?, length.trim().parse().ok()?))
}

/// The bytes of an answer, `most` at most.
fn body(response: Response<Body>, most: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    response.into_body().into_reader().take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        bail!("more than {most} bytes came");
    }
    Ok(bytes)
}
