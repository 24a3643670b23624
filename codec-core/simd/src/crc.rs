//! The host's CRC: carry-less multiplication where the machine has it.

/// CRC-32/ISO-HDLC of `bytes`, the same value as [`codec_core::internals::wire::crc::crc32`]: a
/// [`Crc32`](codec_core::internals::wire::crc::Crc32) for receivers on hosts.
pub fn crc32(bytes: &[u8]) -> u32 {
    crc32fast::hash(bytes)
}

#[cfg(test)]
mod tests {
    #[test]
    fn both_implementations_agree() {
        let bytes: Vec<u8> = (0..3000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
        for len in (0..300).chain([1150, 1280, 3000]) {
            for start in [0, 1, 7] {
                let part = &bytes[start.min(len)..len];
                assert_eq!(
                    super::crc32(part),
                    codec_core::internals::wire::crc::crc32(part),
                    "{start}..{len}"
                );
            }
        }
    }
}
