//! A view order says which view the next step shows.

use rand::seq::SliceRandom;
use rand_pcg::{Pcg64Mcg, rand_core::SeedableRng};

/// All views in an order that is drawn anew for each pass over them.
#[derive(Debug)]
pub(super) struct ViewOrder {
    seed: u64,
    count: usize,
    /// Which pass `order` is of.
    pass: Option<u64>,
    order: Vec<usize>,
}

impl ViewOrder {
    /// Of `count` views, one at least.
    pub(super) fn new(count: usize, seed: u64) -> Self {
        Self { seed, count, pass: None, order: Vec::new() }
    }

    /// The first view after `drawn` others that `shows` what is wanted, which one at least must; counts all
    /// that are drawn until then.
    pub(super) fn next(&mut self, drawn: &mut u64, shows: impl Fn(usize) -> bool) -> usize {
        loop {
            let view = self.view(*drawn);
            *drawn += 1;
            if shows(view) {
                return view;
            }
        }
    }

    /// The view that is drawn after `drawn` others.
    fn view(&mut self, drawn: u64) -> usize {
        let (pass, place) = (drawn / self.count as u64, drawn % self.count as u64);
        if self.pass != Some(pass) {
            self.order = (0..self.count).collect();
            let seed = self.seed ^ pass.wrapping_mul(0xD1B5_4A32_D192_ED03) ^ 0x5EED;
            self.order.shuffle(&mut Pcg64Mcg::seed_from_u64(seed));
            self.pass = Some(pass);
        }
        self.order[place as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_pass_has_every_view_once_and_none_is_like_another() {
        let mut order = ViewOrder::new(20, 1);
        let mut pass =
            |from: u64| -> Vec<usize> { (from..from + 20).map(|drawn| order.view(drawn)).collect() };
        let (first, second, again) = (pass(0), pass(20), pass(0));
        let mut sorted = first.clone();
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq(0..20) && first != second && first == again);
    }
}
