//! Reads and writes footprints by their names: `#[serde(with = "footprint_name")]`, and of those that may be
//! missing `#[serde(with = "footprint_name::option")]`.

use codec_core::Footprint;
use serde::{Deserialize, Deserializer, Serializer, de::Error};

/// Writes the name of `footprint`.
///
/// # Errors
/// What the format refuses.
pub(crate) fn serialize<S: Serializer>(footprint: &Footprint, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(footprint.name())
}

/// Reads a footprint.
///
/// # Errors
/// A name that is none.
pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Footprint, D::Error> {
    named(&String::deserialize(deserializer)?)
}

fn named<E: Error>(name: &str) -> Result<Footprint, E> {
    let allowed = || Footprint::ALL.map(Footprint::name).join(", ");
    Footprint::named(name)
        .ok_or_else(|| E::custom(format!("footprint is {name:?}; {} are allowed", allowed())))
}

pub(crate) mod option {
    //! The same where there may be none.
    use super::*;

    /// Writes the name of `footprint`, if there is one.
    ///
    /// # Errors
    /// What the format refuses.
    pub(crate) fn serialize<S: Serializer>(
        footprint: &Option<Footprint>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        match footprint {
            Some(footprint) => serializer.serialize_some(footprint.name()),
            None => serializer.serialize_none(),
        }
    }

    /// Reads a footprint, if there is one.
    ///
    /// # Errors
    /// A name that is none.
    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<Footprint>, D::Error> {
        Option::<String>::deserialize(deserializer)?.map(|name| named(&name)).transpose()
    }
}
