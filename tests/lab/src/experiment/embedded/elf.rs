//! Reads from the sections of a 32-bit ELF file what it puts into flash and RAM.

use anyhow::{Result, ensure};

/// Bytes of allocated sections.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Sizes {
    /// With contents: code, constants, and the first values of variables.
    pub flash: u64,
    /// Writable: variables, zeroed or not.
    pub ram: u64,
}

const ALLOCATED: u32 = 2;
const WRITABLE: u32 = 1;
const NO_CONTENTS: u32 = 8;
const HEADER: usize = 40;

impl Sizes {
    /// Of the little-endian ELF32 file `bytes`.
    pub(super) fn of(bytes: &[u8]) -> Result<Self> {
        ensure!(bytes.starts_with(b"\x7fELF\x01\x01"), "not a little-endian ELF32 file");
        let read = |at: usize, len: usize| -> Result<u32> {
            let field = bytes.get(at..at.saturating_add(len));
            let field = field.ok_or_else(|| anyhow::anyhow!("byte {at} is past the end of the ELF file"))?;
            Ok(field.iter().rev().fold(0, |value, &byte| value << 8 | u32::from(byte)))
        };
        let (table, size, count) = (read(32, 4)? as usize, read(46, 2)? as usize, read(48, 2)?);
        ensure!(size == HEADER, "section headers of {size} bytes; {HEADER} are known");
        let mut sizes = Self::default();
        for section in 0..count as usize {
            let at = table.saturating_add(section * HEADER);
            read(at + HEADER - 4, 4)?;
            let (kind, flags, len) = (read(at + 4, 4)?, read(at + 8, 4)?, u64::from(read(at + 20, 4)?));
            if flags & ALLOCATED == 0 {
                continue;
            }
            sizes.flash += if kind == NO_CONTENTS { 0 } else { len };
            sizes.ram += if flags & WRITABLE == 0 { 0 } else { len };
        }
        Ok(sizes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file of nothing but section headers: kind, flags, bytes.
    fn file(sections: &[(u32, u32, u32)]) -> Vec<u8> {
        let mut bytes = b"\x7fELF\x01\x01".to_vec();
        bytes.resize(52, 0);
        bytes[32..36].copy_from_slice(&52u32.to_le_bytes());
        bytes[46..48].copy_from_slice(&40u16.to_le_bytes());
        bytes[48..50].copy_from_slice(&(sections.len() as u16).to_le_bytes());
        for &(kind, flags, len) in sections {
            let mut header = [0u8; HEADER];
            header[4..8].copy_from_slice(&kind.to_le_bytes());
            header[8..12].copy_from_slice(&flags.to_le_bytes());
            header[20..24].copy_from_slice(&len.to_le_bytes());
            bytes.extend_from_slice(&header);
        }
        bytes
    }

    #[test]
    fn code_and_constants_are_flash_zeroes_are_ram_variables_are_both() {
        // Null, text, data, bss, debug.
        let bytes = file(&[(0, 0, 0), (1, 6, 100), (1, 3, 20), (8, 3, 7), (1, 0, 1000)]);
        assert_eq!(Sizes::of(&bytes).unwrap(), Sizes { flash: 120, ram: 27 });
    }

    #[test]
    fn what_is_cut_or_something_else_is_refused() {
        let bytes = file(&[(1, 6, 100)]);
        for end in [0, 5, 40, bytes.len() - 1] {
            assert!(Sizes::of(&bytes[..end]).is_err(), "{end}");
        }
        let mut wide = bytes;
        wide[4] = 2;
        assert!(Sizes::of(&wide).is_err());
    }
}
