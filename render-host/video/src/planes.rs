//! Planes of luma and chroma are what video is coded from: 4:2:0, 8 bits, BT.709 in limited range.
//!
//! A chroma sample lies on the left of its two columns and between its two rows, where players take it to be.

use render_host::Image;

/// Weights of red, green and blue in luma, in 65536ths: 219 of 255 steps.
const LUMA: [i32; 3] = [11_966, 40_254, 4064];
/// In the blue difference: 224 steps; their sum is 0, so that grey has no colour.
const BLUE_DIFFERENCE: [i32; 3] = [-6596, -22_189, 28_785];
/// In the red difference.
const RED_DIFFERENCE: [i32; 3] = [28_784, -26_145, -2639];

/// A picture as video is coded from it. Sides are even: odd ones get their last row or column twice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Planes {
    /// Width and height of luma; chroma has half of each.
    pub size: (usize, usize),
    /// Luma, 16 to 235.
    pub luma: Vec<u8>,
    /// Blue difference, 16 to 240.
    pub blue: Vec<u8>,
    /// Red difference.
    pub red: Vec<u8>,
}

/// The even sides of a video of pictures of `size`.
pub fn even(size: (u32, u32)) -> (usize, usize) {
    (size.0.next_multiple_of(2) as usize, size.1.next_multiple_of(2) as usize)
}

impl Planes {
    /// Those of `picture`, whose values are clamped to 0..=1.
    pub fn of(picture: &Image) -> Self {
        let (width, height) = (picture.size().0 as usize, picture.size().1 as usize);
        let size = even(picture.size());
        let rgb = picture.to_rgb8();
        let row = |y: usize| &rgb[3 * width * y.min(height - 1)..][..3 * width];
        let mut planes = Self {
            size,
            luma: Vec::with_capacity(size.0 * size.1),
            blue: Vec::with_capacity(size.0 * size.1 / 4),
            red: Vec::with_capacity(size.0 * size.1 / 4),
        };
        for y in (0..size.1).step_by(2) {
            let (upper, lower) = (row(y), row(y + 1));
            planes.add_luma(upper);
            planes.add_luma(lower);
            planes.add_chroma(upper, lower);
        }
        planes
    }

    fn add_luma(&mut self, row: &[u8]) {
        let values = row.as_chunks::<3>().0.iter().map(|&pixel| luma(pixel.map(i32::from)));
        self.luma.extend(values);
        if !row.len().is_multiple_of(2) {
            self.luma.extend(self.luma.last().copied());
        }
    }

    /// Adds the chroma of two rows: the two columns beside a sample weigh half as much as its own.
    fn add_chroma(&mut self, upper: &[u8], lower: &[u8]) {
        let (upper, lower) = (upper.as_chunks::<3>().0, lower.as_chunks::<3>().0);
        let last = upper.len() - 1;
        let column = |x: usize| [0, 1, 2].map(|c| i32::from(upper[x][c]) + i32::from(lower[x][c]));
        for x in (0..self.size.0).step_by(2) {
            let (left, own, right) = (column(x.saturating_sub(1)), column(x), column((x + 1).min(last)));
            // Eight values of 8 bits.
            let sum = [0, 1, 2].map(|c| left[c] + 2 * own[c] + right[c]);
            self.blue.push(chroma(sum, BLUE_DIFFERENCE));
            self.red.push(chroma(sum, RED_DIFFERENCE));
        }
    }
}

fn luma([r, g, b]: [i32; 3]) -> u8 {
    ((LUMA[0] * r + LUMA[1] * g + LUMA[2] * b + (16 << 16) + (1 << 15)) >> 16) as u8
}

/// The difference of eight times a colour.
fn chroma([r, g, b]: [i32; 3], weights: [i32; 3]) -> u8 {
    ((weights[0] * r + weights[1] * g + weights[2] * b + (128 << 19) + (1 << 18)) >> 19) as u8
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Luma and both differences of a colour, as Recommendation BT.709 defines them.
    fn of_colour([r, g, b]: [f64; 3]) -> [f64; 3] {
        let luma = 0.2126 * r + 0.7152 * g + 0.0722 * b;
        [16.0 + 219.0 * luma, 128.0 + 224.0 * (b - luma) / 1.8556, 128.0 + 224.0 * (r - luma) / 1.5748]
    }

    /// The slow, obvious twin: every sample by the definition, in 64 bits.
    fn obvious(picture: &Image) -> Planes {
        let size = even(picture.size());
        let rgb = picture.to_rgb8();
        let (width, height) = picture.size();
        let pixel = |x: i64, y: usize| {
            let x = x.clamp(0, i64::from(width) - 1) as usize;
            let y = y.min(height as usize - 1);
            [0, 1, 2].map(|c| f64::from(rgb[3 * (width as usize * y + x) + c]) / 255.0)
        };
        let mut planes = Planes { size, luma: Vec::new(), blue: Vec::new(), red: Vec::new() };
        for y in 0..size.1 {
            planes.luma.extend((0..size.0).map(|x| of_colour(pixel(x as i64, y))[0].round() as u8));
        }
        for y in (0..size.1).step_by(2) {
            for x in (0..size.0 as i64).step_by(2) {
                let mut mean = [0.0; 3];
                for (dx, weight) in [(-1, 0.125), (0, 0.25), (1, 0.125)] {
                    for dy in 0..2 {
                        let colour = pixel(x + dx, y + dy);
                        (0..3).for_each(|c| mean[c] += weight * colour[c]);
                    }
                }
                planes.blue.push(of_colour(mean)[1].round() as u8);
                planes.red.push(of_colour(mean)[2].round() as u8);
            }
        }
        planes
    }

    /// The picture that planes show, each chroma sample on its four pixels, by the definition's inverse.
    pub fn shown(planes: &Planes, size: (u32, u32)) -> Image {
        let mut rgb = Vec::new();
        for y in 0..size.1 as usize {
            for x in 0..size.0 as usize {
                let at = planes.size.0 / 2 * (y / 2) + x / 2;
                let luma = (f64::from(planes.luma[planes.size.0 * y + x]) - 16.0) / 219.0;
                let blue = luma + 1.8556 * (f64::from(planes.blue[at]) - 128.0) / 224.0;
                let red = luma + 1.5748 * (f64::from(planes.red[at]) - 128.0) / 224.0;
                let green = (luma - 0.2126 * red - 0.0722 * blue) / 0.7152;
                rgb.extend([red, green, blue].map(|value| value.clamp(0.0, 1.0) as f32));
            }
        }
        Image::new(size.0, size.1, rgb).unwrap()
    }

    fn noise(width: u32, height: u32) -> Image {
        let mut state = 1u32;
        let values = (0..3 * width * height).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as f32 / 255.0
        });
        Image::new(width, height, values.collect()).unwrap()
    }

    #[test]
    fn colours_are_those_of_the_recommendation() {
        for (colour, wanted) in [
            ([0.0, 0.0, 0.0], [16, 128, 128]),
            ([1.0, 1.0, 1.0], [235, 128, 128]),
            ([1.0, 0.0, 0.0], [63, 102, 240]),
            ([0.0, 1.0, 0.0], [173, 42, 26]),
            ([0.0, 0.0, 1.0], [32, 240, 118]),
        ] {
            let planes = Planes::of(&Image::filled(2, 2, colour).unwrap());
            assert_eq!([planes.luma[0], planes.blue[0], planes.red[0]], wanted, "{colour:?}");
        }
    }

    #[test]
    fn integers_are_within_a_step_of_the_definition() {
        for (width, height) in [(16, 16), (17, 9), (1, 1), (2, 3), (64, 31)] {
            let picture = noise(width, height);
            let (fast, slow) = (Planes::of(&picture), obvious(&picture));
            assert_eq!(fast.size, slow.size);
            for (fast, slow) in [(&fast.luma, &slow.luma), (&fast.blue, &slow.blue), (&fast.red, &slow.red)] {
                assert_eq!(fast.len(), slow.len());
                assert!(fast.iter().zip(slow).all(|(a, b)| a.abs_diff(*b) <= 1), "{width} × {height}");
            }
        }
        // The comparison can fail: rows in another order are seen.
        let mut turned = noise(16, 16).rgb().to_vec();
        turned.reverse();
        let turned = Planes::of(&Image::new(16, 16, turned).unwrap());
        let straight = obvious(&noise(16, 16));
        assert!(turned.luma.iter().zip(&straight.luma).any(|(a, b)| a.abs_diff(*b) > 1));
    }
}
