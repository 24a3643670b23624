//! Puts an emulated link between one subscriber and the relay: what the relay sends passes the boxes of
//! `emulator-host` in real time, what the subscriber sends is handed on.

use std::{
    collections::BTreeMap,
    net::{Ipv4Addr, SocketAddr},
    time::{Duration, Instant},
};

use anyhow::Result;
use emulator_host::{
    Nanos,
    link::{BoxOutput, Chain, Datagram, LinkBox, PathConfig},
    session::IP_UDP_BYTES,
};
use tokio::{net::UdpSocket, task::JoinHandle, time::sleep_until};

/// Longest datagram.
const MAX_BYTES: usize = 2048;

/// A link that is there until it is dropped.
pub struct Link {
    /// Where the subscriber finds the relay.
    pub port: u16,
    task: JoinHandle<()>,
}

impl Link {
    /// A way to the relay at `port`, for one subscriber.
    ///
    /// # Errors
    /// A path that is illegal, and what sockets refuse.
    pub async fn start(relay: u16, path: &PathConfig, seed: u64) -> Result<Self> {
        let near = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await?;
        let far = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await?;
        far.connect((Ipv4Addr::LOCALHOST, relay)).await?;
        let port = near.local_addr()?.port();
        let inside = Inside { chain: path.build("relay", seed)?, next: 0, bytes: BTreeMap::new() };
        Ok(Self { port, task: tokio::spawn(carry(near, far, inside)) })
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// What is on the way to the subscriber.
struct Inside {
    chain: Chain,
    next: u64,
    bytes: BTreeMap<u64, Vec<u8>>,
}

impl Inside {
    /// Takes a datagram in, and gives those that are through.
    fn pass(&mut self, datagram: Option<&[u8]>, now: Nanos) -> Vec<Vec<u8>> {
        let mut input = datagram.map(|bytes| {
            let tag = self.next;
            self.next += 1;
            self.bytes.insert(tag, bytes.to_vec());
            Datagram { tag, bytes: bytes.len() as u32 + IP_UDP_BYTES }
        });
        let mut through = Vec::new();
        while let BoxOutput::Datagram(datagram) = self.chain.step(input.take(), now) {
            // Order is kept: what entered before and is still here was lost.
            self.bytes = self.bytes.split_off(&datagram.tag);
            through.extend(self.bytes.remove(&datagram.tag));
        }
        through
    }
}

/// Carries datagrams both ways, for ever.
async fn carry(near: UdpSocket, far: UdpSocket, mut inside: Inside) {
    let began = Instant::now();
    let mut subscriber: Option<SocketAddr> = None;
    let (mut up, mut down) = (vec![0; MAX_BYTES], vec![0; MAX_BYTES]);
    loop {
        let wake =
            Duration::from_nanos(inside.chain.next_wake().0).min(began.elapsed() + Duration::from_secs(1));
        let through = tokio::select! {
            received = near.recv_from(&mut up) => {
                if let Ok((len, from)) = received {
                    subscriber = Some(from);
                    let _ = far.send(&up[..len]).await;
                }
                Vec::new()
            }
            received = far.recv(&mut down) => match received {
                Ok(len) => inside.pass(Some(&down[..len]), nanos(began)),
                Err(_) => Vec::new(),
            },
            () = sleep_until((began + wake).into()) => inside.pass(None, nanos(began)),
        };
        for bytes in through {
            if let Some(subscriber) = subscriber {
                let _ = near.send_to(&bytes, subscriber).await;
            }
        }
    }
}

fn nanos(began: Instant) -> Nanos {
    Nanos(u64::try_from(began.elapsed().as_nanos()).unwrap_or(u64::MAX))
}
