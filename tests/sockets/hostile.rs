//! Neither side can be hurt by the other: garbage, floods, silence.
