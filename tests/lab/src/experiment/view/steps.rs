//! Measures what each step of a player that cannot keep up costs in the picture, and what time it saves.

use std::{thread, time::Duration, time::Instant};

use anyhow::{Result, bail};
use dgs_viewer::{DrawOptions, Drawn, Reduction, Screen, Session};
use render_host::{
    Image,
    gpu::{Device, DeviceOptions},
    metric::psnr,
};

use crate::figures::{Bench, Figure, mean, median};

/// What the protocol says of it.
pub const PROTOCOL: &str = "; steps of keeping up: frames of the clip one after the other through the \
     player's own pass into memory, medians of time with the device waited for, PSNR of what is shown \
     against the whole picture; decode: of that time what the processor takes for the Gaussians";
/// Size of what is shown, pixels.
const SIZE: [u32; 2] = [640, 360];
/// A frame whose tile lists had no room is drawn again.
const TRIES: usize = 8;

/// Enters every step for the stream of `file`, called `name`; `frames` of it are drawn at each.
pub fn run(bench: &mut Bench, name: &str, file: &[u8], frames: u32) -> Result<()> {
    let device = match Device::open(&DeviceOptions::from_env()) {
        Ok(device) => device,
        Err(error) => {
            bench.skipped.push(format!("{name}: steps of keeping up: {error}"));
            return Ok(());
        }
    };
    let mut screen = Screen::in_memory(device)?;
    let (mut session, _) = Session::open(file)?;
    let up = session.up_of_stream();
    session.look_at_all(f64::from(SIZE[0]) / f64::from(SIZE[1]), up)?;
    let mut whole: Option<(f64, Vec<Image>)> = None;
    for (at, step) in Reduction::STEPS.iter().enumerate() {
        let Measured { frame_ms, decode_ms, pictures } = measure(&mut session, &mut screen, step, frames)?;
        let figure = |key: &str, value| Figure::new(format!("{name}.step{at}.{key}"), value, "ms");
        let mut drawn = figure("frame_ms", frame_ms);
        if let Some((whole_ms, all)) = &whole {
            let each: Result<Vec<f64>, _> = pictures.iter().zip(all).map(|(a, b)| psnr(a, b)).collect();
            drawn = drawn.peer("whole", *whole_ms, true).error(mean(&each?), "dB");
        } else {
            whole = Some((frame_ms, pictures));
        }
        bench.push(drawn);
        bench.push(figure("decode_ms", decode_ms));
    }
    bench.also(&format!("; {name} on {}", screen.adapter()));
    Ok(())
}

/// What frames took at a step, medians, and pictures of it.
struct Measured {
    frame_ms: f64,
    decode_ms: f64,
    pictures: Vec<Image>,
}

fn measure(session: &mut Session, screen: &mut Screen, step: &Reduction, frames: u32) -> Result<Measured> {
    session.reduce(step.cap, step.share);
    let size = SIZE.map(|side| (f64::from(side) * step.scale).round() as u32);
    let look = DrawOptions { size, shown: SIZE, background: [0.0; 3], sh_degree: step.sh_degree };
    let mut drawn = None;
    // The first one uploads everything and makes room.
    let mut pictures = vec![picture(session, screen, &mut drawn, &look, 0)?];
    let (mut all_ms, mut decode_ms) = (Vec::new(), Vec::new());
    let last = session.player().info().frames;
    for frame in 1..=frames {
        seek(session, frame % last);
        let began = Instant::now();
        screen.draw(session, &mut drawn, &look)?;
        while screen.pending() > 0 {
            thread::sleep(Duration::from_micros(100));
        }
        all_ms.push(1e3 * began.elapsed().as_secs_f64());
        seek(session, (frame + 1) % last);
        let began = Instant::now();
        session.show()?;
        decode_ms.push(1e3 * began.elapsed().as_secs_f64());
    }
    // What was decoded for its time was not drawn.
    drawn = None;
    for frame in [last / 3, 2 * last / 3] {
        pictures.push(picture(session, screen, &mut drawn, &look, frame)?);
    }
    Ok(Measured { frame_ms: median(&all_ms), decode_ms: median(&decode_ms), pictures })
}

fn seek(session: &mut Session, frame: u32) {
    let rate = session.player().manifest().frames_per_second();
    session.playback_mut().seek((f64::from(frame) + 0.5) / rate);
}

/// Frame `frame` as it is shown.
fn picture(
    session: &mut Session,
    screen: &mut Screen,
    drawn: &mut Drawn,
    look: &DrawOptions,
    frame: u32,
) -> Result<Image> {
    seek(session, frame);
    for _ in 0..TRIES {
        screen.draw(session, drawn, look)?;
        if let Some(image) = screen.read()? {
            return Ok(image);
        }
    }
    bail!("frame {frame}: {TRIES} times no room for tile lists")
}
