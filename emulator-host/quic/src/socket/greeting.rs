//! Waits for the control stream of a client and its first message.

use std::time::{Duration, Instant};

use tokio::time::timeout_at;

use super::{
    carrier::{ControlWriter, Opened, SessionCloser, SessionTransport},
    channel::Closed,
    control::{Control, ControlError},
    message::{ClientMessage, Refusal, RefusalCode, StreamChoice},
    viewer::End,
};

/// A hello, and what it came on.
pub(super) struct Greeting {
    pub(super) carrier: SessionTransport,
    pub(super) ending: SessionCloser,
    pub(super) send: ControlWriter,
    pub(super) control: Control<ClientMessage>,
    pub(super) stream: StreamChoice,
    pub(super) start_us: u64,
}

/// Why there is no session, and what it can be said on.
pub(super) struct NoSession {
    pub(super) end: End,
    pub(super) opened: Option<(SessionCloser, ControlWriter)>,
}

impl NoSession {
    /// A refusal before there is a control stream.
    pub(super) const fn before(refusal: Refusal) -> Self {
        Self { end: End::Refused(refusal), opened: None }
    }
}

impl Greeting {
    /// No session after all.
    pub(super) fn refused(self, code: RefusalCode, sentence: String) -> NoSession {
        let end = End::Refused(Refusal { code, sentence });
        NoSession { end, opened: Some((self.ending, self.send)) }
    }
}

/// Waits for a hello on what `opening` becomes, for `wait` in all.
pub(super) async fn greeting(
    opening: impl Future<Output = Result<Opened, Closed>>,
    wait: Duration,
) -> Result<Greeting, NoSession> {
    let deadline = (Instant::now() + wait).into();
    let late = || {
        let sentence = format!("no hello within {} ms", wait.as_millis());
        Refusal { code: RefusalCode::Silence, sentence }
    };
    let opened = timeout_at(deadline, opening).await;
    let opened = opened.map_err(|_| NoSession::before(late()))?;
    let (carrier, mut ending, send, mut control) = opened.map_err(unopened)?;
    let first = tokio::select! {
        first = timeout_at(deadline, control.next()) => first,
        closed = ending.closed() => return Err(NoSession { end: closed.into(), opened: None }),
    };
    let refusal = |sentence: String| Refusal { code: RefusalCode::Message, sentence };
    let refusal = match first {
        Ok(Ok(Some(ClientMessage::Hello { stream, start_us }))) => {
            return Ok(Greeting { carrier, ending, send, control, stream, start_us });
        }
        Ok(Ok(_)) => refusal("the first message is hello".to_owned()),
        Ok(Err(ControlError::Message(error))) => error.refusal(),
        Ok(Err(error)) => refusal(error.to_string()),
        Err(_) => late(),
    };
    Err(NoSession { end: End::Refused(refusal), opened: Some((ending, send)) })
}

/// What it means that there is no control stream.
fn unopened(closed: Closed) -> NoSession {
    match closed {
        Closed::Web(error) => {
            NoSession::before(Refusal { code: RefusalCode::Message, sentence: error.to_string() })
        }
        closed => NoSession { end: closed.into(), opened: None },
    }
}
