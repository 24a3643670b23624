//! Writes pictures of render-host as AV1 in MP4 or WebM, without any tool.
//!
#![doc = include_str!("../README.md")]

mod encoder;
mod error;
mod mp4;
mod obu;
mod planes;
mod rate;
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod tests;
mod track;
mod video;
mod webm;

pub use self::{
    error::VideoError,
    video::{Container, Video},
};
