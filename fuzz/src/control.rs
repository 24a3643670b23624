//! Messages of the control stream between server and client: bounded, the same however they are cut.

use dgs_quic::socket::message::{ClientMessage, Message, MessageError, MessageReader, ServerMessage};

/// Messages of both sides. The first byte says in what steps the rest comes.
pub fn control(data: &[u8]) {
    let Some((step, bytes)) = data.split_first() else { return };
    let step = usize::from(*step % 32) + 1;
    side::<ClientMessage>(bytes, step);
    side::<ServerMessage>(bytes, step);
}

fn side<M: Message + std::fmt::Debug + PartialEq>(bytes: &[u8], step: usize) {
    let whole = read::<M>([bytes]);
    assert_eq!(read::<M>(bytes.chunks(step)), whole, "however it is cut");
    let (messages, error) = whole;
    let written: Vec<u8> = messages.iter().flat_map(Message::to_bytes).collect();
    assert!(bytes.starts_with(&written), "what is read is written as it was");
    if let Some(error) = error {
        assert!(!error.to_string().is_empty() && !error.refusal().sentence.is_empty());
    }
}

/// Messages up to the first error.
fn read<'d, M: Message>(parts: impl IntoIterator<Item = &'d [u8]>) -> (Vec<M>, Option<MessageError>) {
    let (mut reader, mut messages) = (MessageReader::default(), Vec::new());
    for mut part in parts {
        loop {
            match reader.take(&mut part) {
                Ok(Some(message)) => messages.push(message),
                Ok(None) => break,
                Err(error) => return (messages, Some(error)),
            }
        }
        assert!(part.is_empty(), "a part that ends no message is taken whole");
    }
    (messages, None)
}
