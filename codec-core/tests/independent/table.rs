//! Entropy tables of `SPEC.md` sections 8.1 and 8.2: read from a manifest, or built by their index.

/// Frequencies of tokens, raw bits, and the bytes in the manifest.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    pub frequency: [u64; 256],
    /// Sums of the frequencies of smaller tokens.
    pub below: [u64; 256],
    pub raw_bits: u32,
    pub wire: Vec<u8>,
}

impl Table {
    fn new(frequency: [u64; 256], raw_bits: u32, wire: Vec<u8>) -> Self {
        assert_eq!(frequency.iter().sum::<u64>(), 2048);
        let below = std::array::from_fn(|token| frequency[..token].iter().sum());
        Self { frequency, below, raw_bits, wire }
    }

    /// The table at the front of `bytes`.
    pub fn read(bytes: &[u8]) -> Self {
        if bytes[0] == 0x80 {
            return Self::named(bytes[1]);
        }
        let (first, count) = (usize::from(bytes[1]), usize::from(bytes[2]));
        let at = |place: usize| u64::from(bytes[place]) | u64::from(bytes[place + 1]) << 8;
        let mut frequency = [0; 256];
        frequency[0] = at(3);
        (0..count).for_each(|i| frequency[first + i] = at(5 + 2 * i));
        Self::new(frequency, bytes[0].into(), bytes[..5 + 2 * count].to_vec())
    }

    /// A table of its own: `listed` are the frequencies of tokens from `first` on.
    pub fn own(raw_bits: u8, first: u8, escape: u16, listed: &[u16]) -> Self {
        let mut wire = vec![raw_bits, first, listed.len() as u8];
        wire.extend(escape.to_le_bytes());
        listed.iter().for_each(|f| wire.extend(f.to_le_bytes()));
        Self::read(&wire)
    }

    /// Table `index` of the family.
    pub fn named(index: u8) -> Self {
        let mut weight = [0u64; 256];
        let mut raw_bits = 0;
        match index {
            0..54 => {
                let (bits, ratio) = scale(index);
                raw_bits = bits;
                sides(&mut weight, ratio, bits, 4);
            }
            64..118 => {
                let (bits, ratio) = scale(index - 64);
                let (tail_bits, mut tail) = scale((index - 64 + 9).min(53));
                raw_bits = bits;
                (bits..tail_bits).for_each(|_| tail = (65536 + tail) / 2);
                sides(&mut weight, ratio, bits, 3);
                sides(&mut weight, tail, bits, 1);
            }
            128..173 => {
                let all = (0..=8u64).flat_map(|a| (0..=8 - a).map(move |b| [a, b, 8 - a - b]));
                let parts = all.into_iter().nth(usize::from(index) - 128).unwrap();
                parts.iter().zip(&mut weight[127..130]).for_each(|(part, w)| *w = (part << 29) + (1 << 24));
            }
            _ => panic!("no table {index}"),
        }
        let total: u64 = weight.iter().sum();
        let mut frequency = weight.map(|w| match 8 * w * 2024 / total {
            0 => 0,
            eighths => (eighths / 8).max(1),
        });
        let heaviest = *weight.iter().max().unwrap();
        let nearest = (0..128).flat_map(|d| [128 + d, 128 - d]).find(|&t| weight[t] == heaviest).unwrap();
        frequency[nearest] += 2047 - frequency.iter().sum::<u64>();
        frequency[0] = 1;
        Self::new(frequency, raw_bits, vec![0x80, index])
    }

    /// The token of `value`.
    pub fn token(&self, value: i16) -> usize {
        let token = i32::from(value >> self.raw_bits) + 128;
        let known = (1..=255).contains(&token) && self.frequency[token as usize] > 0;
        if known { token as usize } else { 0 }
    }

    /// Whether the table can code `value`, by a token or by the escape.
    pub fn codes(&self, value: i16) -> bool {
        self.frequency[self.token(value)] > 0
    }
}

/// Raw bits and ratio of a scale.
fn scale(index: u8) -> (u32, u64) {
    const RATIOS: [u64; 33] = [
        512, 645, 813, 1024, 1290, 1624, 2046, 2576, 3243, 4080, 5129, 6439, 8068, 10077, 12529, 15471,
        18922, 22847, 27146, 31654, 36171, 40503, 44500, 48068, 51169, 53810, 56022, 57854, 59356, 60578,
        57835, 59346, 60573,
    ];
    let index = usize::from(index);
    if index < 30 { (0, RATIOS[index]) } else { ((index as u32 - 30) / 3 + 1, RATIOS[30 + (index - 30) % 3]) }
}

fn sides(weight: &mut [u64; 256], ratio: u64, raw_bits: u32, share: u64) {
    let divisor = if raw_bits > 0 { 2 * 65536 } else { 65536 + ratio };
    let mut w = (share << 30) * (65536 - ratio) / divisor;
    for distance in 0..128 {
        weight[128 + distance] += w;
        if raw_bits > 0 && distance < 127 {
            weight[127 - distance] += w;
        } else if raw_bits == 0 && distance > 0 {
            weight[128 - distance] += w;
        }
        w = w * ratio / 65536;
    }
}
