//! Runs the programs that build and emulate the other targets, and reads what they print.

use std::{
    ffi::OsStr,
    io::Read,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail};

/// No program here runs that long; one that does hangs.
const PATIENCE: Duration = Duration::from_secs(600);

/// What a target needs.
pub(super) enum Tool<'t> {
    /// A program on the path.
    Program(&'t str),
    /// A target of the Rust toolchain.
    Target(&'t str),
}

impl Tool<'_> {
    /// Its name, if it is not here.
    pub(super) fn absent(&self) -> Option<String> {
        match self {
            Self::Program(name) => {
                let paths = std::env::var_os("PATH").unwrap_or_default();
                let found = std::env::split_paths(&paths)
                    .any(|p| p.join(name).is_file() || p.join(format!("{name}.exe")).is_file());
                (!found).then(|| (*name).to_owned())
            }
            Self::Target(name) => {
                let sysroot = Command::new("rustc").args(["--print", "sysroot"]).output();
                let sysroot = sysroot.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned());
                let found = sysroot.is_ok_and(|s| Path::new(&s).join("lib/rustlib").join(name).is_dir());
                (!found).then(|| format!("the Rust target {name}"))
            }
        }
    }
}

/// A program to be run.
pub(super) struct Program(Command);

/// `name` without arguments.
pub(super) fn program(name: impl AsRef<OsStr>) -> Program {
    Program(Command::new(name))
}

/// `cargo` in `folder`, building into `target`. Its own progress goes nowhere unless it fails.
pub(super) fn cargo(folder: &Path, target: &Path) -> Program {
    let mut command = Command::new("cargo");
    // What this process was told about its own build is not meant for others.
    for name in ["CARGO_BUILD_TARGET", "CARGO_ENCODED_RUSTFLAGS", "RUSTFLAGS"] {
        command.env_remove(name);
    }
    command.current_dir(folder).env("CARGO_TARGET_DIR", target).env("CARGO_TERM_COLOR", "never");
    Program(command)
}

/// What a program left behind.
pub(super) struct ProgramOutput {
    status: std::process::ExitStatus,
    text: String,
    /// What it wrote to stderr.
    pub errors: String,
}

impl Program {
    pub(super) fn arg(mut self, arg: impl AsRef<OsStr>) -> Self {
        self.0.arg(arg);
        self
    }

    pub(super) fn args(mut self, args: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Self {
        self.0.args(args);
        self
    }

    pub(super) fn env(mut self, name: &str, value: impl AsRef<OsStr>) -> Self {
        self.0.env(name, value);
        self
    }

    /// Runs it to its end; one that takes too long is ended.
    pub(super) fn run(mut self) -> Result<ProgramOutput> {
        let name = PathBuf::from(self.0.get_program()).display().to_string();
        let command = self.0.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().with_context(|| format!("{name} does not start"))?;
        let (text, errors) = (drain(child.stdout.take()), drain(child.stderr.take()));
        let start = Instant::now();
        let status = loop {
            if let Some(status) = child.try_wait()? {
                break status;
            }
            if start.elapsed() > PATIENCE {
                child.kill()?;
                bail!("{name} did not end within {} s", PATIENCE.as_secs());
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        let all = |thread: std::thread::JoinHandle<Vec<u8>>| thread.join().unwrap_or_default();
        let (text, errors) = (all(text), all(errors));
        let (text, errors) = (String::from_utf8_lossy(&text), String::from_utf8_lossy(&errors));
        Ok(ProgramOutput { status, text: text.into_owned(), errors: errors.into_owned() })
    }
}

/// Reads a pipe to its end, beside the other one.
fn drain(pipe: Option<impl Read + Send + 'static>) -> std::thread::JoinHandle<Vec<u8>> {
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        if let Some(mut pipe) = pipe {
            // What was read before an error is still worth showing.
            let _ = pipe.read_to_end(&mut bytes);
        }
        bytes
    })
}

impl ProgramOutput {
    pub(super) fn is_success(&self) -> bool {
        self.status.success()
    }

    /// An error that shows what the program said, unless it succeeded.
    pub(super) fn success(&self, what: &str) -> Result<()> {
        if self.is_success() {
            return Ok(());
        }
        bail!("{what} failed ({})\n{}{}", self.status, self.text, self.errors);
    }

    pub(super) fn lines(&self) -> Lines {
        Lines(self.text.clone())
    }
}

/// `key value` lines.
pub(super) struct Lines(String);

impl Lines {
    /// The value of `key`.
    pub(super) fn text(&self, key: &str) -> Result<&str> {
        let found = self.0.lines().find_map(|l| l.strip_prefix(key)?.strip_prefix(' '));
        found.map(str::trim).with_context(|| format!("no line {key:?} in what was printed:\n{}", self.0))
    }

    /// The value of `key` as a number.
    pub(super) fn number(&self, key: &str) -> Result<f64> {
        let text = self.text(key)?;
        text.parse().with_context(|| format!("{key} is {text:?}, not a number"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_found_by_their_whole_key() {
        let lines = Lines("media.stack 12\nmedia 3\nname of something\n".into());
        assert_eq!((lines.number("media").unwrap(), lines.number("media.stack").unwrap()), (3.0, 12.0));
        assert!(lines.number("name").is_err() && lines.text("stack").is_err());
    }

    #[test]
    fn what_is_not_here_is_named() {
        assert_eq!(Tool::Program("no-such-program").absent().as_deref(), Some("no-such-program"));
        assert!(Tool::Target("pdp11-none").absent().unwrap().contains("pdp11-none"));
    }
}
