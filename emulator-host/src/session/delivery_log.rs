//! Hands the sender of the model what receipts report, without reading their bytes.
//!
//! In the model both ends lie in one memory. A receipt is composed and measured, so that its length is the
//! true one; what it reports are ranges of one log, and the sender looks only at the part of them that no
//! earlier receipt has reported. In debug builds every receipt is also written and read, and has to say the
//! same ([`DeliveryLog::reads_like`]).

use super::feedback::{self, Feedback, NewsRange, Reported};
use crate::graph::{GroupIndex, PacketGraph, PacketIndex};

/// All news of a session, oldest first.
#[derive(Debug, Default)]
pub(super) struct DeliveryLog {
    pub(super) arrived: Vec<PacketIndex>,
    pub(super) recovered: Vec<PacketIndex>,
    pub(super) completed: Vec<GroupIndex>,
}

impl DeliveryLog {
    /// Whether the bytes of a receipt say to the sender what `reported` does.
    pub(super) fn reads_like(&self, bytes: &[u8], reported: Reported, graph: &PacketGraph) -> bool {
        let mut read = Feedback::default();
        if feedback::read(bytes, graph, &mut read).is_err() {
            return false;
        }
        if (read.playout_start, read.pose) != (reported.playout_start(), reported.pose) {
            return false;
        }
        let mut heard = Vec::new();
        LogReader::default().hear(reported, self, graph, |packet| heard.push(packet));
        for packets in [&mut heard, &mut read.received] {
            packets.sort_unstable();
            packets.dedup();
        }
        heard == read.received
    }
}

/// What a sender has heard of each kind of news.
#[derive(Debug, Default)]
pub(super) struct LogReader {
    arrived: ReadRange,
    recovered: ReadRange,
    completed: ReadRange,
}

impl LogReader {
    /// Calls `on_received` with the packets that the receiver has by what is reported for the first time.
    pub(super) fn hear(
        &mut self,
        reported: Reported,
        log: &DeliveryLog,
        graph: &PacketGraph,
        mut on_received: impl FnMut(PacketIndex),
    ) {
        self.arrived.hear(reported.arrived, &log.arrived, &mut on_received);
        self.recovered.hear(reported.recovered, &log.recovered, &mut on_received);
        self.completed.hear(reported.completed, &log.completed, |group| {
            graph.packets_of(group).for_each(&mut on_received);
        });
    }
}

/// The newest unbroken range of entries that were processed. Others may be processed twice, which changes
/// nothing.
#[derive(Debug, Default)]
struct ReadRange(NewsRange);

impl ReadRange {
    fn hear<T: Copy>(&mut self, reported: NewsRange, log: &[T], on_news: impl FnMut(T)) {
        let NewsRange { from, to } = self.0;
        if (from..=to).contains(&reported.from) {
            let fresh = NewsRange { from: to, to: to.max(reported.to) };
            self.0.to = fresh.to;
            log[fresh.places()].iter().copied().for_each(on_news);
            return;
        }
        // Behind a gap of lost receipts, or a receipt that was overtaken.
        if reported.from > to {
            self.0 = reported;
        }
        log[reported.places()].iter().copied().for_each(on_news);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{clock::Nanos, graph::Synthetic, session::feedback::ReceiptWriter};

    #[test]
    fn everything_that_is_reported_is_heard_and_in_order_only_once() {
        let log: Vec<usize> = (0..20).collect();
        let hear = |ranges: &[(u32, u32)]| {
            let (mut heard, mut news) = (ReadRange::default(), Vec::new());
            for (from, to) in ranges {
                heard.hear(NewsRange { from: *from, to: *to }, &log, |item| news.push(item));
            }
            news
        };
        assert_eq!(hear(&[(0, 2), (0, 4), (2, 4), (3, 9), (9, 9)]), (0..9).collect::<Vec<_>>());
        // One receipt was lost, and one is overtaken.
        assert_eq!(hear(&[(0, 2), (5, 7), (3, 6), (6, 8)]), [0, 1, 5, 6, 3, 4, 5, 7]);
    }

    #[test]
    fn a_receipt_that_reports_anything_else_than_its_bytes_is_noticed() {
        let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap();
        let (group, packets) = (GroupIndex(5), [3, 4, 9].map(PacketIndex));
        let mut writer = ReceiptWriter::new();
        packets.iter().for_each(|packet| writer.on_arrived(graph.wire_id(*packet)));
        writer.on_complete(graph.groups()[group.at()].id);
        let mut log =
            DeliveryLog { arrived: packets.to_vec(), completed: vec![group], ..DeliveryLog::default() };
        let reported = writer.compose(Some(Nanos::from_ms(1)));
        let bytes = writer.bytes();
        assert!(log.reads_like(bytes, reported, &graph));
        assert!(!log.reads_like(bytes, Reported { playout_us: 0, ..reported }, &graph));
        assert!(!log.reads_like(bytes, Reported { completed: NewsRange::default(), ..reported }, &graph));
        assert!(!log.reads_like(&bytes[1..], reported, &graph));
        log.arrived[1] = PacketIndex(7);
        assert!(!log.reads_like(bytes, reported, &graph));
    }
}
