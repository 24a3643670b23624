//! A server of ours that is addressed as a relay of Media over QUIC is an error that says so.

use super::*;

#[test]
fn a_server_that_is_no_relay_is_said_to_be_none() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let mut config = ClientConfig { reconnects: 0, ..server.client() };
        config.locator.scheme = Scheme::Moq;
        config.locator.stream = StreamChoice::Name("everything".to_owned());
        let played = crate::moq::play(&config, &mut NullSink, std::future::pending()).await;
        let error = played.error.unwrap().to_string();
        assert!(
            error.contains("speaks no version of Media over QUIC") && error.contains("dgs://"),
            "{error}"
        );
        server.shows_every_frame().await;
        server.stop().await;
    });
}
