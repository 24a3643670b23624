//! Reads what can be read only once, standard input and pipes, and has it ready for whoever reads it next.

use std::{
    collections::BTreeMap,
    fs,
    io::{self, Read},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use anyhow::{Context, Result, bail};
use codec_core::internals::wire::file::MAGIC;

/// Most bytes that are read from a pipe.
const MAX_BYTES: u64 = 2 << 30;
/// Most bytes that are read of what does not begin as a stream does, so that it can be named: a device may
/// give them without end.
const LOOKED_AT: u64 = 1 << 20;
/// The name of standard input.
const STANDARD_INPUT: &str = "-";

/// Bytes of a pipe, or why they could not be read.
type Piped = Result<Arc<Vec<u8>>, String>;

/// What was read of pipes, by their names.
static READ: Mutex<BTreeMap<PathBuf, Piped>> = Mutex::new(BTreeMap::new());

/// Whether `path` is standard input (`-`) or another input that can be read only once.
pub(crate) fn is_piped(path: &Path) -> bool {
    path == Path::new(STANDARD_INPUT)
        || fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir())
}

/// The bytes of file or pipe `path`; of a pipe or a device that does not begin as a stream does, the first.
///
/// # Errors
/// What cannot be read, or a pipe with more than 2 GiB.
pub(crate) fn bytes(path: &Path) -> Result<Arc<Vec<u8>>> {
    if !is_piped(path) {
        let bytes = fs::read(path).with_context(|| format!("{}: cannot read", path.display()))?;
        return Ok(Arc::new(bytes));
    }
    let mut read = READ.lock().unwrap_or_else(PoisonError::into_inner);
    let piped = read.entry(path.to_owned()).or_insert_with(|| once(path).map_err(|error| error.to_string()));
    match piped {
        Ok(bytes) => Ok(Arc::clone(bytes)),
        Err(why) => bail!("{}: cannot read: {why}", path.display()),
    }
}

fn once(path: &Path) -> io::Result<Arc<Vec<u8>>> {
    if path == Path::new(STANDARD_INPUT) {
        all_of_a_stream(io::stdin().lock())
    } else {
        all_of_a_stream(fs::File::open(path)?)
    }
}

/// All bytes of `input`, if it begins as a stream does; else the first.
fn all_of_a_stream(mut input: impl Read) -> io::Result<Arc<Vec<u8>>> {
    let mut bytes = Vec::new();
    input.by_ref().take(MAGIC.len() as u64).read_to_end(&mut bytes)?;
    let most = if bytes == MAGIC { MAX_BYTES + 1 } else { LOOKED_AT };
    input.take(most).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(io::Error::other(format!("found more than {MAX_BYTES} bytes, the most of a pipe")));
    }
    Ok(Arc::new(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_begins_as_a_stream_is_read_to_its_end() {
        let long = MAGIC.iter().copied().chain(std::iter::repeat_n(7, 3 << 20)).collect::<Vec<u8>>();
        assert_eq!(*all_of_a_stream(&long[..]).unwrap(), long);
        let endless = all_of_a_stream(io::repeat(0)).unwrap();
        assert_eq!(endless.len() as u64, LOOKED_AT + MAGIC.len() as u64);
        assert_eq!(*all_of_a_stream(&b"ply"[..]).unwrap(), b"ply");
    }
}
