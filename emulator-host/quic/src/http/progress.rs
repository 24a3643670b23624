//! Ends a connection whose peer takes what is sent too slowly.

use std::{
    io,
    pin::Pin,
    task::{Context, Poll, ready},
    time::Duration,
};

use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    time::{Instant, Sleep},
};

/// Bytes that must pass within the bound while a write waits.
const MIN_BYTES: usize = 16 << 10;

/// A connection on which writing must make progress: at least 16 KiB within `bound`, or all there is.
#[derive(Debug)]
pub(super) struct Progress<S> {
    stream: S,
    bound: Duration,
    /// When what waits must have passed, and how many bytes of it have.
    waiting: Option<(Pin<Box<Sleep>>, usize)>,
}

impl<S> Progress<S> {
    pub(super) fn new(stream: S, bound: Duration) -> Self {
        Self { stream, bound, waiting: None }
    }
}

impl<S: AsyncWrite + Unpin> Progress<S> {
    /// What became of a write: as it was, or the end if it has waited for too long.
    fn checked(&mut self, cx: &mut Context<'_>, written: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        match written {
            Poll::Ready(Ok(bytes)) => {
                if let Some((_, passed)) = &mut self.waiting {
                    *passed += bytes;
                    if *passed >= MIN_BYTES {
                        self.waiting = None;
                    }
                }
                Poll::Ready(Ok(bytes))
            }
            Poll::Ready(Err(error)) => Poll::Ready(Err(error)),
            Poll::Pending => {
                let end = || Box::pin(tokio::time::sleep_until(Instant::now() + self.bound));
                let (sleep, _) = self.waiting.get_or_insert_with(|| (end(), 0));
                ready!(sleep.as_mut().poll(cx));
                Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
            }
        }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Progress<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buffer)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Progress<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.checked(cx, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(cx, slices);
        self.checked(cx, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        ready!(Pin::new(&mut self.stream).poll_flush(cx))?;
        // Everything has passed: waiting begins anew.
        self.waiting = None;
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use std::task::Waker;

    use tokio::{runtime::Builder, time::sleep};

    use super::*;

    const BOUND: Duration = Duration::from_millis(200);

    /// A peer that takes so many bytes more.
    struct Narrow {
        room: usize,
    }

    impl AsyncWrite for Narrow {
        fn poll_write(
            mut self: Pin<&mut Self>,
            _cx: &mut Context<'_>,
            bytes: &[u8],
        ) -> Poll<io::Result<usize>> {
            let taken = self.room.min(bytes.len());
            self.room -= taken;
            if taken > 0 { Poll::Ready(Ok(taken)) } else { Poll::Pending }
        }

        fn poll_flush(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }

        fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }
    }

    /// What becomes of a write to a peer that takes `room` bytes.
    fn write(progress: &mut Progress<Narrow>, room: usize) -> Poll<io::Result<usize>> {
        progress.stream.room = room;
        Pin::new(progress).poll_write(&mut Context::from_waker(Waker::noop()), &[0; 2 * MIN_BYTES])
    }

    /// Nothing here depends on how long a pause really takes: the peer makes room before anybody looks.
    #[test]
    fn who_takes_enough_may_take_long_in_all_and_who_does_not_is_given_up() {
        Builder::new_current_thread().enable_time().build().unwrap().block_on(async {
            let mut progress = Progress::new(Narrow { room: 0 }, BOUND);
            // Twice the bound, never without progress.
            for _ in 0..20 {
                assert!(write(&mut progress, 0).is_pending());
                sleep(BOUND / 10).await;
                assert!(matches!(write(&mut progress, MIN_BYTES), Poll::Ready(Ok(MIN_BYTES))));
            }
            // What is too little in all is as good as nothing.
            assert!(write(&mut progress, 0).is_pending());
            for _ in 0..2 {
                assert!(matches!(write(&mut progress, MIN_BYTES / 2 - 1), Poll::Ready(Ok(_))));
            }
            sleep(2 * BOUND).await;
            match write(&mut progress, 0) {
                Poll::Ready(Err(error)) => assert_eq!(error.kind(), io::ErrorKind::TimedOut),
                other => panic!("{other:?}"),
            }
        });
    }
}
