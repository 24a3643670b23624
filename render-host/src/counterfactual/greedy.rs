//! Delivery order by greed: always the group with the largest gain per cost in what has arrived so far.

use super::utilities::Kept;
use super::{CounterfactualError, Engine, States};

/// A greedy order and what each step of it gained.
#[derive(Clone, Debug, PartialEq)]
pub struct Greedy {
    /// Groups that the base lacked, first choice first.
    pub order: Vec<u32>,
    /// Fall of squared error at each choice; may be negative towards the end.
    pub gains: Vec<f64>,
    /// Squared error of the base, then after each choice.
    pub sse: Vec<f64>,
    /// Tiles looked at, the first look at all of them included.
    pub tiles: usize,
}

/// Orders all groups that the one world of `base` lacks. Ties go to the lower id.
pub(super) fn order(engine: &Engine, base: &States, costs: &[f64]) -> Result<Greedy, CounterfactualError> {
    let needed = engine.groups;
    if costs.len() != needed || costs.iter().any(|&c| !(c > 0.0 && c.is_finite())) {
        return Err(CounterfactualError::Costs { needed });
    }
    let mut state = base.clone();
    let mut kept = Kept::new(engine, &state);
    let mut now = kept.total(engine);
    let mut out = Greedy { order: vec![], gains: vec![], sse: now.sse.clone(), tiles: engine.shared.tiles() };
    while let Some(best) = best(&state, &now.delta, costs) {
        out.order.push(best as u32);
        out.gains.push(now.delta[best]);
        let before = state;
        state = States::new(needed);
        state.push(|group| group == best || before.has(0, group));
        out.tiles += kept.refresh(engine, &state, best as u32);
        now = kept.total(engine);
        out.sse.extend(&now.sse);
    }
    Ok(out)
}

/// The absent group with the largest gain per cost.
fn best(state: &States, gains: &[f64], costs: &[f64]) -> Option<usize> {
    let absent = (0..gains.len()).filter(|&group| !state.has(0, group));
    absent.reduce(
        |best, group| {
            if gains[group] / costs[group] > gains[best] / costs[best] { group } else { best }
        },
    )
}
