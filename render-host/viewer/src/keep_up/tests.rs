//! Scripted times give the steps that they should, and never a swing.

use super::*;

const VIEW: [f64; 6] = [0.0; 6];

/// A player that draws pictures one after the other, with the step at which each was drawn.
struct Script {
    keep_up: KeepUp,
    now_s: f64,
    steps: Vec<usize>,
}

impl Script {
    fn new() -> Self {
        let mut keep_up = KeepUp::default();
        keep_up.look(0.0, true, VIEW);
        Self { keep_up, now_s: 0.0, steps: vec![0] }
    }

    /// Draws for `seconds` pictures that take as long as `cost` says of the step that they are drawn at.
    fn run(&mut self, seconds: f64, cost: impl Fn(usize) -> f64) -> &mut Self {
        let end = self.now_s + seconds;
        while self.now_s < end {
            let took = cost(self.keep_up.at);
            self.now_s += took.max(1.0 / 60.0);
            self.keep_up.look(self.now_s, true, VIEW);
            let before = self.keep_up.at;
            let stepped = self.keep_up.picture(self.now_s, took);
            assert_eq!(stepped, self.keep_up.at != before);
            if stepped {
                self.steps.push(self.keep_up.at);
            }
        }
        self
    }

    /// How often it went up.
    fn rises(&self) -> usize {
        self.steps.windows(2).filter(|pair| pair[1] < pair[0]).count()
    }
}

#[test]
fn it_goes_down_within_a_second_and_up_one_step_in_five() {
    let mut script = Script::new();
    // A hitch is no reason.
    script.run(0.5, |_| 0.02).run(0.3, |_| 0.3).run(0.5, |_| 0.02);
    assert_eq!(script.steps, [0]);
    let begun = script.now_s;
    script.run(0.6, |_| 0.07);
    assert_eq!(script.steps, [0, 1]);
    assert!(script.now_s - begun < 1.0);
    script.run(4.5, |_| 0.02);
    assert_eq!(script.steps, [0, 1], "not yet");
    script.run(1.0, |_| 0.02);
    assert_eq!(script.steps, [0, 1, 0]);
    // Neither late nor early: nothing changes.
    script.run(2.0, |_| 0.07).run(60.0, |_| 0.05);
    assert_eq!(*script.steps.last().unwrap(), 3, "{:?}", script.steps);
}

#[test]
fn what_is_far_too_late_skips_steps_and_ends_at_the_last() {
    let mut script = Script::new();
    script.run(10.0, |_| 0.5);
    assert_eq!(script.steps, [0, 2, 4, 6, 7]);
    assert_eq!(script.keep_up.reduction(), Reduction::STEPS[7]);
    script.run(100.0, |_| 0.5);
    assert_eq!(script.steps.len(), 5);
}

/// A device that can draw what is left at step 3, and not at step 2: each time that is tried again, it takes
/// twice as long.
#[test]
fn it_does_not_swing() {
    let cost = |step: usize| if step < 3 { 0.08 } else { 0.02 };
    let mut script = Script::new();
    script.run(3600.0, cost);
    assert_eq!(script.steps[..4], [0, 1, 2, 3]);
    assert!((5..=10).contains(&script.rises()), "{} in an hour", script.rises());
    let rises = script.rises();
    script.run(1200.0, cost);
    assert!(script.rises() <= rises + 1);
    assert!(script.steps[3..].iter().all(|step| [2, 3].contains(step)), "{:?}", script.steps);
    // Once the load is gone all of it comes back.
    script.run(7200.0, |_| 0.01);
    assert_eq!(script.keep_up.at, 0);
}

#[test]
fn the_same_times_give_the_same_steps_and_wild_ones_swing_seldom() {
    let wild = |seed: u64| {
        let mut script = Script::new();
        let mut state = seed;
        for _ in 0..20_000 {
            // Xorshift (Marsaglia 2003).
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            let took = 0.005 + 0.1 * (state % 1000) as f64 / 1000.0;
            script.run(0.01, |_| took);
        }
        script.steps
    };
    for seed in 1..6 {
        let steps = wild(seed);
        assert_eq!(steps, wild(seed));
        assert!(steps.len() < 12, "{steps:?}");
    }
}

#[test]
fn what_is_still_is_whole_and_a_switch_ends_it() {
    let mut script = Script::new();
    script.run(2.0, |_| 0.5);
    let keep_up = &mut script.keep_up;
    let step = keep_up.reduction();
    assert!(step != Reduction::NONE && !keep_up.sentence().is_empty());
    assert!(!keep_up.look(10.0, false, VIEW));
    assert_eq!((keep_up.reduction(), keep_up.sentence()), (Reduction::NONE, String::new()));
    assert!(!keep_up.picture(10.1, 9.0), "what is still may take its time");
    // A camera that moves is not still until a moment after.
    let moved = [1.0; 6];
    assert!(keep_up.look(11.0, false, moved) && keep_up.look(11.2, false, moved));
    assert_eq!(keep_up.reduction(), step);
    assert!(!keep_up.look(11.4, false, moved));
    keep_up.look(12.0, true, moved);
    assert_eq!(keep_up.reduction(), step);
    keep_up.rest();
    assert_eq!(keep_up.reduction(), Reduction::NONE);
    keep_up.look(12.1, true, moved);
    keep_up.set_on(false);
    assert!(!keep_up.is_on() && (0..99).all(|_| !keep_up.picture(13.0, 1.0)));
    assert_eq!(keep_up.reduction(), Reduction::NONE);
    keep_up.set_on(true);
    assert_eq!((keep_up.at, keep_up.reduction()), (0, Reduction::NONE), "it begins anew");
    assert!(!keep_up.picture(14.0, f64::NAN));
}

#[test]
fn steps_that_change_nothing_are_skipped_and_not_spoken_of() {
    let mut script = Script::new();
    // Colours without harmonics, the base alone, pixels as they are: only Gaussians are left.
    script.keep_up.set_most(0, 0, true);
    script.run(2.0, |_| 0.07);
    assert_eq!(script.steps, [0, 6, 7]);
    assert_eq!(script.keep_up.sentence(), "25 % of the Gaussians");
    let drawn = script.keep_up.reduction();
    assert_eq!((drawn.scale, drawn.sh_degree, drawn.cap), (1.0, 0, 0));
    script.run(60.0, |_| 0.01);
    assert_eq!(script.steps, [0, 6, 7, 6, 5]);
    assert_eq!(script.keep_up.sentence(), "");
    let said = Reduction::STEPS.map(|step| step.to_string());
    assert_eq!(said[0], "");
    assert_eq!(said[1], "56 % of the pixels");
    assert_eq!(said[3], "25 % of the pixels, harmonics of degree 1");
    let last = "25 % of the pixels, one colour from all sides, levels up to 1, 25 % of the Gaussians";
    assert_eq!(said[7], last);
    // Each leaves out what the one before does.
    assert!(Reduction::STEPS.windows(2).all(|pair| pair[1].within(&pair[0]) == pair[1]));
}
