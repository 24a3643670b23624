//! Range asymmetric numeral systems (rANS), in the two forms of the two profiles.
//!
//! A stack, not a queue: the encoder walks the symbols backwards and the decoder forwards, so
//! that decoding starts at the first byte of a packet. All tables are known before the first
//! packet; a packet carries none.
//!
//! - [`lanes`]: profile `dgs1`. Four interleaved 32-bit states, 16-bit renormalisation words,
//!   11-bit probabilities, tokens with an escape and raw low bits, so that every i16 can be coded.
//! - [`bytes`]: profile `paper`. One 32-bit state, bytewise renormalisation, 12-bit
//!   probabilities, an i16 as its low and high byte, each with its own table.
//! - `context`: profile `paper-context`. Binary decisions on the same state, whose probabilities follow
//!   the packet's own symbols.
//! - [`family`]: tables that one byte names.
//! - [`table`]: frequency tables, normalisation, decode slots.
//! - [`form`]: decode tables in the caller's memory, fast or small.

pub mod bytes;
#[cfg(feature = "paper-context")]
pub mod context;
pub mod family;
pub mod form;
pub mod lanes;
mod scale;
pub mod table;
