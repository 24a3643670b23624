//! A step's report says what it did.

/// What a step did.
#[derive(Clone, Debug, PartialEq)]
pub struct StepReport {
    /// Steps taken, this one included; after a rollback, those of the state that was fallen back to.
    pub step: u32,
    /// Index of the view in the training split.
    pub view: usize,
    /// Loss of the view.
    pub loss: f64,
    /// Running mean of the loss, over about 100 steps.
    pub mean_loss: f64,
    /// Width and height of the photographs that are trained on now, pixels.
    pub size: (u32, u32),
    /// Gaussians now.
    pub gaussians: usize,
    /// Control nodes now.
    pub nodes: usize,
    /// Where training fell back to an earlier state: the step that led there, from 1, and what was wrong.
    pub rollback: Option<(u32, String)>,
}
