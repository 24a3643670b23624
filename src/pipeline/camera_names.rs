//! Compares what files call cameras with what people and pictures call them: by the end of a path, since
//! folders and endings differ.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context, Result, bail};
use render_host::View;

/// Names that an error lists.
const LISTED: usize = 5;

/// A name without its folders and ending.
pub(crate) fn stem(name: &str) -> &str {
    let last = name.rsplit(['/', '\\']).next().unwrap_or_default();
    last.rsplit_once('.').map_or(last, |(stem, _)| stem)
}

/// The folders of a name and then its stem.
fn parts(name: &str) -> Vec<&str> {
    let mut parts: Vec<&str> =
        name.split(['/', '\\']).filter(|part| !part.is_empty() && *part != ".").collect();
    if let Some(last) = parts.last_mut() {
        *last = stem(last);
    }
    parts
}

/// How many parts two names have in common, counted from the last: the stem, the folder before it, and so on.
/// Endings do not count; 0 for names without a stem.
pub(crate) fn shared_end(a: &str, b: &str) -> usize {
    if stem(a).is_empty() {
        return 0;
    }
    let (a, b) = (parts(a), parts(b));
    a.iter().rev().zip(b.iter().rev()).take_while(|(a, b)| a == b).count()
}

/// Whether `end` is all of `name`, or the last of its parts; endings do not count.
pub(crate) fn is_end_of(end: &str, name: &str) -> bool {
    let shared = shared_end(end, name);
    shared > 0 && shared == parts(end).len()
}

/// Names of files, without endings, for what is called `names`: their stems, or the whole path with _ for /
/// where others have the same stem, and a number where others have the same path. No two are the same, not
/// even where upper and lower case are.
pub(crate) fn file_names<'n>(names: impl Iterator<Item = &'n str> + Clone) -> Vec<String> {
    let mut of_stem: BTreeMap<&str, usize> = BTreeMap::new();
    for name in names.clone() {
        *of_stem.entry(stem(name)).or_default() += 1;
    }
    let mut taken = BTreeSet::new();
    let file_name = |(i, name): (usize, &str)| {
        let is_alone = of_stem.get(stem(name)) == Some(&1);
        let mut file_name = if is_alone { stem(name).to_owned() } else { parts(name).join("_") };
        while !taken.insert(file_name.to_lowercase()) {
            file_name += &format!("_{i:05}");
        }
        file_name
    };
    names.enumerate().map(file_name).collect()
}

/// The camera of this name, or of this end of its name, or of this number, or that `dgs compare` calls so.
pub(super) fn choose<'v>(views: &'v [View], text: &str) -> Result<&'v View> {
    if let Some(named) = views.iter().find(|view| view.name == text) {
        return Ok(named);
    }
    let numbered = || text.parse::<usize>().ok().and_then(|index| views.get(index));
    // 0001 is rather what a camera is called.
    let counted = || numbered().filter(|_| text == "0" || !text.starts_with(['0', '+']));
    let ending: Vec<&View> = views.iter().filter(|view| is_end_of(text, &view.name)).collect();
    let compared = || {
        let names = file_names(views.iter().map(|view| &*view.name));
        names.iter().position(|name| name == text).and_then(|index| views.get(index))
    };
    match (&ending[..], counted()) {
        ([named], Some(numbered)) if named.name != numbered.name => bail!(
            "--camera is {text}: {} by its name, {} by its number; the whole name is allowed",
            named.name,
            numbered.name
        ),
        ([named], _) => Ok(named),
        (_, Some(numbered)) => Ok(numbered),
        ([], None) => compared().or_else(numbered).with_context(|| not_there(views, text)),
        (several, None) => {
            let names: Vec<&str> = several.iter().map(|view| &*view.name).collect();
            bail!("--camera is {text}: that may be {}", listed(&names))
        }
    }
}

/// That there is no camera called `text`, and which there are.
fn not_there(views: &[View], text: &str) -> String {
    let numbers = format!("0 to {}", views.len() - 1);
    let named: Vec<&str> = views.iter().map(|view| &*view.name).filter(|name| !name.is_empty()).collect();
    if named.is_empty() {
        return format!("--camera is {text}; these cameras have no names: {numbers} are allowed");
    }
    format!("--camera is {text}; a name, {}, or {numbers} are allowed", listed(&named))
}

/// The first of `names`, for people.
pub(crate) fn listed(names: &[&str]) -> String {
    let more = names.len().saturating_sub(LISTED);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{more}", names[..names.len().min(LISTED)].join(", "))
}

#[cfg(test)]
mod tests {
    use render_host::Camera;

    use super::*;

    fn view(name: &str) -> View {
        let camera = Camera::look_at([0.0, 0.0, -3.0], [0.0; 3], [0.0, 1.0, 0.0], 0.8, 8, 8).unwrap();
        View { name: name.to_owned(), time: None, camera }
    }

    #[test]
    fn cameras_are_chosen_by_name_before_number() {
        let views = [view("1"), view("b/c.png")];
        assert_eq!(choose(&views, "1").unwrap().name, "1");
        assert_eq!(choose(&views, "b/c.png").unwrap().name, "b/c.png");
        assert_eq!(choose(&views, "0").unwrap().name, "1");
        assert!(choose(&views, "2").unwrap_err().to_string().contains("0 to 1 are allowed"));
    }

    #[test]
    fn cameras_are_chosen_by_the_end_of_a_name_that_no_other_has() {
        let views = ["left/0001.png", "right/0001.png", "right/0002.png"].map(view);
        for (text, name) in [
            ("left/0001", "left/0001.png"),
            ("0002", "right/0002.png"),
            ("right_0001", "right/0001.png"),
            ("2", "right/0002.png"),
        ] {
            assert_eq!(choose(&views, text).unwrap().name, name, "{text}");
        }
        for (text, says) in [
            ("0001", "that may be left/0001.png, right/0001.png"),
            ("0003", "a name, left/0001.png, right/0001.png, right/0002.png, or 0 to 2 are allowed"),
        ] {
            let error = choose(&views, text).unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
        // A name and another number at once is neither.
        let views = ["1.png", "2.png"].map(view);
        let error = choose(&views, "1").unwrap_err().to_string();
        assert!(error.contains("1.png by its name, 2.png by its number"), "{error}");
        assert_eq!(choose(&views, "2").unwrap().name, "2.png");
        let unnamed = [view("")];
        assert!(choose(&unnamed, "1").unwrap_err().to_string().contains("0 to 0 are allowed"));
    }

    #[test]
    fn ends_of_paths_are_counted_by_part() {
        assert_eq!(shared_end("left/0001.png", "/data/left/0001.jpg"), 2);
        assert_eq!(shared_end("right/0001.png", "/data/left/0001.jpg"), 1);
        assert_eq!(shared_end("./test/r_2", "x\\r_2.png"), 1);
        assert_eq!((shared_end("", ""), shared_end("a/", "b/"), shared_end("r_1", "r_2")), (0, 0, 0));
        assert!(is_end_of("0001", "left/0001.png") && is_end_of("left/0001.png", "left/0001.png"));
        assert!(!is_end_of("x/left/0001", "left/0001.png") && !is_end_of("1", "left/0001.png"));
    }

    #[test]
    fn no_two_files_have_the_same_name() {
        let named = |names: &[&str]| file_names(names.iter().copied());
        assert_eq!(named(&["./test/r_1", "b/r_2.png"]), ["r_1", "r_2"]);
        assert_eq!(named(&["left/1.png", "right/1.png", "2.png"]), ["left_1", "right_1", "2"]);
        assert_eq!(named(&["a_00002", "a", "a"]), ["a_00002", "a", "a_00002_00002"]);
        assert_eq!(named(&["A.png", "a.png"]), ["A", "a_00001"]);
    }
}
