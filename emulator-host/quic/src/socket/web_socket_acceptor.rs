//! An entrance takes the WebSockets that a page's server has granted to the server of sessions.

use std::{net::SocketAddr, sync::Arc};

use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};

use super::web_socket::Socket;

/// WebSockets that wait to be taken on.
const WAITING: usize = 16;

/// Hands upgraded WebSockets to the session server; clones share the channel.
#[derive(Clone, Debug)]
pub struct WebSocketAcceptor {
    granted: mpsc::Sender<AcceptedWebSocket>,
    places: Arc<Semaphore>,
}

/// A WebSocket on its way in.
#[derive(Debug)]
pub(super) struct AcceptedWebSocket {
    pub(super) socket: Socket,
    pub(super) address: SocketAddr,
    /// Given back when the WebSocket has ended.
    pub(super) place: OwnedSemaphorePermit,
}

impl WebSocketAcceptor {
    /// For so many WebSockets at once, and where they come out.
    pub(super) fn new(places: usize) -> (Self, mpsc::Receiver<AcceptedWebSocket>) {
        let (granted, entering) = mpsc::channel(WAITING);
        (Self { granted, places: Arc::new(Semaphore::new(places)) }, entering)
    }

    /// A place for one more, if there is one.
    pub(crate) fn place(&self) -> Option<OwnedSemaphorePermit> {
        self.places.clone().try_acquire_owned().ok()
    }

    /// Lets a WebSocket in. Where the server has closed, it is closed with it.
    pub(crate) async fn enter(&self, socket: Socket, address: SocketAddr, place: OwnedSemaphorePermit) {
        let _ = self.granted.send(AcceptedWebSocket { socket, address, place }).await;
    }
}
