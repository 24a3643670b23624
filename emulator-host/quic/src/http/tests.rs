//! Honest clients get what they ask for, hostile ones cost what was set aside for them.

use std::{
    io::{Read, Write},
    net::{Ipv4Addr, SocketAddr, TcpStream},
    time::{Duration, Instant},
};

use bytes::Bytes;
use tokio::{runtime::Runtime, sync::oneshot, task::JoinHandle};

use super::*;

const LARGE: usize = 64 << 20;
/// Within this a head that is sent at once comes, on a busy machine too.
const PATIENCE: Duration = Duration::from_secs(5);

/// A server in the background of a runtime; clients are plain blocking sockets.
struct Running {
    runtime: Runtime,
    address: SocketAddr,
    stop: oneshot::Sender<()>,
    task: JoinHandle<HttpReport>,
}

impl Running {
    fn start(limits: HttpLimits) -> Self {
        let runtime = Runtime::new().unwrap();
        let stream = |name: &str, file: Bytes| SiteStream {
            name: name.to_owned(),
            address: None,
            web_address: None,
            file: Some(file),
        };
        let ten = stream("ten", Bytes::from_static(b"0123456789"));
        let site = Site::new(|_| None, &[ten, stream("large", vec![7; LARGE].into())], None).unwrap();
        let config = HttpConfig { bind: (Ipv4Addr::LOCALHOST, 0).into(), limits };
        let (stop, stopped) = oneshot::channel::<()>();
        let (address, task) = runtime.block_on(async {
            let server = HttpServer::bind(&config, site).unwrap();
            let address = server.local_addr().unwrap();
            (address, tokio::spawn(server.run(async { drop(stopped.await) })))
        });
        Self { runtime, address, stop, task }
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream
    }

    /// All that comes back for `request` until the server closes.
    fn talk(&self, request: &[u8]) -> String {
        let mut stream = self.connect();
        // A server that has heard enough may close first.
        let _ = stream.write_all(request);
        rest(&mut stream)
    }

    fn get(&self, path: &str, fields: &str) -> String {
        self.talk(format!("GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n{fields}\r\n").as_bytes())
    }

    fn answers(&self) {
        let answer = self.get("/streams/ten.dgs", "");
        assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with("\r\n\r\n0123456789"), "{answer}");
    }

    fn stop(self) -> HttpReport {
        self.stop.send(()).unwrap();
        self.runtime.block_on(self.task).unwrap()
    }
}

fn rest(stream: &mut TcpStream) -> String {
    let mut bytes = Vec::new();
    // A reset is an end too.
    let _ = stream.read_to_end(&mut bytes);
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Limits of a server that waits for `wait`, whatever it waits for.
fn waiting(wait: Duration) -> HttpLimits {
    HttpLimits { head_wait: wait, progress: wait, ..HttpLimits::default() }
}

#[test]
fn files_ranges_and_absences_are_answered() {
    let server = Running::start(HttpLimits::default());
    server.answers();
    let part = server.get("/streams/ten.dgs?x=1", "Range: bytes=-3\r\n");
    assert!(part.starts_with("HTTP/1.1 206") && part.ends_with("\r\n\r\n789"), "{part}");
    assert!(part.to_lowercase().contains("content-range: bytes 7-9/10"), "{part}");
    assert!(server.get("/streams/ten.dgs", "Range: bytes=11-\r\n").starts_with("HTTP/1.1 416"));
    let nothing = server.get("/nothing", "");
    assert!(nothing.starts_with("HTTP/1.1 404") && nothing.contains("/streams.json lists"), "{nothing}");
    let head = server.talk(b"HEAD /streams/ten.dgs HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n");
    assert!(head.starts_with("HTTP/1.1 200") && head.ends_with("\r\n\r\n"), "{head}");
    assert!(head.to_lowercase().contains("content-length: 10"), "{head}");
    // Two requests on one connection. It ends because the second says so: a client that hangs up may do it
    // before the second is read.
    let request = "GET /streams/ten.dgs HTTP/1.1\r\nHost: x\r\n";
    let mut stream = server.connect();
    stream.write_all(format!("{request}\r\n{request}Connection: close\r\n\r\n").as_bytes()).unwrap();
    assert_eq!(rest(&mut stream).matches("0123456789").count(), 2);
    let report = server.stop();
    assert_eq!((report.requests, report.slow, report.malformed), (7, 0, 0), "{report:?}");
}

#[test]
fn what_is_no_request_is_refused_and_counted() {
    let server = Running::start(HttpLimits::default());
    let long = format!("GET /{} HTTP/1.1\r\nHost: x\r\n\r\n", "a".repeat(100_000));
    let fields = format!("GET / HTTP/1.1\r\nHost: x\r\nX: {}\r\n\r\n", "a".repeat(100_000));
    let many = format!("GET / HTTP/1.1\r\nHost: x\r\n{}\r\n", "X: y\r\n".repeat(1000));
    let requests = [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03".as_slice(),
        b"hello\r\n\r\n",
        b"GET  HTTP/1.1\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        long.as_bytes(),
        fields.as_bytes(),
        many.as_bytes(),
    ];
    for request in requests {
        let answer = server.talk(request);
        assert!(answer.is_empty() || answer.starts_with("HTTP/1.1 4"), "{answer}");
    }
    // A body without end is not read.
    let mut endless = server.connect();
    let head = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 99999999999\r\n\r\n";
    endless.write_all(head).unwrap();
    let refused = |stream: &mut TcpStream| (0..100_000).any(|_| stream.write_all(&[0; 4096]).is_err());
    assert!(refused(&mut endless), "400 MB of a body were taken");
    server.answers();
    let report = server.stop();
    assert_eq!(report.malformed, requests.len() as u64, "{report:?}");
}

#[test]
fn who_is_slow_is_closed_before_and_between_requests_and_while_an_answer_is_read() {
    let short = waiting(Duration::from_millis(300));
    let hasty = Running::start(short);
    let began = Instant::now();
    let mut silent = hasty.connect();
    assert_eq!(rest(&mut silent), "");
    // A byte now and then does not help.
    let mut slow = hasty.connect();
    let closed = (0..200).any(|_| {
        std::thread::sleep(Duration::from_millis(50));
        slow.write_all(b"G").is_err()
    });
    assert!(closed, "a head that never ends was waited for");
    let server = Running::start(HttpLimits { head_wait: PATIENCE, ..short });
    // An answer that nobody takes while the next client waits.
    let mut deaf = server.connect();
    deaf.write_all(b"GET /streams/large.dgs HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
    // After an answer too.
    let mut idle = server.connect();
    idle.write_all(b"GET /streams/ten.dgs HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
    assert!(rest(&mut idle).ends_with("0123456789"));
    assert!(rest(&mut deaf).len() < LARGE);
    assert!(began.elapsed() < Duration::from_secs(30));
    server.answers();
    for report in [hasty.stop(), server.stop()] {
        assert_eq!(report.slow, 2, "{report:?}");
    }
}

#[test]
fn who_reads_steadily_gets_all_of_a_large_file() {
    let server = Running::start(HttpLimits::default());
    let mut stream = server.connect();
    stream.write_all(b"GET /streams/large.dgs HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n").unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    let file = &bytes[bytes.len().saturating_sub(LARGE)..];
    assert!(bytes.len() > LARGE && file.iter().all(|byte| *byte == 7), "{} bytes", bytes.len());
    assert_eq!(server.stop().slow, 0);
}

#[test]
fn connections_beyond_the_bound_of_all_are_turned_away() {
    turns_the_fifth_away(HttpLimits { max_connections: 4, ..waiting(PATIENCE) });
}

#[test]
fn connections_beyond_the_bound_of_one_address_are_turned_away() {
    turns_the_fifth_away(HttpLimits { max_connections_per_address: 4, ..waiting(PATIENCE) });
}

fn turns_the_fifth_away(limits: HttpLimits) {
    let server = Running::start(limits);
    let mut open: Vec<TcpStream> = (0..4).map(|_| server.connect()).collect();
    let mut beyond = server.connect();
    assert_eq!(rest(&mut beyond), "");
    // The silent ones are closed, and there is room again.
    open.iter_mut().for_each(|stream| assert_eq!(rest(stream), ""));
    server.answers();
    let report = server.stop();
    assert_eq!((report.turned_away, report.slow), (1, 4), "{report:?}");
}

#[test]
fn closing_ends_idle_connections_at_once_and_answers_within_a_bound() {
    // Limits that end no connection in this time: what ends them is the closing.
    let server = Running::start(waiting(Duration::from_secs(120)));
    let mut idle = server.connect();
    idle.write_all(b"GET /streams/ten.dgs HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
    let mut deaf = server.connect();
    deaf.write_all(b"GET /streams/large.dgs HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
    // Both are being answered.
    for stream in [&mut idle, &mut deaf] {
        stream.read_exact(&mut [0]).unwrap();
    }
    let address = server.address;
    let began = Instant::now();
    let report = server.stop();
    assert!(began.elapsed() < Duration::from_secs(30));
    assert_eq!(report.requests, 2);
    assert!(rest(&mut idle).ends_with("0123456789"));
    assert!(TcpStream::connect(address).is_err());
}

#[test]
fn a_port_that_is_taken_is_named() {
    let server = Running::start(HttpLimits::default());
    let config = HttpConfig { bind: server.address, limits: HttpLimits::default() };
    let site = Site::new(|_| None, &[], None).unwrap();
    let error = server.runtime.block_on(async { HttpServer::bind(&config, site).unwrap_err() });
    assert!(error.to_string().contains(&server.address.to_string()), "{error}");
}
