//! Messages come back however they are cut, and what is wrong with others is named.

use super::*;

fn read<M: Message>(bytes: &[u8]) -> Result<Vec<M>, MessageError> {
    let (mut reader, mut input, mut messages) = (MessageReader::default(), bytes, Vec::new());
    while let Some(message) = reader.take(&mut input)? {
        messages.push(message);
    }
    assert!(input.is_empty());
    Ok(messages)
}

fn client() -> Vec<ClientMessage> {
    vec![
        ClientMessage::Hello { stream: StreamChoice::Name("fox.2".into()), start_us: 1_500_000 },
        ClientMessage::Hello { stream: StreamChoice::Index(513), start_us: u64::MAX },
        ClientMessage::Seek { round: 7, start_us: 12 },
        ClientMessage::Bye,
        ClientMessage::Streams,
        ClientMessage::Receipt(vec![1, 0, 0, 0, 7]),
        ClientMessage::Conditions { round: 8, start_us: 40_000, conditions: Conditions::NONE },
    ]
}

#[test]
fn messages_come_back_whole_however_they_are_cut() {
    let bytes: Vec<u8> = client().iter().flat_map(Message::to_bytes).collect();
    assert_eq!(read::<ClientMessage>(&bytes), Ok(client()));
    for step in 1..bytes.len() {
        let (mut reader, mut messages) = (MessageReader::<ClientMessage>::default(), Vec::new());
        for mut part in bytes.chunks(step) {
            while let Some(message) = reader.take(&mut part).unwrap() {
                messages.push(message);
            }
        }
        assert_eq!(messages, client());
        assert!(!reader.is_inside());
    }
    let refusal = Refusal { code: RefusalCode::Full, sentence: "é".repeat(600) };
    let granted = Granted { link: true, scheduler: false };
    let granted = ServerMessage::Granted { round: 9, granted };
    let server = [ServerMessage::Manifest(vec![9; 300]), ServerMessage::Refusal(refusal), granted];
    let bytes: Vec<u8> = server.iter().flat_map(Message::to_bytes).collect();
    let back = read::<ServerMessage>(&bytes).unwrap();
    assert_eq!((&back[0], &back[2]), (&server[0], &server[2]));
    let ServerMessage::Refusal(cut) = &back[1] else { panic!("{back:?}") };
    assert_eq!((cut.code, cut.sentence.len()), (RefusalCode::Full, 1000));
}

#[test]
fn a_length_is_refused_before_anything_is_stored_for_it() {
    let mut bytes = vec![MANIFEST];
    bytes.extend_from_slice(&u32::MAX.to_le_bytes());
    let error = read::<ServerMessage>(&bytes).unwrap_err();
    assert_eq!(error.to_string(), "manifest: length is 4294967295, allowed 21 to 16777216");
    let error = read::<ClientMessage>(&[BYE, 1, 0, 0, 0]).unwrap_err();
    assert_eq!(error.to_string(), "bye: length is 1, allowed 0 to 0");
}

#[test]
fn what_is_wrong_is_named() {
    let hello = client()[0].to_bytes();
    let with = |at: usize, value: u8| {
        let mut bytes = hello.clone();
        bytes[at] = value;
        read::<ClientMessage>(&bytes).unwrap_err()
    };
    for (at, value, named) in [
        (0, 0x81, "message kind is 0x81"),
        (5, 9, "hello.version is 9, allowed 0"),
        (14, 2, "hello.choice is 2"),
        (15, 200, "its fields take 211"),
        (15, 3, "its fields take 14"),
        (16, b'/', "letters, digits"),
        (16, 0xff, "UTF-8"),
    ] {
        let error = with(at, value);
        assert!(error.to_string().contains(named), "{at}: {error}");
    }
    assert_eq!(with(5, 9).refusal().code, RefusalCode::Version);
    assert_eq!(with(14, 9).refusal().code, RefusalCode::Message);
    let mut refusal = ServerMessage::Refusal(Refusal { code: RefusalCode::Full, sentence: "a".into() });
    let mut bytes = refusal.to_bytes();
    bytes[HEAD_BYTES] = 99;
    assert!(read::<ServerMessage>(&bytes).unwrap_err().to_string().contains("code is 99"));
    if let ServerMessage::Refusal(refusal) = &mut refusal {
        refusal.sentence.clear();
    }
    assert!(read::<ServerMessage>(&refusal.to_bytes()).is_err());
}

#[test]
fn conditions_come_back_as_written_and_never_out_of_bounds() {
    // Anew, `layered`, 2 Mbit/s, 40 ms, 5 % in runs of 4, seed 7.
    let mut body = vec![8, 0, 0, 0, 64, 156, 0, 0, 0, 0, 0, 0, 1, 1];
    body.extend(2_000_000u64.to_le_bytes());
    body.extend(40_000u32.to_le_bytes());
    body.extend([244, 1, 4, 0, 7, 0, 0, 0]);
    let message = |body: &[u8]| {
        let mut bytes = vec![CONDITIONS];
        bytes.extend((body.len() as u32).to_le_bytes());
        bytes.extend(body);
        read::<ClientMessage>(&bytes)
    };
    let [ClientMessage::Conditions { round: 8, start_us: 40_000, conditions }] = message(&body).unwrap()[..]
    else {
        panic!()
    };
    assert!(conditions.anew && conditions.scheduler == Some(emulator_host::PolicyKind::Layered));
    let impairment = conditions.impairment().unwrap();
    assert_eq!(
        (impairment.path.delay.0, impairment.path.queue.bytes, impairment.seed),
        (40_000_000, 62_500, 7)
    );
    let short = ViewerLink { loss: 0.9, burst: 2.0, ..ViewerLink::default() };
    assert!(Conditions::NONE.behind(&short).unwrap_err().to_string().contains("burst is 2"));
    assert!(Conditions::NONE.behind(&ViewerLink { burst: 9.0, ..short }).is_ok());
    assert_eq!(impairment.path.loss, emulator_host::link::LossModel::in_bursts(0.05, 4.0));
    assert!(Conditions::NONE.impairment().is_none());
    let mut unchanged = body.clone();
    unchanged[12] = 2;
    let [ClientMessage::Conditions { conditions, .. }] = message(&unchanged).unwrap()[..] else { panic!() };
    assert!(conditions.keeps_link && !conditions.anew);
    for (at, value, named) in [
        (12, 4, "conditions.flags is 4"),
        (13, 6, "conditions.scheduler is 6"),
        (19, 1, "conditions.rate"),
        (25, 1, "conditions.delay"),
        (27, 200, "conditions.loss"),
        (28, 0, "conditions.burst is 0"),
    ] {
        let mut body = body.clone();
        body[at] = value;
        let error = message(&body).unwrap_err();
        assert!(error.to_string().contains(named), "{at}: {error}");
    }
    assert!(message(&body[1..]).is_err());
}

/// The page writes conditions itself.
#[test]
fn the_page_numbers_schedulers_as_the_message_does() {
    let page = include_str!("../../../../../render-host/viewer/page/conditions.js");
    let list = page.split_once("SCHEDULERS = [").unwrap().1.split_once(']').unwrap().0;
    let names: Vec<_> = list.split(',').map(|name| name.trim().trim_matches('"')).collect();
    assert_eq!(names.len(), emulator_host::PolicyKind::ALL.len() + 1);
    for kind in emulator_host::PolicyKind::ALL {
        let mut body = Vec::new();
        Conditions::NONE.with_scheduler(kind).write(&mut body);
        assert_eq!(names[usize::from(body[1])], kind.name());
    }
}

#[test]
fn a_sentence_is_shown_without_control_characters() {
    let sentence = "no\n\u{1b}[31mred\u{1b}]0;title\u{7}".to_owned();
    let refusal = ServerMessage::Refusal(Refusal { code: RefusalCode::Full, sentence });
    let [ServerMessage::Refusal(found)] = &read::<ServerMessage>(&refusal.to_bytes()).unwrap()[..] else {
        panic!()
    };
    let shown = found.to_string();
    assert!(shown.starts_with("no") && shown.ends_with("title\u{fffd} (full)"), "{shown}");
    assert!(!shown.contains(char::is_control), "{shown:?}");
}
