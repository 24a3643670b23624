//! Reads what Nerfstudio's `transforms.json` has beyond cameras: which frames are for what, and masks.
//!
//! `train_filenames`, `val_filenames` and `test_filenames` list `file_path`s; frames of no list are left out.
//! `mask_path` of a frame names an image of its size, black where pixels are not trained on.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use serde::Deserialize;

use super::error::DatasetError;

#[derive(Deserialize)]
struct Fields {
    #[serde(default)]
    frames: Vec<FrameFields>,
    train_filenames: Option<Vec<String>>,
    val_filenames: Option<Vec<String>>,
    test_filenames: Option<Vec<String>>,
}

#[derive(Deserialize)]
struct FrameFields {
    #[serde(default)]
    file_path: String,
    mask_path: Option<PathBuf>,
}

/// What frames are for, each as indices of frames in the order of the file.
pub(super) struct Splits {
    pub(super) train: Vec<usize>,
    pub(super) validation: Vec<usize>,
    pub(super) test: Vec<usize>,
}

/// What a file says besides.
pub(super) struct Extras {
    /// Of each frame, its mask, as the file names it.
    pub(super) masks: Vec<Option<PathBuf>>,
    /// Where the file has a list.
    pub(super) splits: Option<Splits>,
}

/// Reads `text`, of the file at `path`.
///
/// # Errors
/// A list or a mask of another form; a list with a frame that there is not, or one of training that another
/// list has too; no list of training beside others.
pub(super) fn read(path: &Path, text: &[u8]) -> Result<Extras, DatasetError> {
    let refused = |field: &str, found: String, allowed| DatasetError::Field {
        path: path.to_owned(),
        field: field.to_owned(),
        found,
        allowed,
    };
    let fields: Fields = serde_json::from_slice(text).map_err(|error| {
        refused("JSON", error.to_string(), "mask_path is a text and *_filenames are lists of texts")
    })?;
    let plain = |name: &str| name.strip_prefix("./").unwrap_or(name).to_owned();
    let mut numbers = BTreeMap::new();
    for (index, frame) in fields.frames.iter().enumerate() {
        numbers.entry(plain(&frame.file_path)).or_insert(index);
    }
    let indices = |field: &str, names: &Option<Vec<String>>| -> Result<Vec<usize>, DatasetError> {
        let index = |name: &String| {
            let none = || refused(field, name.clone(), "a file_path of frames is needed");
            numbers.get(&plain(name)).copied().ok_or_else(none)
        };
        let mut found = names.iter().flatten().map(index).collect::<Result<Vec<_>, _>>()?;
        found.sort_unstable();
        found.dedup();
        Ok(found)
    };
    let Fields { train_filenames, val_filenames, test_filenames, .. } = &fields;
    let has_list = [train_filenames, val_filenames, test_filenames].iter().any(|list| list.is_some());
    let splits = Splits {
        train: indices("train_filenames", train_filenames)?,
        validation: indices("val_filenames", val_filenames)?,
        test: indices("test_filenames", test_filenames)?,
    };
    if has_list && splits.train.is_empty() {
        return Err(refused(
            "train_filenames",
            "empty".to_owned(),
            "at least 1 beside the other lists is needed",
        ));
    }
    for (field, list) in [("val_filenames", &splits.validation), ("test_filenames", &splits.test)] {
        if let Some(&index) = list.iter().find(|index| splits.train.binary_search(index).is_ok()) {
            let found = fields.frames[index].file_path.clone();
            return Err(refused(field, found, "none of train_filenames is allowed"));
        }
    }
    let masks = fields.frames.into_iter().map(|frame| frame.mask_path).collect();
    Ok(Extras { masks, splits: has_list.then_some(splits) })
}
