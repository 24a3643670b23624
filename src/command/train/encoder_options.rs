//! Remembers with which options of the encoder a training was begun or its stream was made, so that going on
//! with others does not pass unnoticed.

use std::{collections::BTreeMap, path::Path};

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};

use super::{encoding::steps_are_typed, folder::Folder};
use crate::{args::train::Train, files};

/// Options by which a training chooses when it rounds its values; afterwards it keeps to what it chose.
const ROUNDED_BY: [&str; 4] = ["--pictures", "--search", "--cluster-size", "--block-len"];
/// How much of a training has rounded its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rounded {
    Nothing,
    /// Of a clip in epochs, some and not all.
    SomeEpochs,
    All,
}

/// What stands for an option that was not typed.
const NONE: &str = "none";

/// Options of the encoder by name, each as it is typed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct EncoderOptions(BTreeMap<String, String>);

impl EncoderOptions {
    /// Those of `args`, where a training already keeps to a size of `target_bytes` unless it is 0.
    pub(super) fn of(args: &Train, target_bytes: u64) -> Self {
        let mut options: BTreeMap<String, String> =
            args.codec.values().into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        let optional = |value: Option<String>| value.unwrap_or_else(|| NONE.to_owned());
        options.insert("--encoding-loss".to_owned(), args.encoding_loss.to_string());
        options.insert("--frames".to_owned(), optional(args.frames.map(|frames| frames.to_string())));
        options.insert("--delivery".to_owned(), optional(args.delivery.clone()));
        if target_bytes > 0 && !steps_are_typed(args) {
            options.entry("--target-bytes".to_owned()).and_modify(|value| {
                if value == NONE {
                    *value = target_bytes.to_string();
                }
            });
        }
        Self(options)
    }

    /// Those of the file at `path`; nothing where there is none.
    ///
    /// # Errors
    /// A file that cannot be read, or holds something else.
    pub(super) fn read(path: &Path) -> Result<Option<Self>> {
        if !path.is_file() {
            return Ok(None);
        }
        let failed = || path.display().to_string();
        Ok(Some(serde_json::from_slice(&std::fs::read(path).with_context(failed)?).with_context(failed)?))
    }

    /// Writes them to `path`.
    ///
    /// # Errors
    /// What the system says about the path.
    pub(super) fn write(&self, path: &Path) -> Result<()> {
        files::write(path, serde_json::to_string_pretty(self)?.as_bytes())
    }

    /// Takes them up in a training: writes them to the file at `path` where it begins, and says where it goes
    /// on how they differ from those of that file. What is `rounded` keeps to what it was rounded by; what
    /// comes back are the options that apply. Where no frames were typed they are those `of_source`.
    ///
    /// # Errors
    /// As [`EncoderOptions::read`] and [`EncoderOptions::write`]; other frames than values are rounded for;
    /// other options than some epochs are rounded by, where the rest is not rounded yet.
    pub(super) fn taken_up(
        mut self,
        path: &Path,
        resumes: bool,
        rounded: Rounded,
        of_source: usize,
    ) -> Result<(Self, Vec<String>)> {
        if !resumes {
            self.write(path)?;
            return Ok((self, Vec::new()));
        }
        let Some(before) = Self::read(path)? else { return Ok((self, Vec::new())) };
        let frames = |options: &Self| {
            let typed = options.0.get("--frames").filter(|&value| value != NONE);
            typed.cloned().unwrap_or_else(|| of_source.to_string())
        };
        let [found, was] = [&self, &before].map(frames);
        if rounded == Rounded::All && found != was {
            bail!(
                "--frames is {found}; {was}, as before, is allowed: the training has rounded its values \
                 for so many frames"
            );
        }
        let stays = |change: &String| {
            rounded != Rounded::Nothing && ROUNDED_BY.iter().any(|name| change.starts_with(name))
        };
        let (stay, apply): (Vec<String>, Vec<String>) = self.changes(&before).into_iter().partition(stays);
        if rounded == Rounded::SomeEpochs && !stay.is_empty() {
            bail!(
                "{}: epochs of the training have rounded their values by what was before; that alone is \
                 allowed, as all epochs are rounded by the same",
                stay.join(", ")
            );
        }
        let mut notes = Vec::new();
        if !apply.is_empty() {
            notes.push(format!(
                "--resume: options of the encoder are not those that the training had: {}; scene.dgs is \
                 written with these",
                apply.join(", ")
            ));
        }
        if !stay.is_empty() {
            notes.push(format!(
                "--resume: the training has rounded its values by options of the encoder that it had, and \
                 scene.dgs keeps to those: {} changes nothing; `dgs encode` of the checkpoint takes others",
                stay.join(", ")
            ));
            self.0.extend(before.0.into_iter().filter(|(name, _)| ROUNDED_BY.contains(&name.as_str())));
        }
        Ok((self, notes))
    }

    /// A note where a training goes on, nothing says what it was encoded with, and `stream` replaces another.
    pub(super) fn replaced(args: &Train, folder: &Folder, stream: &[u8]) -> Option<String> {
        let is_unknown = args.resume && !folder.encoder.is_file();
        let differs = || std::fs::read(&folder.stream).is_ok_and(|before| before != stream);
        (is_unknown && differs()).then(|| {
            format!(
                "{}: is another than before: {} is not there to say which options of the encoder it had",
                folder.stream.display(),
                folder.encoder.display()
            )
        })
    }

    /// What differs from `before`, for people: "--coarseness 2 (before: 1)". That what was trained is
    /// fine-tuned for delivery now is no difference.
    pub(super) fn changes(&self, before: &Self) -> Vec<String> {
        let differs = |(name, value): &(&String, &String)| {
            let then = before.0.get(*name);
            then != Some(value) && !(*name == "--delivery" && then.is_none_or(|then| then == NONE))
        };
        let said = |(name, value): (&String, &String)| {
            let then = before.0.get(name).map_or("not known", String::as_str);
            format!("{name} {value} (before: {then})")
        };
        self.0.iter().filter(differs).map(said).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::{super::parsed, *};

    fn of(args: &str, target_bytes: u64) -> EncoderOptions {
        EncoderOptions::of(&parsed(["scene"].into_iter().chain(args.split_whitespace())), target_bytes)
    }

    #[test]
    fn epochs_are_rounded_by_the_same_options() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("encoder.json");
        of("", 0).write(&path).unwrap();
        let resumed = |rounded: Rounded| of("--cluster-size 64", 0).taken_up(&path, true, rounded, 60);
        let error = resumed(Rounded::SomeEpochs).unwrap_err().to_string();
        assert!(error.starts_with("--cluster-size 64 (before: 512): epochs of the training"), "{error}");
        for (rounded, words) in
            [(Rounded::Nothing, "is written with these"), (Rounded::All, "keeps to those")]
        {
            let (_, notes) = resumed(rounded).unwrap();
            assert!(notes.len() == 1 && notes[0].contains(words), "{notes:?}");
        }
    }

    #[test]
    fn every_option_of_the_encoder_makes_a_difference() {
        let plain = of("", 0);
        for typed in [
            "--profile paper",
            "--coarseness 2",
            "--target-bits-per-gaussian 80",
            "--target-bytes 3000",
            "--target-psnr 40",
            "--pictures 0",
            "--search 24",
            "--cluster-size 64",
            "--block-len 16",
            "--window-frames 8",
            "--rank 2",
            "--packet-bytes 400",
            "--repair-set 8",
            "--repair full",
            "--encoding-loss 0.2",
            "--frames 12",
        ] {
            let changes = of(typed, 0).changes(&plain);
            assert_eq!(changes.len(), 1, "{typed}: {changes:?}");
            let name = typed.split(' ').next().unwrap();
            assert!(changes[0].starts_with(name) && changes[0].contains("(before: "), "{changes:?}");
        }
        assert!(of("--steps 9 --seed 3", 0).changes(&plain).is_empty(), "these are not the encoder's");
    }

    #[test]
    fn a_size_that_is_trained_for_stays_and_fine_tuning_what_was_trained_is_no_change() {
        let sized = of("--target-bytes 3000", 0);
        assert_eq!(of("", 3000), sized, "left out, it is that of the training");
        assert_eq!(of("--coarseness 2", 3000).changes(&sized).len(), 2);
        assert!(of("--delivery iid", 0).changes(&of("", 0)).is_empty());
        let back = of("", 0).changes(&of("--delivery iid", 0));
        assert_eq!(back, ["--delivery none (before: iid)"]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("encoder.json");
        assert_eq!(EncoderOptions::read(&path).unwrap(), None);
        sized.write(&path).unwrap();
        assert_eq!(EncoderOptions::read(&path).unwrap(), Some(sized));
        std::fs::write(&path, "[1]").unwrap();
        let error = EncoderOptions::read(&path).unwrap_err().to_string();
        assert!(error.contains("encoder.json"), "{error}");
    }
}
