//! Opens what a player is made of to the encoder, the fuzzers and tests; it makes no promise of
//! stability.
//!
//! | module | what it knows |
//! | --- | --- |
//! | [`wire`] | DGSM manifest, DGSP packets, DGSF receipts, `.dgs` files, CRC: every field, limit and error |
//! | [`rans`] | entropy coding: four lanes per packet, tables named by a byte, the bytewise form of `paper` |
//! | [`arena`] | how one block of memory is divided |
//! | [`receiver`] | packets in, state out |
//! | [`repair`] | lost packets from parity: XOR and a GF(256) Cauchy code |
//! | [`closure`], [`layout`], [`quant`] | which levels count, where symbols lie, what they are worth |
//! | [`decode`] | a state and a frame in, Gaussians out, the same bits on every target |

pub mod arena;
pub mod closure;
pub mod cursor;
pub mod decode;
pub mod digest;
pub mod error;
pub mod footprint;
pub mod gaussian;
pub mod ids;
pub mod layout;
pub mod limits;
pub mod math;
pub mod pack;
pub mod quant;
pub mod rans;
pub mod receiver;
pub mod repair;
pub mod up;
pub mod wire {
    //! Everything that travels, byte by byte.
    pub mod bits;
    pub mod checked;
    pub mod crc;
    pub mod file;
    pub mod manifest;
    pub mod packet;
    pub mod receipt;
}
