//! Names what a session is carried by.

/// What a session is carried by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// QUIC itself: `dgs://`.
    Dgs,
    /// WebTransport, as in browsers: `https://`.
    Https,
}

impl Scheme {
    /// As an address begins.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Dgs => "dgs",
            Self::Https => "https",
        }
    }

    /// The scheme of this name.
    pub(super) fn of(name: &str) -> Option<Self> {
        [Self::Dgs, Self::Https].into_iter().find(|scheme| scheme.name() == name)
    }
}
