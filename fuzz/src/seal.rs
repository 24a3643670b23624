//! What a liar makes fit: CRCs over bytes that were changed, so that what lies behind them is reached.

use codec_core::internals::wire::{crc::crc32, file as dgs};

/// `content` with a CRC that fits.
pub fn with_crc(content: &[u8]) -> Vec<u8> {
    [content, &crc32(content).to_le_bytes()].concat()
}

/// Makes the last four bytes of `sealed` the CRC of those before; nothing if it is shorter.
fn seal(sealed: &mut [u8]) {
    if let Some((content, crc)) = sealed.split_last_chunk_mut::<4>() {
        *crc = crc32(content).to_le_bytes();
    }
}

fn word(bytes: &[u8], at: usize) -> Option<usize> {
    let bytes = bytes.get(at..)?.first_chunk::<4>()?;
    Some(u32::from_le_bytes(*bytes) as usize)
}

fn short(bytes: &[u8], at: usize) -> Option<usize> {
    let bytes = bytes.get(at..)?.first_chunk::<2>()?;
    Some(usize::from(u16::from_le_bytes(*bytes)))
}

/// A `.dgs` file whose manifest, index and packets up to the first length that cannot be all fit.
pub fn dgs_file(bytes: &[u8]) -> Vec<u8> {
    let mut file = bytes.to_vec();
    if !file.starts_with(&dgs::MAGIC) {
        return file;
    }
    let Some(message) = word(&file, 4) else { return file };
    let mut at = message.saturating_add(8);
    if let Some(message) = file.get_mut(8..at) {
        seal(message);
    }
    while let Some(len) = short(&file, at).filter(|&len| len > 0) {
        let Some(packet) = file.get_mut(at + 2..at + 2 + len) else { break };
        seal(packet);
        at += 2 + len;
    }
    if let Some(place) = word(&file, file.len().saturating_sub(4)).and_then(|len| file.len().checked_sub(len))
        && let Some(end) = file.len().checked_sub(4)
        && let Some(index) = file.get_mut(place..end)
    {
        seal(index);
    }
    file
}

/// A zip archive in which the CRC of every stored member fits. What is deflated stays as it is.
pub fn zip(bytes: &[u8]) -> Vec<u8> {
    const CENTRAL: [u8; 4] = *b"PK\x01\x02";
    let mut archive = bytes.to_vec();
    let records: Vec<usize> = (0..bytes.len()).filter(|&at| bytes[at..].starts_with(&CENTRAL)).collect();
    for record in records {
        let member = || -> Option<(usize, u32)> {
            let stored = short(&archive, record + 10)? == 0;
            let (len, local) = (word(&archive, record + 20)?, word(&archive, record + 42)?);
            let names = short(&archive, local.checked_add(26)?)? + short(&archive, local.checked_add(28)?)?;
            let data = archive.get(local + 30 + names..)?.get(..len).filter(|_| stored)?;
            Some((local, crc32(data)))
        };
        let Some((local, crc)) = member() else { continue };
        for at in [record + 16, local + 14] {
            if let Some(place) = archive.get_mut(at..at + 4) {
                place.copy_from_slice(&crc.to_le_bytes());
            }
        }
    }
    archive
}

/// `content` as a gzip stream of stored blocks.
pub fn gzip(content: &[u8]) -> Vec<u8> {
    let mut out = vec![0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 255];
    let mut blocks = content.chunks(0xffff).peekable();
    while let Some(block) = blocks.next() {
        out.push(u8::from(blocks.peek().is_none()));
        out.extend((block.len() as u16).to_le_bytes());
        out.extend((!(block.len() as u16)).to_le_bytes());
        out.extend_from_slice(block);
    }
    out.extend(crc32(content).to_le_bytes());
    out.extend((content.len() as u32).to_le_bytes());
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::streams::fixture;
    use trainer_host::{import, stream::Stream};

    /// Flips a bit of every region of a file: unsealed, the walk stumbles; sealed, only over lies.
    #[test]
    fn a_changed_file_fits_again() {
        let stream = fixture(true);
        let file = stream.to_bytes().unwrap_or_default();
        assert_eq!(dgs_file(&file), file, "what fits stays as it is");
        // A payload byte of the first packet, and the count in the index.
        for at in [8 + stream.message().len() + 2 + 60, file.len() - 8 - 4 * stream.packets().len() - 4] {
            let mut changed = file.clone();
            changed[at] ^= 0x10;
            let damaged = |bytes: &[u8]| Stream::from_bytes(bytes).map(|(_, damage)| damage);
            let before = damaged(&changed).unwrap_or_default();
            assert!(!before.ranges.is_empty() || before.index.is_some(), "{before:?}");
            let after = damaged(&dgs_file(&changed)).unwrap_or_default();
            assert!(after.ranges.is_empty(), "{after:?}");
            assert!(after.index.is_none_or(|e| e.field != "file.index_crc"), "{after:?}");
        }
    }

    #[test]
    fn a_changed_archive_fits_again() {
        let archive = include_bytes!("../corpus/points_npz/four");
        let parse = |bytes: &[u8]| import::points_npz::parse(bytes, 30.0, &import::Limits::default());
        assert_eq!(zip(archive), archive, "what fits stays as it is");
        let at = archive.windows(6).position(|w| w == [255, 0, 128, 0, 0, 0]).unwrap_or(0);
        let mut changed = archive.to_vec();
        changed[at] = 77;
        assert!(parse(&changed).is_err());
        assert!(parse(&zip(&changed)).is_ok());
    }

    #[test]
    fn a_gzip_stream_of_stored_blocks_is_read() {
        let planes = [&b"NGSP\x02\0\0\0\x01\0\0\0\0\x0c\0\0"[..], &[9; 19]].concat();
        let parse = |bytes: &[u8]| import::spz::parse(bytes, &import::Limits::default());
        assert!(parse(&gzip(&planes)).is_ok());
        let mut damaged = gzip(&planes);
        damaged[40] ^= 1;
        assert!(parse(&damaged).is_err(), "the CRC is looked at");
    }
}
