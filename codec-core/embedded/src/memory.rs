//! The receiver's memory, all of it static.

use codec_core::{
    Gaussian, decode,
    receiver::{self, Cell},
};
use static_cell::ConstStaticCell;

use crate::fixture;

static MANIFEST: ConstStaticCell<[u8; fixture::MANIFEST]> = ConstStaticCell::new([0; fixture::MANIFEST]);
static CELLS: ConstStaticCell<[Cell; fixture::CELLS]> =
    ConstStaticCell::new([Cell { symbols: 0, blocks: 0 }; fixture::CELLS]);
static SYMBOLS: ConstStaticCell<[i16; fixture::SYMBOLS]> = ConstStaticCell::new([0; fixture::SYMBOLS]);
static BLOCKS: ConstStaticCell<[u8; fixture::BLOCKS]> = ConstStaticCell::new([0; fixture::BLOCKS]);
static SEEN: ConstStaticCell<[u32; fixture::SEEN]> = ConstStaticCell::new([0; fixture::SEEN]);
static SLOTS: ConstStaticCell<[u32; fixture::SLOTS]> = ConstStaticCell::new([0; fixture::SLOTS]);
static PROGRESS: ConstStaticCell<[u32; fixture::PROGRESS]> = ConstStaticCell::new([0; fixture::PROGRESS]);
static PARITY: ConstStaticCell<[u8; fixture::PARITY]> = ConstStaticCell::new([0; fixture::PARITY]);
static EARLY: ConstStaticCell<[u8; EARLY_BYTES]> = ConstStaticCell::new([0; EARLY_BYTES]);
static CANONICAL: ConstStaticCell<[Gaussian; fixture::GAUSSIANS]> = ConstStaticCell::new([ZERO; fixture::GAUSSIANS]);
static KNOWN: ConstStaticCell<[u8; fixture::BLOCKS]> = ConstStaticCell::new([0; fixture::BLOCKS]);
static OUT: ConstStaticCell<[Gaussian; fixture::GAUSSIANS]> = ConstStaticCell::new([ZERO; fixture::GAUSSIANS]);
static SH_REST: ConstStaticCell<[f32; fixture::SH_REST]> = ConstStaticCell::new([0.0; fixture::SH_REST]);

/// Room for media before the manifest: one packet and its length.
const EARLY_BYTES: usize = fixture::LARGEST_PACKET + 2;

/// All bits zero, so that statics need no image in flash.
const ZERO: Gaussian =
    Gaussian { position: [0.0; 3], scale: [0.0; 3], rotation: [0.0; 4], opacity: 0.0, sh0: [0.0; 3] };

/// Everything a receiver and a decoder need.
pub struct Memory {
    /// The receiver's.
    pub receiver: receiver::Memory<'static>,
    /// The decoder's.
    pub decoder: decode::Memory<'static>,
    /// Where frames go.
    pub out: &'static mut [Gaussian],
    /// Where higher bands go.
    pub sh_rest: &'static mut [f32],
}

impl Memory {
    /// The memory, once.
    pub fn take() -> Option<Self> {
        Some(Self {
            receiver: receiver::Memory {
                manifest: MANIFEST.try_take()?,
                cells: CELLS.try_take()?,
                symbols: SYMBOLS.try_take()?,
                blocks: BLOCKS.try_take()?,
                seen: SEEN.try_take()?,
                slots: SLOTS.try_take()?,
                progress: PROGRESS.try_take()?,
                parity: PARITY.try_take()?,
                early: EARLY.try_take()?,
            },
            decoder: decode::Memory { canonical: CANONICAL.try_take()?, known: KNOWN.try_take()? },
            out: OUT.try_take()?,
            sh_rest: SH_REST.try_take()?,
        })
    }
}
