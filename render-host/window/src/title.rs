//! A title says what a window shows: name, time, level, frame rate; of what a network brings also how good it
//! is by estimate and how fast it comes.

use dgs_viewer::{Conditions, LEVELS, Session};

/// What is counted, per second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Rates {
    /// Frames that were drawn.
    pub frames: f64,
    /// Bits of packets that arrived.
    pub bits: f64,
}

/// The title of a window that shows `session`, whose packets come through `network`.
pub(crate) fn title(name: &str, session: &Session, rates: Rates, network: &Conditions) -> String {
    let clock = session.playback();
    let mut text = format!(
        "{name} · {:.2} of {:.2} s · level {:.1} of {}",
        clock.time_s(),
        clock.duration_s(),
        mean_level(session),
        LEVELS - 1,
    );
    // Of a file nothing arrives: it is there.
    if session.is_live() || !network.is_perfect() {
        text += &format!(" · quality about {:.0} % · {}", 100.0 * session.quality(), rate_text(rates.bits));
    }
    text += &format!(" · {:.0} frames/s", rates.frames);
    if !clock.playing() {
        text += " · paused";
    }
    if clock.rate() != 1.0 {
        text += &format!(" · speed {}", clock.rate());
    }
    if network.loss > 0.0 {
        text += &format!(" · {:.0} % of packets lost", 100.0 * network.loss);
        if network.burst > 1.0 {
            text += &format!(" in runs of {:.0}", network.burst);
        }
    }
    if let Some(rate) = network.rate_bps {
        text += &format!(" · link of {}", rate_text(rate));
    }
    if network.delay_s > 0.0 {
        text += &format!(" · {:.0} ms one way", 1e3 * network.delay_s);
    }
    if session.loaded() < 1.0 {
        text += &format!(" · {:.0} % loaded", 100.0 * session.loaded());
    }
    text
}

fn rate_text(bits_per_s: f64) -> String {
    if bits_per_s < 1e6 {
        format!("{:.0} kbit/s", 1e-3 * bits_per_s)
    } else {
        format!("{:.1} Mbit/s", 1e-6 * bits_per_s)
    }
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
        let (rates, none) = (Rates { frames: 59.7, bits: 0.0 }, Conditions::default());
        let plain = title("fox", &session, rates, &none);
        assert!(plain.starts_with("fox · 0.00 of ") && plain.ends_with(" of 3 · 60 frames/s"), "{plain}");
        session.set_cap(0);
        assert!(title("fox", &session, rates, &none).contains("level 0.0 of 3"));
        session.playback_mut().set_playing(false);
        session.playback_mut().set_rate(0.5);
        let lossy = Conditions { loss: 0.1, ..none };
        let unusual = title("fox", &session, Rates::default(), &lossy);
        assert!(unusual.ends_with("· paused · speed 0.5 · 10 % of packets lost"), "{unusual}");
        assert!(unusual.contains(" of 3 · quality about 0 % · 0 kbit/s · 0 frames/s · "), "{unusual}");
        let slow = Conditions { burst: 4.0, rate_bps: Some(2e6), delay_s: 0.04, ..lossy };
        let slow = title("fox", &session, Rates { frames: 60.0, bits: 1.94e6 }, &slow);
        let network = "10 % of packets lost in runs of 4 · link of 2.0 Mbit/s · 40 ms one way";
        assert!(slow.contains(" · 1.9 Mbit/s · 60 frames/s") && slow.ends_with(network), "{slow}");
    }

    /// What a server sends says how good it is and how fast it comes.
    #[test]
    fn a_title_of_a_live_stream_says_quality_and_bits() {
        let path =
            format!("{}/../../codec-core/tests/conformance/everything.dgs", env!("CARGO_MANIFEST_DIR"));
        let (mut session, _) = Session::open(&fs::read(path).unwrap()).unwrap();
        session.set_live();
        session.show().unwrap();
        let rates = Rates { frames: 60.0, bits: 250e3 };
        let live = title("fox", &session, rates, &Conditions::default());
        assert!(live.contains(" · quality about 100 % · 250 kbit/s · 60 frames/s"), "{live}");
    }
}
