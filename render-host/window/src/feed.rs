//! A feed brings a stream to the window from another thread, and takes back what the window asks for.

use std::{
    ops::Range,
    sync::mpsc::{Receiver, Sender, SyncSender, TryRecvError, channel, sync_channel},
};

use codec_core::internals::wire::receipt::ViewerPose;
use dgs_viewer::Conditions;

/// Arrivals that wait for the window: beyond that the feeder waits, or loses packets.
const WAITING: usize = 4096;

/// What has arrived.
#[derive(Debug)]
pub enum Arrival {
    /// A whole `.dgs` file.
    File(Vec<u8>),
    /// The first bytes of a `.dgs` file of `length` bytes, with its manifest.
    Front {
        /// The bytes.
        bytes: Vec<u8>,
        /// Of the whole file.
        length: u64,
    },
    /// Bytes of that file from offset `at` on.
    Piece {
        /// Where they lie.
        at: u64,
        /// The bytes.
        bytes: Vec<u8>,
    },
    /// The DGSM message of a stream that a server sends.
    Manifest(Vec<u8>),
    /// A packet of it.
    Packet(Vec<u8>),
    /// The stream grows, and playout of it goes on from this time, seconds: from what there is of it now.
    Begin(f64),
    /// What the server makes of the network that was asked for.
    Network {
        /// Whether it emulates it. If not, the window does.
        by_server: bool,
        /// Whether it chooses packets as was asked for.
        by_scheduler: bool,
    },
    /// The server begins as if nothing had come.
    Anew,
    /// Nothing more comes, and why, if that is not as it should be.
    End(Option<String>),
}

/// What the window asks for.
#[derive(Clone, Debug, PartialEq)]
pub enum FeedRequest {
    /// These bytes of the file.
    Bytes(Range<u64>),
    /// The file as a whole.
    Whole,
    /// The stream from this time on, seconds.
    From(f64),
    /// The stream through another network, from the time of a [`FeedRequest::From`] on.
    Network {
        /// The conditions of it; `None` leaves them as they are.
        conditions: Option<Conditions>,
        /// How packets are chosen for it, as `dgs serve --policy` names it; `None` is the server's own way.
        scheduler: Option<&'static str>,
    },
    /// First of all what is seen from here.
    Sight(ViewerPose),
}

/// The window's end.
#[derive(Debug)]
pub struct Feed {
    arrivals: Receiver<Arrival>,
    requests: Sender<FeedRequest>,
    open: bool,
}

/// The other end.
#[derive(Debug)]
pub struct Feeder {
    /// Takes what has arrived.
    pub arrivals: SyncSender<Arrival>,
    /// Gives what is asked for; it ends when the window has.
    pub requests: Receiver<FeedRequest>,
}

/// Both ends of a feed.
pub fn feed() -> (Feeder, Feed) {
    let (arrived, arrivals) = sync_channel(WAITING);
    let (requested, requests) = channel();
    (Feeder { arrivals: arrived, requests }, Feed { arrivals, requests: requested, open: true })
}

impl Feed {
    /// A feed of one whole `.dgs` file.
    pub fn file(bytes: Vec<u8>) -> Self {
        let (feeder, feed) = feed();
        // There is room for the first.
        let _ = feeder.arrivals.try_send(Arrival::File(bytes));
        feed
    }

    /// What has arrived next; `None` where nothing waits.
    pub(crate) fn next(&mut self) -> Option<Arrival> {
        match self.arrivals.try_recv() {
            Ok(Arrival::End(why)) => {
                self.open = false;
                Some(Arrival::End(why))
            }
            Ok(arrival) => Some(arrival),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                self.open = false;
                None
            }
        }
    }

    /// Whether more may arrive.
    pub(crate) fn is_open(&self) -> bool {
        self.open
    }

    /// Says what is asked for; a feeder that is gone misses nothing.
    pub(crate) fn request(&self, request: FeedRequest) {
        let _ = self.requests.send(request);
    }
}
