//! `session replay`: plays a recorded session again, with the recorded gaps to the tick, and compares the receipts.
//!
//! [`rows`] reads the record page by page, on a separate thread. [`plan`] turns the rows into orders, twice: first to check that
//! everything can be played, then to play it. Each order has its onset as a tick; it is sent some seconds ahead. [`compare`]
//! compares each receipt when its play is over.
//!
//! Bounds: three pages of rows, and [`MOST_AHEAD`] pending orders, even for a long session with long gaps.
//!
//! Invariant: the replay plays nothing unless the texts of all selected plays are kept. Exit 0 means that every play that had begun
//! was played as recorded. A signal or an error stops the display.

mod compare;
mod plan;
mod rows;

use super::arguments::{ClientOptions, positive};
use super::ending::Ending;
use super::export::lacks;
use super::output::{give, say, say_json};
use super::text;
use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use compare::{MAX_LISTED, Onset, Skipped, Summary, compare};
use meissner_api::{ArrayDetails, Code, PlayAccepted, Receipt, RecordedPlay, SessionPlays, Status};
use meissner_array::units::TickRate;
use meissner_client::{Client, ClientError, DISK_TIMEOUT, escape};
use plan::{Order, Planner, Recorded, Skip, Step, rate};
use rows::Rows;
use serde_json::json;
use std::collections::VecDeque;
use std::process::ExitCode;
use std::thread;
use std::time::Duration;

/// Time from the last check to the first onset, s.
const START_AFTER_S: u64 = 1;
/// How long before its onset an order is sent, s: a stall of this process then delays no play.
const AHEAD_S: u64 = 5;
/// Pending orders, at most: the daemon queues 16 behind the running play.
const MOST_AHEAD: usize = 12;
/// What a replay says that a signal ends: it must not go on unattended.
const STOPPED: &str = "the replay has ended, and its play was stopped";
const NOT_STOPPED: &str = "the replay has ended, but its play was not stopped";
/// How long to wait for a receipt at a time.
const WAIT_S: f64 = 1.0;

#[derive(Debug, Args)]
pub(super) struct Replay {
    /// Play the session with this id again
    id: String,
    /// Begin with this play, by its number in the export
    #[arg(long, value_name = "PLAY")]
    from: Option<u64>,
    /// End with this play
    #[arg(long, value_name = "PLAY")]
    to: Option<u64>,
    /// Play this one alone
    #[arg(long, value_name = "PLAY", conflicts_with_all = ["from", "to"])]
    play: Option<u64>,
    /// Print what would be played, and play nothing
    #[arg(long)]
    dry_run: bool,
    /// Report a rest error as different if it is more than UM um larger than the recorded one
    #[arg(long, value_name = "UM", default_value_t = 50.0, allow_negative_numbers = true, value_parser = positive)]
    rest_tolerance_um: f64,
    #[command(flatten)]
    options: ClientOptions,
}

pub(super) fn run(asked: &Replay) -> Result<ExitCode> {
    let mut client = asked.options.client()?;
    let session: meissner_api::Session =
        client.get_within(DISK_TIMEOUT, &format!("/v1/sessions/{}", escape(&asked.id)))?;
    if session.reason.is_none() {
        bail!("session {} still runs: end it first, then play it again", session.id);
    }
    if asked.dry_run {
        return dry_run(asked, &session.id);
    }
    let plays = check(asked, &session.id)?;
    let mut player = Player::new(client, plays, &session.id, asked)?;
    player.summary.missing = missing(asked, &session.id)?;
    let played = player.play(plan_all(asked, &session.id)?);
    player.ending.wait_if_stopping();
    if let Err(error) = played {
        player.summary.ended_early = Some(player.end_early(&error));
    }
    let Player { summary, rate, .. } = player;
    let same = summary.is_same();
    give(asked.options.output.json, &summary, || summary_text(&summary, rate))?;
    Ok(if same { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The parts of the session that the record lacks; none if one play was selected, because that play is there.
fn missing(asked: &Replay, id: &str) -> Result<Option<String>> {
    if asked.play.is_some() {
        return Ok(None);
    }
    let beyond = format!("/v1/sessions/{}/plays?from=1000000000", escape(id));
    let none: SessionPlays = asked.options.client()?.get_within(DISK_TIMEOUT, &beyond)?;
    Ok(lacks(&none))
}

/// A play with its plan.
type Planned = (Recorded, Result<Step, Skip>);

/// The selected plays of a session with their plans, one after the other. A play of another array than the daemon's is an error.
fn plan_all(asked: &Replay, id: &str) -> Result<impl Iterator<Item = Result<Planned>>> {
    let selected = |play: u64| match asked.play {
        Some(only) => play == only,
        None => asked.from.is_none_or(|from| play >= from) && asked.to.is_none_or(|to| play <= to),
    };
    let array = asked.options.client()?.get::<ArrayDetails>("/v1/array")?.name;
    let mut planner = Planner::default();
    Ok(Rows::read(asked.options.client()?, id)?
        .filter(move |row| row.as_ref().map_or(true, |row| selected(row.play.play)))
        .map(move |row| {
            let row = row?;
            let planned = planner.plan(row.clone());
            let RecordedPlay { play, array: its, .. } = &row.play;
            // The record of a play without an end does not say its array.
            if planned.is_ok() && *its != array {
                bail!("play {play} was recorded on the array {its}, and the daemon drives {array}");
            }
            Ok((row, planned))
        }))
}

/// Refuses plays that cannot be played, before any is played. Returns the number of plays.
fn check(asked: &Replay, id: &str) -> Result<u64> {
    let (mut plays, mut playable) = (0, false);
    for row in plan_all(asked, id)? {
        let (recorded, planned) = row?;
        plays += 1;
        if let Err(skip @ Skip::NoText { .. }) = planned {
            bail!("play {}: {skip}", recorded.play.play);
        }
        playable |= planned.is_ok();
    }
    if !playable {
        bail!(
            "session {id}: no play of it can be played again; `meissner session export {id}` shows what is recorded"
        );
    }
    Ok(plays)
}

/// Prints the plan.
fn dry_run(asked: &Replay, id: &str) -> Result<ExitCode> {
    let json = asked.options.output.json;
    let (mut steps, mut plays, mut skipped, mut missing, mut end_s) = (Vec::new(), 0u64, 0u64, 0u64, 0.0f64);
    for row in plan_all(asked, id)? {
        let (recorded, planned) = row?;
        let play = &recorded.play;
        plays += 1;
        let about = match &planned {
            Ok(step) => step.note.clone().unwrap_or_default(),
            Err(why) => format!("not played: {why}"),
        };
        missing += u64::from(matches!(planned, Err(Skip::NoText { .. })));
        skipped += u64::from(planned.is_err());
        let start = planned.as_ref().ok().map(|step| step.start);
        let start_s = start.map(|start| rate(play).ticks_to_seconds(start));
        end_s = end_s.max(start_s.unwrap_or(0.0));
        if json && steps.len() < MAX_LISTED {
            steps.push(json!({
                "play": play.play, "pattern": play.pattern, "pattern_sha256": play.pattern_sha256,
                "start_ticks": start, "ordered_ms": play.ordered_ms, "scale": play.scale, "trial": play.trial,
                "items": play.items, "note": about
            }));
        } else if !json {
            let start = start_s.map_or_else(|| "-".to_owned(), |start_s| format!("{start_s:.6} s"));
            let lasts = play.ordered_ms.map_or_else(String::new, |ms| format!(", {:.3} s", ms / 1e3));
            let items = if play.items > 0 { format!(", {} items", play.items) } else { String::new() };
            let about = if about.is_empty() { about } else { format!("; {about}") };
            say(&format!("{start:>16}  play {} {}{lasts}{items}{about}", play.play, play.pattern))?;
        }
    }
    let lacks = self::missing(asked, id)?;
    let document = json!({
        "session": id, "plays": plays, "not_played": skipped, "texts_missing": missing, "missing": lacks,
        "last_onset_s": end_s, "steps": steps
    });
    if json {
        say_json(&document)?;
    } else {
        say(&format!("{plays} plays, {skipped} of them not played; the last onset is at {end_s:.3} s"))?;
    }
    Ok(if missing == 0 && lacks.is_none() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// A step whose orders were sent.
struct UnderWay {
    step: Step,
    ids: Vec<u64>,
}

/// Plays the steps and compares their receipts.
struct Player {
    client: Client,
    ending: Ending,
    json: bool,
    tolerance_um: f32,
    /// The tick rate of the daemon's array.
    rate: TickRate,
    /// The tick of the first onset, and the boot it belongs to.
    base: Option<(u64, u32)>,
    under_way: VecDeque<UnderWay>,
    /// The onset of the last step that was compared.
    last: Option<Onset>,
    summary: Summary,
}

impl Player {
    fn new(mut client: Client, plays: u64, session: &str, asked: &Replay) -> Result<Self> {
        let status: Status = client.get("/v1/status")?;
        if status.state != "armed" {
            bail!("the device is {} ({}): `meissner arm` first", status.state, status.cause);
        }
        if status.play.is_some() || !status.queued.is_empty() {
            bail!("a play runs or waits: wait for its end, or `meissner stop`");
        }
        let array: ArrayDetails = client.get("/v1/array")?;
        Ok(Self {
            client,
            rate: TickRate::new(array.tick_hz),
            ending: Ending::listen_as(&asked.options, STOPPED, NOT_STOPPED)?,
            json: asked.options.output.json,
            tolerance_um: asked.rest_tolerance_um as f32,
            base: None,
            under_way: VecDeque::new(),
            last: None,
            summary: Summary { session: session.to_owned(), plays, ..Summary::default() },
        })
    }

    /// Plays all steps. Ends at the first refused step, after the plays already ordered.
    fn play(&mut self, steps: impl Iterator<Item = Result<Planned>>) -> Result<()> {
        let mut played = Ok(());
        for row in steps {
            played = row.and_then(|(recorded, planned)| match planned {
                Ok(step) => self.order(step),
                Err(why) => self.skip(recorded.play.play, &why, why == Skip::NeverBegan),
            });
            if played.is_err() {
                break;
            }
        }
        while !self.under_way.is_empty() {
            self.follow_oldest()?;
        }
        played
    }

    fn skip(&mut self, play: u64, why: &impl ToString, never_began: bool) -> Result<()> {
        let skipped = Skipped { play, why: why.to_string() };
        self.tell(&format!("play {play}: not played: {}", skipped.why))?;
        self.summary.skip(skipped, never_began);
        Ok(())
    }

    /// A line on stdout, unless a document is to be printed.
    fn tell(&self, line: &str) -> Result<()> {
        if self.json { Ok(()) } else { say(line) }
    }

    /// Waits until a step is due, and sends its orders.
    fn order(&mut self, step: Step) -> Result<()> {
        let (base, boot) = match self.base {
            Some(base) => base,
            None => {
                let (now, boot) = self.now()?;
                *self.base.insert((now + START_AFTER_S * self.rate.per_s(), boot))
            }
        };
        while self.under_way.len() >= MOST_AHEAD
            || self.now()?.0 + AHEAD_S * self.rate.per_s() < base + step.start
        {
            match self.under_way.is_empty() {
                true => thread::sleep(Duration::from_secs_f64(WAIT_S / 4.0)),
                false => self.follow_oldest()?,
            }
        }
        if let Some(note) = &step.note {
            self.tell(&format!("play {}: {note}", step.recorded.play.play))?;
        }
        let mut ids = Vec::new();
        for (start, order) in &step.orders {
            let at_tick = Some(base + step.start + start);
            loop {
                match self.send(order, at_tick, boot) {
                    Ok(id) => break ids.push(id),
                    Err(ClientError::Problem(problem))
                        if problem.code == Code::QueueFull.parts().0 && !self.under_way.is_empty() =>
                    {
                        self.follow_oldest()?;
                    }
                    // The cut play was so short that no stroke fits.
                    Err(ClientError::Problem(problem))
                        if problem.code == Code::Empty.parts().0 && !step.is_whole =>
                    {
                        let why = "it was cut before its first stroke was over";
                        return self.skip(step.recorded.play.play, &why, false);
                    }
                    Err(error) => return Err(anyhow!("play {}: {error}", step.recorded.play.play)),
                }
            }
        }
        self.under_way.push_back(UnderWay { step, ids });
        Ok(())
    }

    fn send(&mut self, order: &Order, at_tick: Option<u64>, boot: u32) -> Result<u64, ClientError> {
        let boot = Some(boot);
        let client = &mut self.client;
        let sent = self.ending.order(|| -> Result<PlayAccepted, ClientError> {
            match order {
                Order::Play(request) => {
                    let mut request = request.clone();
                    (request.at_tick, request.boot) = (at_tick, boot);
                    client.play(&request)
                }
                Order::Sequence(request) => {
                    let mut request = request.clone();
                    (request.at_tick, request.boot) = (at_tick, boot);
                    client.sequence(&request)
                }
            }
        });
        Ok(sent?.id)
    }

    /// Stops the pending plays after an error, and returns why the replay ended.
    fn end_early(&mut self, error: &anyhow::Error) -> String {
        match self.ending.stop(&mut self.client) {
            Ok(_) => error.to_string(),
            Err(failed) => format!("{error}; its plays were not stopped: {failed}"),
        }
    }

    /// The device's clock.
    fn now(&mut self) -> Result<(u64, u32)> {
        let status: Status = self.client.get("/v1/status")?;
        let device = status.device.as_ref().map(|device| device.boot);
        status.clock.map(|clock| clock.tick).zip(device).context("the device is gone: see `meissner status`")
    }

    /// Waits for the end of the oldest step for [`WAIT_S`]; compares it if it is over.
    fn follow_oldest(&mut self) -> Result<()> {
        let Some(UnderWay { ids, .. }) = self.under_way.front() else { return Ok(()) };
        let mut receipts = Vec::new();
        for id in ids {
            let within = Duration::from_secs_f64(WAIT_S) + DISK_TIMEOUT;
            let receipt: Receipt =
                self.client.get_within(within, &format!("/v1/plays/{id}?wait={WAIT_S}"))?;
            if !receipt.state.is_over() {
                return Ok(());
            }
            receipts.push(receipt);
        }
        self.ending.wait_if_stopping();
        let Some(UnderWay { step, .. }) = self.under_way.pop_front() else { return Ok(()) };
        let first = receipts.first().and_then(|receipt| receipt.onset);
        let late = step.orders.first().map_or(0, |(start, _)| *start);
        let now = first
            .map(|onset| Onset { planned: step.start, replayed: onset.actual_tick.saturating_sub(late) });
        let differences = compare(&step, &receipts, (self.last, now), self.tolerance_um);
        if let Some((last, now)) = self.last.zip(now) {
            let error = (now.replayed - last.replayed).abs_diff(now.planned - last.planned);
            self.summary.gap_error_max_ticks = self.summary.gap_error_max_ticks.max(error);
        }
        self.last = now.or(self.last);
        if let Some(differing) = self.summary.add(&step, &receipts, differences) {
            self.tell(&differing.line())?;
        }
        Ok(())
    }
}

fn gaps(summary: &Summary, rate: TickRate) -> String {
    let error = match summary.gap_error_max_ticks {
        0 => "as recorded, to the tick".to_owned(),
        ticks => format!("off by {ticks} ticks at most, {:.3} ms", rate.ticks_to_ms(ticks)),
    };
    match summary.gaps_by_host_clock {
        0 => error,
        inexact => format!("{error}, but {inexact} recorded by the host's clock only"),
    }
}

fn summary_text(summary: &Summary, rate: TickRate) -> String {
    let Summary { plays, replayed, skipped, differing, .. } = summary;
    let mut lines = vec![
        ("session", summary.session.clone()),
        ("replayed", format!("{replayed} of {plays} plays, {skipped} not played")),
        ("as recorded", format!("{}, {differing} differ", replayed - differing)),
        ("gaps", gaps(summary, rate)),
        (
            "largest rest error",
            format!(
                "{:.1} um, recorded {:.1} um",
                summary.rest_error_replayed_max_um, summary.rest_error_recorded_max_um
            ),
        ),
    ];
    lines.extend(summary.ended_early.iter().map(|why| ("ended early", why.clone())));
    lines.extend(summary.missing.iter().map(|missing| ("record", missing.clone())));
    text::pairs(&lines)
}
