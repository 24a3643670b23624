//! Says how sessions end, and what their viewers got.

use std::{net::SocketAddr, time::Duration};

use serde::Serialize;

use crate::socket::{
    carrier::{ControlWriter, SessionCloser},
    channel::Closed,
    message::{Message as _, Refusal, RefusalCode, ServerMessage},
};

/// What one viewer got and said.
#[derive(Clone, Debug, Serialize)]
pub struct ViewerReport {
    /// Where it was.
    pub address: SocketAddr,
    /// Name of the stream.
    pub stream: String,
    /// What chose its packets at the end.
    pub scheduler: &'static str,
    /// Seconds from hello to end.
    pub seconds: f64,
    /// Rounds begun: the first, seeks and repeats.
    pub rounds: u32,
    /// Packets sent, repeats and parity included.
    pub packets: u64,
    /// Their bytes.
    pub media_bytes: u64,
    /// Packets sent again.
    pub retransmitted: u64,
    /// Parity sent.
    pub parity: u64,
    /// Packets that were lost, as far as receipts tell.
    pub lost: u64,
    /// Receipts taken.
    pub receipts: u64,
    /// Whether it said where it is.
    pub located: bool,
    /// Datagrams from the client that are no receipt of a known round.
    pub refused_receipts: u64,
    /// Smoothed round trip at the end, milliseconds.
    pub rtt_ms: f64,
    /// Why it ended.
    pub end: String,
}

/// How a session ended.
#[derive(Debug)]
pub(in crate::socket) enum End {
    /// The client is through.
    Bye,
    /// The server ends it and says why.
    Refused(Refusal),
    /// The connection is gone.
    Gone(Closed),
}

impl End {
    /// The code of a refusal.
    pub(in crate::socket) fn refused(&self) -> Option<RefusalCode> {
        match self {
            Self::Refused(refusal) => Some(refusal.code),
            Self::Bye | Self::Gone(_) => None,
        }
    }
}

impl From<Closed> for End {
    fn from(closed: Closed) -> Self {
        if closed.code() == Some(0) { Self::Bye } else { Self::Gone(closed) }
    }
}

impl std::fmt::Display for End {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Bye => f.write_str("the viewer is through"),
            Self::Refused(refusal) => refusal.fmt(f),
            Self::Gone(error) => error.fmt(f),
        }
    }
}

/// Says why, and closes.
pub(in crate::socket) async fn end_session(ending: SessionCloser, send: ControlWriter, end: &End) {
    let code = match end {
        End::Bye | End::Gone(_) => 0,
        End::Refused(refusal) => {
            // On the stream it is repeated until it has arrived; but a peer that does not read is not waited
            // for.
            let message = ServerMessage::Refusal(refusal.clone()).to_bytes();
            let _ = tokio::time::timeout(Duration::from_millis(500), send.finish(&message)).await;
            u32::from(refusal.code.number())
        }
    };
    let sentence = match end {
        // The code says the rest.
        End::Refused(refusal) => refusal.sentence.clone(),
        End::Bye | End::Gone(_) => end.to_string(),
    };
    ending.close(code, &sentence).await;
}

#[cfg(test)]
mod tests {
    use quinn::{ApplicationClose, ConnectionError, VarInt};
    use web_transport_proto::error_to_http3;

    use super::*;

    fn closed(code: u64, reason: &'static [u8]) -> Closed {
        let error_code = VarInt::from_u64(code).unwrap();
        ConnectionError::ApplicationClosed(ApplicationClose { error_code, reason: reason.into() }).into()
    }

    #[test]
    fn a_viewer_that_closes_is_through_by_whatever_that_is_heard() {
        let session = |code| Closed::Session { code, reason: String::new() };
        for closed in [closed(0, b""), closed(error_to_http3(0), b""), session(0)] {
            assert!(matches!(End::from(closed.clone()), End::Bye), "{closed}");
        }
        for closed in [closed(4, b""), session(4), ConnectionError::TimedOut.into(), Closed::Socket] {
            assert!(matches!(End::from(closed.clone()), End::Gone(_)), "{closed}");
        }
    }

    /// Neither a line nor an escape sequence of its own.
    #[test]
    fn what_a_peer_closes_with_is_one_line_of_text() {
        let closed = closed(4, b"bad\n127.0.0.1:1 figure\x1b[31m \xc2\x9b2J\x07");
        let refusal = closed.refusal().unwrap().to_string();
        for said in [End::from(closed).to_string(), refusal] {
            assert!(said.contains("bad") && !said.contains(char::is_control), "{said:?}");
        }
        let session = Closed::Session { code: 4, reason: "bad\n\u{9b}2J".to_owned() };
        assert!(!session.to_string().contains(char::is_control));
        assert!(!session.refusal().unwrap().to_string().contains(char::is_control));
    }
}
