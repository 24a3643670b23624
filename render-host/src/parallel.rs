//! One switch between the rayon pool and the calling thread.
//!
//! Work is split the same way in both, and each piece writes only its own output, so the result cannot
//! depend on the switch or on the number of threads.

use rayon::prelude::*;

/// Calls `work(i, item i)` for every item of `items`.
pub(crate) fn for_each<T: Send>(parallel: bool, items: &mut [T], work: impl Fn(usize, &mut T) + Sync + Send) {
    if parallel {
        items.par_iter_mut().enumerate().for_each(|(i, item)| work(i, item));
    } else {
        items.iter_mut().enumerate().for_each(|(i, item)| work(i, item));
    }
}

/// Calls `work(i, chunk i)` for every `size` items of `items`; the last chunk may be shorter.
pub(crate) fn for_each_chunk<T: Send>(
    parallel: bool,
    items: &mut [T],
    size: usize,
    work: impl Fn(usize, &mut [T]) + Sync + Send,
) {
    if parallel {
        items.par_chunks_mut(size.max(1)).enumerate().for_each(|(i, chunk)| work(i, chunk));
    } else {
        items.chunks_mut(size.max(1)).enumerate().for_each(|(i, chunk)| work(i, chunk));
    }
}

/// Calls `work(room, i, item i)` for every item of `items`; each thread reuses its `room`.
pub(crate) fn for_each_with<T: Send, R: Default>(
    parallel: bool,
    items: &mut [T],
    work: impl Fn(&mut R, usize, &mut T) + Sync + Send,
) {
    if parallel {
        let items = items.par_iter_mut().enumerate().with_min_len(4);
        items.for_each_init(R::default, |room, (i, item)| work(room, i, item));
    } else {
        let mut room = R::default();
        items.iter_mut().enumerate().for_each(|(i, item)| work(&mut room, i, item));
    }
}
