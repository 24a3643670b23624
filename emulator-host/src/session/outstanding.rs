//! Infers from receipts which media were lost, for transports that do not say it of single datagrams.
//!
//! The rules are those of RFC 9002, 6.1: a packet is lost if three sent after it have arrived, or if one sent
//! after it has arrived and 9/8 of a round trip has passed since it was sent.

use std::{collections::VecDeque, ops::Deref};

use super::media_sender::MediaSender;
use crate::{
    clock::Nanos,
    graph::{PacketGraph, PacketIndex},
    policy::{PacketStatus, Scheduler},
};

/// Reordering threshold in packets (RFC 9002, 6.1.1).
const PACKET_THRESHOLD: u64 = 3;

/// One sending of a packet.
#[derive(Clone, Copy, Debug)]
struct Sending {
    number: u64,
    packet: PacketIndex,
    bytes: u64,
    sent_at: Nanos,
}

/// Media whose fate is not known, in the order in which they were sent.
#[derive(Debug, Default)]
pub struct Outstanding {
    sendings: VecDeque<Sending>,
    next_number: u64,
    /// One more than the largest number known to have arrived.
    arrived_below: u64,
    lost: u64,
    /// Of all sendings.
    bytes: u64,
    arrived_bytes: u64,
    loss_at: Option<Nanos>,
    /// When something was last found to have arrived.
    arrival_at: Nanos,
    /// Whether the transport repeats what is lost by itself.
    is_repeated: bool,
}

impl Outstanding {
    /// Nothing was sent.
    pub fn new() -> Self {
        Self::default()
    }

    /// The transport repeats what is lost by itself from here on: what something later has overtaken is on
    /// its way.
    pub fn set_repeated(&mut self) {
        self.is_repeated = true;
    }

    /// Whether [`Self::set_repeated`] has been called.
    pub fn is_repeated(&self) -> bool {
        self.is_repeated
    }

    /// `packet` has left; enters it here and in `sender`.
    pub fn on_sent<G, S>(&mut self, sender: &mut MediaSender<G, S>, packet: PacketIndex, now: Nanos)
    where
        G: Deref<Target = PacketGraph>,
        S: Scheduler,
    {
        sender.on_sent(packet, self.next_number, now);
        let bytes = u64::from(sender.graph().wire_bytes(packet));
        self.sendings.push_back(Sending { number: self.next_number, packet, bytes, sent_at: now });
        self.bytes += bytes;
        self.next_number += 1;
    }

    /// Goes on with another sender to the same receiver, in whose graph `index` says which packet is which;
    /// what that graph lacks is forgotten.
    pub fn carry_over<G, S>(
        &mut self,
        sender: &mut MediaSender<G, S>,
        index: impl Fn(PacketIndex) -> Option<PacketIndex>,
    ) where
        G: Deref<Target = PacketGraph>,
        S: Scheduler,
    {
        self.sendings.retain_mut(|sending| {
            let Some(packet) = index(sending.packet) else {
                self.bytes -= sending.bytes;
                return false;
            };
            sending.packet = packet;
            sender.on_sent_before(packet, sending.number, sending.sent_at);
            true
        });
    }

    /// Packets whose loss was inferred since this was called before.
    pub fn take_lost(&mut self) -> u64 {
        std::mem::take(&mut self.lost)
    }

    /// Bytes of packets whose fate is not known.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Bytes of packets that are known to have arrived.
    pub fn arrived_bytes(&self) -> u64 {
        self.arrived_bytes
    }

    /// When [`Self::settle`] finds the next loss without further news.
    pub fn next_time(&self) -> Nanos {
        self.loss_at.unwrap_or(Nanos::MAX)
    }

    /// Settles what `sender` has learnt from a receipt, or what time has shown to be lost; how many were
    /// found lost. [`MediaSender::look`] is to be called after it.
    pub fn settle<G, S>(&mut self, sender: &mut MediaSender<G, S>, now: Nanos) -> usize
    where
        G: Deref<Target = PacketGraph>,
        S: Scheduler,
    {
        let path = *sender.path();
        let delay = Nanos(path.smoothed_rtt.0 + path.smoothed_rtt.0 / 8).max(Nanos::from_ms(1));
        let before = self.sendings.len();
        let (mut arrived_below, mut arrived_bytes) = (self.arrived_below, 0);
        let mut arrivals = Vec::new();
        self.sendings.retain(|sending| {
            let arrived = sender.status(sending.packet) == PacketStatus::Delivered;
            // What cannot have come back yet stands for an earlier sending of the same packet.
            if arrived {
                arrived_bytes += sending.bytes;
                arrivals.push(sending.number);
            }
            if arrived && sending.sent_at + path.minimum_rtt <= now {
                arrived_below = arrived_below.max(sending.number + 1);
            }
            !arrived
        });
        arrivals.iter().for_each(|number| sender.on_fate(*number, false, now));
        self.arrived_below = arrived_below;
        let arrived = before - self.sendings.len();
        if arrived > 0 {
            self.arrival_at = now;
        }
        self.arrived_bytes += arrived_bytes;
        self.bytes -= arrived_bytes;
        let mut lost = Vec::new();
        self.loss_at = None;
        let (loss_at, is_repeated) = (&mut self.loss_at, self.is_repeated);
        self.sendings.retain(|sending| {
            if is_repeated || sending.number >= arrived_below {
                return true;
            }
            let due = sending.sent_at + delay;
            if due <= now || arrived_below > sending.number + PACKET_THRESHOLD {
                lost.push(*sending);
                return false;
            }
            *loss_at = Some(loss_at.map_or(due, |at| at.min(due)));
            true
        });
        self.give_up(sender, arrived, &lost, now)
    }

    /// Enters in `sender` that `arrived` packets arrived and `lost` did not; how many were lost.
    fn give_up<G, S>(
        &mut self,
        sender: &mut MediaSender<G, S>,
        arrived: usize,
        lost: &[Sending],
        now: Nanos,
    ) -> usize
    where
        G: Deref<Target = PacketGraph>,
        S: Scheduler,
    {
        if arrived + lost.len() > 0 {
            sender.on_acks_and_losses(arrived, lost.len(), now);
        }
        for sending in lost {
            sender.on_fate(sending.number, true, now);
            sender.on_lost(sending.packet, sending.number, now);
            self.bytes -= sending.bytes;
        }
        self.lost += lost.len() as u64;
        lost.len()
    }

    /// Gives up what left `silence` before the receiver was heard last, at `heard_at`, if nothing has arrived
    /// since then either: at the end of a burst nothing later tells what is lost. While nobody is heard, or
    /// what waited on a link is arriving, nothing is given up; where the transport repeats by itself,
    /// arrivals tell nothing of others. How many were given up; [`MediaSender::look`] is to be called after
    /// it.
    pub fn expire<G, S>(
        &mut self,
        sender: &mut MediaSender<G, S>,
        silence: Nanos,
        heard_at: Nanos,
        now: Nanos,
    ) -> usize
    where
        G: Deref<Target = PacketGraph>,
        S: Scheduler,
    {
        let old = self.sendings.partition_point(|sending| self.quiet_since(sending) + silence <= heard_at);
        let lost: Vec<Sending> = self.sendings.drain(..old).collect();
        self.give_up(sender, 0, &lost, now)
    }

    /// When [`Self::expire`] gives something up, if the receiver is heard then and does not name it.
    pub fn expires_at(&self, silence: Nanos) -> Nanos {
        self.sendings.front().map_or(Nanos::MAX, |sending| self.quiet_since(sending) + silence)
    }

    /// Since when silence tells that `sending` is lost.
    fn quiet_since(&self, sending: &Sending) -> Nanos {
        if self.is_repeated { sending.sent_at } else { sending.sent_at.max(self.arrival_at) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        clock::Rate,
        graph::Synthetic,
        policy::PolicyKind,
        session::{PathFacts, SessionConfig},
    };

    #[test]
    fn what_later_arrivals_overtake_is_lost_and_nothing_else() {
        let graph = Synthetic { frames: 60, ..Synthetic::default() }.build(1).unwrap();
        let round_trip = Nanos::from_ms(40);
        let path = PathFacts {
            rate: Rate::from_mbps(50),
            smoothed_rtt: round_trip,
            minimum_rtt: round_trip,
            ..PathFacts::unknown(1200)
        };
        let rules = SessionConfig::default().sending();
        let scheduler = PolicyKind::Layered.build(&graph);
        let mut sender = MediaSender::new(&graph, scheduler, rules, path, Nanos::ZERO);
        let mut out = Outstanding::new();
        let packets: Vec<PacketIndex> = (0..8)
            .map(|ms| {
                let packet = sender.next(Nanos::from_ms(ms)).unwrap();
                out.on_sent(&mut sender, packet, Nanos::from_ms(ms));
                packet
            })
            .collect();
        // Two that left after packet 1 have arrived, and its 45 ms are not over.
        for packet in [0, 2, 3] {
            sender.on_acked(packets[packet]);
        }
        assert_eq!(out.settle(&mut sender, Nanos::from_ms(43)), 0);
        // Time alone shows it.
        assert_eq!(out.next_time(), Nanos::from_ms(46));
        assert_eq!(out.settle(&mut sender, Nanos::from_ms(46)), 1);
        assert_eq!(out.next_time(), Nanos::MAX);
        // Three that were sent later show it at once.
        sender.on_acked(packets[7]);
        assert_eq!(out.settle(&mut sender, Nanos::from_ms(47)), 1);
        assert_eq!([out.take_lost(), out.take_lost()], [2, 0]);
        assert_eq!(out.next_time(), Nanos::from_ms(50));
        // Packets 5 and 6 left 5 and 6 ms after the first; nothing else tells that 6 is lost.
        let bytes = |packet: usize| u64::from(graph.packets()[packets[packet].at()].wire_bytes);
        assert_eq!(out.bytes(), bytes(5) + bytes(6));
        assert_eq!(out.arrived_bytes(), [0, 2, 3, 7].map(bytes).iter().sum::<u64>());
        let silence = Nanos::from_ms(100);
        // Since the last arrival.
        assert_eq!(out.expires_at(silence), Nanos::from_ms(147));
        // Of a receiver that is not heard nothing is known.
        assert_eq!(out.expire(&mut sender, silence, Nanos::from_ms(146), Nanos::from_s(9)), 0);
        assert_eq!(out.expire(&mut sender, silence, Nanos::from_ms(147), Nanos::from_ms(147)), 2);
        assert_eq!((out.take_lost(), out.bytes()), (2, 0));
    }

    #[test]
    fn what_a_transport_repeats_is_given_up_by_its_age_alone() {
        let graph = Synthetic { frames: 60, ..Synthetic::default() }.build(1).unwrap();
        let rules = SessionConfig::default().sending();
        let scheduler = PolicyKind::Layered.build(&graph);
        let path = PathFacts { minimum_rtt: Nanos::from_ms(1), ..PathFacts::unknown(1200) };
        let mut sender = MediaSender::new(&graph, scheduler, rules, path, Nanos::ZERO);
        let mut out = Outstanding::new();
        out.set_repeated();
        let packets = [0, 1, 2].map(|ms| {
            let packet = sender.next(Nanos::from_ms(ms)).unwrap();
            out.on_sent(&mut sender, packet, Nanos::from_ms(ms));
            packet
        });
        sender.on_acked(packets[2]);
        let (silence, later) = (Nanos::from_ms(100), Nanos::from_ms(101));
        assert_eq!(out.settle(&mut sender, Nanos::from_ms(90)), 0);
        assert_eq!(out.expire(&mut sender, silence, later, later), 2);
    }
}
