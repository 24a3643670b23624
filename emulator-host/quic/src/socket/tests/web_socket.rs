//! A WebSocket carries the same session, and a client that speaks it badly is refused by name or ended.

use codec_core::player::MAX_RECEIPT_BYTES;
use dgs_player::{Caps, Player};
use futures_util::{SinkExt, StreamExt};
use tokio::net::TcpStream;
use tokio_tungstenite::{
    WebSocketStream, client_async,
    tungstenite::{Error, Message, client::IntoClientRequest, handshake::client::Request},
};

use super::*;
use crate::{
    http::{HttpConfig, HttpLimits, HttpServer, Site},
    socket::message::{ClientMessage, Message as _, MessageReader, RefusalCode, ServerMessage},
};

type Socket = WebSocketStream<TcpStream>;

/// A page's server before a server of sessions.
struct Pages {
    address: SocketAddr,
    _stop: oneshot::Sender<()>,
}

impl Pages {
    fn start(server: &Running) -> Self {
        let config = HttpConfig { bind: (Ipv4Addr::LOCALHOST, 0).into(), limits: HttpLimits::default() };
        let site = Site::new(|_| None, &[], None).unwrap();
        let pages = HttpServer::bind(&config, site).unwrap().with_sessions(server.entrance.clone());
        let address = pages.local_addr().unwrap();
        let (stop, stopped) = oneshot::channel::<()>();
        tokio::spawn(pages.run(async { drop(stopped.await) }));
        Self { address, _stop: stop }
    }

    fn request(&self) -> Request {
        format!("ws://{}/session", self.address).into_client_request().unwrap()
    }

    async fn ask(&self, request: Request) -> Result<Socket, Error> {
        let stream = TcpStream::connect(self.address).await.unwrap();
        client_async(request, stream).await.map(|(socket, _)| socket)
    }

    async fn open(&self) -> Socket {
        self.ask(self.request()).await.unwrap()
    }
}

fn frame(kind: u8, content: &[u8]) -> Message {
    Message::Binary([&[kind], content].concat().into())
}

fn hello(index: u16) -> Message {
    frame(0, &ClientMessage::Hello { stream: StreamChoice::Index(index), start_us: 0 }.to_bytes())
}

/// What a server has said until it closed: messages, packets, the code of the close.
#[derive(Debug, Default)]
struct Heard {
    messages: Vec<ServerMessage>,
    packets: Vec<Vec<u8>>,
    code: Option<u16>,
}

impl Heard {
    /// Why there is no session, on the control stream and as the code of the close.
    fn refused(&self) -> RefusalCode {
        let Some(ServerMessage::Refusal(refusal)) = self.messages.last() else { panic!("{self:?}") };
        assert_eq!(self.code, Some(4000 + u16::from(refusal.code.number())), "{self:?}");
        refusal.code
    }
}

/// Listens until the server closes or has sent `most` packets.
async fn listen(socket: &mut Socket, most: usize) -> Heard {
    let (mut heard, mut reader) = (Heard::default(), MessageReader::<ServerMessage>::default());
    while let Some(Ok(message)) = socket.next().await {
        match message {
            Message::Binary(frame) if frame[0] == 0 => {
                let mut input = &frame[1..];
                while let Some(message) = reader.take(&mut input).unwrap() {
                    heard.messages.push(message);
                }
            }
            Message::Binary(frame) => {
                assert_eq!(frame[0], 1);
                heard.packets.push(frame[1..].to_vec());
                if heard.packets.len() >= most {
                    break;
                }
            }
            Message::Close(close) => heard.code = close.map(|close| close.code.into()),
            _ => {}
        }
    }
    heard
}

#[test]
fn a_websocket_carries_manifest_media_and_receipts() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let pages = Pages::start(&server);
        let mut socket = pages.open().await;
        socket.send(hello(0)).await.unwrap();
        let expected = stream();
        let all = expected.packets().iter().filter(|packet| !packet.is_empty()).count();
        let Heard { messages, packets, .. } = listen(&mut socket, all.min(32)).await;
        let [ServerMessage::Manifest(manifest)] = &messages[..] else { panic!("{messages:?}") };
        assert_eq!(manifest, expected.message());
        let mut player = Player::new(manifest, &Caps::HOST).unwrap();
        player.push_all(packets.iter().map(Vec::as_slice));
        // More comes only once a receipt has come.
        let mut receipt = vec![0; MAX_RECEIPT_BYTES];
        let length = player.with_core(|core| core.receipt(0, 1, None, &mut receipt)).unwrap();
        let receipt = [&0u32.to_le_bytes(), &receipt[..length]].concat();
        socket.send(frame(1, &receipt)).await.unwrap();
        if all > packets.len() {
            let more = listen(&mut socket, all - packets.len()).await.packets;
            player.push_all(more.iter().map(Vec::as_slice));
        }
        for frame in 0..player.info().frames {
            let usable = player.usable(frame).unwrap();
            assert_eq!(usable.canonical[0], usable.blocks, "frame {frame}");
        }
        // What is said on the control stream may overtake a datagram, here as over QUIC.
        tokio::time::sleep(Duration::from_secs(2)).await;
        socket.send(frame(0, &ClientMessage::Bye.to_bytes())).await.unwrap();
        assert_eq!(listen(&mut socket, usize::MAX).await.code, Some(1000));
        let (report, viewers) = server.stop().await;
        assert_eq!((report.viewers, report.refused.len()), (1, 0), "{report:?}");
        assert!(viewers[0].receipts == 1 && viewers[0].end == "the viewer is through", "{viewers:?}");
    });
}

#[test]
fn what_is_no_session_is_refused_by_name() {
    within(async {
        // Who says nothing must not wait long, and whoever says something must not be late.
        let limits = |hello_wait| ServerLimits { hello_wait, ..ServerLimits::default() };
        let impatient = Running::start(limits(Duration::from_secs(5)));
        let server = Running::start(limits(PATIENCE));
        let (hurried, pages) = (Pages::start(&impatient), Pages::start(&server));
        let seek = ClientMessage::Seek { round: 1, start_us: 0 }.to_bytes();
        let claimed = [&[1u8][..], &u32::MAX.to_le_bytes()].concat();
        for (said, code) in [
            (None, RefusalCode::Silence),
            (Some(frame(0, b"GET / HTTP/1.1\r\n")), RefusalCode::Message),
            (Some(frame(0, &claimed)), RefusalCode::Message),
            (Some(frame(0, &seek)), RefusalCode::Message),
            (Some(hello(9)), RefusalCode::UnknownStream),
            (Some(frame(1, b"no receipt before hello")), RefusalCode::Silence),
        ] {
            let is_silent = code == RefusalCode::Silence;
            let mut socket = if is_silent { hurried.open().await } else { pages.open().await };
            if let Some(message) = said.clone() {
                socket.send(message).await.unwrap();
            }
            assert_eq!(listen(&mut socket, usize::MAX).await.refused(), code, "{said:?}");
        }
        // What is none of the protocol ends the WebSocket.
        for said in [
            Message::Text("hello".into()),
            Message::Binary(vec![].into()),
            frame(2, b"a third kind"),
            frame(0, &[0; 5000]),
        ] {
            let mut socket = pages.open().await;
            socket.send(said.clone()).await.unwrap();
            let heard = listen(&mut socket, usize::MAX).await;
            assert!(heard.packets.is_empty(), "{said:?}: {heard:?}");
        }
        server.shows_every_frame().await;
        server.stop().await;
        impatient.shows_every_frame_in_the_end().await;
        impatient.stop().await;
    });
}

#[test]
fn floods_end_in_a_refusal() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let pages = Pages::start(&server);
        let mut socket = pages.open().await;
        socket.send(hello(0)).await.unwrap();
        for _ in 0..200 {
            socket.feed(frame(1, b"\0\0\0\0no receipt")).await.unwrap();
        }
        socket.flush().await.unwrap();
        // Those that came too fast were lost; the rest are too many all the same.
        for _ in 0..300 {
            for _ in 0..60 {
                let _ = socket.feed(frame(1, b"\0\0\0\0no receipt")).await;
            }
            let patience = Duration::from_millis(200);
            let is_open = socket.flush().await.is_ok();
            if !is_open || tokio::time::timeout(patience, listen(&mut socket, 999)).await.is_ok() {
                break;
            }
        }
        let (report, _) = server.stop().await;
        assert_eq!(report.refused.get("flood"), Some(&1), "{report:?}");
    });
}

#[test]
fn pages_of_other_sites_get_no_websocket_and_places_are_counted() {
    within(async {
        let limits = ServerLimits { max_viewers: 1, hello_wait: PATIENCE, ..ServerLimits::default() };
        let server = Running::start(limits);
        let pages = Pages::start(&server);
        let status = |answer: Result<Socket, Error>| match answer {
            Err(Error::Http(answer)) => answer.status().as_u16(),
            Err(error) => panic!("{error}"),
            Ok(_) => 101,
        };
        let from = |origin: String| {
            let mut request = pages.request();
            request.headers_mut().insert("Origin", origin.parse().unwrap());
            request
        };
        assert_eq!(status(pages.ask(from("http://elsewhere".to_owned())).await), 403);
        assert_eq!(status(pages.ask(from(format!("http://{}", pages.address))).await), 101);
        let mut open = Vec::new();
        let refused = loop {
            match pages.ask(pages.request()).await {
                Ok(socket) => open.push(socket),
                Err(Error::Http(answer)) => break answer.status().as_u16(),
                Err(error) => panic!("{error}"),
            }
        };
        assert!(refused == 503 && (16..=17).contains(&open.len()), "{refused} after {}", open.len());
        // One of them may watch.
        open[0].send(hello(0)).await.unwrap();
        assert!(!listen(&mut open[0], 1).await.packets.is_empty());
        open[1].send(hello(0)).await.unwrap();
        assert_eq!(listen(&mut open[1], usize::MAX).await.refused(), RefusalCode::Full);
        server.stop().await;
    });
}

/// The connections that carried the requests are counted no more once they are WebSockets.
#[test]
fn one_address_does_not_take_all_places() {
    within(async {
        let limits =
            ServerLimits { max_viewers_per_address: 2, hello_wait: PATIENCE, ..ServerLimits::default() };
        let server = Running::start(limits);
        let pages = Pages::start(&server);
        let mut open = Vec::new();
        for _ in 0..6 {
            open.push(pages.open().await);
        }
        let refused = pages.ask(pages.request()).await;
        assert!(matches!(refused, Err(Error::Http(answer)) if answer.status().as_u16() == 503));
        // One that ends makes room.
        open.pop();
        while pages.ask(pages.request()).await.is_err() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        server.stop().await;
    });
}
