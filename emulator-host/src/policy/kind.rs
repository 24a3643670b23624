//! Names the policies, and builds the scheduler of the one that is named.

use super::{
    Dash, DeadlineUtility, DeadlineUtilityConfig, Dependency, Layered, Scheduler,
    deadline_utility_paper::{DeadlineUtilityPaper, DeadlineUtilityPaperConfig},
};
use crate::graph::PacketGraph;

/// The policies by name.
///
/// # Examples
/// ```
/// use emulator_host::{PolicyKind, graph::Synthetic};
///
/// let graph = Synthetic::default().build(1)?;
/// for kind in PolicyKind::ALL {
///     assert_eq!(kind.build(&graph).name(), kind.name());
/// }
/// # Ok::<(), emulator_host::graph::GraphError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum PolicyKind {
    /// [`Layered`].
    Layered,
    /// [`Dash`].
    Dash,
    /// [`Dependency`].
    Dependency,
    /// [`DeadlineUtility`].
    DeadlineUtility,
    /// Scores by the paper's S(g) exactly. Around the score: the base of frame 0 comes first, groups with P_g
    /// below .05 are skipped, 16 are ranked together for up to 100 ms, and one that was begun is finished.
    DeadlineUtilityPaper,
}

impl PolicyKind {
    /// Every policy.
    pub const ALL: [Self; 5] =
        [Self::Dash, Self::DeadlineUtility, Self::DeadlineUtilityPaper, Self::Dependency, Self::Layered];

    /// Name in reports, as in the paper's table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Layered => "layered",
            Self::Dash => "dash",
            Self::Dependency => "dependency",
            Self::DeadlineUtility => "deadline-utility",
            Self::DeadlineUtilityPaper => "deadline-utility-paper",
        }
    }

    /// A fresh scheduler for `graph`.
    pub fn build(self, graph: &PacketGraph) -> Box<dyn Scheduler + Send> {
        match self {
            Self::Layered => Box::new(Layered::new(graph)),
            Self::Dash => Box::new(Dash::new(graph)),
            Self::Dependency => Box::new(Dependency::new(graph)),
            Self::DeadlineUtility => Box::new(DeadlineUtility::new(graph, DeadlineUtilityConfig::default())),
            Self::DeadlineUtilityPaper => {
                Box::new(DeadlineUtilityPaper::new(graph, DeadlineUtilityPaperConfig::default()))
            }
        }
    }
}
