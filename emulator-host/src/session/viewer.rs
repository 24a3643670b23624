//! Plays one clip at a modelled screen: a receiver behind [`Endpoint`], playout, receipts, and measures it.
//!
//! It serves every transport in virtual time; sizes of media come from the graph.

use super::{
    SessionConfig, delivery_log::DeliveryLog, feedback::Reported, media_receiver::MediaReceiver,
    media_sender::MediaSender, metrics::Metrics, threshold::Threshold, viewer_path::ViewerPath,
};
use crate::{
    clock::Nanos,
    graph::{GroupIndex, PacketGraph, PacketIndex},
    link::Chain,
    policy::Scheduler,
    receiver::{Arrival, Endpoint, take_fresh},
    report::{Report, SenderRow},
};

/// The viewing end of a run.
pub struct Viewer<'a> {
    graph: &'a PacketGraph,
    endpoint: &'a mut dyn Endpoint,
    receiver: MediaReceiver,
    metrics: Metrics<'a>,
    manifest: bool,
    threshold: Threshold,
    /// Bit `i % 64` of word `i / 64`: group `i` has been reported.
    reported_groups: Vec<u64>,
    recovered: Vec<PacketIndex>,
    news: DeliveryLog,
    path: Option<ViewerPath>,
}

impl std::fmt::Debug for Viewer<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Viewer").field("manifest", &self.manifest).finish_non_exhaustive()
    }
}

impl<'a> Viewer<'a> {
    /// Nothing has arrived; a clip without a manifest has it already.
    pub fn new(graph: &'a PacketGraph, config: &SessionConfig, endpoint: &'a mut dyn Endpoint) -> Self {
        let mut receiver = MediaReceiver::new(config.startup);
        receiver.on_clip(graph.frames(), graph.frame_interval());
        let mut viewer = Self {
            graph,
            endpoint,
            receiver,
            metrics: Metrics::new(graph),
            manifest: false,
            threshold: Threshold::new(config.startup.rule, graph),
            reported_groups: vec![0; graph.groups().len().div_ceil(64)],
            recovered: Vec::new(),
            news: DeliveryLog::default(),
            path: config.viewer.clone(),
        };
        viewer.look();
        if graph.manifest_bytes() == 0 {
            viewer.control(0, true);
        }
        viewer
    }

    /// Playout and its clock.
    pub fn playout(&self) -> &MediaReceiver {
        &self.receiver
    }

    /// A media packet arrives.
    pub fn media(&mut self, packet: PacketIndex, now: Nanos) {
        let arrival = self.endpoint.media(packet, now, &mut self.recovered);
        self.metrics.arrive(packet, arrival, self.receiver.next_frame());
        if arrival != Arrival::Refused {
            self.receiver.on_arrived(self.graph.wire_id(packet));
            self.news.arrived.push(packet);
        }
        self.take_recovered();
    }

    /// `bytes` distinct bytes of the control stream have arrived so far; `complete` once all have.
    pub fn control(&mut self, bytes: usize, complete: bool) {
        self.manifest |= complete;
        if complete {
            self.metrics.on_manifest();
        }
        self.endpoint.control(bytes, complete, &mut self.recovered);
        self.take_recovered();
    }

    fn take_recovered(&mut self) {
        for packet in self.recovered.drain(..) {
            self.metrics.recover(packet);
            self.receiver.on_recovered(self.graph.wire_id(packet));
            self.news.recovered.push(packet);
        }
        self.receiver.on_change();
    }

    /// Starts playout if the threshold is reached or the wait is over; whether it starts now.
    pub fn start_if_ready(&mut self, now: Nanos) -> bool {
        let (endpoint, threshold) = (&mut self.endpoint, &mut self.threshold);
        let manifest = self.manifest;
        self.receiver.start_if_ready(now, || {
            let snapshot = endpoint.snapshot(0);
            manifest && threshold.is_reached(snapshot)
        })
    }

    /// Shows every frame that is due.
    pub fn show_due(&mut self, now: Nanos) {
        while let Some(frame) = self.receiver.frame_due(now) {
            let snapshot = self.endpoint.snapshot(frame);
            take_fresh(&mut self.reported_groups, &snapshot.groups, |index| {
                let group = GroupIndex(index);
                self.receiver.on_complete(self.graph.groups()[group.at()].id);
                self.news.completed.push(group);
            });
            self.metrics.show(frame, now, snapshot);
            self.look();
        }
    }

    /// The viewer is where it sees the next frame from.
    fn look(&mut self) {
        if let Some(path) = &self.path {
            self.receiver.on_pose(path.pose(self.receiver.next_frame()));
        }
    }

    /// Appends the bytes of the next receipt to `out`.
    pub fn receipt(&mut self, out: &mut Vec<u8>) {
        self.receiver.receipt(out);
    }

    /// Length of the next receipt, and what it reports: for a transport that moves no bytes.
    pub(super) fn receipt_and_news(&mut self) -> (u32, Reported) {
        let (len, reported) = self.receiver.measured_receipt();
        debug_assert!(self.is_as_written(len, reported), "a receipt reports other news than its bytes");
        (len as u32, reported)
    }

    /// Whether the bytes of the receipt composed last have this length, and say what is reported.
    fn is_as_written(&mut self, len: usize, reported: Reported) -> bool {
        let bytes = self.receiver.receipt_bytes();
        bytes.len() == len && self.news.reads_like(bytes, reported, self.graph)
    }

    /// All news so far.
    pub(super) fn news(&self) -> &DeliveryLog {
        &self.news
    }

    /// Enters the sender's state into the report.
    pub fn sample(&mut self, row: SenderRow) {
        self.metrics.sample(row);
    }

    /// The report of a run that ended at `now`. Name of the controller, seed, digest and counts of datagrams
    /// are the caller's to enter.
    pub fn report<G, S>(self, sender: &MediaSender<G, S>, paths: [&Chain; 2], now: Nanos) -> Report
    where
        G: std::ops::Deref<Target = PacketGraph>,
        S: Scheduler,
    {
        let boxes = paths.into_iter().flat_map(Chain::box_counts);
        let boxes = boxes.map(|(label, counts)| (label.to_owned(), counts)).collect();
        let mut report = self.metrics.report(now, sender.forecasts(), boxes);
        report.policy = sender.policy().to_owned();
        report.startup_ms = self.receiver.playout_start().map(Nanos::as_ms);
        report.startup_reached = self.receiver.threshold_reached();
        report.sender = sender.counts();
        report
    }
}
