//! Plays a served stream and says how good it was: `dgs play`.

mod shown;

use std::{path::Path, time::Duration};

use anyhow::{Context, Result, bail};
use codec_core::{
    Caps,
    internals::{ids::Level, wire::receipt::ViewerPose},
};
use dgs_player::StreamInfo;
use dgs_quic::socket::{
    ClientConfig, Conditions, FrameShown, FrameSink, Granted, PlayError, PlayReport, Scheme, play,
};
use serde_json::json;
use shown::{Quality, Shown};
use trainer_host::Stream;

use super::{
    interruption::leave,
    relay,
    socket::{interruption, runtime, trust},
};
use crate::{
    args::Play,
    figures::{frozen, startup},
    files::LineLog,
    output::VerbOutput,
    pictures::PictureOutput,
    pipeline::{self, Frames, Quiet, Watching},
};

/// What a clip is numbered by that began again.
const NUMBERED: &str = "the clip began again: files in a folder, and psnr_db in --json, are numbered in the \
                        order of showing";

/// Remembers the state in which each frame was shown; pictures are drawn once nothing has to be on time.
struct States<'a> {
    args: &'a Play,
    draws: bool,
    shown: Shown,
    /// The viewer that is typed, once the manifest is there, and the frame that it sees next.
    watching: Option<Result<Watching>>,
    next: u32,
    /// The stream that what is shown is compared with.
    reference: Option<&'a Stream>,
    log: Option<LineLog>,
}

impl FrameSink for States<'_> {
    fn manifest(&mut self, message: &[u8]) {
        if self.watching.is_some() {
            return;
        }
        self.watching = match self.reference.map_or(Ok(()), |reference| check(reference, message)) {
            Err(error) => Some(Err(error)),
            Ok(()) => self.args.cameras.is_given().then(|| watching(self.args, message)),
        };
    }

    fn show(&mut self, player: &mut dgs_player::Player, frame: u32) -> Result<(), String> {
        self.next = frame + 1;
        if self.draws {
            self.shown.add(frame, player.content().blocks);
        }
        match &self.watching {
            Some(Err(error)) => Err(format!("{error:#}")),
            _ => Ok(()),
        }
    }

    fn shown(&mut self, frame: &FrameShown) {
        if let Some(log) = &mut self.log {
            log.add(frame);
        }
    }

    fn pose(&mut self) -> Option<ViewerPose> {
        match &self.watching {
            Some(Ok(watching)) => Some(watching.camera(self.next).pose()),
            _ => None,
        }
    }
}

/// Refuses a manifest that is not the one of the file that what is shown is compared with.
fn check(reference: &Stream, message: &[u8]) -> Result<()> {
    if reference.message() == message {
        return Ok(());
    }
    let wanted = reference.manifest()?.head().frames;
    let found = dgs_player::Player::new(message, &Caps::HOST)?.info().frames;
    if wanted != found {
        bail!("--reference has {wanted} frames; the stream that is served has {found}");
    }
    bail!("--reference has {wanted} frames, as the stream that is served has, but is another stream")
}

/// The viewer that is typed, before a stream of which the manifest alone is there: its proxies say where the
/// scene lies.
fn watching(args: &Play, message: &[u8]) -> Result<Watching> {
    let player = dgs_player::Player::new(message, &Caps::HOST)?;
    Watching::of(&args.cameras, &args.view, &mut frames(args, player))
}

/// All that `player` has.
fn frames(args: &Play, player: dgs_player::Player) -> Frames {
    Frames::of_stream(player, Level::ALL[Level::COUNT - 1], args.up.map(Into::into))
}

/// Runs the verb.
pub fn run(args: &Play, quiet: Quiet) -> Result<VerbOutput> {
    let trust = trust(&args.url, args.pin, args.ca.as_ref())?;
    check_relay(args)?;
    let conditions = conditions(args)?;
    let output = args.out.as_deref().map(|out| output(args, out)).transpose()?;
    let mut warnings = Vec::new();
    let reference = match &args.reference {
        Some(path) => Some(pipeline::read_stream(path, &mut |w| warnings.push(w))?),
        None => None,
    };
    let config = ClientConfig {
        start_us: (args.seek * 1e6) as u64,
        loops: args.repeat,
        streams: args.streams,
        conditions,
        duration: args.duration.map(duration),
        ..ClientConfig::new(args.url.clone(), trust)
    };
    let log = args.log.as_deref().map(|path| LineLog::open(path, "round")).transpose()?;
    let draws = args.out.is_some() || reference.is_some();
    let (shown, whole) = (Shown::default(), reference.as_ref());
    let mut states = States { args, draws, shown, watching: None, next: 0, reference: whole, log };
    let played = runtime()?.block_on(async {
        match args.url.scheme {
            Scheme::Moq => relay::play(&config, &mut states, interruption()).await,
            Scheme::Dgs | Scheme::Https => play(&config, &mut states, interruption()).await,
        }
    });
    if played.error.is_none() && played.player.is_none() {
        // A person has interrupted it before anything came.
        leave();
    }
    let watching = states.watching.take().transpose()?;
    if let Some(error) = played.error {
        if played.report.shown_count == 0 {
            let is_up = matches!(error, PlayError::TimeUp { .. });
            let error = anyhow::Error::new(error);
            let error = if is_up { error.context("--duration is over") } else { error };
            return Err(error.context(args.url.to_string()));
        }
        warnings.push(format!("{}: {error}; what was shown counts", args.url));
    }
    warnings.extend(ungranted(args, played.report.granted));
    let grows = played.report.grows;
    let clip = played.player.as_ref().filter(|_| !grows).map(dgs_player::Player::info);
    warnings.extend(clip.and_then(|info| past_the_end(args, &info)));
    let rounded = output
        .zip(played.player.as_ref())
        .and_then(|(output, player)| output.rounded_rate(player.manifest().frames_per_second()));
    let quality = match (played.player, draws) {
        (Some(player), true) => {
            let output = args.out.as_deref().zip(output);
            let mut frames = frames(args, player);
            let watching = match watching {
                Some(watching) => watching,
                None => Watching::of(&args.cameras, &args.view, &mut frames)?,
            };
            states.shown.draw(args, &frames, &watching, (output, reference.as_ref()), quiet)?
        }
        _ => None,
    };
    let mut text = summary(args, &played.report, quality.as_ref());
    let growing = if grows { unused_where_it_grows(args) } else { None };
    let numbered = states.shown.repeats().then(|| NUMBERED.to_owned());
    let notes: Vec<String> = growing.into_iter().chain(rounded).chain(numbered).collect();
    for note in &notes {
        text += &format!("  note: {note}\n");
    }
    let damaged = !warnings.is_empty();
    let out = args.out.as_deref().map(crate::files::shown);
    let json = json!({
        "report": played.report, "quality": quality, "out": out, "notes": notes,
        "warnings": warnings,
    });
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// When to stop; what is longer than any time that can be counted is for ever.
fn duration(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
}

/// Refuses what a relay cannot be asked for.
fn check_relay(args: &Play) -> Result<()> {
    if args.url.scheme != Scheme::Moq {
        return Ok(());
    }
    if args.policy.is_some() || args.impair.is_some() {
        bail!("{}: --policy and --impair are for a server of ours; a relay takes no such wishes", args.url);
    }
    if args.seek > 0.0 {
        bail!(
            "{}: --seek is for a server of ours; what a relay has is played from where it is now",
            args.url
        );
    }
    if args.streams {
        bail!("{}: --streams is for a server of ours; what comes from a relay is in streams", args.url);
    }
    Ok(())
}

/// What is typed and means nothing where a stream grows.
fn unused_where_it_grows(args: &Play) -> Option<String> {
    let typed = [("--seek", args.seek > 0.0), ("--loop", args.repeat)];
    let unused: Vec<&str> = typed.iter().filter(|(_, typed)| *typed).map(|(name, _)| *name).collect();
    (!unused.is_empty()).then(|| {
        let unused = unused.join(", ");
        format!("the stream grows: it was played from its newest window on, once; not used: {unused}")
    })
}

/// What the server is to change in this session, if anything.
fn conditions(args: &Play) -> Result<Option<Conditions>> {
    if args.policy.is_none() && args.impair.is_none() {
        return Ok(None);
    }
    let mut conditions = Conditions::NONE;
    if let Some(policy) = args.policy {
        conditions = conditions.with_scheduler(pipeline::policy(policy));
    }
    if let Some(text) = &args.impair {
        let link = pipeline::viewer_link(text)?;
        return Ok(Some(conditions.behind(&link).with_context(|| format!("--impair {text}"))?));
    }
    Ok(Some(conditions.with_link_as_it_is()))
}

/// What the server did not grant of what was asked for.
fn ungranted(args: &Play, granted: Option<Granted>) -> Option<String> {
    let Granted { link, scheduler } = granted?;
    let missing = match (args.impair.is_some() && !link, args.policy.is_some() && !scheduler) {
        (false, false) => return None,
        (true, true) => "--impair and --policy",
        (true, false) => "--impair",
        (false, true) => "--policy",
    };
    Some(format!("{}: the server does not grant {missing}; the session was under its own", args.url))
}

/// That the clip is over where it was to begin.
fn past_the_end(args: &Play, info: &StreamInfo) -> Option<String> {
    let (frames, seconds) = info.frames_per_seconds;
    let seconds = f64::from(info.frames) * f64::from(seconds) / f64::from(frames.max(1));
    let url = &args.url;
    (args.seek >= seconds)
        .then(|| format!("{url}: --seek is {}; the clip lasts {seconds:.2} s: its end is shown", args.seek))
}

/// What pictures are written as, if they can be.
fn output(args: &Play, out: &Path) -> Result<PictureOutput> {
    let output = PictureOutput::of(out, args.video_codec)?;
    if output.is_still() {
        bail!("{}: holds one picture; frames go to a folder, an animation or a video", out.display());
    }
    output.check(out, args.overwrite)?;
    Ok(output)
}

/// The report for people.
fn summary(args: &Play, report: &PlayReport, quality: Option<&Quality>) -> String {
    let startup = startup(report.startup_ms, report.startup_reached);
    let late = report.shown.iter().map(|shown| shown.late_ms).fold(0.0, f64::max);
    let mut text = format!(
        "{}\n  startup {startup}, {} frames shown of a clip of {}, {} rounds, at most {late:.1} ms late\n  \
         base missed {:.2} %, {:.2} of 4 levels usable, {}\n  {} packets, {:.1} KiB, {} recovered by \
         repair, {} twice, {} refused, {} connections\n",
        args.url,
        report.shown_count,
        report.frames,
        report.rounds,
        100.0 * report.base_miss_rate,
        report.mean_levels,
        frozen(report.freezes, report.frozen_frames),
        report.packets,
        report.received_bytes as f64 / 1024.0,
        report.recovered,
        report.duplicates,
        report.refused,
        report.connections,
    );
    if let Some(Granted { link, scheduler }) = report.granted {
        let said = |granted: bool| if granted { "granted" } else { "refused" };
        let wishes = [("link", args.impair.is_some(), link), ("scheduler", args.policy.is_some(), scheduler)];
        let wishes = wishes.iter().filter(|(_, is_wished, _)| *is_wished);
        let answers: Vec<String> =
            wishes.map(|(name, _, granted)| format!("{name} {}", said(*granted))).collect();
        text += &format!("  asked of the server: {}\n", answers.join(", "));
    }
    if let Some(quality) = quality {
        text += &format!(
            "  PSNR against complete frames: mean {:.2} dB, worst tenth {:.2} dB\n",
            quality.mean_psnr_db, quality.worst_tenth_psnr_db
        );
    }
    if let Some(folder) = args.out.as_ref().filter(|_| report.shown_count > 0) {
        text += &format!("  frames as shown: {}\n", folder.display());
    }
    text
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::args::{Cli, Verb};

    fn played(typed: &[&str]) -> Box<Play> {
        let typed = [&["dgs", "play"], typed].concat();
        match Cli::try_parse_from(&typed) {
            Ok(Cli { verb: Verb::Play(args), .. }) => args,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_time_to_play_may_be_longer_than_any_that_can_be_counted() {
        assert_eq!(duration(0.5), Duration::from_millis(500));
        assert_eq!((duration(1e20), duration(f64::MAX)), (Duration::MAX, Duration::MAX));
    }

    #[test]
    fn playout_that_began_as_the_wait_was_over_is_said_so() {
        let args = played(&["dgs://host"]);
        let begun = PlayReport { startup_ms: Some(5005.2), ..PlayReport::default() };
        let text = summary(&args, &begun, None);
        assert!(text.contains("startup not reached in 5005 ms, 0 frames shown"), "{text}");
        let reached = PlayReport { startup_reached: true, ..begun };
        assert!(summary(&args, &reached, None).contains("startup 5005 ms, "));
    }

    #[test]
    fn a_relay_is_sent_no_request_that_it_cannot_serve() {
        for (typed, named) in [
            (&["--policy", "dash"][..], "--policy"),
            (&["--seek", "1"], "--seek"),
            (&["--streams"], "--streams"),
        ] {
            let error = check_relay(&played(&[&["moq+https://host/fox"], typed].concat())).unwrap_err();
            assert!(error.to_string().contains(named), "{error}");
            check_relay(&played(&[&["dgs://host/fox"], typed].concat())).unwrap();
        }
        check_relay(&played(&["moq+https://host/fox", "--loop", "--seek", "0"])).unwrap();
    }

    #[test]
    fn what_a_stream_that_grows_leaves_unused_is_said() {
        assert_eq!(unused_where_it_grows(&played(&["dgs://host"])), None);
        let note = unused_where_it_grows(&played(&["dgs://host", "--seek", "3", "--loop"])).unwrap();
        assert!(note.ends_with("not used: --seek, --loop"), "{note}");
    }

    #[test]
    fn a_reference_is_the_stream_that_is_served() {
        let file = |bytes: &[u8]| Stream::from_bytes(bytes).unwrap().0;
        let shown = file(include_bytes!("../../codec-core/tests/conformance/everything.dgs"));
        let extents = file(include_bytes!("../../codec-core/tests/conformance/made-extents.dgs"));
        let xor = file(include_bytes!("../../codec-core/tests/conformance/xor.dgs"));
        check(&shown, shown.message()).unwrap();
        let error = check(&shown, extents.message()).unwrap_err().to_string();
        assert!(error.contains("11 frames") && error.contains("another stream"), "{error}");
        let error = check(&shown, xor.message()).unwrap_err().to_string();
        assert!(error.contains("--reference has 11 frames; the stream that is served has"), "{error}");
    }
}
