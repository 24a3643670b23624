//! Runs public coders on the same packets, each with one table for all of them where it can.

use anyhow::{Result, anyhow};
use constriction::stream::{
    Decode,
    model::{SmallContiguousCategoricalEntropyModel, SmallContiguousLookupDecoderModel},
    stack::SmallAnsCoder,
};
use ryg_rans_rs_core::{
    BackwardByteWriter, ByteReader, RansByteDecSymbol, RansByteEncSymbol, RansByteState,
    rans_byte_dec_advance_symbol_step, rans_byte_dec_get, rans_byte_dec_init, rans_byte_dec_renorm,
    rans_byte_enc_flush, rans_byte_enc_put_symbol,
};
use zstd::{
    bulk::{Compressor, Decompressor},
    zstd_safe::CParameter,
};

use super::{
    coders::{Arena, Coder, Decoded},
    law::Packets,
};

/// All peers for one law.
pub fn all(packets: &Packets) -> Result<Vec<Box<dyn Coder>>> {
    Ok(vec![
        Box::new(Ryg::new(packets)?),
        Box::new(Constriction::new(packets)?),
        Box::new(Zstd::new(packets)?),
    ])
}

fn refused(error: impl std::fmt::Debug) -> anyhow::Error {
    anyhow!("{error:?}")
}

/// `ryg-rans-rs-core`: byte-wise rANS, two lanes, 14 bits, no unsafe code.
struct Ryg {
    encode: Vec<RansByteEncSymbol>,
    decode: Vec<RansByteDecSymbol>,
    slots: Vec<u8>,
}

const RYG_BITS: u32 = 14;

impl Ryg {
    fn new(packets: &Packets) -> Result<Self> {
        let frequency = packets.frequencies(RYG_BITS);
        let (mut encode, mut decode, mut slots) = (Vec::new(), Vec::new(), Vec::new());
        let mut start = 0;
        for (token, &f) in frequency.iter().enumerate() {
            let place = if f == 0 { 0 } else { start };
            encode.push(RansByteEncSymbol::new(place, f.max(1), RYG_BITS).map_err(refused)?);
            decode.push(RansByteDecSymbol::new(place, f.max(1)).map_err(refused)?);
            slots.extend(std::iter::repeat_n(token as u8, f as usize));
            start += f;
        }
        Ok(Self { encode, decode, slots })
    }
}

impl Coder for Ryg {
    fn name(&self) -> String {
        "ryg-rans-rs-core".into()
    }

    fn whole(&self) -> bool {
        false
    }

    fn encode(&mut self, packets: &Packets, arena: &mut Arena) -> Result<bool> {
        for (tokens, (room, place)) in packets.tokens.chunks_exact(packets.len).zip(arena.rooms()) {
            let total = room.len();
            let mut writer = BackwardByteWriter::new(room);
            let (mut a, mut b) = (RansByteState::new(), RansByteState::new());
            let (pairs, odd) = tokens.as_chunks::<2>();
            for &token in odd {
                rans_byte_enc_put_symbol(&mut a, &mut writer, &self.encode[usize::from(token)])
                    .map_err(refused)?;
            }
            for pair in pairs.iter().rev() {
                rans_byte_enc_put_symbol(&mut b, &mut writer, &self.encode[usize::from(pair[1])])
                    .map_err(refused)?;
                rans_byte_enc_put_symbol(&mut a, &mut writer, &self.encode[usize::from(pair[0])])
                    .map_err(refused)?;
            }
            rans_byte_enc_flush(&b, &mut writer).map_err(refused)?;
            rans_byte_enc_flush(&a, &mut writer).map_err(refused)?;
            let len = writer.bytes_written();
            *place = (total - len, len);
        }
        Ok(true)
    }

    fn decode(&mut self, packets: &Packets, bodies: &[&[u8]], out: &mut Decoded) -> Result<()> {
        for (body, tokens) in bodies.iter().copied().zip(out.tokens.chunks_exact_mut(packets.len)) {
            let mut reader = ByteReader::new(body);
            let mut a = rans_byte_dec_init(&mut reader).map_err(refused)?;
            let mut b = rans_byte_dec_init(&mut reader).map_err(refused)?;
            let (pairs, odd) = tokens.as_chunks_mut::<2>();
            for pair in pairs {
                let s = self.slots[rans_byte_dec_get(&a, RYG_BITS) as usize];
                let t = self.slots[rans_byte_dec_get(&b, RYG_BITS) as usize];
                *pair = [s, t];
                rans_byte_dec_advance_symbol_step(&mut a, &self.decode[usize::from(s)], RYG_BITS);
                rans_byte_dec_advance_symbol_step(&mut b, &self.decode[usize::from(t)], RYG_BITS);
                rans_byte_dec_renorm(&mut a, &mut reader).map_err(refused)?;
                rans_byte_dec_renorm(&mut b, &mut reader).map_err(refused)?;
            }
            for token in odd {
                *token = self.slots[rans_byte_dec_get(&a, RYG_BITS) as usize];
            }
        }
        Ok(())
    }
}

/// `constriction`: 16-bit words, 32-bit state, one lane, 12-bit lookup decoder.
struct Constriction {
    encode: SmallContiguousCategoricalEntropyModel,
    decode: SmallContiguousLookupDecoderModel,
    first: u8,
}

impl Constriction {
    fn new(packets: &Packets) -> Result<Self> {
        let frequency = packets.frequencies(20);
        let first = frequency.iter().position(|&f| f > 0).unwrap_or(0);
        let last = frequency.iter().rposition(|&f| f > 0).unwrap_or(0);
        let probability: Vec<f64> =
            frequency[first..=last].iter().map(|&f| f64::from(f.max(1)) / f64::from(1 << 20)).collect();
        let encode =
            SmallContiguousCategoricalEntropyModel::from_floating_point_probabilities_perfect(&probability)
                .map_err(|()| anyhow!("constriction refuses the law"))?;
        let decode = SmallContiguousLookupDecoderModel::from(encode.to_lookup_decoder_model());
        Ok(Self { encode, decode, first: first as u8 })
    }
}

impl Coder for Constriction {
    fn name(&self) -> String {
        "constriction".into()
    }

    fn whole(&self) -> bool {
        false
    }

    fn encode(&mut self, packets: &Packets, arena: &mut Arena) -> Result<bool> {
        for (tokens, (room, place)) in packets.tokens.chunks_exact(packets.len).zip(arena.rooms()) {
            let mut coder = SmallAnsCoder::new();
            let symbols = tokens.iter().map(|&t| usize::from(t - self.first));
            coder.encode_iid_symbols_reverse(symbols, &self.encode).map_err(refused)?;
            let words = coder.into_compressed().map_err(refused)?;
            for (place, word) in room.chunks_exact_mut(2).zip(&words) {
                place.copy_from_slice(&word.to_le_bytes());
            }
            *place = (0, 2 * words.len());
        }
        Ok(true)
    }

    fn decode(&mut self, packets: &Packets, bodies: &[&[u8]], out: &mut Decoded) -> Result<()> {
        let mut words = Vec::new();
        for (body, tokens) in bodies.iter().copied().zip(out.tokens.chunks_exact_mut(packets.len)) {
            words.clear();
            words.extend(body.as_chunks::<2>().0.iter().map(|pair| u16::from_le_bytes(*pair)));
            let mut coder = SmallAnsCoder::from_compressed_slice(&words).map_err(refused)?;
            let symbols = coder.decode_iid_symbols(tokens.len(), &self.decode);
            for (token, symbol) in tokens.iter_mut().zip(symbols) {
                *token = symbol.map_err(refused)? as u8 + self.first;
            }
        }
        Ok(())
    }
}

/// `zstd`, level 1, with a dictionary of the law's tables: C, several coders in one.
struct Zstd {
    compressor: Compressor<'static>,
    decompressor: Decompressor<'static>,
}

impl Zstd {
    fn new(packets: &Packets) -> Result<Self> {
        let samples: Vec<&[u8]> = packets.tokens.chunks_exact(packets.len).collect();
        let dictionary = zstd::dict::from_samples(&samples, 1 << 12)?;
        let mut compressor = Compressor::with_dictionary(1, &dictionary)?;
        compressor.set_parameter(CParameter::ContentSizeFlag(false))?;
        compressor.set_parameter(CParameter::ChecksumFlag(false))?;
        compressor.set_parameter(CParameter::DictIdFlag(false))?;
        Ok(Self { compressor, decompressor: Decompressor::with_dictionary(&dictionary)? })
    }
}

impl Coder for Zstd {
    fn name(&self) -> String {
        "zstd-dictionary".into()
    }

    fn whole(&self) -> bool {
        false
    }

    fn rust(&self) -> bool {
        false
    }

    fn encode(&mut self, packets: &Packets, arena: &mut Arena) -> Result<bool> {
        for (tokens, (room, place)) in packets.tokens.chunks_exact(packets.len).zip(arena.rooms()) {
            // Where it does not compress, a packet may be longer than its room.
            *place = (0, self.compressor.compress_to_buffer(tokens, room)?);
        }
        Ok(true)
    }

    fn decode(&mut self, packets: &Packets, bodies: &[&[u8]], out: &mut Decoded) -> Result<()> {
        for (body, tokens) in bodies.iter().copied().zip(out.tokens.chunks_exact_mut(packets.len)) {
            self.decompressor.decompress_to_buffer(body, tokens)?;
        }
        Ok(())
    }
}
