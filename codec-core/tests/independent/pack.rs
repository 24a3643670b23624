//! The packer of `SPEC.md` section 5.2, both ways, one bit at a time.

/// The model: probabilities of a zero bit by class, phase and node, and the byte so far.
struct Model {
    zero: Vec<u64>,
    class: usize,
    phase: usize,
    node: usize,
}

impl Model {
    fn new() -> Self {
        Self { zero: vec![1024; 4 * 4 * 256], class: 0, phase: 0, node: 1 }
    }

    fn slot(&mut self) -> &mut u64 {
        &mut self.zero[(self.class * 4 + self.phase) * 256 + self.node]
    }

    /// The bit is known: the probability learns, the node moves on.
    fn learn(&mut self, bit: bool) {
        let probability = self.slot();
        *probability = if bit {
            *probability - (*probability >> 4)
        } else {
            *probability + ((2048 - *probability) >> 4)
        };
        self.node = 2 * self.node + usize::from(bit);
    }

    /// The byte is whole: the next one begins.
    fn next_byte(&mut self) -> u8 {
        let byte = (self.node - 256) as u8;
        self.class = match byte {
            0 => 0,
            1..=15 => 1,
            16..=239 => 2,
            240.. => 3,
        };
        self.phase = (self.phase + 1) % 4;
        self.node = 1;
        byte
    }
}

/// The packed form of `body`.
pub fn pack(body: &[u8]) -> Vec<u8> {
    let (mut low, mut range) = (0u64, 0xffff_ffffu64);
    let (mut pending, mut count, mut out) = (0u64, 0, Vec::new());
    let mut shift = |low: &mut u64| {
        if *low < 0xff00_0000 || *low >= 1 << 32 {
            let carry = *low >> 32;
            out.push((pending + carry) as u8);
            (0..count).for_each(|_| out.push((0xff + carry) as u8));
            pending = *low >> 24 & 0xff;
            count = 0;
        } else {
            count += 1;
        }
        *low = (*low & 0xff_ffff) << 8;
    };
    let mut model = Model::new();
    for &byte in body {
        for place in (0..8).rev() {
            let bit = byte >> place & 1 == 1;
            let bound = (range >> 11) * *model.slot();
            if bit {
                low += bound;
                range -= bound;
            } else {
                range = bound;
            }
            model.learn(bit);
            while range < 1 << 24 {
                range <<= 8;
                shift(&mut low);
            }
        }
        model.next_byte();
    }
    (0..5).for_each(|_| shift(&mut low));
    out
}

/// The body of `len` bytes that `packed` is the packed form of.
pub fn unpack(packed: &[u8], len: usize) -> Vec<u8> {
    assert_eq!(packed[0], 0);
    let mut code = packed[1..5].iter().fold(0u64, |code, &byte| code << 8 | u64::from(byte));
    let (mut at, mut range, mut body) = (5, 0xffff_ffffu64, Vec::new());
    let mut model = Model::new();
    while body.len() < len {
        for _ in 0..8 {
            let bound = (range >> 11) * *model.slot();
            let bit = code >= bound;
            if bit {
                code -= bound;
                range -= bound;
            } else {
                range = bound;
            }
            model.learn(bit);
            while range < 1 << 24 {
                range <<= 8;
                code = code << 8 | u64::from(packed[at]);
                at += 1;
            }
        }
        body.push(model.next_byte());
    }
    assert_eq!((code, at), (0, packed.len()));
    body
}
