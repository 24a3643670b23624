//! What every verb takes that sends over an emulated link.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::number::{not_negative, positive, real, whole};

/// The link. What the receiver sends comes over 2 Mbit/s with the same delay.
#[derive(Clone, Debug, Args)]
pub struct LinkArgs {
    /// Capacity trace: mahimahi, UCC 5G CSV, two columns (seconds, Mbit/s), or three or four (seconds,
    /// Mbit/s, one-way delay in ms, loss in %); lines that begin with # are comments. A row's rate holds
    /// until the next row; in files of two columns with pitree in their name it holds until the row's own
    /// time [default: built-in bursty trace, scaled so that the stream is `load` times what fits].
    #[arg(long)]
    pub trace: Option<PathBuf>,
    /// One-way delay over time, both ways: a number of milliseconds per line, each for 10 ms.
    #[arg(long, value_name = "FILE")]
    pub delay_trace: Option<PathBuf>,
    /// Start this many seconds into the trace: at least 0.
    #[arg(long, default_value_t = 0.0, value_parser = not_negative, allow_negative_numbers = true)]
    pub trace_offset: f64,
    /// Multiply the trace's capacity by this, above 0.
    #[arg(long, value_parser = positive, allow_negative_numbers = true)]
    pub scale: Option<f64>,
    /// For the built-in trace: bytes of manifest and packets over what the link carries while the clip
    /// plays, above 0 [default: 1.2].
    #[arg(long, value_parser = positive, allow_negative_numbers = true)]
    pub load: Option<f64>,
    /// One-way delay, 0 to 60000 milliseconds; delays of a trace come on top of it [default: 0 with such
    /// a trace, else half the capacity trace's own round trip, else 30].
    #[arg(long, value_parser = whole::<u64>(0..=60_000, "milliseconds"))]
    pub delay_ms: Option<u64>,
    /// Share of datagrams lost in Gilbert–Elliott bursts (mean burst four packets), 0 to 0.3 [default: 0 with
    /// --trace, whose queue and own losses are enough, else 0.02].
    #[arg(long, value_parser = real(0.0..=0.3, "a share"), allow_negative_numbers = true)]
    pub burst_loss: Option<f64>,
    /// Queue, as 0 to 60000 milliseconds of the mean rate, and 3 kB (two whole datagrams) at least.
    #[arg(long, default_value_t = 250, value_parser = whole::<u64>(0..=60_000, "milliseconds"))]
    pub queue_ms: u64,
    /// Congestion controller.
    #[arg(long, value_enum, default_value_t = ControllerName::Newreno)]
    pub controller: ControllerName,
    /// What carries packets over the link.
    #[arg(long, value_enum, default_value_t = TransportName::Model)]
    pub transport: TransportName,
    /// Seed of random losses and jitter, and of the built-in trace; the default does not begin in a fade.
    #[arg(long, default_value_t = 2)]
    pub link_seed: u64,
}

impl LinkArgs {
    /// Load where nothing is said.
    pub const LOAD: f64 = 1.2;

    /// What a person should know who typed a load that changes nothing.
    pub fn unused(&self) -> Option<String> {
        let beside = match (&self.trace, self.scale) {
            (Some(_), _) => "--trace",
            (None, Some(_)) => "--scale",
            (None, None) => return None,
        };
        self.load.map(|_| format!("--load is not used beside {beside}: it scales the built-in trace"))
    }
}

/// A transport of an emulated delivery.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TransportName {
    /// The emulator's model of QUIC.
    Model,
    /// QUIC itself (`quinn-proto`) in virtual time, its handshake done before; with newreno, cubic or scream.
    Quic,
}

/// A congestion controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ControllerName {
    /// RFC 9002 NewReno.
    Newreno,
    /// RFC 9438 CUBIC.
    Cubic,
    /// The paper's BBR-inspired model, with headroom above the rate that it estimates.
    BbrModel,
    /// The same as the paper's text has it, r_send = min(r_cwnd, r_path) exactly: it hardly finds a faster
    /// path than its first window did.
    BbrPaper,
    /// SCReAMv2 (RFC 8298bis): bounds the delay of its own queue, made for media.
    Scream,
}
