//! Controls say what a key does to the session, as on the page of the player.

use dgs_viewer::{Conditions, Session};
use winit::keyboard::{Key, NamedKey};

use crate::{WindowError, options::aspect};

/// The keys and what they do, for people.
pub const KEYS: [(&str, &str); 23] = [
    ("Space, K", "play or pause"),
    (", .", "one frame back or on"),
    ("Home End", "to the start or the end"),
    ("< >", "slower or faster"),
    ("L", "loop"),
    ("drag, arrows", "turn around the scene"),
    ("right drag, Shift + arrows", "pan"),
    ("wheel, + −", "nearer or farther"),
    ("W A S D Q E, Shift: faster", "fly, by keys held together"),
    ("0", "first view"),
    ("U", "another way up"),
    ("1 2 3 4", "highest level shown"),
    ("O", "paint blocks by level, by what just came, by what is missing"),
    ("[ ]", "lose fewer or more packets"),
    ("C V", "lose them in shorter or longer runs"),
    ("N", "lose others"),
    ("G T", "a link of a lower or higher rate"),
    ("M J", "less or more delay on it, one way"),
    ("P", "another scheduler of the server"),
    ("B", "another background"),
    ("R", "draw less where pictures come late, or never"),
    ("F, Esc", "full screen and back"),
    ("?", "these keys"),
];

/// Pixels of a drag and factor that one press of a key moves.
const TURN: f64 = 24.0;
const ZOOM: f64 = 1.15;
/// Speeds that keys go through, seconds of the clip per second.
const SPEEDS: [f64; 6] = [0.1, 0.25, 0.5, 1.0, 2.0, 4.0];
/// Share of packets that one press of a key loses more or fewer.
const LOSS_STEP: f64 = 0.05;
/// Packets lost in a row, in the mean, when keys lose packets and have not said how many.
const BURST: f64 = 4.0;
/// Factor by which one press of a key makes that longer, and the most.
const BURST_STEP: f64 = 2.0;
const MAX_BURST: f64 = 64.0;
/// Rates of a link that keys go through, bits per second; past the last there is no limit.
const RATES_BPS: [f64; 9] = [0.25e6, 0.5e6, 1e6, 2e6, 5e6, 10e6, 20e6, 50e6, 100e6];
/// Delay that one press of a key adds or takes away, and the most, milliseconds towards the viewer.
const DELAY_STEP_MS: f64 = 20.0;
const MAX_DELAY_MS: f64 = 1000.0;
/// Backgrounds that a key goes through.
const BACKGROUNDS: [[f32; 3]; 4] = [[0.0; 3], [0.25; 3], [0.75; 3], [1.0; 3]];

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Act {
    Toggle,
    Step(i32),
    Start,
    End,
    Faster,
    Slower,
    Loop,
    Turn(f64, f64),
    Pan(f64, f64),
    Zoom(f64),
    Fly([f64; 3]),
    Home,
    NextUp,
    Cap(usize),
    Overlay,
    Loss(f64),
    /// The factor of the mean run.
    Burst(f64),
    Reseed,
    LowerRate,
    HigherRate,
    /// Milliseconds more.
    Delay(f64),
    Scheduler,
    Background,
    KeepUp,
    Fullscreen,
    Leave,
    Help,
}

impl Act {
    /// What `key` asks for, with Shift if `shift`.
    pub fn of(key: &Key, shift: bool) -> Option<Self> {
        match key {
            Key::Named(named) => Self::of_named(*named, shift),
            Key::Character(text) => Self::of_text(&text.to_lowercase()),
            _ => None,
        }
    }

    fn of_named(key: NamedKey, shift: bool) -> Option<Self> {
        let drag = |dx: f64, dy: f64| if shift { Self::Pan(dx, dy) } else { Self::Turn(dx, dy) };
        Some(match key {
            NamedKey::Space => Self::Toggle,
            NamedKey::Home => Self::Start,
            NamedKey::End => Self::End,
            NamedKey::ArrowLeft => drag(TURN, 0.0),
            NamedKey::ArrowRight => drag(-TURN, 0.0),
            NamedKey::ArrowUp => drag(0.0, TURN),
            NamedKey::ArrowDown => drag(0.0, -TURN),
            NamedKey::F11 => Self::Fullscreen,
            NamedKey::Escape => Self::Leave,
            _ => return None,
        })
    }

    fn of_text(text: &str) -> Option<Self> {
        Some(match text {
            " " | "k" => Self::Toggle,
            "," => Self::Step(-1),
            "." => Self::Step(1),
            "<" => Self::Slower,
            ">" => Self::Faster,
            "l" => Self::Loop,
            "+" | "=" => Self::Zoom(ZOOM),
            "-" => Self::Zoom(1.0 / ZOOM),
            "0" => Self::Home,
            "u" => Self::NextUp,
            "1" => Self::Cap(0),
            "2" => Self::Cap(1),
            "3" => Self::Cap(2),
            "4" => Self::Cap(3),
            "o" => Self::Overlay,
            "[" => Self::Loss(-LOSS_STEP),
            "]" => Self::Loss(LOSS_STEP),
            "c" => Self::Burst(1.0 / BURST_STEP),
            "v" => Self::Burst(BURST_STEP),
            "n" => Self::Reseed,
            "g" => Self::LowerRate,
            "t" => Self::HigherRate,
            "m" => Self::Delay(-DELAY_STEP_MS),
            "j" => Self::Delay(DELAY_STEP_MS),
            "p" => Self::Scheduler,
            "b" => Self::Background,
            "r" => Self::KeepUp,
            "f" => Self::Fullscreen,
            "?" => Self::Help,
            _ => return None,
        })
    }

    /// Does it to `session`, shown on `size` pixels. What no session knows, the window does.
    pub fn apply(self, session: &mut Session, size: [u32; 2]) -> Result<(), WindowError> {
        let height = f64::from(size[1]);
        match self {
            Self::Toggle => {
                let playing = session.playback().playing();
                session.playback_mut().set_playing(!playing);
            }
            Self::Step(frames) => session.playback_mut().step(frames),
            Self::Start => session.playback_mut().seek(0.0),
            Self::End => session.playback_mut().seek(f64::MAX),
            Self::Faster => {
                let rate = session.playback().rate();
                let next = SPEEDS.into_iter().find(|&speed| speed > rate).unwrap_or(rate);
                session.playback_mut().set_rate(next);
            }
            Self::Slower => {
                let rate = session.playback().rate();
                let next = SPEEDS.into_iter().rev().find(|&speed| speed < rate).unwrap_or(rate);
                session.playback_mut().set_rate(next);
            }
            Self::Loop => {
                let looping = session.playback().looping();
                session.playback_mut().set_looping(!looping);
            }
            Self::Turn(dx, dy) => session.orbit_mut().turn(dx, dy, height),
            Self::Pan(dx, dy) => session.orbit_mut().pan(dx, dy, height),
            Self::Zoom(factor) => session.orbit_mut().zoom(factor),
            Self::Fly([right, up, forward]) => session.orbit_mut().fly(right, up, forward),
            Self::Home => *session.orbit_mut() = session.orbit().home(aspect(size)),
            Self::NextUp => *session.orbit_mut() = session.orbit().with_up(session.orbit().up().next()),
            Self::Cap(cap) => session.set_cap(cap),
            Self::Overlay => session.set_overlay(session.overlay().next()),
            Self::Loss(_)
            | Self::Burst(_)
            | Self::Reseed
            | Self::LowerRate
            | Self::HigherRate
            | Self::Delay(_) => {
                if let Some(conditions) = self.network(session.conditions()) {
                    session.impair(conditions)?;
                }
            }
            // Only a server has one.
            Self::Scheduler => {}
            Self::Background | Self::KeepUp | Self::Fullscreen | Self::Leave | Self::Help => {}
        }
        Ok(())
    }

    /// The network that it asks for in place of `before`.
    pub fn network(self, before: Conditions) -> Option<Conditions> {
        match self {
            Self::Loss(more) => {
                // Steps add up to whole percents.
                let loss = (100.0 * (before.loss + more)).round().clamp(0.0, 90.0) / 100.0;
                let is_chosen = before.loss > 0.0 || before.burst > 1.0;
                let burst = if is_chosen { before.burst } else { BURST };
                Some(Conditions { loss, burst: possible_burst(loss, burst), ..before })
            }
            Self::Burst(factor) => {
                let burst = (before.burst * factor).round().clamp(1.0, MAX_BURST);
                Some(Conditions { burst: possible_burst(before.loss, burst), ..before })
            }
            Self::Reseed => Some(Conditions { seed: before.seed.wrapping_add(1), ..before }),
            Self::LowerRate => {
                let is_lower = |rate: f64| before.rate_bps.is_none_or(|now| rate < now);
                let lower = RATES_BPS.into_iter().rev().find(|&rate| is_lower(rate));
                Some(Conditions { rate_bps: lower.or(before.rate_bps), ..before })
            }
            Self::HigherRate => {
                let next = |now: f64| RATES_BPS.into_iter().find(|&rate| rate > now);
                Some(Conditions { rate_bps: before.rate_bps.and_then(next), ..before })
            }
            Self::Delay(more_ms) => {
                let delay_ms = (1e3 * before.delay_s + more_ms).round().clamp(0.0, MAX_DELAY_MS);
                Some(Conditions { delay_s: delay_ms / 1e3, ..before })
            }
            _ => None,
        }
    }

    /// Whether it moves the clock elsewhere, so that a server should send from there.
    pub fn seeks(self) -> bool {
        matches!(self, Self::Toggle | Self::Step(_) | Self::Start | Self::End)
    }
}

/// The mean run of lost packets that is asked for, but no shorter than it takes to lose a share `loss`; at 1
/// losses are independent, and any share can be lost.
fn possible_burst(loss: f64, burst: f64) -> f64 {
    // In ten-thousandths, as a server counts it: what should be whole would else be rounded up.
    let lost = (1e4 * loss).round();
    if burst > 1.0 { burst.max((lost / (1e4 - lost)).ceil()) } else { 1.0 }
}

/// The background after `now`.
pub(crate) fn next_background(now: [f32; 3]) -> [f32; 3] {
    let at = BACKGROUNDS.iter().position(|known| *known == now);
    BACKGROUNDS[at.map_or(0, |at| (at + 1) % BACKGROUNDS.len())]
}

#[cfg(test)]
mod tests {
    use std::fs;

    use dgs_viewer::Overlay;

    use super::*;

    const SIZE: [u32; 2] = [320, 240];

    fn session() -> Session {
        let path =
            format!("{}/../../codec-core/tests/conformance/everything.dgs", env!("CARGO_MANIFEST_DIR"));
        Session::open(&fs::read(path).unwrap()).unwrap().0
    }

    fn press(session: &mut Session, text: &str) {
        let act = Act::of(&Key::Character(text.into()), false).unwrap();
        act.apply(session, SIZE).unwrap();
    }

    #[test]
    fn keys_do_what_their_table_says() {
        let mut session = session();
        press(&mut session, " ");
        assert!(session.playback().playing());
        press(&mut session, ".");
        assert!(!session.playback().playing() && session.playback().frame() == 1);
        press(&mut session, ",");
        assert_eq!(session.playback().frame(), 0);
        for (key, rate) in [(">", 2.0), (">", 4.0), (">", 4.0), ("<", 2.0), ("<", 1.0), ("<", 0.5)] {
            press(&mut session, key);
            assert_eq!(session.playback().rate(), rate, "{key}");
        }
        press(&mut session, "L");
        assert!(!session.playback().looping());
        press(&mut session, "2");
        press(&mut session, "o");
        assert_eq!((session.cap(), session.overlay()), (1, Overlay::Levels));
        let before = session.orbit().numbers();
        Act::Fly([0.1, 0.2, 0.3]).apply(&mut session, SIZE).unwrap();
        press(&mut session, "+");
        assert_ne!(session.orbit().numbers(), before);
        press(&mut session, "u");
        assert_eq!(session.orbit().up().name(), "minus-y");
        for (key, loss) in [("]", 0.05), ("]", 0.1), ("[", 0.05), ("[", 0.0), ("[", 0.0)] {
            press(&mut session, key);
            assert_eq!(session.conditions().loss, loss, "{key}");
        }
        let seed = session.conditions().seed;
        press(&mut session, "n");
        assert_eq!(session.conditions().seed, seed + 1);
    }

    #[test]
    fn keys_change_the_link_in_steps() {
        let mut session = session();
        // Keys that lose packets lose them in runs of four, unless another length was chosen.
        for (key, burst) in [("]", 4.0), ("V", 8.0), ("]", 8.0), ("c", 4.0), ("c", 2.0), ("c", 1.0)] {
            press(&mut session, key);
            assert_eq!(session.conditions().burst, burst, "{key}");
        }
        press(&mut session, "]");
        assert_eq!((session.conditions().loss, session.conditions().burst), (0.15, 1.0), "independent");
        for (key, rate) in
            [("g", Some(100e6)), ("G", Some(50e6)), ("t", Some(100e6)), ("t", None), ("t", None)]
        {
            press(&mut session, key);
            assert_eq!(session.conditions().rate_bps, rate, "{key}");
        }
        (0..20).for_each(|_| press(&mut session, "g"));
        assert_eq!(session.conditions().rate_bps, Some(0.25e6));
        for (key, delay_s) in [("j", 0.02), ("j", 0.04), ("m", 0.02), ("m", 0.0), ("m", 0.0)] {
            press(&mut session, key);
            assert_eq!(session.conditions().delay_s, delay_s, "{key}");
        }
        (0..60).for_each(|_| press(&mut session, "j"));
        assert_eq!(session.conditions().delay_s, 1.0);
    }

    /// What keys ask a server for is within what it grants.
    #[test]
    fn no_run_is_too_short_for_the_loss() {
        let mut now = Conditions::default();
        for (loss, burst) in [(0.5, 4.0), (0.8, 4.0), (0.85, 6.0), (0.9, 9.0)] {
            while now.loss < loss {
                now = Act::Loss(LOSS_STEP).network(now).unwrap();
            }
            assert_eq!((now.loss, now.burst), (loss, burst));
        }
        assert_eq!(Act::Burst(0.5).network(now).unwrap().burst, 9.0);
    }

    #[test]
    fn shift_pans_what_turns_without() {
        let left = Key::Named(NamedKey::ArrowLeft);
        assert_eq!(Act::of(&left, false), Some(Act::Turn(TURN, 0.0)));
        assert_eq!(Act::of(&left, true), Some(Act::Pan(TURN, 0.0)));
        assert_eq!(Act::of(&Key::Character("y".into()), false), None);
        assert_eq!(Act::of(&Key::Character("w".into()), false), None, "a key to fly by is held");
        assert_eq!(Act::of(&Key::Named(NamedKey::Tab), false), None);
    }

    #[test]
    fn backgrounds_go_round_and_begin_anew_after_one_of_their_own() {
        let mut now = [0.1, 0.2, 0.3];
        let seen: Vec<_> = (0..5)
            .map(|_| {
                now = next_background(now);
                now[0]
            })
            .collect();
        assert_eq!(seen, [0.0, 0.25, 0.75, 1.0, 0.0]);
    }
}
