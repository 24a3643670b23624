//! Deliveries per second: 30 s of content at 5 Mbit/s over a constant 5 Mbit/s link and over a bursty trace.

use criterion::{Criterion, criterion_group, criterion_main};
use emulator_host::{
    PolicyKind, SessionConfig, Trace,
    clock::Nanos,
    graph::Synthetic,
    link::{Capacity, PathConfig},
    simulate,
};

fn sims(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("sims");
    group.sample_size(20);
    let clip = Synthetic::default().build(1);
    let bursty = Capacity::Trace(Trace::bursty(1, Nanos::from_s(60)));
    for (name, capacity) in [("constant", PathConfig::default().capacity), ("bursty", bursty)] {
        for policy in PolicyKind::ALL {
            let forward = PathConfig { capacity: capacity.clone(), ..PathConfig::default() };
            let config = SessionConfig { policy, forward, ..SessionConfig::default() };
            group.bench_function(format!("{name}/{}", policy.name()), |bencher| {
                bencher.iter(|| clip.as_ref().map(|graph| simulate(graph, &config)));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, sims);
criterion_main!(benches);
