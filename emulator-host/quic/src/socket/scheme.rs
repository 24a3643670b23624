//! Names what a session is carried by.

/// What a session is carried by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// QUIC itself: `dgs://`.
    Dgs,
    /// WebTransport, as in browsers: `https://`.
    Https,
    /// Media over QUIC through a relay: `moq+https://`.
    Moq,
}

impl Scheme {
    const ALL: [Self; 3] = [Self::Dgs, Self::Https, Self::Moq];

    /// As an address begins.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Dgs => "dgs",
            Self::Https => "https",
            Self::Moq => "moq+https",
        }
    }

    /// The scheme of this name.
    pub(super) fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|scheme| scheme.name() == name)
    }
}
