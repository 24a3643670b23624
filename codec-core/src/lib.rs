//! codec-core
#![no_std]
#![forbid(unsafe_code)]
pub mod closure;
pub mod decode;
pub mod digest;
pub mod error;
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
pub mod wire {
    //! wire
    pub mod bits;
    pub mod crc;
    pub mod cursor;
    pub mod file;
    pub mod manifest;
    pub mod packet;
    pub mod receipt;
}
pub use error::{Error, ErrorKind, Result};
pub use gaussian::Gaussian;
