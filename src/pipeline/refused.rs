//! Says what helps where a scene or a stream is refused: an option, a verb, another file.

use std::{fs, io::Read as _, path::Path};

use trainer_host::import::{ErrorKind, ImportError};

/// Where a folder of photographs says what its cameras are.
const DATASETS: [&str; 9] = [
    "transforms_train.json",
    "transforms.json",
    "train_meta.json",
    "sparse/0/cameras.bin",
    "sparse/0/cameras.txt",
    "sparse/cameras.bin",
    "sparse/cameras.txt",
    "colmap/sparse/0/cameras.bin",
    "colmap/sparse/0/cameras.txt",
];
/// Bytes of a file that are looked at.
const LOOKED_AT: u64 = 4096;

/// `error` of reading `path`, with what helps. `is_readable` tries whether `--keep-readable` reads anything.
pub(super) fn hinted(error: ImportError, path: &Path, is_readable: impl Fn() -> bool) -> anyhow::Error {
    let helps = match error.kind {
        ErrorKind::TooLarge if &*error.field == "Gaussian count" => {
            Some("--max-gaussians accepts more".to_owned())
        }
        _ if error.allowed.contains("finite") => Some("--keep-readable leaves such Gaussians out".to_owned()),
        ErrorKind::Truncated | ErrorKind::Malformed if is_readable() => {
            Some("--keep-readable reads what is there".to_owned())
        }
        _ => instead(path),
    };
    match helps {
        Some(helps) => anyhow::anyhow!("{error}; {helps}"),
        None => error.into(),
    }
}

/// What `path` is that is neither a scene nor a stream, and what takes it.
pub(super) fn instead(path: &Path) -> Option<String> {
    if path.is_dir() {
        let trained = path.join("checkpoint.dgst");
        if trained.is_file() {
            return Some(format!("{} is the scene that was trained", trained.display()));
        }
        let is_dataset = DATASETS.iter().any(|name| path.join(name).is_file());
        return is_dataset
            .then(|| format!("it holds photographs: dgs train {} makes a scene of them", path.display()));
    }
    let name = path.file_name()?.to_string_lossy();
    if !name.ends_with(".json") {
        return None;
    }
    if name.starts_with("transforms") || name.ends_with("_meta.json") {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new(".")).display();
        return Some(format!(
            "it holds cameras: --cameras takes it, and dgs train {folder} makes a scene of their photographs"
        ));
    }
    let mut start = Vec::new();
    fs::File::open(path).ok()?.take(LOOKED_AT).read_to_end(&mut start).ok()?;
    let mark = b"\"made_from\"";
    let holds_decisions = start.windows(mark.len()).any(|window| window == mark);
    holds_decisions.then(|| "it holds decisions: dgs inspect --decisions says which".to_owned())
}
