//! Builds the links of `--impair`: one that a server puts before every viewer or that a stream is sent over,
//! one that a viewer asks for.

use std::{path::Path, time::Duration};

use anyhow::{Context, Result, bail, ensure};
use dgs_quic::socket::{Impairment, ViewerLink};
use emulator_host::{
    Bytes, Nanos, Rate,
    link::{Capacity, LightLoad, LossModel, PathConfig, QueueLimit},
    trace::Replay,
};

use super::recording::{Recording, read_recording};

/// What is allowed, for errors.
const ALLOWED: &str = "a trace file, or a list of loss=5%, burst=4, rate=5mbit, delay=40ms, jitter=5ms, \
                       queue=250ms, trace=FILE, light=40mbit/15kB/100ms, seed=1";
/// The same of a link that a viewer asks for.
const ALLOWED_TO_VIEWERS: &str = "a list of loss=5%, burst=4, rate=5mbit, delay=40ms, seed=1";
/// The queue of a link without a rate of its own has nothing to wait for; one with a rate has this.
const QUEUE: Nanos = Nanos::from_ms(250);
const LOSSES: &str = "0% to 90%, such as 5% or 0.05";
const TIMES: &str = "0ms to 60000ms";
/// What [`light_load`] reads.
pub(crate) const LIGHT_LOADS: &str = "the rate of the first bytes after a pause, how many they are, \
                                      and the pause: 1kbit to 100000mbit, 1kB to 1000000kB, 0ms to 60000ms";

/// A link as it was described, and what to say about it.
#[derive(Clone, Debug)]
pub(crate) struct Impaired {
    /// The link.
    pub(crate) impairment: Impairment,
    /// What whoever uses its trace should know.
    pub(crate) notes: Vec<String>,
}

/// The link that `text` describes, for `dgs serve` and `dgs stream`.
///
/// # Errors
/// A word that is not allowed or is given twice, a number out of range, words that contradict each other or
/// have no meaning without another, an unreadable trace.
pub(crate) fn impairment(text: &str) -> Result<Impaired> {
    let mut path = PathConfig::unimpaired();
    let mut notes = Vec::new();
    let keys = ["loss", "burst", "rate", "delay", "jitter", "queue", "trace", "light", "seed"];
    // Without a word it is the name of a trace, whatever that has in it.
    let words = match text.contains('=') {
        true => Words::parse(text, &keys, ALLOWED)?,
        false => Words { words: vec![("trace", text)], allowed: ALLOWED },
    };
    path.loss = words.loss(mean_burst, "1 to 1000 packets")?;
    path.jitter = words.read("jitter", TIMES, span)?.unwrap_or(Nanos::ZERO);
    let delay = words.read("delay", TIMES, span)?;
    path.delay = delay.unwrap_or(Nanos::ZERO);
    let seed = words.read("seed", "0 to 18446744073709551615", |text| text.parse().ok())?.unwrap_or(1);
    let queue = words.read("queue", TIMES, span)?;
    let rate = words.read("rate", "1kbit to 100000mbit", |text| rate(text, 1e11))?;
    if let Some(rate) = rate {
        path.capacity = Capacity::Constant(rate);
    }
    if let Some(file) = words.value("trace") {
        ensure!(rate.is_none(), "--impair: rate and trace are given; one of both is allowed");
        let Recording { replay, notes: said } = read_recording(Path::new(file)).with_context(|| {
            format!("--impair: {file:?} is no trace that can be used; {ALLOWED} are allowed")
        })?;
        notes.extend(said.into_iter().map(|note| format!("--impair: {file}: {note}")));
        let Replay { capacity, delay: delays, loss } = replay;
        if let Some(round_trip) = capacity.base_rtt().filter(|_| delay.is_none() && delays.is_none()) {
            path.delay = Nanos(round_trip.0 / 2);
            notes.push(format!(
                "--impair: {file}: its round trip is {:.0} ms, so {:.0} ms one way are added; delay= says \
                 otherwise",
                round_trip.as_ms(),
                path.delay.as_ms()
            ));
        }
        path.capacity = Capacity::Trace(capacity);
        (path.delay_trace, path.loss_trace) = (delays, loss);
    }
    path.light = words.read("light", LIGHT_LOADS, light_load)?;
    let mean = match &path.capacity {
        Capacity::Unlimited => None,
        Capacity::Constant(rate) => Some(*rate),
        Capacity::Trace(trace) => Some(trace.mean_rate()),
    };
    ensure!(
        mean.is_some() || path.light.is_none(),
        "--impair: light needs rate or trace: without them bursts are as fast as everything else"
    );
    match mean {
        Some(mean) => path.queue = QueueLimit::lasting(queue.unwrap_or(QUEUE), mean),
        None => ensure!(queue.is_none(), "--impair: queue needs rate or trace: without them nothing waits"),
    }
    Ok(Impaired { impairment: Impairment { path, seed }, notes })
}

/// The link that `text` describes, for a viewer who asks its server for it.
///
/// # Errors
/// A word that is not allowed or is given twice, a number out of range or finer than the wire holds, words
/// that contradict each other or have no meaning without another.
pub fn viewer_link(text: &str) -> Result<ViewerLink> {
    let words = Words::parse(text, &["loss", "burst", "rate", "delay", "seed"], ALLOWED_TO_VIEWERS)?;
    words.loss(
        |text| mean_burst(text).filter(|burst| burst.fract() == 0.0),
        "a whole number of packets, 1 to 1000",
    )?;
    let finest = "in steps of 0.01%";
    let loss = words.read("loss", finest, |text| share(text).filter(|share| is_whole(share * 1e4)))?;
    let delay = words.read("delay", "0ms to 1000ms in steps of 0.001ms", |text| {
        span(text).filter(|span| *span <= Nanos::from_s(1) && span.0 % 1000 == 0)
    })?;
    Ok(ViewerLink {
        loss: loss.unwrap_or(0.0),
        burst: words.read("burst", "", mean_burst)?.unwrap_or(1.0),
        rate: words.read("rate", "1kbit to 1000mbit", |text| rate(text, 1e9))?,
        delay: Duration::from_nanos(delay.unwrap_or(Nanos::ZERO).0),
        seed: words.read("seed", "0 to 4294967295", |text| text.parse().ok())?.unwrap_or(1),
    })
}

/// The words of a description, each with a key of its own.
struct Words<'t> {
    words: Vec<(&'t str, &'t str)>,
    allowed: &'static str,
}

impl<'t> Words<'t> {
    fn parse(text: &'t str, keys: &[&str], allowed: &'static str) -> Result<Self> {
        let mut words: Vec<(&str, &str)> = Vec::new();
        for word in text.split(',').map(str::trim) {
            let known = word.split_once('=').filter(|(key, _)| keys.contains(key));
            let (key, value) =
                known.with_context(|| format!("--impair: {word:?} is not allowed; {allowed} are"))?;
            if words.iter().any(|(other, _)| *other == key) {
                bail!("--impair: {key} is given twice; once is allowed");
            }
            words.push((key, value));
        }
        Ok(Self { words, allowed })
    }

    fn value(&self, key: &str) -> Option<&'t str> {
        self.words.iter().find(|(other, _)| *other == key).map(|(_, value)| *value)
    }

    /// The value of `key` as `parse` reads it; `range` says what is allowed.
    fn read<T>(&self, key: &str, range: &str, parse: impl Fn(&str) -> Option<T>) -> Result<Option<T>> {
        let Some(value) = self.value(key) else { return Ok(None) };
        let refusal = || {
            let word = format!("{key}={value}");
            format!("--impair: {word:?} is not allowed: {key} is {range}; {} are", self.allowed)
        };
        parse(value).with_context(refusal).map(Some)
    }

    /// What `loss` and `burst` say together; `parse` reads a burst.
    fn loss(&self, parse: impl Fn(&str) -> Option<f64>, range: &str) -> Result<LossModel> {
        let loss = self.read("loss", LOSSES, share)?;
        let burst = self.read("burst", range, parse)?;
        if let (None, Some(_)) = (loss, burst) {
            bail!("--impair: burst needs loss: without it nothing is lost");
        }
        let (loss, burst) = (loss.unwrap_or(0.0), burst.unwrap_or(1.0));
        let least = LossModel::least_burst(loss);
        ensure!(
            burst == 1.0 || burst >= least,
            "--impair: a loss of {} % in bursts of {burst} packets is impossible; burst={} is the least, and \
             burst=1 loses independently",
            figure(100.0 * loss),
            (least * 100.0 - 1e-6).ceil() / 100.0
        );
        Ok(LossModel::in_bursts(loss, burst))
    }
}

/// A number to four digits behind the point, without zeros at its end.
fn figure(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

/// Whether `value` is a whole number, but for the rounding of its calculation.
fn is_whole(value: f64) -> bool {
    (value - value.round()).abs() < 1e-6
}

/// A share of datagrams below all of them: `5%` or `0.05`.
fn share(text: &str) -> Option<f64> {
    let share = match text.strip_suffix('%') {
        Some(percent) => percent.parse::<f64>().ok()? / 100.0,
        None => text.parse().ok()?,
    };
    (0.0..=0.9).contains(&share).then_some(share)
}

/// Mean number of datagrams lost in a row.
fn mean_burst(text: &str) -> Option<f64> {
    text.parse().ok().filter(|burst| (1.0..=1000.0).contains(burst))
}

/// `5mbit` or `500kbit`, from 1 kbit/s to `most` bit/s.
fn rate(text: &str, most: f64) -> Option<Rate> {
    let (number, factor) = text
        .strip_suffix("mbit")
        .map(|number| (number, 1e6))
        .or_else(|| text.strip_suffix("kbit").map(|number| (number, 1e3)))?;
    let rate = number.parse::<f64>().ok()? * factor;
    (1e3..=most).contains(&rate).then_some(Rate(rate.round() as u64))
}

/// `40mbit/15kB/100ms`: rate, bytes and pause of what a link does for bursts after a pause.
pub(crate) fn light_load(text: &str) -> Option<LightLoad> {
    let mut parts = text.split('/');
    let (first, second, third) = (parts.next()?, parts.next()?, parts.next()?);
    if parts.next().is_some() {
        return None;
    }
    let kilobytes = second.strip_suffix("kB")?.parse::<f64>().ok()?;
    let burst = (1.0..=1e6).contains(&kilobytes).then_some(Bytes((kilobytes * 1e3).round() as u64))?;
    Some(LightLoad { rate: rate(first, 1e11)?, burst, pause: span(third)? })
}

/// `40ms`, up to a minute.
fn span(text: &str) -> Option<Nanos> {
    let ms = text.strip_suffix("ms")?.parse::<f64>().ok()?;
    (0.0..=60_000.0).contains(&ms).then_some(Nanos((ms * 1e6).round() as u64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_is_read_word_by_word() {
        let text = "loss=5%,rate=5mbit,delay=40ms,burst=4,seed=7";
        let Impairment { path, seed } = impairment(text).unwrap().impairment;
        assert!(matches!(path.capacity, Capacity::Constant(Rate(5_000_000))));
        assert_eq!((path.delay, path.queue.bytes, seed), (Nanos::from_ms(40), 156_250, 7));
        let LossModel::GilbertElliott { enter_bad, leave_bad, .. } = path.loss else { panic!() };
        assert!((enter_bad / (enter_bad + leave_bad) - 0.05).abs() < 1e-12 && leave_bad == 0.25);
        let path = impairment("rate=2mbit,light=40mbit/15kB/100ms").unwrap().impairment.path;
        let (rate, burst, pause) = (Rate::from_mbps(40), Bytes(15_000), Nanos::from_ms(100));
        assert_eq!(path.light, Some(LightLoad { rate, burst, pause }));
        let path = impairment("loss=0.1").unwrap().impairment.path;
        assert!(matches!((path.capacity, path.loss), (Capacity::Unlimited, LossModel::Iid(0.1))));
    }

    #[test]
    fn a_viewer_asks_for_fewer_things() {
        let link = viewer_link("loss=5%,burst=4,rate=500kbit,delay=40ms,seed=7").unwrap();
        let whole = ViewerLink {
            rate: Some(Rate(500_000)),
            delay: Duration::from_millis(40),
            loss: 0.05,
            burst: 4.0,
            seed: 7,
        };
        assert_eq!(link, whole);
        for text in ["jitter=5ms", "queue=1ms", "trace=x", "x.csv", "", "loss=2", "rate=5"] {
            let error = format!("{:#}", viewer_link(text).unwrap_err());
            assert!(error.contains("--impair: ") && !error.contains("jitter=5ms,"), "{text}: {error}");
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        for text in [
            "loss=2",
            "loss=-1%",
            "loss=nan",
            "rate=5",
            "rate=0mbit",
            "delay=5",
            "delay=1e9ms",
            "burst=0",
            "colour=red",
            "loss=1%,,",
            "seed=x",
        ] {
            let error = format!("{:#}", impairment(text).unwrap_err());
            assert!(error.contains("--impair: ") && error.contains("rate=5mbit"), "{text}: {error}");
        }
        assert!(format!("{:#}", impairment("no.csv").unwrap_err()).contains("no.csv"));
    }

    #[test]
    fn words_that_contradict_each_other_or_mean_nothing_are_refused() {
        for (text, words) in [
            ("loss=90%,burst=2", "a loss of 90 % in bursts of 2 packets is impossible; burst=9 is the least"),
            ("loss=70%,burst=2", "burst=2.34 is the least"),
            ("loss=1%,loss=2%", "loss is given twice"),
            ("rate=1mbit,trace=x", "rate and trace are given"),
            ("burst=4", "burst needs loss"),
            ("queue=9ms", "queue needs rate or trace"),
            ("delay=70000ms", "delay is 0ms to 60000ms"),
            ("rate=1bit", "rate is 1kbit to 100000mbit"),
            ("light=40mbit/15kB/100ms", "light needs rate or trace"),
            ("rate=1mbit,light=40mbit/15kB", "light is the rate of the first bytes after a pause"),
            ("rate=1mbit,light=40mbit/15kB/1ms/2", "1kB to 1000000kB"),
            ("rate=1mbit,light=40/15kB/1ms", "1kbit to 100000mbit"),
            ("rate=1mbit,light=40mbit/0.5kB/1ms", "1kB to 1000000kB"),
        ] {
            let error = format!("{:#}", impairment(text).unwrap_err());
            assert!(error.contains(words), "{text}: {error}");
        }
        assert!(impairment("loss=90%,burst=9").is_ok() && impairment("loss=90%,burst=1").is_ok());
        for (text, words) in [
            ("loss=0.001%", "loss is in steps of 0.01%"),
            ("loss=5%,burst=2.5", "burst is a whole number of packets, 1 to 1000"),
            ("loss=90%,burst=2", "burst=9 is the least"),
            ("delay=2000ms", "delay is 0ms to 1000ms in steps of 0.001ms"),
            ("delay=0.0001ms", "steps of 0.001ms"),
            ("rate=2000mbit", "rate is 1kbit to 1000mbit"),
            ("seed=4294967296", "seed is 0 to 4294967295"),
        ] {
            let error = format!("{:#}", viewer_link(text).unwrap_err());
            assert!(error.contains(words), "{text}: {error}");
        }
        assert!(viewer_link("loss=0.07%,delay=0.125ms").is_ok());
    }

    #[test]
    fn a_trace_brings_its_round_trip_and_what_is_to_be_known_of_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("phone.csv");
        let rows = "Timestamp,DL_bitrate,UL_bitrate,State,PINGAVG\n2020.02.14_09.38.00,10,1,I,80\n\
                    2020.02.14_09.38.01,900,1,I,-\n";
        std::fs::write(&file, rows).unwrap();
        let named = |more: &str| impairment(&format!("trace={}{more}", file.display())).unwrap();
        let Impaired { impairment, notes } = named("");
        assert_eq!(impairment.path.delay, Nanos::from_ms(40));
        let notes = notes.join("; ");
        assert!(notes.contains("the phone was idle") && notes.contains("40 ms one way are added"), "{notes}");
        assert_eq!(named(",delay=5ms").impairment.path.delay, Nanos::from_ms(5));
    }
}
