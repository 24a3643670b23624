//! The manifest of `dgs1` as plain data (`SPEC.md` section 5.3), and the order of symbols (section 7).

use crate::table::Table;

/// What a manifest body says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Model {
    pub sh_degree: u8,
    pub block_len: u16,
    pub rate: (u32, u32),
    pub packets: u32,
    pub epochs: Vec<Epoch>,
    pub quants: Vec<[Quantiser; 13]>,
    /// Per stream: table and code length of each choice.
    pub table_sets: Vec<Vec<(u8, u8)>>,
    /// Ranges of repair, as they are sent.
    pub repairs: Vec<Vec<u8>>,
    pub transforms: Vec<u8>,
    /// Planes of bytes, all blocks of the canonical cells in each.
    pub proxies: Option<Vec<u8>>,
    pub drawing: u8,
    pub tables: Vec<Table>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Epoch {
    pub frames: u32,
    pub origin: [f32; 3],
    pub clusters: Vec<Cluster>,
    pub windows: Vec<Window>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cluster {
    pub gaussians: u16,
    pub quant: u8,
    pub degree: u8,
    pub left_out: u8,
    pub centre: [i16; 3],
    pub radius: u16,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Window {
    pub frames: u16,
    pub rank: u8,
    /// Values of the learned basis, vector-major.
    pub basis: Vec<i16>,
    /// One per cluster of the epoch.
    pub motions: Vec<Motion>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// 0 static, 1 rigid, 2 affine.
    pub track: u8,
    pub left_out: u8,
    pub shift: u8,
    pub track_coefficients: u8,
    /// Of the five moving classes.
    pub coefficients: [u8; 5],
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quantiser {
    pub step: f32,
    pub ratio: [u8; 3],
    pub flags: u8,
}

impl Model {
    /// The unpacked body.
    pub fn body(&self) -> Vec<u8> {
        let clusters: usize = self.epochs.iter().map(|e| e.clusters.len()).sum();
        let windows: Vec<&Window> = self.epochs.iter().flat_map(|e| &e.windows).collect();
        let basis: Vec<i16> = windows.iter().flat_map(|w| w.basis.clone()).collect();
        let mut out = vec![1, self.sh_degree];
        out.extend(self.block_len.to_le_bytes());
        let frames = self.epochs.iter().map(|e| e.frames).sum();
        [frames, self.rate.0, self.rate.1, self.packets]
            .iter()
            .for_each(|v: &u32| out.extend(v.to_le_bytes()));
        out.extend((self.epochs.len() as u16).to_le_bytes());
        out.extend((windows.len() as u16).to_le_bytes());
        out.extend((clusters as u32).to_le_bytes());
        for count in [self.quants.len(), self.tables.len(), self.repairs.len()] {
            out.extend((count as u16).to_le_bytes());
        }
        out.extend([u8::from(self.proxies.is_some()), self.drawing]);
        out.extend((basis.len() as u32).to_le_bytes());
        out.extend((self.transforms.len() as u32 / 4).to_le_bytes());
        self.epoch_records(&mut out);
        self.window_records(&mut out);
        for cluster in self.epochs.iter().flat_map(|e| &e.clusters) {
            out.extend(cluster.gaussians.to_le_bytes());
            out.extend([cluster.quant, cluster.degree | cluster.left_out << 2]);
            cluster.centre.iter().for_each(|c| out.extend(c.to_le_bytes()));
            out.extend(cluster.radius.to_le_bytes());
        }
        for motion in windows.iter().flat_map(|w| &w.motions) {
            out.extend([motion.track | motion.left_out << 2, motion.shift, motion.track_coefficients]);
            out.extend(motion.coefficients);
        }
        for quantiser in self.quants.iter().flatten() {
            out.extend(quantiser.step.to_le_bytes());
            out.extend(quantiser.ratio);
            out.push(quantiser.flags);
        }
        for set in &self.table_sets {
            let of = |i: usize| set.get(i).copied().unwrap_or((0, 0));
            out.push(set.len() as u8);
            (0..4).for_each(|i| out.push(of(2 * i).1 | of(2 * i + 1).1 << 4));
            (0..8).for_each(|i| out.push(of(i).0));
        }
        out.extend(self.repairs.concat());
        basis.iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend(&self.transforms);
        out.extend(self.proxies.iter().flatten());
        self.tables.iter().for_each(|t| out.extend(&t.wire));
        out
    }

    fn epoch_records(&self, out: &mut Vec<u8>) {
        let (mut frame, mut cluster, mut window) = (0u32, 0u32, 0u32);
        for epoch in &self.epochs {
            let gaussians: u32 = epoch.clusters.iter().map(|c| u32::from(c.gaussians)).sum();
            let (clusters, windows) = (epoch.clusters.len() as u32, epoch.windows.len() as u32);
            for value in [frame, epoch.frames, gaussians, cluster, clusters, window, windows] {
                out.extend(value.to_le_bytes());
            }
            epoch.origin.iter().for_each(|v| out.extend(v.to_le_bytes()));
            out.extend([0; 12]);
            frame += epoch.frames;
            cluster += clusters;
            window += windows;
        }
    }

    fn window_records(&self, out: &mut Vec<u8>) {
        let (mut frame, mut cell, mut basis) = (0u32, 0u32, 0u32);
        for (e, epoch) in self.epochs.iter().enumerate() {
            let mut first_frame = frame;
            for window in &epoch.windows {
                out.extend((e as u16).to_le_bytes());
                out.extend(window.frames.to_le_bytes());
                for value in [first_frame, cell, basis] {
                    out.extend(value.to_le_bytes());
                }
                out.extend([window.rank, 0, 0, 0]);
                first_frame += u32::from(window.frames);
                cell += epoch.clusters.len() as u32;
                basis += window.basis.len() as u32;
            }
            frame += epoch.frames;
        }
    }

    /// What `body` says.
    pub fn read(body: &[u8]) -> Self {
        let mut reader = Reader { bytes: body, at: 0 };
        let r = &mut reader;
        assert_eq!(r.u8(), 1, "profile dgs1");
        let mut model = Self { sh_degree: r.u8(), block_len: r.u16(), ..Self::default() };
        let _frames = r.u32();
        model.rate = (r.u32(), r.u32());
        model.packets = r.u32();
        let (epochs, windows, clusters) = (r.u16(), r.u16(), r.u32());
        let [quants, tables, repairs] = [r.u16(), r.u16(), r.u16()];
        let proxies = r.u8();
        model.drawing = r.u8();
        let (basis_values, transform_values) = (r.u32(), r.u32());
        let mut shares = Vec::new();
        for _ in 0..epochs {
            let [_, frames, _, _, clusters, _, windows] = [(); 7].map(|()| r.u32());
            let origin = [(); 3].map(|()| f32::from_bits(r.u32()));
            assert_eq!(r.take(12), [0; 12]);
            shares.push((clusters, windows));
            model.epochs.push(Epoch { frames, origin, ..Epoch::default() });
        }
        let mut read_windows = Vec::new();
        for _ in 0..windows {
            let (_, frames, _, _, basis) = (r.u16(), r.u16(), r.u32(), r.u32(), r.u32());
            read_windows.push((Window { frames, rank: r.u8(), ..Window::default() }, basis));
            r.take(3);
        }
        let mut read_clusters = (0..clusters).map(|_| Cluster::read(r)).collect::<Vec<_>>().into_iter();
        let mut read_windows = read_windows.into_iter();
        let mut bases = Vec::new();
        for (epoch, &(clusters, windows)) in model.epochs.iter_mut().zip(&shares) {
            epoch.clusters = read_clusters.by_ref().take(clusters as usize).collect();
            for (mut window, basis) in read_windows.by_ref().take(windows as usize) {
                window.motions = (0..clusters).map(|_| Motion::read(r)).collect();
                bases.push(basis as usize);
                epoch.windows.push(window);
            }
        }
        model.quants = (0..quants).map(|_| [(); 13].map(|()| Quantiser::read(r))).collect();
        model.table_sets = (0..87).map(|_| table_set(r)).collect();
        model.repairs = (0..repairs).map(|_| r.take(16).to_vec()).collect();
        let basis: Vec<i16> = (0..basis_values).map(|_| r.u16() as i16).collect();
        for (window, start) in model.epochs.iter_mut().flat_map(|e| &mut e.windows).zip(bases) {
            let len = usize::from(window.rank) * usize::from(window.frames);
            window.basis = basis[start..start + len].to_vec();
        }
        model.transforms = r.take(4 * transform_values as usize).to_vec();
        let blocks: usize = model
            .epochs
            .iter()
            .flat_map(|e| &e.clusters)
            .map(|c| usize::from(c.gaussians.div_ceil(model.block_len)))
            .sum();
        model.proxies = (proxies == 1).then(|| r.take(13 * blocks).to_vec());
        for _ in 0..tables {
            let table = Table::read(&r.bytes[r.at..]);
            r.at += table.wire.len();
            model.tables.push(table);
        }
        assert_eq!(r.at, body.len());
        model
    }
}

fn table_set(r: &mut Reader<'_>) -> Vec<(u8, u8)> {
    let count = usize::from(r.u8());
    let lengths: Vec<u8> = r.take(4).iter().flat_map(|byte| [byte & 15, byte >> 4]).collect();
    r.take(8).iter().copied().zip(lengths).take(count).collect()
}

impl Cluster {
    fn read(r: &mut Reader<'_>) -> Self {
        let (gaussians, quant, kind) = (r.u16(), r.u8(), r.u8());
        let centre = [(); 3].map(|()| r.u16() as i16);
        Self { gaussians, quant, degree: kind & 3, left_out: kind >> 2, centre, radius: r.u16() }
    }
}

impl Motion {
    fn read(r: &mut Reader<'_>) -> Self {
        let (kind, shift, track_coefficients) = (r.u8(), r.u8(), r.u8());
        let coefficients = [(); 5].map(|()| r.u8());
        Self { track: kind & 3, left_out: kind >> 2, shift, track_coefficients, coefficients }
    }
}

impl Quantiser {
    fn read(r: &mut Reader<'_>) -> Self {
        let step = f32::from_bits(r.u32());
        Self { step, ratio: [(); 3].map(|()| r.u8()), flags: r.u8() }
    }

    /// Whether there is a symbol at `level` for a class that first appears at `first`.
    fn has_symbol(&self, level: usize, first: usize) -> bool {
        level == first || level > first && self.ratio[level - 1] > 1
    }
}

/// Reads little-endian fields.
pub struct Reader<'b> {
    pub bytes: &'b [u8],
    pub at: usize,
}

impl<'b> Reader<'b> {
    pub fn take(&mut self, n: usize) -> &'b [u8] {
        self.at += n;
        &self.bytes[self.at - n..self.at]
    }

    pub fn u8(&mut self) -> u8 {
        self.take(1)[0]
    }

    pub fn u16(&mut self) -> u16 {
        u16::from(self.u8()) | u16::from(self.u8()) << 8
    }

    pub fn u32(&mut self) -> u32 {
        u32::from(self.u16()) | u32::from(self.u16()) << 16
    }

    pub fn varint(&mut self) -> u32 {
        let (mut value, mut shift) = (0, 0);
        loop {
            let byte = self.u8();
            value |= u32::from(byte & 0x7f) << shift;
            shift += 7;
            if byte & 0x80 == 0 {
                return value;
            }
        }
    }
}

/// One cluster in one span.
#[derive(Clone, Copy)]
pub struct Cell<'m> {
    pub cluster: &'m Cluster,
    pub quant: &'m [Quantiser; 13],
    pub motion: Option<&'m Motion>,
    pub block_len: usize,
}

/// Components, first level and harmonic degree of each class.
const CLASSES: [(usize, usize, u8); 8] =
    [(3, 0, 0), (3, 0, 0), (3, 0, 0), (1, 0, 0), (3, 0, 0), (9, 1, 1), (15, 2, 2), (21, 3, 3)];

impl Model {
    /// The cells of epoch or window `span`, in order of their clusters.
    pub fn cells(&self, motion: bool, span: usize) -> Vec<Cell<'_>> {
        let block_len = usize::from(self.block_len);
        let of = |epoch: &Epoch, cluster: usize| &self.quants[usize::from(epoch.clusters[cluster].quant)];
        if !motion {
            let epoch = &self.epochs[span];
            let clusters = epoch.clusters.iter().enumerate();
            return clusters
                .map(|(c, cluster)| Cell { cluster, quant: of(epoch, c), motion: None, block_len })
                .collect();
        }
        let windows = self.epochs.iter().flat_map(|e| e.windows.iter().map(move |w| (e, w)));
        let (epoch, window) = windows.into_iter().nth(span).unwrap();
        let pairs = epoch.clusters.iter().zip(&window.motions).enumerate();
        pairs
            .map(|(c, (cluster, motion))| Cell {
                cluster,
                quant: of(epoch, c),
                motion: Some(motion),
                block_len,
            })
            .collect()
    }

    /// Every span in the order of cells: whether it is a window, and its number.
    pub fn spans(&self) -> Vec<(bool, usize)> {
        let windows: usize = self.epochs.iter().map(|e| e.windows.len()).sum();
        (0..self.epochs.len()).map(|e| (false, e)).chain((0..windows).map(|w| (true, w))).collect()
    }
}

impl Cell<'_> {
    /// Number of blocks.
    pub fn blocks(&self) -> usize {
        usize::from(self.cluster.gaussians).div_ceil(self.block_len)
    }

    /// Gaussians of `block`.
    pub fn gaussians(&self, block: usize) -> usize {
        (usize::from(self.cluster.gaussians) - block * self.block_len).min(self.block_len)
    }

    /// Whether `level` is the track of a cell that moves.
    pub fn is_track(&self, level: usize) -> bool {
        level == 0 && self.motion.is_some_and(|m| m.track > 0)
    }

    /// Quantiser and first level of a class in this cell.
    fn class(&self, class: usize) -> (&Quantiser, usize) {
        if self.motion.is_some() {
            (&self.quant[8 + class], 1)
        } else {
            (&self.quant[class], CLASSES[class].1)
        }
    }

    /// Class, coefficient and components of what a Gaussian has at `level`, in order.
    fn parts(&self, level: usize) -> Vec<(usize, usize, usize)> {
        let left_out = self.motion.map_or(self.cluster.left_out, |m| m.left_out);
        let mut parts = Vec::new();
        let classes = if self.motion.is_some() { 5 } else { 8 };
        for (class, &(components, _, degree)) in CLASSES.iter().enumerate().take(classes) {
            let (quantiser, first) = self.class(class);
            let known = self.motion.is_some() || degree <= self.cluster.degree;
            if known && level + usize::from(left_out) <= 3 && quantiser.has_symbol(level, first) {
                let coefficients = self.motion.map_or(1, |m| m.coefficients[class].into());
                (0..coefficients).for_each(|k| parts.push((class, k, components)));
            }
        }
        parts
    }

    /// Symbol runs of `blocks` at `level`: stream and length.
    pub fn runs(&self, level: usize, blocks: std::ops::Range<usize>) -> Vec<(usize, usize)> {
        if self.is_track(level) {
            return self.track_runs();
        }
        let mut runs = Vec::new();
        for block in blocks {
            let n = self.gaussians(block);
            for (class, k, components) in self.parts(level) {
                let (quantiser, first) = self.class(class);
                let (stream, start) = match self.motion {
                    None => (class * 4 + level, 32 + class),
                    Some(_) => (52 + (class * 3 + level - 1) * 2 + usize::from(k > 0), 82 + class),
                };
                for _ in 0..components {
                    if level == first && quantiser.flags & 1 == 1 {
                        runs.push((start, 1));
                        runs.extend((n > 1).then_some((stream, n - 1)));
                    } else {
                        runs.push((stream, n));
                    }
                }
            }
        }
        runs
    }

    fn track_runs(&self) -> Vec<(usize, usize)> {
        let motion = self.motion.unwrap();
        let turning = if motion.track == 1 { 3 } else { 9 };
        let mut runs = Vec::new();
        for (kind, parameters) in [(usize::from(motion.track), turning), (0, 3)] {
            for (band, (low, high)) in [(0, 1), (1, 4), (4, 8), (8, 256)].into_iter().enumerate() {
                let high = usize::from(motion.track_coefficients).min(high);
                runs.extend((high > low).then(|| (40 + kind * 4 + band, parameters * (high - low))));
            }
        }
        runs
    }

    /// Symbols of `blocks` at `level`.
    pub fn symbols(&self, level: usize, blocks: std::ops::Range<usize>) -> usize {
        self.runs(level, blocks).iter().map(|run| run.1).sum()
    }
}
