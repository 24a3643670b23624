//! The shell connects an engine with a window of the system: events in, pictures out.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use dgs_viewer::{Screen, ScreenError};
use render_host::gpu::wgpu;
use winit::{
    application::ApplicationHandler,
    dpi::PhysicalSize,
    event::{ElementState, MouseButton, MouseScrollDelta, StartCause, WindowEvent},
    event_loop::{ActiveEventLoop, ControlFlow, EventLoop},
    keyboard::{Key, ModifiersState},
    window::{Fullscreen, Window, WindowId},
};

use crate::{
    Feed, WindowError, WindowOptions,
    controls::{Act, KEYS},
    engine::Engine,
    flying::Flying,
};

/// Screens that are opened in vain before giving up, and what lies between two tries.
const TRIES: u32 = 4;
const PAUSE: Duration = Duration::from_millis(150);
/// What lies between two titles.
const TITLE_EVERY: Duration = Duration::from_millis(250);
/// Factor per line and per pixel of a wheel.
const LINE: f64 = 0.15;
const PIXEL: f64 = 0.0015;

/// What a window did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Frames drawn.
    pub frames: u64,
    /// From the start to its end, seconds.
    pub seconds: f64,
    /// What drew them last.
    pub adapter: String,
    /// Devices that were lost and replaced.
    pub devices_lost: u32,
}

/// Shows what `feed` brings in a window until it is closed. `say` gets sentences for people.
///
/// Call it on the main thread: on some systems windows live on no other.
///
/// # Errors
/// No display, no device, or no stream.
pub fn run(options: WindowOptions, feed: Feed, say: &mut dyn FnMut(&str)) -> Result<Report, WindowError> {
    let events = EventLoop::new()?;
    let mut shell = Shell {
        size: options.size,
        fullscreen: options.fullscreen,
        engine: Engine::new(options, feed),
        say,
        began: Instant::now(),
        window: None,
        screen: None,
        tries: 0,
        retry_at: None,
        requested: false,
        hidden: false,
        wake_at: None,
        drawn: 0,
        titled_at: None,
        keys: ModifiersState::empty(),
        pointer: Pointer::default(),
        flying: Flying::default(),
        report: Report::default(),
        failed: None,
    };
    events.run_app(&mut shell)?;
    let Shell { engine, failed, began, mut report, .. } = shell;
    report.frames = engine.frames();
    report.seconds = began.elapsed().as_secs_f64();
    failed.map_or(Ok(report), Err)
}

/// Where the pointer is and what it drags.
#[derive(Debug, Default)]
struct Pointer {
    at: Option<(f64, f64)>,
    turns: bool,
    pans: bool,
}

struct Shell<'s> {
    engine: Engine,
    say: &'s mut dyn FnMut(&str),
    size: [u32; 2],
    fullscreen: bool,
    began: Instant,
    window: Option<Arc<Window>>,
    screen: Option<Screen>,
    /// Screens opened since a frame was drawn, and when to try the next.
    tries: u32,
    retry_at: Option<Instant>,
    /// Whether this asked for the next turn.
    requested: bool,
    /// Whether nothing of the window is seen.
    hidden: bool,
    wake_at: Option<Instant>,
    /// Frames drawn.
    drawn: u64,
    titled_at: Option<Instant>,
    keys: ModifiersState,
    pointer: Pointer,
    flying: Flying,
    report: Report,
    failed: Option<WindowError>,
}

impl ApplicationHandler for Shell<'_> {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.window.is_some() {
            return;
        }
        let [width, height] = self.size;
        let attributes = Window::default_attributes()
            .with_title(self.engine.title())
            .with_inner_size(PhysicalSize::new(width, height))
            .with_fullscreen(self.fullscreen.then_some(Fullscreen::Borderless(None)));
        match events.create_window(attributes) {
            Ok(window) => {
                let PhysicalSize { width, height } = window.inner_size();
                self.size = [width, height];
                window.request_redraw();
                self.window = Some(Arc::new(window));
            }
            Err(error) => self.fail(events, error.into()),
        }
    }

    fn new_events(&mut self, _: &ActiveEventLoop, cause: StartCause) {
        if matches!(cause, StartCause::ResumeTimeReached { .. }) {
            self.wake_at = None;
            self.request();
        }
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let acts = match event {
            WindowEvent::CloseRequested => return events.exit(),
            WindowEvent::RedrawRequested => {
                // The system asks on its own where what was shown has gone.
                if !std::mem::take(&mut self.requested) {
                    self.engine.redraw();
                }
                return self.tick(events);
            }
            WindowEvent::Resized(PhysicalSize { width, height }) => {
                self.size = [width, height];
                Vec::new()
            }
            WindowEvent::Occluded(hidden) => {
                self.hidden = hidden;
                self.engine.redraw();
                Vec::new()
            }
            WindowEvent::ModifiersChanged(modifiers) => {
                self.keys = modifiers.state();
                return;
            }
            WindowEvent::KeyboardInput { event, .. } if event.state == ElementState::Pressed => {
                let others = ModifiersState::CONTROL | ModifiersState::ALT | ModifiersState::SUPER;
                if self.keys.intersects(others) {
                    return;
                }
                let touched = match &event.logical_key {
                    Key::Character(text) => self.flying.press(text, self.began.elapsed().as_secs_f64()),
                    _ => None,
                };
                let act = touched.map(Act::Fly);
                act.or_else(|| Act::of(&event.logical_key, self.keys.shift_key())).into_iter().collect()
            }
            WindowEvent::KeyboardInput { event, .. } => {
                if let Key::Character(text) = &event.logical_key {
                    self.flying.release(text);
                }
                return;
            }
            WindowEvent::Focused(false) => {
                self.flying.stop();
                return;
            }
            WindowEvent::MouseInput { state, button, .. } => {
                self.pointer.press(button, state == ElementState::Pressed);
                return;
            }
            WindowEvent::CursorMoved { position, .. } => {
                self.pointer.moved((position.x, position.y), self.keys.shift_key()).into_iter().collect()
            }
            WindowEvent::MouseWheel { delta, .. } => vec![wheel(delta)],
            WindowEvent::PinchGesture { delta, .. } => vec![Act::Zoom((1.0 + delta).max(0.1))],
            WindowEvent::DroppedFile(path) => {
                self.open(&path);
                Vec::new()
            }
            _ => return,
        };
        for act in acts {
            if let Err(error) = self.act(act) {
                return self.fail(events, error);
            }
        }
        self.request();
    }

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        events.set_control_flow(self.wake_at.map_or(ControlFlow::Wait, ControlFlow::WaitUntil));
    }
}

impl Pointer {
    fn press(&mut self, button: MouseButton, down: bool) {
        match button {
            MouseButton::Left => self.turns = down,
            MouseButton::Right | MouseButton::Middle => self.pans = down,
            _ => {}
        }
    }

    /// What a move to `to` does.
    fn moved(&mut self, to: (f64, f64), shift: bool) -> Option<Act> {
        let from = self.at.replace(to)?;
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        if self.pans || (self.turns && shift) {
            Some(Act::Pan(dx, dy))
        } else {
            self.turns.then_some(Act::Turn(dx, dy))
        }
    }
}

/// What a turn of the wheel does.
fn wheel(delta: MouseScrollDelta) -> Act {
    Act::Zoom(match delta {
        MouseScrollDelta::LineDelta(_, lines) => (LINE * f64::from(lines)).exp(),
        MouseScrollDelta::PixelDelta(pixels) => (PIXEL * pixels.y).exp(),
    })
}

impl Shell<'_> {
    /// Ends with `error`.
    fn fail(&mut self, events: &ActiveEventLoop, error: WindowError) {
        self.failed.get_or_insert(error);
        events.exit();
    }

    fn request(&mut self) {
        if let Some(window) = &self.window {
            self.requested = true;
            window.request_redraw();
        }
    }

    /// Plays a file that was dropped on the window.
    fn open(&mut self, path: &std::path::Path) {
        let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        let opened = std::fs::read(path).map_err(|error| error.to_string()).and_then(|bytes| {
            // What is no stream leaves the one that plays alone.
            dgs_viewer::Session::open(&bytes).map_err(|error| error.to_string()).map(|_| bytes)
        });
        match opened {
            Ok(bytes) => self.engine.play(name, Feed::file(bytes)),
            Err(error) => (self.say)(&format!("{}: {error}", path.display())),
        }
    }

    fn act(&mut self, act: Act) -> Result<(), WindowError> {
        match act {
            Act::Fullscreen => self.set_fullscreen(!self.fullscreen),
            Act::Leave if self.fullscreen => self.set_fullscreen(false),
            Act::Help => KEYS.iter().for_each(|(keys, does)| (self.say)(&format!("{keys:28}{does}"))),
            _ => {}
        }
        self.engine.act(act, self.size)
    }

    fn set_fullscreen(&mut self, fullscreen: bool) {
        self.fullscreen = fullscreen;
        if let Some(window) = &self.window {
            window.set_fullscreen(fullscreen.then_some(Fullscreen::Borderless(None)));
        }
    }

    /// One turn of the loop.
    fn tick(&mut self, events: &ActiveEventLoop) {
        let now = Instant::now();
        let flown = self.flying.moved((now - self.began).as_secs_f64(), self.keys.shift_key());
        if let Some(Err(error)) = flown.map(|flown| self.act(Act::Fly(flown))) {
            return self.fail(events, error);
        }
        let seen = !self.hidden && self.size.iter().all(|&side| side > 0);
        let next = if seen { self.show(now) } else { self.engine.hide(self.size) };
        match next {
            Ok(next) => self.wake_at = next.and_then(|s| now.checked_add(Duration::from_secs_f64(s))),
            Err(error) => return self.fail(events, error),
        }
        self.engine.complaints().iter().for_each(|complaint| (self.say)(complaint));
        if self.engine.has_ended() {
            events.exit();
        }
        self.write_title(now);
        // Who flies is drawn again and again.
        if flown.is_some() && seen {
            self.request();
        }
    }

    /// Opens a screen where there is none, moves the clock, draws.
    fn show(&mut self, now: Instant) -> Result<Option<f64>, WindowError> {
        if self.screen.as_ref().is_some_and(Screen::is_lost) {
            self.lose(now);
        }
        if self.screen.is_none() && self.retry_at.is_none_or(|at| now >= at) {
            self.open_screen(now)?;
        }
        let seconds = (now - self.began).as_secs_f64();
        let ticked = self.engine.tick(seconds, self.screen.as_mut(), self.size);
        let next = match ticked {
            Err(WindowError::Screen(error)) if self.tries < TRIES => {
                if self.screen.as_ref().is_some_and(|screen| !screen.is_lost()) {
                    (self.say)(&format!("the device is opened again: {error}"));
                }
                self.lose(now);
                None
            }
            ticked => ticked?,
        };
        if self.engine.frames() > self.drawn {
            (self.drawn, self.tries) = (self.engine.frames(), 0);
        }
        let retry = self.retry_at.filter(|_| self.screen.is_none());
        let retry = retry.map(|at| at.saturating_duration_since(now).as_secs_f64());
        Ok([next, retry].into_iter().flatten().reduce(f64::min))
    }

    fn lose(&mut self, now: Instant) {
        self.screen = None;
        self.report.devices_lost += 1;
        self.retry_at = now.checked_add(PAUSE * 2u32.pow(self.tries));
        self.engine.forget();
    }

    fn open_screen(&mut self, now: Instant) -> Result<(), WindowError> {
        let Some(window) = &self.window else { return Ok(()) };
        self.tries += 1;
        match pollster::block_on(opened(window)) {
            Ok(screen) => {
                self.report.adapter = screen.adapter();
                self.screen = Some(screen);
                self.retry_at = None;
                self.engine.forget();
                Ok(())
            }
            Err(error) if self.tries >= TRIES => Err(error.into()),
            Err(_) => {
                self.retry_at = now.checked_add(PAUSE * 2u32.pow(self.tries));
                Ok(())
            }
        }
    }

    fn write_title(&mut self, now: Instant) {
        let due = self.titled_at.is_none_or(|at| now - at >= TITLE_EVERY) || self.wake_at.is_none();
        if let (true, Some(window)) = (due, &self.window) {
            window.set_title(&self.engine.title());
            self.titled_at = Some(now);
        }
    }
}

/// A screen on `window`.
async fn opened(window: &Arc<Window>) -> Result<Screen, ScreenError> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::PRIMARY;
    // Indirect arguments are written by our own kernels within limits; wgpu need not check them.
    descriptor.flags = wgpu::InstanceFlags::empty();
    let instance = wgpu::Instance::new(descriptor);
    let surface = instance.create_surface(Arc::clone(window))?;
    Screen::open(&instance, surface).await
}
