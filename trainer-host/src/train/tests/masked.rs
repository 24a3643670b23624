//! Tests of masks in training and evaluation.

use super::*;

/// A spot that is in every photograph is trained where it counts and not where a mask leaves it out; what
/// is compared is compared where it counts.
#[test]
fn pixels_that_do_not_count_are_not_trained_on() {
    let clean = dataset(synth::SynthKind::Balls, 1, 12);
    let spot = |x: u32, y: u32| (24..40).contains(&x) && (24..40).contains(&y);
    let masked = |counted: bool| {
        let view = |view: &PosedPhotograph| {
            let pixels = || (0..64 * 64u32).map(|at| spot(at % 64, at / 64));
            let rgba = view.photograph.rgba().chunks_exact(4).zip(pixels());
            let rgba =
                rgba.flat_map(|(pixel, spot)| if spot { vec![255, 0, 255, 255] } else { pixel.to_vec() });
            let mask = PixelMask::new(64, 64, pixels().map(|spot| u8::from(!spot)).collect());
            PosedPhotograph {
                photograph: Photograph::new(64, 64, rgba.collect()).unwrap(),
                counted: mask.filter(|_| counted),
                ..view.clone()
            }
        };
        let train = Views::new(clean.train.photographs().iter().map(view).collect()).unwrap();
        Dataset { train, ..clean.clone() }
    };
    let psnr = |views: &Dataset| {
        let trained = trained(views, &options(), 300);
        evaluate(&*trained.model(), &clean.test, 1, [0.0; 3]).unwrap().psnr_db
    };
    let (with, without) = (masked(true), masked(false));
    let (with_mask, without_mask) = (psnr(&with), psnr(&without));
    assert!(with_mask > without_mask + 3.0, "{with_mask} {without_mask}");
    let clean_trained = trained(&clean, &options(), 300);
    let against = |views: &Dataset| evaluate(&*clean_trained.model(), &views.train, 1, [0.0; 3]).unwrap();
    assert!(against(&with).psnr_db > against(&without).psnr_db + 3.0);
    assert!(against(&with).ssim > against(&without).ssim + 0.02);
    let seen =
        |views: &Dataset| perceptual(&*clean_trained.model(), &views.train, 1, [0.0; 3], None).unwrap();
    assert!(seen(&with).flip < seen(&without).flip - 0.02);
}
