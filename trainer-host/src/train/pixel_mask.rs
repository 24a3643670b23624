//! A pixel mask says something of each pixel of a photograph.

/// Yes or no for each pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PixelMask {
    width: u32,
    height: u32,
    /// Exactly `width * height`, row by row: 255 for yes, 0 for no.
    values: Vec<u8>,
}

impl PixelMask {
    /// A mask of `width` x `height` pixels: yes where a value, row by row, is not 0. None where there is
    /// another number of values.
    pub fn new(width: u32, height: u32, mut values: Vec<u8>) -> Option<Self> {
        values.iter_mut().for_each(|value| *value = if *value > 0 { 255 } else { 0 });
        (values.len() == width as usize * height as usize).then_some(Self { width, height, values })
    }

    /// Width and height, pixels.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// 255 for yes and 0 for no, row by row.
    pub fn values(&self) -> &[u8] {
        &self.values
    }

    /// What is said of a pixel; no outside.
    pub fn at(&self, x: u32, y: u32) -> bool {
        let at = y as usize * self.width as usize + x as usize;
        x < self.width && self.values.get(at).is_some_and(|&value| value > 0)
    }

    /// The mask of a photograph `by` times smaller, at least 1: yes where all pixels that it covers say yes.
    #[must_use]
    pub(crate) fn reduced(&self, by: u32) -> Self {
        self.where_many(by, by * by)
    }

    /// The same: yes where at least half of the pixels that it covers say yes.
    #[must_use]
    pub(super) fn mostly(&self, by: u32) -> Self {
        self.where_many(by, (by * by).div_ceil(2))
    }

    /// The mask of a photograph `by` times smaller: yes where so many pixels that it covers say yes.
    fn where_many(&self, by: u32, needed: u32) -> Self {
        let (width, height) = (self.width / by, self.height / by);
        let mut counts = vec![0; width as usize];
        let mut values = Vec::with_capacity(width as usize * height as usize);
        let row = self.width.max(1) as usize;
        for rows in self.values.chunks_exact(row * by as usize) {
            counts.fill(0);
            for row in rows.chunks_exact(row) {
                for (count, pixels) in counts.iter_mut().zip(row.chunks_exact(by as usize)) {
                    *count += pixels.iter().map(|&value| u32::from(value > 0)).sum::<u32>();
                }
            }
            values.extend(counts.iter().map(|&count| if count >= needed { 255 } else { 0 }));
        }
        Self { width, height, values }
    }

    /// Its first `width` columns and `height` rows, where it has them.
    #[must_use]
    pub(super) fn cut(&self, width: u32, height: u32) -> Self {
        let (width, height) = (width.min(self.width), height.min(self.height));
        let rows = self.values.chunks_exact(self.width.max(1) as usize).take(height as usize);
        let values = rows.flat_map(|row| &row[..width as usize]).copied().collect();
        Self { width, height, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_is_reduced_and_cut_with_its_photograph() {
        let mask = PixelMask::new(4, 2, vec![1, 255, 0, 1, 1, 1, 1, 1]).unwrap();
        assert_eq!(PixelMask::new(4, 2, vec![0; 7]), None);
        assert!(mask.at(3, 0) && !mask.at(2, 0) && !mask.at(4, 0) && !mask.at(0, 2));
        assert_eq!(mask.reduced(2).values(), [255, 0], "one of four pixels says no");
        assert_eq!(mask.mostly(2).values(), [255, 255]);
        assert_eq!((mask.reduced(3).size(), mask.reduced(3).values().len()), ((1, 0), 0));
        assert_eq!((mask.cut(3, 1).size(), mask.cut(3, 1).values()), ((3, 1), &[255, 255, 0][..]));
    }
}
