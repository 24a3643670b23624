//! A display without a screen: an X server in memory, what is on it, and hands for it.

use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
};

use render_host::Image;

/// An X server that ends when this is dropped.
pub struct Display {
    server: Child,
    /// As in the environment variable of the same name.
    pub name: String,
    folder: tempfile::TempDir,
}

impl Display {
    /// A display, or `None` on a machine that has no such server; in CI that is a failure.
    pub fn open() -> Option<Self> {
        let present = |program: &str| Command::new(program).arg("-help").output().is_ok();
        if !present("Xvfb") || !present("xdotool") {
            assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "xvfb or xdotool is missing");
            eprintln!("no Xvfb or no xdotool here: the window is not tested");
            return None;
        }
        let folder = tempfile::tempdir().unwrap();
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "640x480x24", "-nolisten", "tcp", "-fbdir"])
            .arg(folder.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut number = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut number).unwrap();
        Some(Self { server, name: format!(":{}", number.trim()), folder })
    }

    /// What is in its upper left corner.
    pub fn picture(&self, width: u32, height: u32) -> Image {
        screen(&self.folder.path().join("Xvfb_screen0"), width, height)
    }

    /// Moves the pointer, presses keys and buttons, as `xdotool` does with `words`.
    pub fn act(&self, words: &[&str]) -> String {
        let output = Command::new("xdotool").args(words).env("DISPLAY", &self.name).output().unwrap();
        String::from_utf8_lossy(&output.stdout).trim().to_owned()
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// The upper left corner of a picture in the format of `xwd`: 25 words, of which the first is the length of
/// the head, 13 the bytes of a row and 20 the colours of a table that lies before the pixels.
fn screen(file: &Path, width: u32, height: u32) -> Image {
    let bytes = fs::read(file).unwrap();
    let word = |at: usize| u32::from_be_bytes(bytes[4 * at..4 * at + 4].try_into().unwrap()) as usize;
    let (first, row) = (word(0) + 12 * word(19), word(12));
    assert_eq!(word(11), 32, "bits of a pixel");
    let pixels = (0..height as usize)
        .flat_map(|y| (0..width as usize).map(move |x| (x, y)))
        .map(|(x, y)| &bytes[first + y * row + 4 * x..][..4]);
    // Little-endian: blue, green, red.
    let rgb = pixels.flat_map(|p| [p[2], p[1], p[0]]).map(|v| f32::from(v) / 255.0).collect();
    Image::new(width, height, rgb).unwrap()
}
