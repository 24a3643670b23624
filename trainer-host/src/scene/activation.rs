//! Goes between the domains that a scene is stored in and those that a renderer draws: of opacity and colour.

/// Value of the harmonic of band 0, which is constant: display colour is `0.5 + SH_C0 · sh0`.
pub const SH_C0: f32 = render_host::harmonics::C0 as f32;

/// Opacity, 0 to 1, of a logit.
pub fn sigmoid(logit: f32) -> f32 {
    1.0 / (1.0 + (-logit).exp())
}

/// Logit of an opacity in 0..=1; infinite at both ends.
pub fn logit(opacity: f32) -> f32 {
    (opacity / (1.0 - opacity)).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_undoes_the_other() {
        for opacity in [0.0, 1e-6, 0.25, 0.5, 0.999, 1.0] {
            assert!((sigmoid(logit(opacity)) - opacity).abs() < 1e-6, "{opacity}");
        }
        assert_eq!((logit(0.0), logit(1.0), sigmoid(0.0)), (f32::NEG_INFINITY, f32::INFINITY, 0.5));
        assert_eq!(SH_C0, (0.5 / std::f64::consts::PI.sqrt()) as f32);
    }
}
