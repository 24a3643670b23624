//! Tells scenes apart by a digest of their values.

use codec_core::internals::digest::Digest;

use super::{Scene, Track};

impl Scene {
    /// A digest of every value of every epoch, bit for bit; of nothing else, such as the frame rate.
    pub fn digest(&self) -> Digest {
        let mut all = Digest::new();
        for epoch in self.epochs() {
            let a = epoch.attributes();
            all = all
                .bytes(&(epoch.frames() as u64).to_le_bytes())
                .bytes(&(epoch.count() as u64).to_le_bytes());
            all = with(all, &a.positions, |v| v);
            all = with(all, &a.rotations, |v| v);
            all = with(all, &a.log_scales, |v| v);
            all = with(all, &a.opacity_logits, |v| [v]);
            all = with(all, &a.sh0, |v| v);
            all = all.values(&a.sh_rest);
        }
        all
    }
}

fn with<T: Copy, const N: usize>(digest: Digest, track: &Track<T>, of: impl Fn(T) -> [f32; N]) -> Digest {
    let (Track::Constant(all) | Track::PerFrame(all)) = track;
    all.iter().fold(digest, |digest, &value| digest.values(&of(value)))
}
