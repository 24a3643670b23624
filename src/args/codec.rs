//! What every verb takes that encodes.

use clap::{Args, ValueEnum};
use codec_core::internals::limits;
use trainer_host::encode::Protection;

use super::number::{coarseness, positive, real, repair_set, whole};

const COARSENESS: f32 = 1.0;
const CLUSTER_SIZE: usize = 512;
const BLOCK_LEN: usize = 64;
const PACKET_BYTES: usize = 1150;
/// Least target PSNR, dB: above 0.
const MIN_PSNR_DB: f64 = 1e-3;

/// Options that only profile `dgs1` has.
const OF_DGS1: [&str; 4] = ["--pictures", "--block-len", "--window-frames", "--packet-bytes"];

/// How to encode.
#[derive(Clone, Debug, Args)]
pub struct CodecArgs {
    /// Format choices.
    #[arg(long, value_enum, default_value_t = ProfileName::Dgs1)]
    pub profile: ProfileName,
    /// Quantiser steps relative to the visually lossless default, 0.001 to 1000: 2 is twice as coarse.
    #[arg(
        long, default_value_t = COARSENESS, group = "fineness", value_parser = coarseness,
        allow_negative_numbers = true
    )]
    pub coarseness: f32,
    /// Choose the coarseness, 0.001 to 1024: at most this many bits per Gaussian on the wire, as close as up
    /// to 8 encodings come; a scene with less to say takes fewer.
    #[arg(
        long, value_name = "BITS", group = "fineness", value_parser = positive,
        allow_negative_numbers = true
    )]
    pub target_bits_per_gaussian: Option<f64>,
    /// Choose the coarseness, 0.001 to 1024: at most this many bytes on the wire (manifest, packets and
    /// parity), as close as up to 8 encodings come; a scene with less to say takes fewer.
    #[arg(long, value_name = "BYTES", group = "fineness", value_parser = whole::<u64>(1..=u64::MAX, "bytes"))]
    pub target_bytes: Option<u64>,
    /// Choose the coarseness, 0.001 to 1024, in up to 8 encodings: at least this PSNR in dB, above 0 and at
    /// most 99, from validation (never held-out) cameras; a picture counts by the share of it that the scene
    /// covers.
    #[arg(
        long, value_name = "DB", group = "fineness", value_parser = real(MIN_PSNR_DB..=99.0, "dB"),
        allow_negative_numbers = true
    )]
    pub target_psnr: Option<f64>,
    /// Pictures per epoch that tell how much an error in each Gaussian shows: steps follow (dgs1). 1 to
    /// 1024; 0: the same steps for all [default: 16; 0 where dgs train rounds values itself].
    #[arg(long, value_parser = whole::<usize>(0..=1024, "pictures"))]
    pub pictures: Option<usize>,
    /// Spend up to this many trial encodings, 4 to 500, on how attributes share the bits: fewer bytes at the
    /// same PSNR from validation cameras, or a higher one at a target size. Up to 8 more encodings then come
    /// back to that PSNR, or meet the target if one is given. 24 are a good start; 0 is no search.
    #[arg(long, value_name = "ENCODINGS", default_value_t = 0, value_parser = trial_encodings)]
    pub search: usize,
    /// Most Gaussians in a cluster: 1 to 32768. Sets of more than 192 that are spread out are cut whatever is
    /// allowed; a note says so where no cluster comes near the bound.
    #[arg(
        long, default_value_t = CLUSTER_SIZE, value_parser = whole(1..=limits::MAX_CLUSTER_LEN, "Gaussians")
    )]
    pub cluster_size: usize,
    /// Gaussians per block, the unit of loss: 1 to 256 (dgs1).
    #[arg(long, default_value_t = BLOCK_LEN, value_parser = whole(1..=limits::MAX_BLOCK_LEN, "Gaussians"))]
    pub block_len: usize,
    /// Most frames in a motion window, 1 to 64 (dgs1) [default: one second].
    #[arg(long, value_parser = whole(1..=limits::MAX_WINDOW_FRAMES, "frames"))]
    pub window_frames: Option<usize>,
    /// Most vectors in the shared temporal basis, 0 to 64 [default: 8, in profile paper 4].
    #[arg(long, value_parser = whole(0..=limits::MAX_RANK, "vectors"))]
    pub rank: Option<usize>,
    /// Largest packet, 200 to 1226 bytes, header and CRC included (dgs1).
    #[arg(long, default_value_t = PACKET_BYTES, value_parser = whole::<usize>(200..=1226, "bytes"))]
    pub packet_bytes: usize,
    /// Base packets per XOR repair set, 2 to 64; 0 sends no parity.
    #[arg(long, conflicts_with = "repair", value_parser = repair_set)]
    pub repair_set: Option<u8>,
    /// Parity per kind of packets: none, standard, strong (where nothing is sent again), full (where besides
    /// one packet in ten is lost), or a list of KIND=K+R (any R losses of K packets are repaired) with KIND
    /// base, tracks, 1, 2 or 3; with @P% behind it smaller sets are as safe at a loss of P as full ones
    /// [default: standard in stream, demo and serve, where it is sent; none elsewhere].
    #[arg(long, value_parser = Protection::parse)]
    pub repair: Option<Protection>,
}

/// Parses the most trial encodings of a search: with fewer than 4 no step could be compared with another.
fn trial_encodings(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(most @ (0 | 4..=500)) => Ok(most),
        _ => Err("4 to 500 trial encodings, or 0 for no search, is allowed".to_owned()),
    }
}

impl CodecArgs {
    /// The options that differ from their defaults.
    pub fn given(&self) -> Vec<&'static str> {
        let options = [
            ("--profile", self.profile != ProfileName::Dgs1),
            ("--coarseness", self.coarseness != COARSENESS),
            ("--target-bits-per-gaussian", self.target_bits_per_gaussian.is_some()),
            ("--target-bytes", self.target_bytes.is_some()),
            ("--target-psnr", self.target_psnr.is_some()),
            ("--pictures", self.pictures.is_some()),
            ("--search", self.search != 0),
            ("--cluster-size", self.cluster_size != CLUSTER_SIZE),
            ("--block-len", self.block_len != BLOCK_LEN),
            ("--window-frames", self.window_frames.is_some()),
            ("--rank", self.rank.is_some()),
            ("--packet-bytes", self.packet_bytes != PACKET_BYTES),
            ("--repair-set", self.repair_set.is_some()),
            ("--repair", self.repair.is_some()),
        ];
        options.into_iter().filter(|(_, is_given)| *is_given).map(|(name, _)| name).collect()
    }

    /// Every option and its value as it is typed; "none" where there is none.
    pub fn values(&self) -> Vec<(&'static str, String)> {
        fn typed<T: ToString>(value: Option<T>) -> String {
            value.map_or_else(|| "none".to_owned(), |value| value.to_string())
        }
        let profile = self.profile.to_possible_value();
        vec![
            ("--profile", typed(profile.as_ref().map(|profile| profile.get_name()))),
            ("--coarseness", self.coarseness.to_string()),
            ("--target-bits-per-gaussian", typed(self.target_bits_per_gaussian)),
            ("--target-bytes", typed(self.target_bytes)),
            ("--target-psnr", typed(self.target_psnr)),
            ("--pictures", typed(self.pictures)),
            ("--search", self.search.to_string()),
            ("--cluster-size", self.cluster_size.to_string()),
            ("--block-len", self.block_len.to_string()),
            ("--window-frames", typed(self.window_frames)),
            ("--rank", typed(self.rank)),
            ("--packet-bytes", self.packet_bytes.to_string()),
            ("--repair-set", typed(self.repair_set)),
            ("--repair", typed(self.repair)),
        ]
    }

    /// The options that differ from their defaults and mean nothing to the profile.
    pub fn unused(&self) -> Vec<&'static str> {
        if self.profile == ProfileName::Dgs1 {
            return Vec::new();
        }
        self.given().into_iter().filter(|name| OF_DGS1.contains(name)).collect()
    }
}

/// A named set of format choices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ProfileName {
    /// The paper's format, the baseline.
    Paper,
    /// The paper's format with its context-adaptive coder.
    PaperContext,
    /// This project's format.
    Dgs1,
}

#[cfg(test)]
mod tests {
    use super::trial_encodings;

    /// Trials that would do nothing are refused, as are more than an encoding spends.
    #[test]
    fn a_search_has_no_trials_or_enough() {
        for text in ["1", "2", "3", "501", "-4", "4.5", "many", ""] {
            let refused = trial_encodings(text).unwrap_err();
            assert_eq!(refused, "4 to 500 trial encodings, or 0 for no search, is allowed", "{text}");
        }
        for most in [0, 4, 24, 500] {
            assert_eq!(trial_encodings(&most.to_string()), Ok(most));
        }
    }
}
