//! Chooses what is compared with what: frames, cameras, pictures.

use std::{
    collections::{BTreeMap, btree_map::Entry},
    path::PathBuf,
};

use anyhow::{Context, Result, bail};
use codec_core::internals::ids::Level;
use render_host::Camera;
use trainer_host::viewpoint::Ring;

use super::{
    named::{Named, by_name},
    side::{self, Pictures, Side},
};
use crate::{
    args::{Compare, ViewArgs},
    figures::counted,
    pipeline::{self, Frames, RENDER_RING, Showing, Surroundings, file_names, listed},
};

/// Cameras around scenes without their own, where both sides are rendered.
const RING: (Ring, usize) = (Ring::HeldOut, 3);
/// Width and height of pictures where nothing else says, pixels.
const SIZE: (u32, u32) = (512, 512);

/// What is compared with what, once.
pub(super) struct Pair {
    /// File name of the heat map, without its ending: no two are the same.
    pub(super) name: String,
    pub(super) frame: u32,
    pub(super) camera: usize,
    pub(super) a: Source,
    pub(super) b: Source,
}

impl Pair {
    /// Whether any of its pictures is a render.
    pub(super) fn is_rendered(&self) -> bool {
        [&self.a, &self.b].into_iter().any(|source| matches!(source, Source::Render(_)))
    }
}

/// Where one picture of a pair comes from.
#[derive(Clone)]
pub(super) enum Source {
    File(PathBuf),
    Render(Box<Camera>),
}

/// All that is compared.
pub(super) struct Chosen {
    pub(super) pairs: Vec<Pair>,
    /// From where, for people.
    pub(super) cameras: String,
    /// What a person should know of the choice.
    pub(super) notes: Vec<String>,
}

/// What is compared with what, and from where.
///
/// # Errors
/// Sides of which nothing, or not everything, can be compared.
pub(super) fn choose(args: &Compare, a: &mut Side, b: &mut Side) -> Result<Chosen> {
    let has_stream = [&*a, &*b].iter().any(|side| side.is_stream());
    let mut chosen = match (a, b) {
        (Side::Pictures(a), Side::Pictures(b)) => pictures(args, a, b)?,
        (Side::Frames(a), Side::Frames(b)) => {
            let count = matched_frames(args, a.count(), b.count())?;
            let views = views(args, b, count, &args.view, RING)?;
            let pair = |Shown { name, frame, camera, from, .. }: Shown| {
                let render = Source::Render(Box::new(from));
                Pair { name, frame, camera, a: render.clone(), b: render }
            };
            let pairs = views.list.into_iter().filter(|shown| shown.is_chosen).map(pair).collect();
            Chosen { pairs, cameras: views.description, notes: Vec::new() }
        }
        (Side::Frames(frames), Side::Pictures(pictures)) => {
            photographed(args, frames, pictures, &args.b, false)?
        }
        (Side::Pictures(pictures), Side::Frames(frames)) => {
            photographed(args, frames, pictures, &args.a, true)?
        }
    };
    let names = file_names(chosen.pairs.iter().map(|pair| &*pair.name));
    chosen.pairs.iter_mut().zip(names).for_each(|(pair, name)| pair.name = name);
    if !has_stream && args.level != Level::HIGHEST.get() {
        chosen.notes.push("neither side is a stream; not used: --level".to_owned());
    }
    Ok(chosen)
}

/// Pairs of pictures that are there.
fn pictures(args: &Compare, a: &Pictures, b: &Pictures) -> Result<Chosen> {
    let (pairs, how) = side::pairs(&a.paths, &b.paths)?;
    let chosen = match args.frames {
        None => 0..pairs.len(),
        Some(range) => {
            let range = range.within(pairs.len() as u32)?;
            range.start as usize..range.end as usize
        }
    };
    let pair = |(i, (a, b)): (usize, (PathBuf, PathBuf))| {
        let name = side::name_of(&b);
        Pair { name, frame: i as u32, camera: 0, a: Source::File(a), b: Source::File(b) }
    };
    let pairs = pairs.into_iter().enumerate().filter(|(i, _)| chosen.contains(i)).map(pair);
    let mut notes = Vec::new();
    if let (Some(of_a), Some(of_b)) = (&a.cameras, &b.cameras)
        && of_a != of_b
    {
        notes.push(format!("{} was rendered from {of_a}, {} from {of_b}", args.a, args.b));
    }
    let unused = unused_for_pictures(args);
    if !unused.is_empty() {
        notes.push(format!("pictures are compared as they are; not used: {}", unused.join(", ")));
    }
    Ok(Chosen { pairs: pairs.collect(), cameras: format!("as they are, {how}"), notes })
}

/// What is typed and says nothing of pictures.
fn unused_for_pictures(args: &Compare) -> Vec<&'static str> {
    args.cameras.given().into_iter().chain(typed_sides(args)).chain(args.scene.given()).collect()
}

/// Sides that are typed, where pictures have sizes of their own.
fn typed_sides(args: &Compare) -> Vec<&'static str> {
    let sides = [("--width", args.view.width.is_some()), ("--height", args.view.height.is_some())];
    sides.into_iter().filter(|(_, typed)| *typed).map(|(name, _)| name).collect()
}

/// Pairs of renders of `frames` and pictures that are there: of side A if `is_first`.
fn photographed(
    args: &Compare,
    frames: &mut Frames,
    pictures: &Pictures,
    name: &str,
    is_first: bool,
) -> Result<Chosen> {
    let size = side::size(pictures.paths.first().context("no pictures")?)?;
    let mut views_at = |(width, height): (u32, u32)| {
        let view = ViewArgs { width: Some(width), height: Some(height), ..args.view.clone() };
        views(args, frames, frames.count(), &view, RENDER_RING)
    };
    let Matched { mut list, paths, cameras, how } = matched(views_at(size)?, &pictures.paths)?;
    let mut others = BTreeMap::new();
    for (shown, path) in list.iter_mut().zip(&paths) {
        let own = side::size(path)?;
        if own == size {
            continue;
        }
        let cameras: &mut BTreeMap<_, _> = match others.entry(own) {
            Entry::Occupied(there) => there.into_mut(),
            Entry::Vacant(free) => {
                let at = views_at(own).with_context(|| path.display().to_string())?;
                free.insert(
                    at.list.into_iter().map(|shown| ((shown.camera, shown.frame), shown.from)).collect(),
                )
            }
        };
        let camera = cameras.get(&(shown.camera, shown.frame));
        shown.from = camera.context("a camera that is not there at another size")?.clone();
    }
    let pairs = list.into_iter().zip(paths).map(|(Shown { name, frame, camera, from, .. }, path)| {
        let (render, file) = (Source::Render(Box::new(from)), Source::File(path));
        let (a, b) = if is_first { (file, render) } else { (render, file) };
        Pair { name, frame, camera, a, b }
    });
    let mut notes = Vec::new();
    if let Some(of) = pictures.cameras.as_ref().filter(|of| **of != cameras) {
        notes.push(format!("{name} was rendered from {of}; it is compared with what {cameras} see"));
    }
    let unused = typed_sides(args);
    if !unused.is_empty() {
        notes.push(format!("renders are of the size of their pictures; not used: {}", unused.join(", ")));
    }
    Ok(Chosen { pairs: pairs.collect(), cameras: format!("{cameras}, {how}"), notes })
}

/// Renders and the pictures that they are compared with, one by one.
struct Matched {
    list: Vec<Shown>,
    paths: Vec<PathBuf>,
    cameras: String,
    how: &'static str,
}

/// Which of `views` the pictures of `paths` show: all that are chosen, or what `dgs render` writes of a clip,
/// which is its frames from the first camera, or some of them. Where any name says which, names decide, and
/// pictures of what is not chosen are left out.
///
/// # Errors
/// Names that do not say it of all, or a number of pictures that fits nothing.
fn matched(views: Views, paths: &[PathBuf]) -> Result<Matched> {
    let Views { list, description, of_first, is_clip } = views;
    let of_first_camera = list.iter().filter(|shown| is_clip && shown.camera == 0);
    let first: Vec<Shown> =
        of_first_camera.map(|shown| Shown { name: format!("{:05}", shown.frame), ..shown.clone() }).collect();
    let all = list.iter().filter(|shown| shown.is_chosen).count();
    let counts = format!("{}, and cameras and frames for {all}", counted(paths.len(), "picture"));
    for (list, cameras, is_whole) in [(&list, &description, true), (&first, &of_first, false)] {
        let names: Vec<&str> = list.iter().map(|shown| shown.name.as_str()).collect();
        let Named { pictures, mut wrong, is_any } = by_name(paths, &names);
        if !is_any {
            continue;
        }
        let chosen = list.iter().zip(pictures).filter(|(shown, _)| shown.is_chosen);
        let (there, missing): (Vec<_>, Vec<_>) = chosen.partition(|(_, picture)| picture.is_some());
        // A part of the frames may be there.
        if !missing.is_empty() && (is_whole || there.is_empty()) {
            let names: Vec<&str> = missing.iter().map(|(shown, _)| shown.name.as_str()).collect();
            wrong.push(format!("no picture is that of {}", listed(&names)));
        }
        if !wrong.is_empty() {
            bail!("{counts}: {}; --camera, --frames choose", wrong.join("; "));
        }
        let there = there.into_iter().filter_map(|(shown, picture)| Some((shown.clone(), picture?)));
        let (list, paths) = there.unzip();
        return Ok(Matched { list, paths, cameras: cameras.clone(), how: "matched by name" });
    }
    let [list, mut first] =
        [list, first].map(|list| list.into_iter().filter(|shown| shown.is_chosen).collect::<Vec<Shown>>());
    let by_order = |list: Vec<Shown>, cameras: String| {
        Ok(Matched { list, paths: paths.to_vec(), cameras, how: "matched by order" })
    };
    if paths.len() == all && (!is_clip || first.len() < all) {
        return by_order(list, description);
    }
    if is_clip {
        if paths.len() == 1 {
            first.truncate(1);
        }
        if paths.len() == first.len() {
            return by_order(first, of_first);
        }
    }
    bail!("{counts}; as many are needed where names do not say which: --camera, --frames")
}

/// A picture that may be rendered.
#[derive(Clone)]
struct Shown {
    name: String,
    frame: u32,
    camera: usize,
    from: Camera,
    /// Whether its frame is one of those that are compared.
    is_chosen: bool,
}

/// Pictures that may be rendered, and from where.
struct Views {
    list: Vec<Shown>,
    /// For people: all cameras.
    description: String,
    /// For people: the first camera.
    of_first: String,
    /// Whether every camera shows every frame.
    is_clip: bool,
}

/// Of how many frames some are compared: both sides have as many, or those that were chosen. A side of one
/// frame stands for any one frame.
fn matched_frames(args: &Compare, a: u32, b: u32) -> Result<u32> {
    let most = a.max(b);
    let chosen = args.frames.map(|range| range.within(most)).transpose()?;
    let has = |count: u32| {
        chosen.as_ref().is_some_and(|chosen| chosen.end <= count || (count == 1 && chosen.len() == 1))
    };
    if a != b && !(has(a) && has(b)) {
        let (first, second) = (&args.a, &args.b);
        bail!("{first} and {second} have {a} and {b} frames; as many are needed, or --frames that both have");
    }
    Ok(most)
}

/// The frame of `side` that stands for `frame`.
pub(super) fn frame_of(side: &Frames, frame: u32) -> u32 {
    if side.count() == 1 { 0 } else { frame }
}

/// The pictures to render, of a clip of `count` frames.
fn views(
    args: &Compare,
    frames: &mut Frames,
    count: u32,
    view: &ViewArgs,
    ring: (Ring, usize),
) -> Result<Views> {
    let (own, up) = (frames.cameras().to_vec(), frames.up());
    let mut around = Surroundings { own: &own, framing: &mut || frames.framing(), ring, size: SIZE, up };
    let found = pipeline::viewpoints(&args.cameras, view, &mut around)?;
    let chosen = match args.frames {
        None => 0..count,
        Some(range) => range.within(count)?,
    };
    let is_clip = found.showing == Showing::Clip;
    let mut list = Vec::new();
    for (camera, view) in found.views.iter().enumerate() {
        let name = view.name.as_str();
        let shown = |frame: u32, name: String| {
            let is_chosen = chosen.contains(&frame);
            Shown { name, frame, camera, from: view.camera.clone(), is_chosen }
        };
        if is_clip {
            list.extend((0..count).map(|frame| shown(frame, format!("{frame:05}_camera{camera}"))));
            continue;
        }
        let frame = found.showing.frame_of(view, camera, count, &chosen)?;
        let name = if name.is_empty() { format!("{camera:05}") } else { name.to_owned() };
        list.push(shown(frame, name));
    }
    if !list.iter().any(|shown| shown.is_chosen) {
        bail!("nothing to compare: no camera shows a frame that is chosen");
    }
    let (description, of_first) = (found.of_frames(args.frames), found.of_first());
    Ok(Views { list, description, of_first, is_clip })
}
