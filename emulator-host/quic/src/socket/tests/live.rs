//! A stream that grows is played as it comes, by those who were there before and by those who come late.

use emulator_host::{
    graph::Selection,
    session::{Startup, StartupRule},
};
use tokio::task::LocalSet;

use super::*;

/// The stream with its first packets alone.
fn part(count: usize) -> (Stream, PacketGraph) {
    let mut part = stream();
    for at in count..part.packets().len() {
        part.remove(PacketId::new(at as u32).unwrap());
    }
    let whole = graph(&stream());
    let parts = Selection::with_packets(whole.parts(), |packet| packet.at() < count).of(whole.parts());
    (part, PacketGraph::new(parts).unwrap())
}

#[test]
fn what_comes_later_arrives_in_the_round_that_is_running() {
    within(async {
        let all = stream().packets().len();
        let (none, empty) = part(0);
        let (offer, feed) = ServedStream::live("live", &none, empty, 0).unwrap();
        let server = Running::offering(ServerLimits::default(), offer);
        // Playout begins when all has come, on a busy machine too: the session ends with the clip.
        let startup = Startup { rule: StartupRule::AfterWait, max_wait: Nanos::from_s(6) };
        let config = ClientConfig { start_us: u64::MAX, startup, ..server.client() };
        let viewer = async {
            let played = play(&config, &mut NullSink, std::future::pending()).await;
            assert!(played.error.is_none(), "{:?}", played.error);
            let player = played.player.unwrap();
            let has = (0..all).filter(|at| player.has(PacketId::new(*at as u32).unwrap())).count();
            (has, played.report)
        };
        let local = LocalSet::new();
        let growth = async {
            for count in [all / 2, all] {
                tokio::time::sleep(Duration::from_millis(300)).await;
                let (stream, graph) = part(count);
                feed.renew(&stream, graph, 0).unwrap();
            }
        };
        let ((has, report), ()) = local.run_until(async { tokio::join!(viewer, growth) }).await;
        assert_eq!((has, report.shown_count, report.refused), (all, u64::from(report.frames), 0));
        assert!(report.grows);
        // Who comes late begins at the newest window, whatever time it asks for, and does not begin again.
        let frames = report.frames;
        let (stream, graph) = part(all);
        feed.renew(&stream, graph, frames - 1).unwrap();
        let first = *super::super::served_stream::starts(&stream.manifest().unwrap()).last().unwrap();
        let late = ClientConfig { loops: true, ..server.client() };
        let played = play(&late, &mut NullSink, std::future::pending()).await.whole().unwrap();
        assert_eq!(played.shown_count, u64::from(frames - first), "{played:?}");
        assert_eq!(played.shown[0].frame, first);
        drop(feed);
        // The input has ended: nothing changes.
        let after = play(&late, &mut NullSink, std::future::pending()).await.whole().unwrap();
        assert_eq!(after.shown_count, played.shown_count);
        let (counts, viewers) = server.stop().await;
        assert_eq!((counts.viewers, counts.refused.len()), (3, 0), "{viewers:?}");
    });
}
