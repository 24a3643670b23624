//! Builds the links of `--impair`: one that a server puts before every viewer, one that a viewer asks for.

use std::{path::Path, time::Duration};

use anyhow::{Context, Result, bail};
use dgs_quic::socket::{Impairment, ViewerLink};
use emulator_host::{
    Nanos, Rate,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
};

use super::link::read_replay;

/// What is allowed, for errors.
const ALLOWED: &str = "a trace file, or a list of loss=5%, burst=4, rate=5mbit, delay=40ms, jitter=5ms, \
                       queue=250ms, trace=FILE, seed=1";
/// The same of a link that a viewer asks for.
const ALLOWED_TO_VIEWERS: &str = "a list of loss=5%, burst=4, rate=5mbit, delay=40ms, seed=1";
/// The queue of a link without a rate of its own has nothing to wait for; one with a rate has this.
const QUEUE: Nanos = Nanos::from_ms(250);

/// The link that `text` describes, for `dgs serve`.
///
/// # Errors
/// A word that is not allowed, a number out of range, an unreadable trace.
pub fn impairment(text: &str) -> Result<Impairment> {
    let mut path = PathConfig::unimpaired();
    let (mut loss, mut burst, mut queue, mut seed) = (0.0, 1.0, QUEUE, 1);
    let whole_trace = format!("trace={text}");
    let words = if text.contains('=') { text } else { whole_trace.as_str() };
    let refusal = |word| refusal(word, ALLOWED);
    for word in words.split(',') {
        let (key, value) = word.split_once('=').with_context(|| refusal(word))?;
        match key {
            "loss" => loss = share(value).with_context(|| refusal(word))?,
            "burst" => burst = mean_burst(value).with_context(|| refusal(word))?,
            "rate" => path.capacity = Capacity::Constant(rate(value).with_context(|| refusal(word))?),
            "delay" => path.delay = span(value).with_context(|| refusal(word))?,
            "jitter" => path.jitter = span(value).with_context(|| refusal(word))?,
            "queue" => queue = span(value).with_context(|| refusal(word))?,
            "seed" => seed = value.parse().with_context(|| refusal(word))?,
            "trace" => {
                let replay = read_replay(Path::new(value))?;
                path.capacity = Capacity::Trace(replay.capacity);
                (path.delay_trace, path.loss_trace) = (replay.delay, replay.loss);
            }
            _ => bail!(refusal(word)),
        }
    }
    path.loss = LossModel::in_bursts(loss, burst);
    let mean = match &path.capacity {
        Capacity::Unlimited => None,
        Capacity::Constant(rate) => Some(*rate),
        Capacity::Trace(trace) => Some(trace.mean_rate()),
    };
    if let Some(mean) = mean {
        path.queue = QueueLimit::lasting(queue, mean);
    }
    Ok(Impairment { path, seed })
}

/// The link that `text` describes, for a viewer who asks its server for it.
///
/// # Errors
/// A word that is not allowed, a number out of range.
pub fn viewer_link(text: &str) -> Result<ViewerLink> {
    let mut link = ViewerLink::default();
    let refusal = |word| refusal(word, ALLOWED_TO_VIEWERS);
    for word in text.split(',') {
        let (key, value) = word.split_once('=').with_context(|| refusal(word))?;
        match key {
            "loss" => link.loss = share(value).with_context(|| refusal(word))?,
            "burst" => link.burst = mean_burst(value).with_context(|| refusal(word))?,
            "rate" => link.rate = Some(rate(value).with_context(|| refusal(word))?),
            "delay" => {
                let delay = span(value).with_context(|| refusal(word))?;
                link.delay = Duration::from_nanos(delay.0);
            }
            "seed" => link.seed = value.parse().with_context(|| refusal(word))?,
            _ => bail!(refusal(word)),
        }
    }
    Ok(link)
}

fn refusal(word: &str, allowed: &str) -> String {
    format!("--impair: {word:?} is not allowed; {allowed} are")
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

/// `5mbit` or `500kbit`, 1 kbit/s to 100 Gbit/s.
fn rate(text: &str) -> Option<Rate> {
    let (number, factor) = text
        .strip_suffix("mbit")
        .map(|number| (number, 1e6))
        .or_else(|| text.strip_suffix("kbit").map(|number| (number, 1e3)))?;
    let rate = number.parse::<f64>().ok()? * factor;
    (1e3..=1e11).contains(&rate).then_some(Rate(rate as u64))
}

/// `40ms`, up to a minute.
fn span(text: &str) -> Option<Nanos> {
    let ms = text.strip_suffix("ms")?.parse::<f64>().ok()?;
    (0.0..=60_000.0).contains(&ms).then_some(Nanos((ms * 1e6) as u64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_is_read_word_by_word() {
        let Impairment { path, seed } = impairment("loss=5%,rate=5mbit,delay=40ms,burst=4,seed=7").unwrap();
        assert!(matches!(path.capacity, Capacity::Constant(Rate(5_000_000))));
        assert_eq!((path.delay, path.queue.bytes, seed), (Nanos::from_ms(40), 156_250, 7));
        let LossModel::GilbertElliott { enter_bad, leave_bad, .. } = path.loss else { panic!() };
        assert!((enter_bad / (enter_bad + leave_bad) - 0.05).abs() < 1e-12 && leave_bad == 0.25);
        let path = impairment("loss=0.1").unwrap().path;
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
}
