//! DGSM, the control manifest, holds everything a receiver must know before the first packet means
//! anything.
//!
//! On the wire: `"DGSM"`, version, three zero bytes, raw length, packed length, the packed body,
//! CRC-32. The unpacked body is fixed-width records in sections, so that a view can answer any
//! question by index, without a heap. [`Manifest::parse`] walks it once and checks every number
//! and every cross-reference; after that an accessor gives `None` for what the stream has not.
//!
//! `SPEC.md` gives every byte.

mod check;
mod profile;
mod proxy;
mod record;
mod seal;
mod sections;
pub mod stream;
mod table_set;
mod view;

pub use profile::{ChunkCoder, PAPER_CONTEXT, Profile};
pub use proxy::Proxy;
pub use record::{Cluster, Epoch, Head, Motion, Quant, Repair, Track, Window, block_len};
pub use seal::{HEADER_BYTES, MAGIC, ManifestHead, VERSION, open, seal};
pub use table_set::{MAX_TABLE_SET_BITS, TableSet};
pub use view::Manifest;
pub(crate) use view::Outline;
