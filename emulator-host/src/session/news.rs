//! Hands the sender of the model what receipts tell, without reading their bytes.
//!
//! In the model both ends lie in one memory. A receipt is written, so that its length is the true one; what
//! it tells are stretches of one log, and the sender looks only at the part of them that no earlier receipt
//! has told. In debug builds every receipt is also read, and has to tell the same ([`NewsLog::reads_like`]).

use super::feedback::{self, Feedback, Stretch, Told};
use crate::graph::{GroupIndex, PacketGraph, PacketIndex};

/// All news of a session, oldest first.
#[derive(Debug, Default)]
pub(super) struct NewsLog {
    pub(super) arrived: Vec<PacketIndex>,
    pub(super) recovered: Vec<PacketIndex>,
    pub(super) completed: Vec<GroupIndex>,
}

impl NewsLog {
    /// Whether the bytes of a receipt say to the sender what `told` does.
    pub(super) fn reads_like(&self, bytes: &[u8], told: Told, graph: &PacketGraph) -> bool {
        let mut read = Feedback::default();
        if feedback::read(bytes, graph, &mut read).is_err() || read.playout_start != told.playout_start() {
            return false;
        }
        let mut heard = Vec::new();
        Heard::default().hear(told, self, graph, |packet| heard.push(packet));
        for packets in [&mut heard, &mut read.received] {
            packets.sort_unstable();
            packets.dedup();
        }
        heard == read.received
    }
}

/// What a sender has heard of each kind of news.
#[derive(Debug, Default)]
pub(super) struct Heard {
    arrived: HeardStretch,
    recovered: HeardStretch,
    completed: HeardStretch,
}

impl Heard {
    /// Calls `on_received` with the packets that the receiver has by what is told for the first time.
    pub(super) fn hear(
        &mut self,
        told: Told,
        log: &NewsLog,
        graph: &PacketGraph,
        mut on_received: impl FnMut(PacketIndex),
    ) {
        self.arrived.hear(told.arrived, &log.arrived, &mut on_received);
        self.recovered.hear(told.recovered, &log.recovered, &mut on_received);
        self.completed.hear(told.completed, &log.completed, |group| {
            graph.groups()[group.at()].packets.iter().for_each(|packet| on_received(*packet));
        });
    }
}

/// The newest unbroken stretch that was heard. What lies outside of it may be heard twice; that does no harm.
#[derive(Debug, Default)]
struct HeardStretch(Stretch);

impl HeardStretch {
    fn hear<T: Copy>(&mut self, told: Stretch, log: &[T], on_news: impl FnMut(T)) {
        let Stretch { from, to } = self.0;
        if (from..=to).contains(&told.from) {
            let fresh = Stretch { from: to, to: to.max(told.to) };
            self.0.to = fresh.to;
            log[fresh.places()].iter().copied().for_each(on_news);
            return;
        }
        // Behind a gap of lost receipts, or a receipt that was overtaken.
        if told.from > to {
            self.0 = told;
        }
        log[told.places()].iter().copied().for_each(on_news);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{clock::Nanos, graph::Synthetic, session::feedback::ReceiptWriter};

    #[test]
    fn everything_that_is_told_is_heard_and_in_order_only_once() {
        let log: Vec<usize> = (0..20).collect();
        let hear = |stretches: &[(u32, u32)]| {
            let (mut heard, mut news) = (HeardStretch::default(), Vec::new());
            for (from, to) in stretches {
                heard.hear(Stretch { from: *from, to: *to }, &log, |item| news.push(item));
            }
            news
        };
        assert_eq!(hear(&[(0, 2), (0, 4), (2, 4), (3, 9), (9, 9)]), (0..9).collect::<Vec<_>>());
        // One receipt was lost, and one is overtaken.
        assert_eq!(hear(&[(0, 2), (5, 7), (3, 6), (6, 8)]), [0, 1, 5, 6, 3, 4, 5, 7]);
    }

    #[test]
    fn a_receipt_that_tells_anything_else_than_its_bytes_is_noticed() {
        let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap();
        let (group, packets) = (GroupIndex(5), [3, 4, 9].map(PacketIndex));
        let mut writer = ReceiptWriter::new();
        packets.iter().for_each(|packet| writer.on_arrived(graph.wire_id(*packet)));
        writer.on_complete(graph.groups()[group.at()].id);
        let mut log = NewsLog { arrived: packets.to_vec(), completed: vec![group], ..NewsLog::default() };
        let (bytes, told) = writer.write(Some(Nanos::from_ms(1)));
        assert!(log.reads_like(bytes, told, &graph));
        assert!(!log.reads_like(bytes, Told { playout_us: 0, ..told }, &graph));
        assert!(!log.reads_like(bytes, Told { completed: Stretch::default(), ..told }, &graph));
        assert!(!log.reads_like(&bytes[1..], told, &graph));
        log.arrived[1] = PacketIndex(7);
        assert!(!log.reads_like(bytes, told, &graph));
    }
}
