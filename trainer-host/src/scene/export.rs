//! Writes frames in formats that others read: bytes out, no file access.
//!
//! A frame is written from its [`Attributes`](crate::scene::Attributes), not from a rendered instant,
//! so logs and logits survive without a detour through `exp` and `ln`.

pub mod ply;
pub mod spz;
