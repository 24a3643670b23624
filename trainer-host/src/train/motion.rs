//! Moves Gaussians by control nodes: a few rigid motions that every Gaussian near them blends.
//!
//! A node is a place with a motion over time (a turn about the place, and a shift); a Gaussian follows its
//! nearest nodes with weights that fall off with distance and that training corrects ("skinning"). Sparse
//! nodes join the views of different instants: without them each Gaussian would learn its path alone from
//! few views (Huang et al., "SC-GS", CVPR 2024, sections 4.1 and 4.2).

mod basis;
mod layer;
mod nodes;
mod residual;
mod rigidity;
mod skinning;
mod smoothness;
mod stillness;
mod trajectory;

pub use basis::TemporalBasis;
pub(super) use layer::{Followed, MovedPoint, NodeGradient};
pub(super) use nodes::ControlNodes;
pub(super) use residual::{Neighbourhoods, slopes as residual_slopes};
pub(super) use skinning::{Posed, PosedGradient, Rest, Skinned, SkinnedGradient};
pub(super) use trajectory::{Trajectory, times as trajectory_times};

/// Nodes that a Gaussian follows.
pub(super) const FOLLOWED: usize = 4;
