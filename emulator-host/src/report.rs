//! Reports what a run has shown, in the terms of the paper's tables. Everything serialises.

use serde::Serialize;

use crate::{clock::Nanos, link::Counts};

/// One playout time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameRow {
    /// When it was shown.
    pub time_ns: Nanos,
    /// Which frame.
    pub frame: u32,
    /// Bytes of distinct packets that can be shown so far, whatever frame they belong to.
    pub usable_bytes: u64,
    /// Usable utility ÷ positive utility of the groups active at this frame; may be negative if only harmful
    /// groups arrived.
    pub utility: f64,
    /// Share of the groups active at this frame whose closure is not usable, 0..=1.
    pub miss: f64,
    /// The same among groups of level 0.
    pub base_miss: f64,
}

/// The sender's state at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct SenderRow {
    /// When.
    pub time_ns: Nanos,
    /// Congestion window, bytes of UDP payload.
    pub window_bytes: u64,
    /// Bytes in flight.
    pub in_flight_bytes: u64,
    /// Smoothed round trip.
    pub smoothed_rtt_ns: Nanos,
    /// Rate the scheduler counts on, bits/s.
    pub rate_bps: u64,
}

/// Packets and bytes that one box received, delivered and dropped.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct BoxRow {
    /// Label of the box.
    pub label: String,
    /// Its counts at the end of the run.
    pub counts: Counts,
}

/// Media bytes that arrived and showed nothing. Each packet is in one part at most.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Waste {
    /// Arrived after the last frame that could use it.
    pub late_bytes: u64,
    /// Arrived in time, but its closure was not complete at any frame that could use it.
    pub outside_closure_bytes: u64,
    /// Arrived again, or after it had been recovered.
    pub duplicate_bytes: u64,
    /// Parity that recovered nothing.
    pub unused_repair_bytes: u64,
    /// Refused because the buffer before the manifest was full.
    pub refused_bytes: u64,
}

impl Waste {
    /// All parts together.
    pub fn total_bytes(&self) -> u64 {
        self.late_bytes
            + self.outside_closure_bytes
            + self.duplicate_bytes
            + self.unused_repair_bytes
            + self.refused_bytes
    }
}

/// Forecasts whose chance lies in one tenth of 0..=1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ForecastBin {
    /// Forecasts.
    pub count: u64,
    /// Their mean chance.
    pub chance: f64,
    /// How many came true.
    pub hits: u64,
}

/// A scheduler's forecasts, "this packet arrives before that frame is shown", beside what happened.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ForecastRow {
    /// Forecasts.
    pub count: u64,
    /// Brier score: mean of (chance − outcome)².
    pub brier: f64,
    /// The score of always saying how often it comes true in this run.
    pub base_rate_brier: f64,
    /// Mean of (chance − share that came true)² over the bins: 0 if calibrated.
    pub reliability: f64,
    /// By tenths.
    pub bins: Vec<ForecastBin>,
}

/// How often things happened at the sender.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SenderCounts {
    /// Datagrams sent, probes and control included.
    pub datagrams: u64,
    /// Media packets sent for the first time, parity excluded.
    pub media: u64,
    /// Media packets sent again.
    pub retransmitted: u64,
    /// Parity packets sent.
    pub parity: u64,
    /// Control datagrams sent, repeats included.
    pub control: u64,
    /// Pings sent for want of anything better to probe with.
    pub pings: u64,
    /// Packets declared lost.
    pub lost: u64,
    /// Of these, acknowledged later.
    pub spurious: u64,
    /// Probe timeouts.
    pub probe_timeouts: u64,
    /// Choices of the scheduler that were refused because they were expired, early or not media; a correct
    /// one has none.
    pub refused_choices: u64,
    /// Receipts whose bytes could not be read.
    pub refused_receipts: u64,
}

impl SenderCounts {
    /// The sums of both: a transport counts datagrams, the sender of media packets.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            datagrams: self.datagrams + other.datagrams,
            media: self.media + other.media,
            retransmitted: self.retransmitted + other.retransmitted,
            parity: self.parity + other.parity,
            control: self.control + other.control,
            pings: self.pings + other.pings,
            lost: self.lost + other.lost,
            spurious: self.spurious + other.spurious,
            probe_timeouts: self.probe_timeouts + other.probe_timeouts,
            refused_choices: self.refused_choices + other.refused_choices,
            refused_receipts: self.refused_receipts + other.refused_receipts,
        }
    }
}

/// One run.
///
/// # Examples
/// ```
/// use emulator_host::{SessionConfig, graph::Synthetic, simulate};
///
/// let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1)?;
/// let report = simulate(&graph, &SessionConfig::default())?;
/// let shown = report.frames.iter().filter(|frame| frame.base_miss == 0.0).count();
/// println!("{shown} of 30 frames with every base; mean utility {:.2}", report.utility);
/// // The same seed gives the same run.
/// assert_eq!(report.digest, simulate(&graph, &SessionConfig::default())?.digest);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Name of the scheduler.
    pub policy: String,
    /// Name of the congestion controller.
    pub controller: String,
    /// Seed of the path.
    pub seed: u64,
    /// When playout started, ms after the first datagram was sent; `None` if it never did.
    pub startup_ms: Option<f64>,
    /// Whether it started because the threshold was reached, and not because the wait was over.
    pub startup_reached: bool,
    /// Mean of [`FrameRow::miss`] over all frames of the clip; frames that were never shown count as missed.
    pub miss_rate: f64,
    /// The same for level 0.
    pub base_miss_rate: f64,
    /// The same as [`Self::miss_rate`] for groups of positive utility, 0..=1: what a scheduler leaves out
    /// because it would make the picture worse, or no better, is no miss. A frame without such groups has
    /// none missing.
    #[serde(skip)]
    pub positive_miss_rate: f64,
    /// Mean of [`FrameRow::utility`]; frames that were never shown count as zero.
    pub utility: f64,
    /// Length of the run.
    pub duration_ns: Nanos,
    /// Media bytes that arrived, bits/s over the run.
    pub goodput_bps: f64,
    /// Media bytes that were part of something shown, bits/s over the run.
    pub usable_goodput_bps: f64,
    /// Media bytes that arrived.
    pub media_bytes: u64,
    /// Media packets that arrived before the manifest was complete.
    pub buffered_before_manifest: u64,
    /// Packets recovered from parity.
    pub recovered: u64,
    /// What arrived in vain.
    pub waste: Waste,
    /// The sender's counters.
    pub sender: SenderCounts,
    /// The scheduler's forecasts, if it makes any.
    pub forecast: Option<ForecastRow>,
    /// One row per playout time.
    pub frames: Vec<FrameRow>,
    /// Bytes of media that had arrived by each of [`Self::frames`], ascending: every packet that arrived,
    /// repeated ones and parity included, with 58 bytes of headers each, as on the link of the model. 0
    /// before the manifest is complete: nothing can be shown then.
    #[serde(skip)]
    pub arrived_bytes: Vec<u64>,
    /// The sender's state over time.
    pub samples: Vec<SenderRow>,
    /// Counts of every box, downlink first.
    pub boxes: Vec<BoxRow>,
    /// Median and 95th percentile of how long datagrams took from the sender's socket to the receiver, queues
    /// included; `None` where the transport does not record it, or nothing arrived.
    #[serde(skip)]
    pub one_way_delay: Option<[Nanos; 2]>,
    /// FNV-1a over (time, length, direction) of every datagram sent and delivered: equal digests, equal runs.
    pub digest: u64,
}
