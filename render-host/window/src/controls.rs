//! Controls say what a key does to the session, as on the page of the player.

use dgs_viewer::{Conditions, Session};
use winit::keyboard::{Key, NamedKey};

use crate::{WindowError, options::aspect};

/// The keys and what they do, for people.
pub const KEYS: [(&str, &str); 20] = [
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
    ("N", "lose others"),
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
/// Packets lost in a row, in the mean, when keys lose packets.
const BURST: f64 = 4.0;
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
    Reseed,
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
            "n" => Self::Reseed,
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
            Self::Loss(_) | Self::Reseed => {
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
                Some(Conditions { loss, burst: BURST, ..before })
            }
            Self::Reseed => Some(Conditions { seed: before.seed.wrapping_add(1), ..before }),
            _ => None,
        }
    }

    /// Whether it moves the clock elsewhere, so that a server should send from there.
    pub fn seeks(self) -> bool {
        matches!(self, Self::Toggle | Self::Step(_) | Self::Start | Self::End)
    }
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
