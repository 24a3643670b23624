//! Reads and writes a footprint by its name: `#[serde(with = "footprint_name")]`.

use codec_core::Footprint;
use serde::{Deserialize, Deserializer, Serializer, de::Error};

/// Writes the name of `footprint`.
///
/// # Errors
/// What the format refuses.
pub fn serialize<S: Serializer>(footprint: &Footprint, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(footprint.name())
}

/// Reads a footprint.
///
/// # Errors
/// A name that is none.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Footprint, D::Error> {
    let name = String::deserialize(deserializer)?;
    let allowed = || Footprint::ALL.map(Footprint::name).join(", ");
    Footprint::named(&name)
        .ok_or_else(|| D::Error::custom(format!("footprint is {name:?}; {} are allowed", allowed())))
}
