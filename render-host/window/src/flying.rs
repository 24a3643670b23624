//! Flies while keys are held, any of them together.

use std::collections::BTreeMap;

/// Share of the distance that a touch of a key moves at once.
const STEP: f64 = 0.08;
/// Seconds for which a key is held before it flies: a touch moves by one step, however long it lasts.
const TOUCH: f64 = 0.2;
/// Shares of the distance that a held key flies in a second, and how many times as many with Shift.
const SPEED: f64 = 1.5;
const FASTER: f64 = 3.0;
/// Longest time that one move is for, seconds: a window that was hidden for long does not jump.
const LONGEST: f64 = 0.1;

/// Right, up and forward, in shares of the distance.
pub(crate) type Move = [f64; 3];

/// The keys that are held.
#[derive(Debug, Default)]
pub(crate) struct Flying {
    /// Since when each is, seconds.
    down: BTreeMap<char, f64>,
    /// When what is held moved last, seconds.
    then: f64,
}

/// Where a key flies to: right, up, forward.
fn direction(key: char) -> Option<Move> {
    Some(match key {
        'w' => [0.0, 0.0, 1.0],
        's' => [0.0, 0.0, -1.0],
        'a' => [-1.0, 0.0, 0.0],
        'd' => [1.0, 0.0, 0.0],
        'q' => [0.0, -1.0, 0.0],
        'e' => [0.0, 1.0, 0.0],
        _ => return None,
    })
}

/// The key to fly by that `text` is, whether Shift is held or not.
fn key_of(text: &str) -> Option<char> {
    let mut letters = text.chars().flat_map(char::to_lowercase);
    let key = letters.next().filter(|&key| direction(key).is_some());
    key.filter(|_| letters.next().is_none())
}

impl Flying {
    /// Takes a key that is pressed, or pressed still, at `now` seconds; gives the move of a touch. None if
    /// it is no key to fly by.
    pub fn press(&mut self, text: &str, now: f64) -> Option<Move> {
        let key = key_of(text)?;
        if self.down.is_empty() {
            self.then = now;
        }
        let is_new = !self.down.contains_key(&key);
        self.down.entry(key).or_insert(now);
        direction(key).map(|to| to.map(|share| if is_new { share * STEP } else { 0.0 }))
    }

    /// A key is let go.
    pub fn release(&mut self, text: &str) {
        if let Some(key) = key_of(text) {
            self.down.remove(&key);
        }
    }

    /// All keys are let go: without the focus no event says so.
    pub fn stop(&mut self) {
        self.down.clear();
    }

    /// The move since the last one until `now` seconds, all keys together; none where no key is held.
    pub fn moved(&mut self, now: f64, is_fast: bool) -> Option<Move> {
        if self.down.is_empty() {
            return None;
        }
        let speed = SPEED * if is_fast { FASTER } else { 1.0 };
        let mut sum = [0.0; 3];
        for (&key, &since) in &self.down {
            let seconds = (now - self.then.max(since + TOUCH)).clamp(0.0, LONGEST);
            let to = direction(key).unwrap_or_default();
            sum = std::array::from_fn(|axis| sum[axis] + to[axis] * speed * seconds);
        }
        self.then = now;
        Some(sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_near(found: Option<Move>, expected: Move) {
        let found = found.unwrap();
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}, not {expected:?}");
    }

    #[test]
    fn keys_are_down_together_and_shift_is_faster() {
        let mut flying = Flying::default();
        assert_eq!(flying.moved(1.0, false), None);
        assert_near(flying.press("w", 2.0), [0.0, 0.0, STEP]);
        assert_near(flying.press("W", 2.0), [0.0; 3]);
        assert_near(flying.press("d", 2.0), [STEP, 0.0, 0.0]);
        // Until a touch is over.
        assert_near(flying.moved(2.1, false), [0.0; 3]);
        assert_near(flying.moved(2.22, false), [0.03, 0.0, 0.03]);
        assert_near(flying.moved(2.24, true), [0.09, 0.0, 0.09]);
        flying.release("D");
        assert_near(flying.moved(2.26, false), [0.0, 0.0, 0.03]);
        flying.press("s", 2.26);
        assert_near(flying.moved(2.28, false), [0.0, 0.0, 0.03]);
        assert_near(flying.moved(9.0, false), [0.0; 3]);
        flying.release("s");
        assert_near(flying.moved(20.0, false), [0.0, 0.0, SPEED * LONGEST]);
        flying.stop();
        assert_eq!(flying.moved(20.1, false), None);
        assert_eq!(flying.press("x", 20.2), None);
        assert_eq!(flying.press("was", 20.2), None);
    }
}
