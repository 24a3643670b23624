//! Plays a stream whose packets come over UDP, every seventh of them lost: `decode_udp FILE`.

use std::{net::UdpSocket, thread, time::Duration};

use dgs_player::{Caps, Stream, Waiting};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::fs::read(std::env::args().nth(1).ok_or("decode_udp FILE")?)?;
    let (receiver, sender) = (UdpSocket::bind("127.0.0.1:0")?, UdpSocket::bind("127.0.0.1:0")?);
    receiver.set_read_timeout(Some(Duration::from_millis(500)))?;
    sender.connect(receiver.local_addr()?)?;
    let (stream, _) = Stream::from_bytes(&file)?;
    // The manifest comes by a reliable way of its own.
    let mut player = Waiting::new(Caps::HOST)?.manifest(stream.message()).map_err(|(_, error)| error)?;
    thread::spawn(move || {
        for packet in stream.packets().iter().enumerate().filter(|(i, _)| i % 7 != 3).map(|(_, p)| p) {
            let _ = sender.send(packet);
        }
    });
    let mut datagram = [0; 1500];
    while let Ok(len) = receiver.recv(&mut datagram) {
        let _ = player.push(&datagram[..len]); // a refusal is counted
    }
    println!("{:?}\n{:?}", player.counters(), player.usable(0)?);
    println!("{} Gaussians in frame 0", player.frame(0)?.gaussians.len());
    Ok(())
}
