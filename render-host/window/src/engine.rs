//! An engine draws a session when something has changed: the loop of a window without the window.

use codec_core::internals::wire::receipt::ViewerPose;
use dgs_viewer::{Drawn, Look, Screen, Session, Wanted, message};

use crate::{
    Arrival, Feed, WindowError, WindowOptions, Wish,
    controls::{Act, next_background},
    title::title,
};

/// Frames that wait longer than this, seconds, for as many frames in a row, have fewer pixels from then on.
const SLOW_S: f64 = 1.0 / 18.0;
const SLOW_FRAMES: u32 = 20;
/// What they draw then, of width and of height, and the least of it.
const FEWER: f64 = 0.75;
const SMALLEST_SCALE: f64 = 0.5;
/// Frames that a device may be given before it has finished the first of them.
const MOST_PENDING: u32 = 2;
/// How soon to look again, seconds: while a device draws, for what arrives, and at most while the clock runs.
const DRAWING_S: f64 = 0.004;
const ARRIVING_S: f64 = 0.02;
const LONGEST_S: f64 = 0.1;
/// How soon to look again at what arrives while nothing is seen.
const HIDDEN_S: f64 = 0.25;
/// Over how long frames are counted, seconds.
const COUNTED_S: f64 = 0.5;
/// Packets of others that one look takes at most, so that a flood does not stop the pictures.
const MOST_ARRIVALS: usize = 1024;

/// What a drawn picture depends on.
type State = (u64, u32, [f64; 6], &'static str, Look);

/// The session that is shown, where its stream comes from, and what of it is on the screen.
pub(crate) struct Engine {
    options: WindowOptions,
    feed: Feed,
    session: Option<Session>,
    /// The last piece of a file that was wished for.
    wished: Option<Wish>,
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
    slow: u32,
    scale: f64,
    frames: u64,
    counted: (f64, u64),
    rate: f64,
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
            wished: None,
            said: None,
            drawn: None,
            state: None,
            last_s: None,
            due_s: None,
            wanted_s: None,
            slow: 0,
            scale: 1.0,
            frames: 0,
            counted: (0.0, 0),
            rate: 0.0,
            ended: false,
            complaints: Vec::new(),
        }
    }

    /// Does what a key asks for.
    pub fn act(&mut self, act: Act, size: [u32; 2]) -> Result<(), WindowError> {
        if act == Act::Background {
            self.background = next_background(self.background);
        }
        let Some(session) = &mut self.session else { return Ok(()) };
        act.apply(session, size)?;
        if act.seeks() {
            self.feed.wish(Wish::From(session.playback().time_s()));
        }
        Ok(())
    }

    /// Plays the stream of `feed` in place of what is played.
    pub fn play(&mut self, name: String, feed: Feed) {
        self.options.name = name;
        (self.feed, self.session, self.wished, self.said) = (feed, None, None, None);
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
            Some(session) => title(&self.options.name, session, self.rate),
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
            self.feed.wish(Wish::From(session.playback().time_s()));
        }
        self.ended |= step.ended;
        // A server sends first what is seen.
        let pose = session.orbit().pose().filter(|pose| session.is_live() && self.said != Some(*pose));
        if let Some(pose) = pose {
            self.feed.wish(Wish::Sight(pose));
            self.said = Some(pose);
        }
        let busy = session.deliver(now_s);
        let playing = session.playback().playing();
        let next = if playing { Some(until_next_frame(session)) } else { None };
        let mut drawing = None;
        if let Some(screen) = screen {
            self.draw(now_s, screen, size)?;
            let unfinished = screen.pending() > 0 || screen.must_draw_again();
            drawing = unfinished.then_some(DRAWING_S);
        }
        self.count(now_s);
        let due = [next, drawing, arriving, busy.then_some(ARRIVING_S)];
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
        let scaled = |side: u32| ((f64::from(side) * self.scale).round() as u32).max(1);
        let look = Look { size: shown.map(scaled), shown, background: self.background };
        let orbit = session.orbit();
        let (view, up) = (orbit.numbers(), orbit.up().name());
        let state = (session.content(), session.playback().frame(), view, up, look);
        if self.state == Some(state) && !screen.must_draw_again() {
            return Ok(());
        }
        // Since this was to be looked at: whoever is late has something to draw since then.
        let wanted_s = *self.wanted_s.get_or_insert(self.due_s.unwrap_or(now_s).min(now_s));
        if screen.pending() >= MOST_PENDING {
            return Ok(());
        }
        screen.draw(session, &mut self.drawn, &look)?;
        self.state = Some(state);
        self.frames += 1;
        self.wanted_s = None;
        self.keep_up(now_s - wanted_s);
        Ok(())
    }

    /// Counts frames per second.
    fn count(&mut self, now_s: f64) {
        let (since, frames) = self.counted;
        let passed = now_s - since;
        if passed >= COUNTED_S {
            self.rate = (self.frames - frames) as f64 / passed;
            self.counted = (now_s, self.frames);
        }
    }

    /// A frame had to wait for `seconds`. Where many do, fewer pixels are drawn from now on.
    fn keep_up(&mut self, seconds: f64) {
        self.slow = if seconds > SLOW_S { self.slow + 1 } else { 0 };
        if self.slow >= SLOW_FRAMES && self.scale > SMALLEST_SCALE {
            self.scale = (self.scale * FEWER).max(SMALLEST_SCALE);
            self.slow = 0;
        }
    }

    /// Takes what has arrived, and wishes for what is wanted next.
    fn take_arrivals(&mut self, size: [u32; 2]) -> Result<(), WindowError> {
        for _ in 0..MOST_ARRIVALS {
            let Some(arrival) = self.feed.next() else { break };
            self.take(arrival, size)?;
        }
        let Some(session) = &self.session else { return Ok(()) };
        let wish = match session.wanted() {
            Wanted::Range(range) => Wish::Bytes(range),
            Wanted::Whole => Wish::Whole,
            Wanted::Nothing => return Ok(()),
        };
        if self.wished.as_ref() != Some(&wish) {
            self.feed.wish(wish.clone());
            self.wished = Some(wish);
        }
        Ok(())
    }

    fn take(&mut self, arrival: Arrival, size: [u32; 2]) -> Result<(), WindowError> {
        match (arrival, &mut self.session) {
            (Arrival::File(bytes), Some(session)) => session.take_whole(&bytes)?,
            (Arrival::File(bytes), None) => {
                let (session, damage) = Session::open(&bytes)?;
                if !damage.is_none() {
                    self.complaints.push(format!("{}: {damage}", self.options.name));
                }
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
            (Arrival::End(Some(why)), None) => return Err(WindowError::Feed(why)),
            (Arrival::End(Some(why)), Some(_)) => self.complaints.push(why),
            // A manifest that is repeated says nothing new; what belongs to no stream is nobody's.
            (Arrival::Manifest(_) | Arrival::Piece { .. } | Arrival::Packet(_) | Arrival::End(None), _) => {}
        }
        Ok(())
    }

    fn begin(&mut self, mut session: Session, size: [u32; 2]) -> Result<(), WindowError> {
        self.options.apply(&mut session, size)?;
        self.forget();
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

#[cfg(test)]
mod tests {
    use std::fs;

    use dgs_viewer::{FIRST_BYTES, Overlay, Up};
    use render_host::{
        Image,
        gpu::{Device, DeviceOptions},
    };

    use super::*;
    use crate::feed;

    const SIZE: [u32; 2] = [64, 48];

    fn file() -> Vec<u8> {
        let path =
            format!("{}/../../codec-core/tests/conformance/everything.dgs", env!("CARGO_MANIFEST_DIR"));
        fs::read(path).unwrap()
    }

    fn options() -> WindowOptions {
        WindowOptions {
            name: "fox".into(),
            size: SIZE,
            background: [0.0; 3],
            up: Up::default(),
            cap: 3,
            overlay: Overlay::None,
            time_s: 0.0,
            playing: true,
            fullscreen: false,
            closes: false,
        }
    }

    #[test]
    fn the_clock_follows_time_and_stands_while_nothing_is_seen() {
        let mut engine = Engine::new(options(), Feed::file(file()));
        assert!(engine.tick(0.0, None, SIZE).unwrap().is_some());
        let interval = 1.0 / engine.session.as_ref().unwrap().player().manifest().frames_per_second();
        engine.tick(0.5 * interval, None, SIZE).unwrap();
        let time = |engine: &Engine| engine.session.as_ref().unwrap().playback().time_s();
        assert!((time(&engine) - 0.5 * interval).abs() < 1e-9);
        engine.hide(SIZE).unwrap();
        engine.tick(100.0, None, SIZE).unwrap();
        assert!((time(&engine) - 0.5 * interval).abs() < 1e-9);
        engine.act(Act::Toggle, SIZE).unwrap();
        assert_eq!(engine.tick(101.0, None, SIZE).unwrap(), None, "a paused window sleeps");
    }

    #[test]
    fn a_file_comes_in_pieces_as_it_is_wished_for() {
        let file = file();
        let (feeder, feed) = feed();
        let mut engine = Engine::new(options(), feed);
        let first = file[..file.len().min(FIRST_BYTES as usize) / 2].to_vec();
        let length = file.len() as u64;
        feeder.arrivals.send(Arrival::Front { bytes: first, length }).unwrap();
        engine.tick(0.0, None, SIZE).unwrap();
        let mut wishes = 0;
        while let Ok(Wish::Bytes(range)) = feeder.wishes.try_recv() {
            let bytes = file[range.start as usize..range.end as usize].to_vec();
            feeder.arrivals.send(Arrival::Piece { at: range.start, bytes }).unwrap();
            engine.tick(0.0, None, SIZE).unwrap();
            wishes += 1;
        }
        let session = engine.session.as_ref().unwrap();
        assert!(wishes > 0 && session.loaded() == 1.0, "{wishes} wishes");
        assert_eq!(session.packets().0, Session::open(&file).unwrap().0.packets().0);
    }

    #[test]
    fn a_feed_that_ends_before_anything_came_says_why_and_later_only_complains() {
        let (feeder, feed) = feed();
        let mut engine = Engine::new(options(), feed);
        feeder.arrivals.send(Arrival::End(Some("the server is gone".into()))).unwrap();
        let error = engine.tick(0.0, None, SIZE).unwrap_err();
        assert_eq!(error.to_string(), "the server is gone");
        feeder.arrivals.send(Arrival::File(file())).unwrap();
        feeder.arrivals.send(Arrival::End(Some("the server is gone".into()))).unwrap();
        engine.tick(0.0, None, SIZE).unwrap();
        assert_eq!(engine.complaints(), ["the server is gone"]);
        assert!(Engine::new(options(), Feed::file(b"no stream".to_vec())).tick(0.0, None, SIZE).is_err());
    }

    #[test]
    fn frames_that_come_slowly_draw_fewer_pixels_and_never_too_few() {
        let mut engine = Engine::new(options(), Feed::file(file()));
        (0..SLOW_FRAMES - 1).for_each(|_| engine.keep_up(1.0));
        engine.keep_up(0.01);
        assert_eq!(engine.scale, 1.0);
        (0..SLOW_FRAMES).for_each(|_| engine.keep_up(0.1));
        assert_eq!(engine.scale, 0.75);
        (0..10 * SLOW_FRAMES).for_each(|_| engine.keep_up(0.1));
        assert_eq!(engine.scale, SMALLEST_SCALE);
    }

    #[test]
    fn a_server_hears_where_the_camera_is_once_and_again_when_it_moves() {
        let (feeder, feed) = feed();
        let mut engine = Engine::new(options(), feed);
        let (session, _) = Session::open(&file()).unwrap();
        let stream = dgs_player::Stream::from_bytes(&file()).unwrap().0;
        feeder.arrivals.send(Arrival::Manifest(stream.message().to_vec())).unwrap();
        let said = |engine: &mut Engine, at: f64| -> Vec<ViewerPose> {
            engine.tick(at, None, SIZE).unwrap();
            let wishes = feeder.wishes.try_iter();
            wishes.filter_map(|wish| if let Wish::Sight(pose) = wish { Some(pose) } else { None }).collect()
        };
        let first = said(&mut engine, 0.0);
        assert_eq!((first.len(), said(&mut engine, 0.1).len()), (1, 0));
        engine.act(Act::Turn(30.0, 0.0), SIZE).unwrap();
        let second = said(&mut engine, 0.2);
        assert!(second.len() == 1 && second != first);
        // A file has no sender.
        assert!(!session.is_live());
    }

    /// A screen in memory; `None` on a machine without any driver, which in CI is a failure.
    fn screen() -> Option<Screen> {
        match Device::open(&DeviceOptions::from_env()) {
            Ok(device) => Some(Screen::in_memory(device).unwrap()),
            Err(error) => {
                assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "{error}");
                eprintln!("SKIPPED: {error}");
                None
            }
        }
    }

    /// What is on `screen` once `engine` has nothing more to draw.
    fn settled(engine: &mut Engine, screen: &mut Screen) -> Image {
        for _ in 0..4 {
            engine.tick(0.0, Some(screen), SIZE).unwrap();
            if let Some(image) = screen.read().unwrap() {
                return image;
            }
        }
        panic!("nothing was drawn")
    }

    #[test]
    fn another_device_shows_what_the_lost_one_did_and_what_has_not_changed_is_drawn_once() {
        let Some(mut first) = screen() else { return };
        let mut engine = Engine::new(WindowOptions { playing: false, ..options() }, Feed::file(file()));
        let before = settled(&mut engine, &mut first);
        let frames = engine.frames();
        engine.tick(1.0, Some(&mut first), SIZE).unwrap();
        assert_eq!(engine.frames(), frames);
        first.destroy();
        let _ = first.pending();
        assert!(first.is_lost());
        let Some(mut second) = screen() else { return };
        engine.forget();
        assert_eq!(settled(&mut engine, &mut second).rgb(), before.rgb());
        // The comparison can fail: another background.
        engine.act(Act::Background, SIZE).unwrap();
        assert_ne!(settled(&mut engine, &mut second).rgb(), before.rgb());
    }

    /// Fewer pixels, scaled up, are the same picture but for what is between them.
    #[test]
    fn a_picture_of_fewer_pixels_fills_the_window() {
        let Some(mut screen) = screen() else { return };
        let mut engine = Engine::new(WindowOptions { playing: false, ..options() }, Feed::file(file()));
        let whole = settled(&mut engine, &mut screen);
        engine.scale = SMALLEST_SCALE;
        let scaled = settled(&mut engine, &mut screen);
        assert_eq!([scaled.width(), scaled.height()], SIZE);
        let db = render_host::metric::psnr(&whole, &scaled).unwrap();
        assert!((20.0..60.0).contains(&db), "{db} dB");
    }
}
