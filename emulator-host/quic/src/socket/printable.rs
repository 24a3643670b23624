//! Makes what a peer says fit for a terminal.

use std::fmt::Display;

/// `text` with U+FFFD in place of each control character: a line break would forge a line of ours, an escape
/// sequence restyle the terminal.
pub(crate) fn printable(text: impl Display) -> String {
    text.to_string().replace(char::is_control, "\u{fffd}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_text_is_replaced() {
        assert_eq!(printable("fünf → 5"), "fünf → 5");
        assert_eq!(printable("a\nb\x1b[31m\x07\u{9b}1m"), "a\u{fffd}b\u{fffd}[31m\u{fffd}\u{fffd}1m");
    }
}
