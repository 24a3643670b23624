//! An entrance takes the WebSockets that a page's server has granted to the server of sessions.

use std::{
    net::{IpAddr, SocketAddr},
    sync::Arc,
};

use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};

use super::{
    per_address::{PerAddress, Place},
    web_socket::Socket,
};

/// WebSockets that wait to be taken on.
const WAITING: usize = 16;

/// A WebSocket's place among all, and among those of its address; given back when it is dropped.
pub(crate) type WebSocketPlace = (OwnedSemaphorePermit, Place);

/// Hands upgraded WebSockets to the session server; clones share the channel.
#[derive(Clone, Debug)]
pub struct WebSocketAcceptor {
    granted: mpsc::Sender<AcceptedWebSocket>,
    places: Arc<Semaphore>,
    addresses: Arc<PerAddress>,
}

/// A WebSocket on its way in.
#[derive(Debug)]
pub(super) struct AcceptedWebSocket {
    pub(super) socket: Socket,
    pub(super) address: SocketAddr,
    /// Given back when the WebSocket has ended.
    pub(super) place: WebSocketPlace,
}

impl WebSocketAcceptor {
    /// For so many WebSockets at once, and so many of one address, and where they come out.
    pub(super) fn new(places: usize, of_address: usize) -> (Self, mpsc::Receiver<AcceptedWebSocket>) {
        let (granted, entering) = mpsc::channel(WAITING);
        let (places, addresses) = (Arc::new(Semaphore::new(places)), PerAddress::new(of_address));
        (Self { granted, places, addresses }, entering)
    }

    /// A place for one more from `address`, if there is one.
    pub(crate) fn place(&self, address: IpAddr) -> Option<WebSocketPlace> {
        self.places.clone().try_acquire_owned().ok().zip(self.addresses.take(address))
    }

    /// Lets a WebSocket in. Where the server has closed, it is closed with it.
    pub(crate) async fn enter(&self, socket: Socket, address: SocketAddr, place: WebSocketPlace) {
        let _ = self.granted.send(AcceptedWebSocket { socket, address, place }).await;
    }
}
