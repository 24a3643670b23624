//! A parameter holds one attribute of many items and takes steps of Adam.
//!
//! Kingma and Ba, "Adam: A Method for Stochastic Optimization", algorithm 1.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Values that one task updates, about: fixed, so that the result does not depend on the number of threads.
const CHUNK: usize = 32_768;

/// Values of one attribute, `width` per item, with what Adam remembers of their gradients.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    width: usize,
    values: Vec<f32>,
    /// Running mean of gradients.
    first: Vec<f32>,
    /// Running mean of squared gradients.
    second: Vec<f32>,
    /// Not stored: written anew in each step.
    #[serde(skip)]
    gradient: Vec<f32>,
}

/// One step of Adam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamStep {
    /// Learning rate, units of the parameter.
    pub rate: f32,
    /// Decay of the running mean of gradients, 0.9 by custom.
    pub first_decay: f32,
    /// Decay of the running mean of squares, 0.999 by custom.
    pub second_decay: f32,
    /// Number of this step, from 1: early means are scaled up by it.
    pub number: u32,
}

impl AdamStep {
    /// What early means of gradients and of squares are scaled up by.
    fn scales(self) -> [f32; 2] {
        let power = self.number.min(i32::MAX as u32) as i32;
        [self.first_decay, self.second_decay].map(|decay| 1.0 / (1.0 - decay.powi(power)))
    }

    /// Moves `x` against its gradient `g`; `m` and `v` are its running means.
    #[inline]
    fn take(self, [first_scale, second_scale]: [f32; 2], x: &mut f32, m: &mut f32, v: &mut f32, g: f32) {
        let Self { rate, first_decay, second_decay, .. } = self;
        *m = first_decay * *m + (1.0 - first_decay) * g;
        *v = second_decay * *v + (1.0 - second_decay) * g * g;
        *x -= rate * *m * first_scale / ((*v * second_scale).sqrt() + 1e-15);
    }
}

impl Parameter {
    /// `values.len() / width` items that nothing is remembered of.
    pub fn new(width: usize, values: Vec<f32>) -> Self {
        let zero = vec![0.0; values.len()];
        Self { width, first: zero.clone(), second: zero.clone(), gradient: zero, values }
    }

    /// Values per item.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of items.
    pub fn items(&self) -> usize {
        self.values.len().checked_div(self.width).unwrap_or(0)
    }

    /// All values, item after item.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// The values of an item that exists.
    pub fn item(&self, index: usize) -> &[f32] {
        &self.values[index * self.width..][..self.width]
    }

    /// As [`Parameter::item`], to be changed from outside a step.
    pub fn item_mut(&mut self, index: usize) -> &mut [f32] {
        &mut self.values[index * self.width..][..self.width]
    }

    /// All values, to be changed from outside a step.
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }

    /// Where the gradient of the next step is written, as long as the values.
    pub fn gradient_mut(&mut self) -> &mut [f32] {
        self.gradient.resize(self.values.len(), 0.0);
        &mut self.gradient
    }

    /// The values and where their gradient is written.
    pub fn values_and_gradient(&mut self) -> (&[f32], &mut [f32]) {
        self.gradient.resize(self.values.len(), 0.0);
        (&self.values, &mut self.gradient)
    }

    /// Takes a step against the gradient.
    pub fn step(&mut self, step: AdamStep) {
        let scales = step.scales();
        self.update(|values, first, second, gradient| {
            for (((x, m), v), g) in values.iter_mut().zip(first).zip(second).zip(gradient) {
                step.take(scales, x, m, v, *g);
            }
        });
    }

    /// As [`Parameter::step`], where the values of an item have not begun together: `numbers` are those of
    /// this step, one per value of an item.
    pub fn step_numbered(&mut self, step: AdamStep, numbers: &[u32]) {
        let scales = numbers.iter().map(|&number| AdamStep { number, ..step }.scales());
        let (scales, width): (Vec<[f32; 2]>, usize) = (scales.collect(), self.width.max(1));
        self.update(|values, first, second, gradient| {
            let values = values.chunks_exact_mut(width);
            let means = first.chunks_exact_mut(width).zip(second.chunks_exact_mut(width));
            for ((values, (first, second)), gradient) in values.zip(means).zip(gradient.chunks_exact(width)) {
                let all = values.iter_mut().zip(first).zip(second).zip(gradient).zip(&scales);
                all.for_each(|((((x, m), v), g), scales)| step.take(*scales, x, m, v, *g));
            }
        });
    }

    /// Changes the values of whole items and their two running means by their gradients.
    fn update(&mut self, change: impl Fn(&mut [f32], &mut [f32], &mut [f32], &[f32]) + Sync) {
        self.gradient.resize(self.values.len(), 0.0);
        let width = self.width.max(1);
        let length = (CHUNK / width).max(1) * width;
        self.values
            .par_chunks_mut(length)
            .zip(self.first.par_chunks_mut(length))
            .zip(self.second.par_chunks_mut(length))
            .zip(self.gradient.par_chunks(length))
            .for_each(|(((values, first), second), gradient)| change(values, first, second, gradient));
    }

    /// Gives each of the `items` items there are `width` values, no fewer than it has: new ones come last,
    /// are 0, and nothing is remembered of them.
    pub fn widen(&mut self, width: usize, items: usize) {
        let (before, length) = (self.width, width * items);
        let wide = |from: &[f32]| {
            let mut to = vec![0.0; length];
            if before > 0 {
                let pairs = to.chunks_exact_mut(width).zip(from.chunks_exact(before));
                pairs.for_each(|(to, from)| to[..before].copy_from_slice(from));
            }
            to
        };
        let (values, first, second) = (wide(&self.values), wide(&self.first), wide(&self.second));
        *self = Self { width, values, first, second, gradient: vec![0.0; length] };
    }

    /// Keeps the items of these indices, in this order; an index may appear more than once. From place
    /// `fresh` on, items are copies: their gradients so far are another item's and are forgotten.
    pub fn select(&mut self, indices: &[usize], fresh: usize) {
        let width = self.width;
        let pick = |from: &[f32]| -> Vec<f32> {
            indices.iter().flat_map(|&i| from[i * width..][..width].iter().copied()).collect()
        };
        let (values, mut first, second) = (pick(&self.values), pick(&self.first), pick(&self.second));
        first[fresh.min(indices.len()) * width..].fill(0.0);
        *self = Self { width, gradient: vec![0.0; values.len()], values, first, second };
    }

    /// Whether lengths agree and every number is finite: what is read from a file may not be so.
    pub fn is_sound(&self, width: usize, items: usize) -> bool {
        let length = width * items;
        let parts = [&self.values, &self.first, &self.second];
        self.width == width
            && parts.iter().all(|part| part.len() == length && part.iter().all(|v| v.is_finite()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(number: u32) -> AdamStep {
        AdamStep { rate: 0.1, first_decay: 0.9, second_decay: 0.999, number }
    }

    #[test]
    fn steps_are_those_of_the_definition() {
        let mut parameter = Parameter::new(2, vec![1.0, -2.0, 0.5, 3.0]);
        let (mut x, mut m, mut v) = ([1.0f64, -2.0, 0.5, 3.0], [0.0f64; 4], [0.0f64; 4]);
        for number in 1..=50 {
            for (i, g) in parameter.gradient_mut().iter_mut().enumerate() {
                *g = (i as f32 + 1.0) * (0.3 * number as f32).sin();
            }
            parameter.step(step(number));
            for i in 0..4 {
                let g = f64::from((i as f32 + 1.0) * (0.3 * number as f32).sin());
                m[i] = 0.9 * m[i] + 0.1 * g;
                v[i] = 0.999 * v[i] + 0.001 * g * g;
                let (m, v) =
                    (m[i] / (1.0 - 0.9f64.powi(number as i32)), v[i] / (1.0 - 0.999f64.powi(number as i32)));
                x[i] -= 0.1 * m / (v.sqrt() + 1e-15);
            }
        }
        for (found, expected) in parameter.values().iter().zip(x) {
            assert!((f64::from(*found) - expected).abs() < 1e-4, "{found} {expected}");
        }
    }

    /// Three items of one value, which a second one joins after five steps.
    #[test]
    fn values_that_begin_late_take_the_steps_that_they_would_take_alone() {
        let pull = |number: u32, index: usize| (0.3 * number as f32 + index as f32).sin() + 0.5;
        let stepped = |parameter: &mut Parameter, number: u32, after: u32, numbers: &[u32]| {
            let width = parameter.width();
            let gradient = parameter.gradient_mut().iter_mut().enumerate();
            gradient.for_each(|(at, g)| *g = pull(number + after, at / width));
            parameter.step_numbered(step(number), numbers);
        };
        let (mut early, mut late) = (Parameter::new(1, vec![1.0, 2.0, 3.0]), Parameter::new(1, vec![0.0; 3]));
        (1..=5).for_each(|number| stepped(&mut early, number, 0, &[number]));
        let mut both = early.clone();
        both.widen(2, 3);
        assert!(both.is_sound(2, 3) && both.values().chunks(2).all(|item| item[1] == 0.0));
        let mut together = both.clone();
        for number in 6..=20 {
            stepped(&mut both, number, 0, &[number, number - 5]);
            stepped(&mut together, number, 0, &[number; 2]);
            stepped(&mut early, number, 0, &[number]);
            stepped(&mut late, number - 5, 5, &[number - 5]);
        }
        let [early, late] = [early, late].map(|parameter| parameter.values().to_vec());
        let columns = |parameter: &Parameter, at: usize| -> Vec<f32> {
            parameter.values().chunks(2).map(|item| item[at]).collect()
        };
        assert_eq!([columns(&both, 0), columns(&both, 1)], [early, late.clone()]);
        assert_ne!(columns(&together, 1), late, "steps of another count are longer");
    }

    #[test]
    fn values_that_begin_together_take_plain_steps() {
        let begun = || Parameter::new(3, (0..30).map(|at| at as f32).collect());
        let (mut plain, mut numbered) = (begun(), begun());
        for number in 1..=10 {
            for parameter in [&mut plain, &mut numbered] {
                let gradient = parameter.gradient_mut().iter_mut().enumerate();
                gradient.for_each(|(at, g)| *g = (at as f32 + number as f32).cos());
            }
            plain.step(step(number));
            numbered.step_numbered(step(number), &[number; 3]);
        }
        assert_eq!(plain, numbered);
    }

    #[test]
    fn selected_copies_forget_their_momentum_and_other_items_do_not() {
        let mut parameter = Parameter::new(1, vec![1.0, 2.0, 3.0]);
        parameter.gradient_mut().fill(1.0);
        parameter.step(step(1));
        parameter.select(&[2, 0, 0], 2);
        assert_eq!(parameter.items(), 3);
        assert!(parameter.first[1] > 0.0 && parameter.first[2] == 0.0);
        assert_eq!(parameter.item(1), parameter.item(2));
        assert!(parameter.is_sound(1, 3) && !parameter.is_sound(1, 4));
    }
}
