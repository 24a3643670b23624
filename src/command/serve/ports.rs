//! The ports of `dgs serve`: one for datagrams, one for the page.

use std::net::{TcpListener, UdpSocket};

use anyhow::{Context, Result};
use dgs_quic::http::{HttpConfig, HttpLimits, HttpServer};

use crate::args::Serve;

/// Numbers of ports that are tried where the system chooses one for datagrams and for the page.
const MAX_NUMBERS: usize = 16;

/// The ports, open before there is anything to serve on them.
pub(super) struct Ports {
    pub(super) socket: UdpSocket,
    /// That of the page, if there is one.
    pub(super) page: Option<(TcpListener, HttpConfig)>,
}

impl Ports {
    /// Opens a socket by `open`, and the page's port, which unless it is named has the same number. A number
    /// that the system chose may be free for datagrams alone: then another is asked for.
    pub(super) fn open(args: &Serve, open: impl Fn() -> Result<UdpSocket>) -> Result<Self> {
        let is_chosen = args.listen.port() == 0 && args.http.is_none();
        let mut left = if is_chosen { MAX_NUMBERS } else { 1 };
        loop {
            let socket = open()?;
            if args.no_http {
                return Ok(Self { socket, page: None });
            }
            let bind = args.http.map_or_else(|| socket.local_addr().context("--listen"), Ok)?;
            left -= 1;
            match HttpServer::open(bind) {
                Ok(listener) => {
                    let http = HttpConfig { bind, limits: HttpLimits::default() };
                    return Ok(Self { socket, page: Some((listener, http)) });
                }
                Err(error) if left == 0 => {
                    return Err(error).context("--http takes another port, --no-http serves no page");
                }
                Err(_) => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::args::{Cli, Verb};

    /// The first number is another's for the page; the ports are open, and nothing was named.
    #[test]
    fn a_number_that_is_free_for_datagrams_alone_is_passed_over() {
        let listeners = std::iter::repeat_with(|| TcpListener::bind("127.0.0.1:0").unwrap());
        let is_half_free = |taken: &TcpListener| UdpSocket::bind(taken.local_addr().unwrap()).is_ok();
        let taken = listeners.take(100).find(is_half_free).unwrap();
        let half_free = taken.local_addr().unwrap();
        let opened = |typed: &[&str]| {
            let typed = [&["dgs", "serve", "none.dgs"], typed].concat();
            let Ok(Cli { verb: Verb::Serve(args), .. }) = Cli::try_parse_from(typed) else { panic!() };
            let tries = std::cell::Cell::new(0);
            let ports = Ports::open(&args, || {
                tries.set(tries.get() + 1);
                let address = if tries.get() == 1 { half_free } else { args.listen };
                Ok(UdpSocket::bind(address).unwrap())
            });
            (ports, tries.get())
        };
        let (ports, tries) = opened(&["--listen", "127.0.0.1:0"]);
        let ports = ports.unwrap();
        let page = ports.page.unwrap().0.local_addr().unwrap();
        // Another program may have taken the page's half of the second number too.
        assert_eq!(page, ports.socket.local_addr().unwrap());
        assert!(tries >= 2, "{tries}");
        let (ports, tries) = opened(&["--listen", "127.0.0.1:0", "--no-http"]);
        assert!(ports.unwrap().page.is_none() && tries == 1);
        // A number that was named is the one that is meant.
        let (ports, tries) = opened(&["--listen", &half_free.to_string()]);
        let error = ports.map(|_| ()).unwrap_err();
        assert!(format!("{error:#}").contains("--http takes another port") && tries == 1, "{error:#}");
    }
}
