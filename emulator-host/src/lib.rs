//! `emulator-host` knows **time**: a discrete-event network emulator, congestion control, delivery schedulers
//! and delivery metrics, all in virtual time.
//!
//! The walk of a run, which is also the order of the modules:
//!
//! ```text
//! graph ─▶ policy ─▶ congestion ─▶ link (trace) ─▶ receiver (repair) ─▶ report
//!            ▲                                          │
//!            └───────────── link (uplink) ◀── receipts ─┘          session owns the loop
//! ```
//!
//! Promises:
//! - **Time and chance are arguments.** `now` is a [`Nanos`] that the caller passes; every random draw comes
//!   from a stream keyed by a seed and the label of its owner ([`rng::stream`]).
//! - **The event path is integers**: nanoseconds, bytes, bits per second. Floating point appears in scheduler
//!   scores and in metrics only, built from `+ − × ÷ √`, so one seed gives one [`Report::digest`] everywhere.
//! - Ties break by (time, sequence); nothing walks a hash map.
//!
//! Deliberately absent: handshakes, encryption, real sockets, pixels and the bytes of packets. A packet is an
//! index here; an [`Endpoint`] may own the bytes.
//!
//! ```
//! use emulator_host::{SessionConfig, graph::Synthetic, simulate};
//!
//! let graph = Synthetic { frames: 60, ..Synthetic::default() }.build(1)?;
//! let report = simulate(&graph, &SessionConfig::default())?;
//! assert_eq!(report.frames.len(), 60);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod bound;
pub mod clock;
pub mod congestion;
mod event;
pub mod graph;
pub mod link;
pub mod policy;
pub mod receiver;
mod repair;
pub mod report;
pub mod rng;
pub mod session;
mod startup;
pub mod sweep;
pub mod trace;
mod viewpoint;

pub use clock::{Bytes, Nanos, Rate};
pub use congestion::{Controller, ControllerKind};
pub use graph::{GroupIndex, PacketGraph, PacketIndex};
pub use policy::{PolicyKind, Scheduler, SenderView};
pub use receiver::{Endpoint, GraphReceiver, Snapshot};
pub use report::Report;
pub use session::{SessionConfig, SessionError, run, simulate};
pub use trace::Trace;
pub use viewpoint::Viewpoint;
