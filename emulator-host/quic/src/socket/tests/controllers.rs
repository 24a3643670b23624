//! Viewers are sent to by the congestion controller that the server names.

use quinn::congestion::{Bbr, Cubic, NewReno};

use super::*;
use crate::congestion::{PathWatch, ScreamController, Watched};

#[test]
fn a_connection_has_the_controller_that_is_named() {
    within(async {
        for (control, name) in [
            (CongestionControl::NewReno, "newreno"),
            (CongestionControl::Cubic, "cubic"),
            (CongestionControl::Bbr, "bbr"),
            (CongestionControl::Scream, "scream"),
        ] {
            let Loopback { served, viewer, _ends } =
                Loopback::new(ServerLimits::default().transport(control)).await;
            let watched = served.congestion_state().into_any().downcast::<Watched<PathWatch>>().unwrap();
            let state = watched.inner.into_any();
            let found = [
                ("newreno", state.is::<NewReno>()),
                ("cubic", state.is::<Cubic>()),
                ("bbr", state.is::<Bbr>()),
                ("scream", state.is::<ScreamController>()),
            ];
            assert_eq!(found.into_iter().filter(|(_, is)| *is).collect::<Vec<_>>(), [(name, true)]);
            // Ten datagrams: more than that would be lost at once in the queue of a slow link.
            assert_eq!(served.congestion_state().initial_window(), 12_000, "{name}");
            drop(viewer);
        }
    });
}
