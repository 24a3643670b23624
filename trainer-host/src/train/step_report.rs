//! A step's report says what it did, and its stages what it is doing.

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

/// Parts of a step, for whoever measures them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Choosing a view; new sizes and nodes.
    Prepare,
    /// Moving the Gaussians to the view's time.
    Pose,
    /// Rendering, loss and gradients of the splats.
    Render,
    /// Gradients of attributes and nodes.
    Motion,
    /// Steps of Adam.
    Update,
    /// Adding and removing Gaussians.
    Density,
}
