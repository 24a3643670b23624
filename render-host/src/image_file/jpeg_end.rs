//! Whether a JPEG file goes on to the end of its picture: the decoder shows grey where it was cut off.

/// Marker of the end of a picture.
const END: u8 = 0xd9;

/// Refuses the JPEG file `bytes` where its segments and scans do not lead to the end of a picture, as in a
/// file that was cut off. What comes after that end, as a second picture may, is not looked at.
pub(super) fn check(bytes: &[u8]) -> Result<(), String> {
    let mut rest = bytes;
    while let Some((marker, after)) = next_marker(rest) {
        rest = match marker {
            END => return Ok(()),
            // Start of a picture, restarts within a scan, and a marker for private use have no length.
            0x01 | 0xd0..=0xd8 => after,
            // A picture within a segment, as a small one is for a preview, has an end of its own.
            _ => {
                let length = after.first_chunk().map_or(0, |length| u16::from_be_bytes(*length));
                after.get(usize::from(length)..).unwrap_or_default()
            }
        };
    }
    Err(format!("cut off: {} bytes without the end of the picture (ff d9)", bytes.len()))
}

/// The next marker in `bytes`, and what follows it. In data of a scan a 0 follows each byte of ff; before a
/// marker may be any number of them.
fn next_marker(bytes: &[u8]) -> Option<(u8, &[u8])> {
    let mut rest = bytes;
    loop {
        let at = rest.iter().position(|&byte| byte == 0xff)?;
        rest = rest.get(at + 1..)?;
        match rest.split_first()? {
            (0x00 | 0xff, _) => {}
            (&marker, after) => return Some((marker, after)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{
        super::{Bounds, Rgba8, jpeg_of_rgb8},
        *,
    };

    const BOUNDS: Bounds = Bounds { side: 64, bytes: 1 << 20, flat_bytes: 1 << 20 };

    /// Noise, which has all bytes in its data.
    fn file() -> Vec<u8> {
        let mut state = 7u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        let rgb: Vec<u8> = (0..3 * 40 * 24).map(|_| next()).collect();
        jpeg_of_rgb8(40, 24, &rgb, 100).unwrap()
    }

    #[test]
    fn files_that_are_cut_off_are_refused_wherever_they_end() {
        let file = file();
        assert!(file.windows(2).any(|pair| pair == [0xff, 0x00]));
        let whole = Rgba8::decode(&file, BOUNDS).unwrap();
        for end in 2..file.len() {
            assert!(Rgba8::decode(&file[..end], BOUNDS).is_err(), "{end} of {} bytes", file.len());
        }
        let said = Rgba8::decode(&file[..file.len() - 1], BOUNDS).unwrap_err().to_string();
        let named = format!("cut off: {} bytes without the end of the picture", file.len() - 1);
        assert!(said.contains(&named), "{said}");
        // Bytes after the end are a matter of others.
        let longer = [&file[..], &[0, 7, 0xff]].concat();
        assert_eq!(Rgba8::decode(&longer, BOUNDS), Ok(whole));
    }

    #[test]
    fn the_end_of_a_preview_is_not_that_of_the_picture() {
        let file = file();
        let segment = [0xffu8, 0xe1, 0, 8, 0xff, 0xd8, 0xff, 0xd8, 0xff, 0xd9];
        let with_preview = [&file[..2], &segment, &file[2..]].concat();
        assert_eq!(check(&with_preview), Ok(()));
        assert!(Rgba8::decode(&with_preview, BOUNDS).is_ok());
        for end in [12, 200, with_preview.len() - 2] {
            assert!(check(&with_preview[..end]).is_err(), "{end}");
        }
        assert!(check(&[]).is_err() && check(&[0xff; 9]).is_err());
    }

    /// A restart within a scan is not its end, and segments come between scans.
    #[test]
    fn scans_go_on_after_restarts() {
        let scan = [0xffu8, 0xda, 0, 2, 1, 2, 0xff, 0xd0, 3, 0xff, 0x00, 0xd9];
        let bytes = [&[0xff, 0xd8][..], &scan, &[0xff, 0xc4, 0, 3, 9], &scan, &[0xff, 0xff, 0xd9]].concat();
        assert_eq!(check(&bytes), Ok(()));
        for end in 0..bytes.len() {
            assert!(check(&bytes[..end]).is_err(), "{end}");
        }
    }
}
