//! Loses datagrams in bursts: the two-state Markov channel of Gilbert and Elliott.
//!
//! The state changes once per datagram, before the loss is drawn. Mean burst length is 1 / `leave_bad`
//! datagrams; the long-run share of time in the bad state is `enter_bad / (enter_bad + leave_bad)`.

use super::loss::LossProcess;
use crate::{
    clock::Nanos,
    rng::{Probability, RandomStream},
};

/// Chances per datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GilbertElliottParams {
    /// Good to bad.
    pub enter_bad: Probability,
    /// Bad to good.
    pub leave_bad: Probability,
    /// Loss in the good state.
    pub loss_good: Probability,
    /// Loss in the bad state.
    pub loss_bad: Probability,
}

/// Loses datagrams in bursts.
#[derive(Clone, Copy, Debug)]
pub struct GilbertElliott {
    params: GilbertElliottParams,
    bad: bool,
}

impl GilbertElliott {
    /// Starts in the good state.
    pub const fn new(params: GilbertElliottParams) -> Self {
        Self { params, bad: false }
    }
}

impl LossProcess for GilbertElliott {
    fn loses(&mut self, random: &mut RandomStream, _now: Nanos) -> bool {
        let change = if self.bad { self.params.leave_bad } else { self.params.enter_bad };
        self.bad ^= random.happens(change);
        random.happens(if self.bad { self.params.loss_bad } else { self.params.loss_good })
    }
}

#[cfg(test)]
mod tests {
    use super::{
        super::{BoxOutput, Datagram, LinkBox, loss::Loss},
        *,
    };

    #[test]
    fn losses_come_in_bursts_of_the_given_length_and_share() {
        let chance = |p| Probability::new(p).unwrap();
        let params = GilbertElliottParams {
            enter_bad: chance(0.01),
            leave_bad: chance(0.25),
            loss_good: chance(0.0),
            loss_bad: chance(1.0),
        };
        let mut link = Loss::new("ge", GilbertElliott::new(params), 5);
        let lost: Vec<bool> = (0..200_000)
            .map(|tag| link.step(Some(Datagram { tag, bytes: 100 }), Nanos::ZERO) == BoxOutput::Idle)
            .collect();
        let losses = lost.iter().filter(|lost| **lost).count() as f64;
        let bursts = lost.windows(2).filter(|pair| !pair[0] && pair[1]).count() as f64;
        assert!((losses / 200_000.0 - 0.01 / 0.26).abs() < 0.004, "{losses}");
        assert!((losses / bursts - 4.0).abs() < 0.3, "{}", losses / bursts);
        assert!(link.counts().balanced());
    }
}
