//! Names the controllers, and builds the one that is named.

use super::{BbrModel, Controller, Cubic, NewReno, Scream};

/// The controllers by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ControllerKind {
    /// [`NewReno`].
    NewReno,
    /// [`Cubic`].
    Cubic,
    /// [`BbrModel`].
    BbrModel,
    /// [`Scream`].
    Scream,
    /// [`BbrModel::paper`]: min(r_cwnd, r̂_path) exactly.
    BbrPaper,
}

impl ControllerKind {
    /// Every controller.
    pub const ALL: [Self; 5] = [Self::NewReno, Self::Cubic, Self::BbrModel, Self::Scream, Self::BbrPaper];

    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::NewReno => "newreno",
            Self::Cubic => "cubic",
            Self::BbrModel => "bbr-model",
            Self::Scream => "scream",
            Self::BbrPaper => "bbr-paper",
        }
    }

    /// A fresh controller for datagrams of up to `datagram_bytes` of UDP payload.
    pub fn build(self, datagram_bytes: u64) -> Box<dyn Controller> {
        match self {
            Self::NewReno => Box::new(NewReno::new(datagram_bytes)),
            Self::Cubic => Box::new(Cubic::new(datagram_bytes)),
            Self::BbrModel => Box::new(BbrModel::new(datagram_bytes)),
            Self::Scream => Box::new(Scream::new(datagram_bytes)),
            Self::BbrPaper => Box::new(BbrModel::paper(datagram_bytes)),
        }
    }
}
