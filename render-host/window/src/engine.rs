//! An engine draws a session when something has changed: the loop of a window without the window.

#[cfg(test)]
mod tests;

use codec_core::internals::wire::receipt::ViewerPose;
use dgs_player::Damage;
use dgs_viewer::{Conditions, DrawOptions, Drawn, KeepUp, Screen, Session, Wanted, message};

use crate::{
    Arrival, Feed, FeedRequest, WindowError, WindowOptions,
    controls::{Act, next_background},
    options::aspect,
    title::{Rates, title},
};

/// Frames that a device may be given before it has finished the first of them.
const MAX_PENDING: u32 = 2;
/// How soon to look again, seconds: while a device draws, for what arrives, and at most while the clock runs.
const DRAWING_S: f64 = 0.004;
const ARRIVING_S: f64 = 0.02;
const LONGEST_S: f64 = 0.1;
/// How soon to look again at what arrives while nothing is seen.
const HIDDEN_S: f64 = 0.25;
/// Over how long frames and bits are counted, seconds.
const COUNTED_S: f64 = 0.5;
/// Packets of others that one look takes at most, so that a flood does not stop the pictures.
const MAX_ARRIVALS: usize = 1024;

/// What a drawn picture depends on.
type State = (u64, u32, [f64; 6], &'static str, DrawOptions);

/// The session that is shown, where its stream comes from, and what of it is on the screen.
pub(crate) struct Engine {
    options: WindowOptions,
    feed: Feed,
    session: Option<Session>,
    /// Whether its stream grows, and playout has begun.
    begun: bool,
    /// The last piece of a file that was asked for.
    requested: Option<FeedRequest>,
    /// The network and the scheduler that the server was last asked for.
    network: Option<Conditions>,
    scheduler: Option<&'static str>,
    /// Where the camera was when the server last heard of it.
    said: Option<ViewerPose>,
    drawn: Drawn,
    state: Option<State>,
    background: [f32; 3],
    /// When the clock was moved last, and when it was to be moved next, seconds.
    last_s: Option<f64>,
    due_s: Option<f64>,
    /// Since when there has been something to draw, seconds.
    wanted_s: Option<f64>,
    keep_up: KeepUp,
    frames: u64,
    /// Until when frames and bytes were counted last, seconds, and how many there were.
    counted: (f64, u64, u64),
    rates: Rates,
    /// Whether the clip has ended and the window is to close.
    ended: bool,
    complaints: Vec<String>,
}

impl Engine {
    pub fn new(options: WindowOptions, feed: Feed) -> Self {
        Self {
            background: options.background,
            options,
            feed,
            session: None,
            begun: false,
            requested: None,
            network: None,
            scheduler: None,
            said: None,
            drawn: None,
            state: None,
            last_s: None,
            due_s: None,
            wanted_s: None,
            keep_up: KeepUp::default(),
            frames: 0,
            counted: (0.0, 0, 0),
            rates: Rates::default(),
            ended: false,
            complaints: Vec::new(),
        }
    }

    /// Does what a key asks for.
    pub fn act(&mut self, act: Act, size: [u32; 2]) -> Result<(), WindowError> {
        if act == Act::Background {
            self.background = next_background(self.background);
        }
        if act == Act::KeepUp {
            self.keep_up.set_on(!self.keep_up.is_on());
        }
        let Some(session) = &mut self.session else { return Ok(()) };
        let before = self.network.unwrap_or(session.conditions());
        // A server, if it grants that, chooses packets for the network that is asked for.
        let requested = act.network(before).filter(|_| session.is_live());
        let asks = requested.is_some() || (act == Act::Scheduler && session.is_live());
        if asks {
            self.network = requested.or(self.network);
            if act == Act::Scheduler {
                self.scheduler = next_scheduler(&self.options.schedulers, self.scheduler);
            }
            let (conditions, scheduler) = (self.network, self.scheduler);
            self.feed.request(FeedRequest::Network { conditions, scheduler });
        } else {
            act.apply(session, size)?;
        }
        if act.seeks() || asks {
            self.feed.request(FeedRequest::From(session.playback().time_s()));
        }
        Ok(())
    }

    /// Plays the stream of `feed` in place of what is played.
    pub fn play(&mut self, name: String, feed: Feed) {
        self.options.name = name;
        (self.feed, self.session, self.requested, self.said) = (feed, None, None, None);
        (self.network, self.scheduler) = (None, None);
        (self.drawn, self.state, self.last_s) = (None, None, None);
    }

    /// What another screen must be given anew.
    pub fn forget(&mut self) {
        (self.drawn, self.state) = (None, None);
    }

    /// What was drawn is no longer on the window: it is drawn again.
    pub fn redraw(&mut self) {
        self.state = None;
    }

    /// The title of the window.
    pub fn title(&self) -> String {
        match &self.session {
            Some(session) => {
                let network = self.network.unwrap_or(session.conditions());
                let scheduler = self.scheduler.map_or(String::new(), |name| format!(" · {name}"));
                let reduced = self.keep_up.sentence();
                let reduced =
                    if reduced.is_empty() { reduced } else { format!(" · keeping up with {reduced}") };
                let whole = if self.keep_up.is_on() { "" } else { " · always whole" };
                title(&self.options.name, session, self.rates, &network) + &scheduler + &reduced + whole
            }
            None => format!("{} · loading", self.options.name),
        }
    }

    /// Frames drawn.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Whether the clip was played once and that was all that was wanted.
    pub fn has_ended(&self) -> bool {
        self.ended && self.options.closes
    }

    /// Takes the sentences for people that have come up since the last call.
    pub fn complaints(&mut self) -> Vec<String> {
        std::mem::take(&mut self.complaints)
    }

    /// Time stands while nothing is seen. Takes what arrives; returns when to look again, seconds.
    pub fn hide(&mut self, size: [u32; 2]) -> Result<Option<f64>, WindowError> {
        (self.last_s, self.due_s, self.wanted_s) = (None, None, None);
        self.take_arrivals(size)?;
        Ok(self.feed.is_open().then_some(HIDDEN_S))
    }

    /// Moves the clock to `now_s`, draws if something has changed; returns when to look again, seconds from
    /// now, or `None` while nothing happens by itself.
    pub fn tick(
        &mut self,
        now_s: f64,
        screen: Option<&mut Screen>,
        size: [u32; 2],
    ) -> Result<Option<f64>, WindowError> {
        self.take_arrivals(size)?;
        let arriving = self.feed.is_open().then_some(ARRIVING_S);
        let Some(session) = &mut self.session else { return Ok(arriving) };
        let passed = self.last_s.map_or(0.0, |last| now_s - last);
        self.last_s = Some(now_s);
        let step = session.advance(passed);
        if step.looped {
            self.feed.request(FeedRequest::From(session.playback().time_s()));
        }
        self.ended |= step.ended;
        // A server sends first what is seen.
        let pose = session.orbit().pose().filter(|pose| session.is_live() && self.said != Some(*pose));
        if let Some(pose) = pose {
            self.feed.request(FeedRequest::Sight(pose));
            self.said = Some(pose);
        }
        let busy = session.deliver(now_s);
        let playing = session.playback().playing();
        let next = if playing { Some(until_next_frame(session)) } else { None };
        let still = self.adapt(now_s).then_some(ARRIVING_S);
        let mut drawing = None;
        if let Some(screen) = screen {
            self.draw(now_s, screen, size)?;
            let unfinished = screen.pending() > 0 || screen.must_draw_again();
            drawing = unfinished.then_some(DRAWING_S);
        }
        self.count(now_s);
        // What has just come is painted as new by drawing it.
        let busy = busy || self.session.as_ref().is_some_and(Session::fading);
        let due = [next, drawing, still, arriving, busy.then_some(ARRIVING_S)];
        let soonest = due.into_iter().flatten().reduce(f64::min);
        self.due_s = soonest.map(|soonest| now_s + soonest);
        if soonest.is_none() {
            self.last_s = None;
        }
        Ok(soonest)
    }

    /// Draws what has changed, unless the device has enough to do.
    fn draw(&mut self, now_s: f64, screen: &mut Screen, shown: [u32; 2]) -> Result<(), WindowError> {
        let Some(session) = &mut self.session else { return Ok(()) };
        let reduction = self.keep_up.reduction();
        let scaled = |side: u32| ((f64::from(side) * reduction.scale).round() as u32).max(1);
        let (background, sh_degree) = (self.background, reduction.sh_degree);
        let look = DrawOptions { size: shown.map(scaled), shown, background, sh_degree };
        let orbit = session.orbit();
        let (view, up) = (orbit.numbers(), orbit.up().name());
        let state = (session.content(), session.playback().frame(), view, up, look);
        if self.state == Some(state) && !screen.must_draw_again() {
            return Ok(());
        }
        // Since this was to be looked at: whoever is late has something to draw since then.
        let wanted_s = *self.wanted_s.get_or_insert(self.due_s.unwrap_or(now_s).min(now_s));
        if screen.pending() >= MAX_PENDING {
            return Ok(());
        }
        screen.draw(session, &mut self.drawn, &look)?;
        self.state = Some(state);
        self.frames += 1;
        self.wanted_s = None;
        self.keep_up.picture(now_s, now_s - wanted_s);
        Ok(())
    }

    /// Counts frames and bits per second.
    fn count(&mut self, now_s: f64) {
        let (since, frames, bytes) = self.counted;
        let passed = now_s - since;
        if passed >= COUNTED_S {
            let arrived = self.session.as_ref().map_or(0, Session::delivered_bytes);
            // Fewer than before where packets come anew.
            let bits = 8.0 * arrived.saturating_sub(bytes) as f64 / passed;
            self.rates = Rates { frames: (self.frames - frames) as f64 / passed, bits };
            self.counted = (now_s, self.frames, arrived);
        }
    }

    /// Leaves out of what is drawn at `now_s` as much as pictures that came late ask for. True while the
    /// camera moves or the clock runs: what is still is drawn whole.
    fn adapt(&mut self, now_s: f64) -> bool {
        let Some(session) = &mut self.session else { return false };
        let sh_degree = session.player().info().sh_degree.get();
        self.keep_up.set_most(sh_degree, session.cap(), false);
        let moving = self.keep_up.look(now_s, session.playback().playing(), session.orbit().numbers());
        let reduction = self.keep_up.reduction();
        session.reduce(reduction.cap, reduction.share);
        moving
    }

    /// Takes what has arrived, and asks for what is wanted next.
    fn take_arrivals(&mut self, size: [u32; 2]) -> Result<(), WindowError> {
        for _ in 0..MAX_ARRIVALS {
            let Some(arrival) = self.feed.next() else { break };
            self.take(arrival, size)?;
        }
        let Some(session) = &mut self.session else { return Ok(()) };
        session.look_again(aspect(size))?;
        let request = match session.wanted() {
            Wanted::Range(range) => FeedRequest::Bytes(range),
            Wanted::Whole => FeedRequest::Whole,
            Wanted::Nothing => return Ok(()),
        };
        if self.requested.as_ref() != Some(&request) {
            self.feed.request(request.clone());
            self.requested = Some(request);
        }
        Ok(())
    }

    fn complain_of(&mut self, damage: &Damage) {
        if !damage.is_none() {
            self.complaints.push(format!("{}: {damage}", self.options.name));
        }
    }

    fn take(&mut self, arrival: Arrival, size: [u32; 2]) -> Result<(), WindowError> {
        match (arrival, &mut self.session) {
            (Arrival::File(bytes), Some(session)) => {
                let damage = session.take_whole(&bytes)?;
                self.complain_of(&damage);
            }
            (Arrival::File(bytes), None) => {
                let (session, damage) = Session::open(&bytes)?;
                self.complain_of(&damage);
                self.begin(session, size)?;
            }
            (Arrival::Front { bytes, length }, _) => {
                let Ok(front) = message(&bytes)? else {
                    return Err(WindowError::Feed("file.manifest: its bytes are not all there".into()));
                };
                let mut session = Session::new(front)?;
                session.fetch(length);
                session.take(0, &bytes);
                self.begin(session, size)?;
            }
            (Arrival::Manifest(bytes), None) => {
                let mut session = Session::new(&bytes)?;
                session.set_live();
                self.begin(session, size)?;
            }
            (Arrival::Piece { at, bytes }, Some(session)) => session.take(at, &bytes),
            (Arrival::Packet(packet), Some(session)) => session.push(&packet),
            (Arrival::Begin(time_s), Some(session)) => {
                let playback = session.playback_mut();
                // Its end is one: nothing of it is sent again.
                playback.set_looping(false);
                // Who pauses it stays where they are; at its end nobody has.
                let has_ended = playback.time_s() >= playback.duration_s();
                if !std::mem::replace(&mut self.begun, true) || playback.playing() || has_ended {
                    playback.seek(time_s);
                }
                if has_ended {
                    playback.set_playing(true);
                }
            }
            (Arrival::Network { by_server, by_scheduler }, Some(session)) => {
                if let Some(name) = self.scheduler.filter(|_| !by_scheduler) {
                    self.complaints.push(format!("{}: the server does not grant {name}", self.options.name));
                    self.scheduler = None;
                }
                let here = self.network.filter(|_| !by_server).unwrap_or_default();
                if here != session.conditions() {
                    session.impair(here)?;
                }
            }
            (Arrival::Anew, Some(session)) => session.restart()?,
            (Arrival::End(Some(why)), None) => return Err(WindowError::Feed(why)),
            (Arrival::End(Some(why)), Some(_)) => self.complaints.push(why),
            // A manifest that is repeated says nothing new; what belongs to no stream is nobody's.
            (Arrival::Manifest(_) | Arrival::Piece { .. } | Arrival::Packet(_) | Arrival::Begin(_), _)
            | (Arrival::Network { .. } | Arrival::Anew | Arrival::End(None), _) => {}
        }
        Ok(())
    }

    fn begin(&mut self, mut session: Session, size: [u32; 2]) -> Result<(), WindowError> {
        self.options.apply(&mut session, size)?;
        self.forget();
        self.begun = false;
        self.keep_up.restart();
        self.session = Some(session);
        Ok(())
    }
}

/// When the next frame is due, seconds from now.
fn until_next_frame(session: &Session) -> f64 {
    let (clock, rate) = (session.playback(), session.player().manifest().frames_per_second());
    let frame = f64::from(clock.frame());
    let left = if clock.rate() > 0.0 {
        (frame + 1.0) / rate - clock.time_s()
    } else {
        clock.time_s() - frame / rate
    };
    let seconds = left / clock.rate().abs().max(1e-3);
    // A tenth of a millisecond more, so that the frame is due then.
    if seconds.is_finite() { (seconds + 1e-4).clamp(1e-3, LONGEST_S) } else { LONGEST_S }
}

/// The scheduler after `now` in `all`; first and last is the server's own, `None`.
fn next_scheduler(all: &[&'static str], now: Option<&'static str>) -> Option<&'static str> {
    let after = now.and_then(|now| all.iter().position(|name| *name == now)).map_or(0, |at| at + 1);
    all.get(after).copied()
}
