//! A title says what a window shows: name, time, level, frame rate.

use dgs_viewer::{LEVELS, Session};

/// The title of a window that shows `session` at `rate` frames per second, where a share `loss` of packets is
/// lost on purpose.
pub(crate) fn title(name: &str, session: &Session, rate: f64, loss: f64) -> String {
    let clock = session.playback();
    let mut text = format!(
        "{name} · {:.2} of {:.2} s · level {:.1} of {} · {rate:.0} frames/s",
        clock.time_s(),
        clock.duration_s(),
        mean_level(session),
        LEVELS - 1,
    );
    if !clock.playing() {
        text += " · paused";
    }
    if clock.rate() != 1.0 {
        text += &format!(" · speed {}", clock.rate());
    }
    if loss > 0.0 {
        text += &format!(" · {:.0} % of packets lost", 100.0 * loss);
    }
    if session.loaded() < 1.0 {
        text += &format!(" · {:.0} % loaded", 100.0 * session.loaded());
    }
    text
}

/// The mean level at which blocks are shown; a block without its base, by a stand-in, counts 0.
fn mean_level(session: &Session) -> f64 {
    let Ok(blocks) = session.levels() else { return 0.0 };
    let shown = |at: usize| at.saturating_sub(1).min(session.cap()) as f64;
    let sum: f64 = blocks.iter().enumerate().map(|(at, &count)| shown(at) * f64::from(count)).sum();
    sum / f64::from(blocks.iter().sum::<u32>().max(1))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_title_says_time_level_and_rate_and_what_is_unusual() {
        let path =
            format!("{}/../../codec-core/tests/conformance/everything.dgs", env!("CARGO_MANIFEST_DIR"));
        let (mut session, _) = Session::open(&fs::read(path).unwrap()).unwrap();
        session.playback_mut().set_playing(true);
        let plain = title("fox", &session, 59.7, 0.0);
        assert!(plain.starts_with("fox · 0.00 of ") && plain.ends_with(" of 3 · 60 frames/s"), "{plain}");
        session.set_cap(0);
        assert!(title("fox", &session, 60.0, 0.0).contains("level 0.0 of 3"));
        session.playback_mut().set_playing(false);
        session.playback_mut().set_rate(0.5);
        let unusual = title("fox", &session, 0.0, 0.1);
        assert!(unusual.ends_with("· paused · speed 0.5 · 10 % of packets lost"), "{unusual}");
    }
}
