//! Decodes the triangle mode and the index mode: numbers of vertices, by what was seen last.

use super::source::{Fault, Source};

/// First byte of a stream of triangles, and of one of indices.
const TRIANGLES: u8 = 0xe1;
const INDICES: u8 = 0xd1;
/// Bytes of the table at the end of a stream of triangles.
const TABLE: usize = 16;
/// Bytes of padding at the end of a stream of indices.
const PADDING: usize = 4;

/// The last sixteen of something, the newest first.
struct Recent<T>([Option<T>; 16]);

impl<T: Copy> Recent<T> {
    fn push(&mut self, value: T) {
        self.0.rotate_right(1);
        self.0[0] = Some(value);
    }

    fn get(&self, place: u8) -> Result<T, Fault> {
        self.0[usize::from(place & 15)]
            .ok_or_else(|| Fault::new("triangles", "a corner or side not seen before", "one that was"))
    }
}

/// What a decoder of triangles remembers.
struct Triangles<'a> {
    source: Source<'a>,
    /// The next vertex that was never seen.
    next: u32,
    /// The vertex that was last given by its number.
    last: u32,
    sides: Recent<[u32; 2]>,
    corners: Recent<u32>,
}

/// The vertices of `count / 3` triangles.
pub fn triangles(bytes: &[u8], count: usize) -> Result<Vec<u32>, Fault> {
    let mut source = start(bytes, TRIANGLES, "0xe1")?;
    let codes = source.take(count / 3)?;
    let data = source.0.len().checked_sub(TABLE);
    let data = data.ok_or_else(|| Fault::new("content", "no room for its table", "16 bytes at its end"))?;
    let (data, table) = source.0.split_at(data);
    if table[14..] != [0; 2] || table.iter().any(|entry| entry >> 4 == 15 || entry & 15 == 15) {
        return Err(Fault::new("table", "an entry of 15", "entries below it, the last two 0"));
    }
    let (sides, corners) = (Recent([None; 16]), Recent([None; 16]));
    let mut decoder = Triangles { source: Source(data), next: 0, last: 0, sides, corners };
    let mut out = Vec::with_capacity(3 * codes.len());
    for &code in codes {
        out.extend(decoder.triangle(code, table)?);
    }
    decoder.source.end()?;
    Ok(out)
}

impl Triangles<'_> {
    fn triangle(&mut self, code: u8, table: &[u8]) -> Result<[u32; 3], Fault> {
        let (side, corner) = (code >> 4, code & 15);
        if side < 15 {
            return self.beside(side, corner);
        }
        if corner < 14 {
            let entry = table[usize::from(corner)];
            let a = self.fresh();
            return self.apart(a, entry);
        }
        let entry = self.source.byte()?;
        if entry == 0 {
            self.next = 0;
        }
        let a = if corner == 14 { self.fresh() } else { self.numbered()? };
        self.apart(a, entry)
    }

    /// A triangle on a side of an earlier one.
    fn beside(&mut self, side: u8, corner: u8) -> Result<[u32; 3], Fault> {
        let [a, b] = self.sides.get(side)?;
        let c = match corner {
            0 => self.fresh(),
            1..13 => self.corners.get(corner)?,
            13 | 14 => {
                let step = if corner == 13 { u32::MAX } else { 1 };
                self.last = self.last.wrapping_add(step);
                self.last
            }
            _ => self.numbered()?,
        };
        self.sides.push([c, b]);
        self.sides.push([a, c]);
        if corner == 0 || corner >= 13 {
            self.corners.push(c);
        }
        Ok([a, b, c])
    }

    /// A triangle with a first corner of its own; `entry` says what the other two are.
    fn apart(&mut self, a: u32, entry: u8) -> Result<[u32; 3], Fault> {
        let (of_b, of_c) = (entry >> 4, entry & 15);
        let b = self.other(of_b)?;
        let c = self.other(of_c)?;
        self.sides.push([b, a]);
        self.sides.push([c, b]);
        self.sides.push([a, c]);
        self.corners.push(a);
        for (corner, kind) in [(b, of_b), (c, of_c)] {
            if kind == 0 || kind == 15 {
                self.corners.push(corner);
            }
        }
        Ok([a, b, c])
    }

    fn other(&mut self, kind: u8) -> Result<u32, Fault> {
        match kind {
            0 => Ok(self.fresh()),
            15 => self.numbered(),
            place => self.corners.get(place - 1),
        }
    }

    fn fresh(&mut self) -> u32 {
        let vertex = self.next;
        self.next = vertex.wrapping_add(1);
        vertex
    }

    fn numbered(&mut self) -> Result<u32, Fault> {
        let coded = self.source.varint()?;
        self.last = self.last.wrapping_add(coded >> 1 ^ (coded & 1).wrapping_neg());
        Ok(self.last)
    }
}

/// `count` indices, each near one of two earlier ones.
pub fn indices(bytes: &[u8], count: usize) -> Result<Vec<u32>, Fault> {
    let source = start(bytes, INDICES, "0xd1")?;
    let content = source.0.len().checked_sub(PADDING);
    let content = content.ok_or_else(|| Fault::new("content", "no padding", "4 bytes at its end"))?;
    let mut source = Source(&source.0[..content]);
    let mut last = [0u32; 2];
    let mut out = Vec::new();
    for _ in 0..count {
        let coded = source.varint()?;
        let near = &mut last[(coded & 1) as usize];
        let coded = coded >> 1;
        *near = near.wrapping_add(coded >> 1 ^ (coded & 1).wrapping_neg());
        out.push(*near);
    }
    source.end()?;
    Ok(out)
}

fn start<'a>(bytes: &'a [u8], first: u8, allowed: &str) -> Result<Source<'a>, Fault> {
    let mut source = Source(bytes);
    match source.byte()? {
        byte if byte == first => Ok(source),
        other => Err(Fault::new("first byte", format_args!("{other:#04x}"), allowed)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_follow_one_of_two() {
        // +5 and +100 from the two, then -1 and +1.
        let bytes = [INDICES, 5 << 2, 0x91, 0x03, 2, 1 << 2 | 1, 0, 0, 0, 0];
        assert_eq!(indices(&bytes, 4).unwrap(), [5, 100, 4, 101]);
        assert!(indices(&bytes, 3).unwrap_err().found.contains("too many"));
        assert!(indices(&bytes, 5).is_err());
        assert!(indices(&[INDICES, 0xff, 0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0, 0], 1).is_err());
    }

    #[test]
    fn triangles_of_what_was_never_seen_are_refused() {
        let with = |code: u8, data: &[u8]| [&[TRIANGLES, code][..], data, &[0; TABLE]].concat();
        assert_eq!(triangles(&with(0xf0, &[]), 3).unwrap(), [0, 1, 2]);
        assert_eq!(triangles(&with(0xff, &[0xff, 10, 1, 2]), 3).unwrap(), [5, 4, 5]);
        assert_eq!(triangles(&with(0x00, &[]), 3).unwrap_err().field, "triangles");
        assert_eq!(triangles(&with(0xfe, &[0x10]), 3).unwrap_err().field, "triangles");
        assert!(triangles(&with(0xf0, &[7]), 3).unwrap_err().found.contains("too many"));
        let mut bytes = with(0xf0, &[]);
        bytes[4] = 0xf0;
        assert_eq!(triangles(&bytes, 3).unwrap_err().field, "table");
    }
}
