//! Chooses what is compared with what: frames, cameras, pictures.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use codec_core::internals::ids::Level;
use render_host::Camera;
use trainer_host::viewpoint::Ring;

use super::side::{self, Pictures, Side};
use crate::{
    args::{Compare, ViewArgs},
    pipeline::{self, Frames, RENDER_RING, Showing, Surroundings},
};

/// Cameras around scenes without their own, where both sides are rendered.
const RING: (Ring, usize) = (Ring::HeldOut, 3);
/// Width and height of pictures where nothing else says, pixels.
const SIZE: (u32, u32) = (512, 512);

/// What is compared with what, once.
pub(super) struct Pair {
    /// File name of the heat map, without its ending.
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
            let pair = |Shown { name, frame, camera, from }: Shown| {
                let render = Source::Render(Box::new(from));
                Pair { name, frame, camera, a: render.clone(), b: render }
            };
            let pairs = views.list.into_iter().map(pair).collect();
            Chosen { pairs, cameras: views.description, notes: Vec::new() }
        }
        (Side::Frames(frames), Side::Pictures(pictures)) => {
            photographed(args, frames, pictures, &args.b, false)?
        }
        (Side::Pictures(pictures), Side::Frames(frames)) => {
            photographed(args, frames, pictures, &args.a, true)?
        }
    };
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
        let name = side::stem(&b.to_string_lossy()).to_owned();
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
    Ok(Chosen { pairs: unique(pairs.collect()), cameras: format!("as they are, {how}"), notes })
}

/// What is typed and says nothing of pictures.
fn unused_for_pictures(args: &Compare) -> Vec<&'static str> {
    let sides = [("--width", args.view.width.is_some()), ("--height", args.view.height.is_some())];
    let sides = sides.into_iter().filter(|(_, typed)| *typed).map(|(name, _)| name);
    args.cameras.given().into_iter().chain(sides).chain(args.scene.given()).collect()
}

/// Pairs of renders of `frames` and pictures that are there: of side A if `is_first`.
fn photographed(
    args: &Compare,
    frames: &mut Frames,
    pictures: &Pictures,
    name: &str,
    is_first: bool,
) -> Result<Chosen> {
    let first = pictures.paths.first().context("no pictures")?;
    let (width, height) = side::read(first, args.view.background)?.size();
    let view = ViewArgs {
        width: args.view.width.or(Some(width)),
        height: args.view.height.or(Some(height)),
        ..args.view.clone()
    };
    let views = views(args, frames, frames.count(), &view, RENDER_RING)?;
    let Matched { list, paths, cameras, how } = matched(views, &pictures.paths)?;
    let pairs = list.into_iter().zip(paths).map(|(Shown { name, frame, camera, from }, path)| {
        let (render, file) = (Source::Render(Box::new(from)), Source::File(path));
        let (a, b) = if is_first { (file, render) } else { (render, file) };
        Pair { name, frame, camera, a, b }
    });
    let mut notes = Vec::new();
    if let Some(of) = pictures.cameras.as_ref().filter(|of| **of != cameras) {
        notes.push(format!("{name} was rendered from {of}; it is compared with what {cameras} see"));
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

/// Which of `views` the pictures of `paths` show: all of them, or what `dgs render` writes of a clip, which
/// is its frames from the first camera, or one of them.
fn matched(views: Views, paths: &[PathBuf]) -> Result<Matched> {
    let Views { list, description, of_first, is_clip } = views;
    let found = |list: Vec<Shown>, paths: Vec<PathBuf>, cameras: String, how: &'static str| {
        Ok(Matched { list, paths, cameras, how })
    };
    let (by_name, by_order) = ("matched by name", "matched by order");
    let names: Vec<&str> = list.iter().map(|shown| shown.name.as_str()).collect();
    if let Some(paths) = side::by_name(paths, &names) {
        return found(list, paths, description, by_name);
    }
    let all = list.len();
    let is_all = paths.len() == all;
    let mut first: Vec<Shown> = list.iter().filter(|shown| shown.camera == 0).cloned().collect();
    if is_all && (!is_clip || first.len() < all) {
        return found(list, paths.to_vec(), description, by_order);
    }
    if is_clip {
        first.iter_mut().for_each(|shown| shown.name = format!("{:05}", shown.frame));
        let names: Vec<&str> = first.iter().map(|shown| shown.name.as_str()).collect();
        if let Some(paths) = side::by_name(paths, &names) {
            return found(first, paths, of_first, by_name);
        }
        let is_named =
            |shown: &Shown| paths.iter().any(|path| side::stem(&path.to_string_lossy()) == shown.name);
        let some: Vec<Shown> = first.iter().filter(|shown| is_named(shown)).cloned().collect();
        if some.len() == paths.len() {
            return found(some, paths.to_vec(), of_first, by_name);
        }
        if paths.len() == 1 {
            first.truncate(1);
        }
        if paths.len() == first.len() {
            return found(first, paths.to_vec(), of_first, by_order);
        }
    }
    bail!(
        "{} pictures, and cameras and frames for {all}; as many are needed where names do not say which: \
         --camera, --frames",
        paths.len()
    )
}

/// A picture that is to be rendered.
#[derive(Clone)]
struct Shown {
    name: String,
    frame: u32,
    camera: usize,
    from: Camera,
}

/// Pictures that are to be rendered, and from where.
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
        let name = side::stem(&view.name);
        let shown = |frame: u32, name: String| Shown { name, frame, camera, from: view.camera.clone() };
        if is_clip {
            let each = chosen.clone().map(|frame| shown(frame, format!("{frame:05}_camera{camera}")));
            list.extend(each);
            continue;
        }
        let frame = found.showing.frame_of(view, camera, count, &chosen)?;
        if chosen.contains(&frame) {
            let name = if name.is_empty() { format!("{camera:05}") } else { name.to_owned() };
            list.push(shown(frame, name));
        }
    }
    if list.is_empty() {
        bail!("nothing to compare: no camera shows a frame that is chosen");
    }
    let (description, of_first) = (found.of_frames(args.frames), found.of_first());
    Ok(Views { list, description, of_first, is_clip })
}

/// Gives pictures of the same name a number.
fn unique(mut pairs: Vec<Pair>) -> Vec<Pair> {
    let mut names = std::collections::BTreeSet::new();
    for (i, pair) in pairs.iter_mut().enumerate() {
        if !names.insert(pair.name.clone()) {
            pair.name = format!("{}_{i:05}", pair.name);
            names.insert(pair.name.clone());
        }
    }
    pairs
}
