//! The stream that is baked in, and what the host makes of it.

include!(concat!(env!("DGS_FIXTURE"), "/fixture.rs"));

/// The DGSM message.
pub static MESSAGE: &[u8] = include_bytes!(concat!(env!("DGS_FIXTURE"), "/manifest.dgsm"));

/// Packets in order of arrival: length (u16, little-endian), bytes.
pub static ARRIVALS: &[u8] = include_bytes!(concat!(env!("DGS_FIXTURE"), "/packets.bin"));

/// A lane body with its table, and the digest of its symbols.
pub struct Law {
    /// The table as in a manifest.
    pub table: &'static [u8],
    /// The body.
    pub body: &'static [u8],
    /// Digest of the symbols, little-endian.
    pub digest: &'static [u8],
}

macro_rules! law {
    ($n:literal) => {
        Law {
            table: include_bytes!(concat!(env!("DGS_FIXTURE"), "/law-", $n, ".table")),
            body: include_bytes!(concat!(env!("DGS_FIXTURE"), "/law-", $n, ".body")),
            digest: include_bytes!(concat!(env!("DGS_FIXTURE"), "/law-", $n, ".digest")),
        }
    };
}

/// One per entry of [`LAWS`].
pub static BODIES: [Law; 3] = [law!(0), law!(1), law!(2)];

/// The packets, one after the other.
pub fn packets(mut rest: &'static [u8]) -> impl Iterator<Item = &'static [u8]> {
    core::iter::from_fn(move || {
        let (len, tail) = rest.split_first_chunk::<2>()?;
        let (packet, tail) = tail.split_at_checked(usize::from(u16::from_le_bytes(*len)))?;
        rest = tail;
        Some(packet)
    })
}
