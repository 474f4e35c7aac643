//! Commands that change something: play, stop, estop, reset, arm, disarm, home.
//!
//! They send one request and print its result. `play --wait` subscribes to events before it sends the request, so it
//! misses no event of its play; if a slow terminal loses events, it asks the daemon for the receipt.
//!
//! Invariant: no request is sent twice, except an e-stop.

use super::arguments::{ClientOptions, EdgeOptions, FITS, Onset, PlayOptions, choice, positive};
use super::ending::Ending;
use super::files::{self, Kind};
use super::output::{give, say, shown, tell};
use super::progress::Progress;
use super::{pattern_file, session_token, text};
use anyhow::{Result, anyhow, bail};
use clap::Args;
use meissner_api::{
    ArmRequest, Code, EdgeRequest, Event, Fit, Item, LatePolicy, MAX_BODY, Order, Receipt, ResetRequest,
    Status, Terms,
};
use meissner_client::{Client, ClientError, Endpoint, Events, HOME_TIMEOUT};
use serde_json::json;
use std::io::{self, BufRead, IsTerminal, Read, Write};
use std::path::Path;
use std::process::ExitCode;
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

/// How often a waiting command sends a sign of life: the shortest `silence_s` of a client is 1 s.
const SIGN_OF_LIFE: Duration = Duration::from_millis(250);

#[derive(Debug, Args)]
pub(super) struct Play {
    /// Play the pattern of this name, or the pattern or order in this file (FILE.toml, FILE.json, or `-` for an order from stdin)
    what: String,
    /// Play for S seconds: truncate or loop the pattern
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = positive)]
    seconds: Option<f64>,
    /// Allow a play without end, until `meissner stop` or a participant's limit
    #[arg(long)]
    endless: bool,
    /// Begin at TICK of the device's clock, MS milliseconds after the request, or at NS nanoseconds of CLOCK_MONOTONIC
    #[arg(long, value_name = "TICK|+MS|@NS")]
    at: Option<Onset>,
    #[command(flatten)]
    edge: EdgeOptions,
    /// Choose which strokes are played at the end
    #[arg(long, default_value = "whole", value_parser = choice::<Fit>(FITS))]
    fit: Fit,
    /// Refuse the play if a motor is too slow for a motion
    #[arg(long)]
    strict: bool,
    #[command(flatten)]
    play: PlayOptions,
    /// Wait for the end and print the receipt; exit 1 if not all was played. Ctrl-C, SIGTERM and SIGHUP stop the play (exit 130, 143, 129)
    #[arg(long)]
    wait: bool,
    #[command(flatten)]
    options: ClientOptions,
}

pub(super) fn command(options: &ClientOptions, name: &str) -> Result<ExitCode> {
    let status: Status = options.client()?.post(&format!("/v1/{name}"), &json!({}))?;
    print_state(options, &status)
}

pub(super) fn edge(options: &ClientOptions, at: Option<Onset>) -> Result<ExitCode> {
    let (at_tick, at_ms, None) = Onset::keys(at) else {
        bail!("--at: an edge comes at a tick or after milliseconds: TICK or +MS");
    };
    let status: Status = options.client()?.post("/v1/edge", &EdgeRequest { at_tick, at_ms })?;
    print_state(options, &status)
}

pub(super) fn withdraw(options: &ClientOptions, id: u64) -> Result<ExitCode> {
    let receipt: Receipt = options.client()?.delete(&format!("/v1/plays/{id}"))?;
    give(options.output.json, &receipt, || text::receipt(&receipt))
}

/// Sends an e-stop to this place. Returns whether a device has confirmed it, and the status, which on a busy daemon may not come.
fn stop_at(endpoint: Endpoint) -> Result<(bool, Option<Status>), ClientError> {
    let place = endpoint.place.clone();
    let is_confirmed = match meissner_client::estop_at(&place) {
        // The daemon has latched the emergency stop.
        Err(ClientError::Problem(problem)) if problem.code == Code::NoDevice.parts().0 => false,
        stopped => stopped.map(|()| true)?,
    };
    let status = Client::at(endpoint).and_then(|mut client| client.get("/v1/status"));
    let warn = |error: &ClientError| {
        tell(&format!("warning: {place}: {}, but no status came: {error}", done(is_confirmed)));
    };
    Ok((is_confirmed, status.inspect_err(warn).ok()))
}

/// What an e-stop has done.
const fn done(is_confirmed: bool) -> &'static str {
    if is_confirmed { "the emergency stop is confirmed" } else { "the emergency stop is latched" }
}

/// Sends the e-stop to both possible daemons at once: there is no time to choose. Prints each answer as it comes; the
/// document of `--json` is the first.
pub(super) fn estop(options: &ClientOptions) -> Result<ExitCode> {
    let (endpoint, json) = (options.endpoint(), options.output.json);
    let (tell, answers) = mpsc::channel();
    for place in endpoint.places() {
        let order = |place: Endpoint, tell: mpsc::Sender<_>| {
            let answer = stop_at(place.clone());
            // The send fails only if this process is ending.
            let _ = tell.send((place, answer));
        };
        let (at, told) = (endpoint.only(place), tell.clone());
        // If no thread can start, send one after the other.
        if thread::Builder::new().spawn(move || order(at, told)).is_err() {
            order(endpoint.only(place), tell.clone());
        }
    }
    drop(tell);
    let (mut stopped, mut failed) = (Vec::new(), Vec::new());
    // Wait for every answer even if stdout is closed: this process must not end before it has sent each request.
    let mut said = Ok(ExitCode::SUCCESS);
    for (place, answer) in answers {
        match answer {
            Ok((is_confirmed, status)) => {
                let state = match &status {
                    None => done(is_confirmed).to_owned(),
                    Some(status) => match status.estop.off_ms.filter(|_| status.is_connected()) {
                        Some(ms) => {
                            format!("{}: lines off within {ms:.1} ms of the order", text::state(status))
                        }
                        None => text::state(status),
                    },
                };
                said = said.and(match stopped.is_empty() {
                    true => give(json, &status, || state),
                    false if json => Ok(ExitCode::SUCCESS),
                    false => say(&format!("{place}: {state}")).map(|()| ExitCode::SUCCESS),
                });
                stopped.push(is_confirmed || status.is_some_and(|status| status.is_connected()));
            }
            Err(error) => failed.push(error),
        }
    }
    said?;
    if !stopped.is_empty() && !json && !stopped.contains(&true) {
        say(
            "no device is connected, so no line was turned off: cut the supply if pins move, and see `meissner status`",
        )?;
    }
    // Once one daemon was stopped, another user's daemon may refuse.
    let absent = |error: &ClientError| matches!(error, ClientError::NoDaemon { .. }) || error.is_hidden();
    let foreign = |error: &ClientError| matches!(error, ClientError::Denied { .. }) && !stopped.is_empty();
    match failed.iter().position(|error| !absent(error) && !foreign(error)) {
        Some(at) => Err(failed.swap_remove(at).into()),
        None if !stopped.is_empty() => Ok(ExitCode::SUCCESS),
        None => Err(match failed.swap_remove(0) {
            ClientError::NoDaemon { source, .. } => ClientError::NoDaemon { endpoint, source },
            error => error,
        }
        .into()),
    }
}

pub(super) fn reset(options: &ClientOptions, force: bool, keep: bool) -> Result<ExitCode> {
    let mut client = options.client()?;
    let status = match client.post("/v1/reset", &ResetRequest { force, keep, estops_seen: None }) {
        // On a terminal a person can decide.
        Err(ClientError::Problem(problem))
            if problem.code == Code::RecentEStop.parts().0 && io::stdin().is_terminal() =>
        {
            // The person's decision covers only the stops so far, not one that comes while they read.
            let Status { estop, .. } = client.get("/v1/status")?;
            ask(&problem.detail, "Is it safe to reset? [yes/no] ", "not reset: find out why first")?;
            client.post("/v1/reset", &ResetRequest { force: true, keep, estops_seen: Some(estop.orders) })
        }
        answer => answer,
    };
    print_state(options, &status?)
}

pub(super) fn home(options: &ClientOptions) -> Result<ExitCode> {
    let status: Status = options.client()?.post_within(HOME_TIMEOUT, "/v1/home", &json!({}))?;
    give(options.output.json, &status, || match text::drift(&status) {
        Some(drift) => format!("{}; drift: {drift}", text::state(&status)),
        None => text::state(&status),
    })
}

pub(super) fn arm(options: &ClientOptions, asked: ArmRequest) -> Result<ExitCode> {
    let mut client = options.client()?;
    let status = match client.post("/v1/arm", &asked) {
        // The daemon has armed nothing. On a terminal a person can look at the pins.
        Err(ClientError::Problem(problem))
            if problem.code == Code::LevelNotChecked.parts().0 && io::stdin().is_terminal() =>
        {
            let checked = Some(ask_level(&problem.detail)?);
            client.post("/v1/arm", &ArmRequest { checked, ..asked })
        }
        answer => answer,
    };
    let status: Status = status?;
    if !matches!(status.state.as_str(), "armed" | "returning") {
        bail!("not armed: {} ({}); see `meissner status` and the daemon's log", status.state, status.cause);
    }
    print_state(options, &status)
}

/// Asks the person at the terminal whether the pins are level; returns the name of the user.
fn ask_level(why: &str) -> Result<String> {
    ask(
        why,
        "Are all pins level? Look at them. [yes/no] ",
        "not armed: level the pins first, then arm again",
    )?;
    let user = nix::unistd::User::from_uid(nix::unistd::getuid()).ok().flatten();
    Ok(user.map_or_else(|| format!("uid {}", nix::unistd::getuid()), |user| user.name))
}

/// Asks the person at the terminal; without a yes the command fails.
fn ask(why: &str, question: &str, otherwise: &str) -> Result<()> {
    write!(io::stderr(), "{}\n{question}", shown(why))?;
    let mut answer = String::new();
    io::stdin().lock().take(100).read_line(&mut answer)?;
    if !matches!(answer.trim(), "yes" | "y") {
        bail!("{otherwise}");
    }
    Ok(())
}

fn print_state(options: &ClientOptions, status: &Status) -> Result<ExitCode> {
    give(options.output.json, status, || text::state(status))
}

impl Play {
    fn order(&self) -> Result<Order> {
        let Self { what, seconds, endless, fit, strict, play, edge, .. } = self;
        let item =
            Item { seconds: *seconds, scale: play.scale, trigger: play.trigger.request(), ..Item::default() };
        let file = Path::new(what);
        let is_file = what == files::STDIN || files::is_file(what) || what.ends_with(".json");
        let pattern = match is_file {
            false => Some(what.as_str().into()),
            true if what != files::STDIN && pattern_file::is_one(file)? => {
                Some(pattern_file::inline(&pattern_file::of_file(file)?.pattern)?)
            }
            true => None,
        };
        let Order { name, items, terms } = match pattern {
            Some(pattern) => Order::new(Item { pattern: Some(pattern), ..item }, Terms::default()),
            None if item != Item::default() => bail!(
                "{what}: its items say for how long, how strong and with which trigger: leave out --seconds, --scale and the trigger's options"
            ),
            None => read_order(file)?,
        };
        let (at_tick, at_ms, at_monotonic_ns) = match (self.at, edge.on_edge) {
            (None, None) => (terms.at_tick, terms.at_ms, terms.at_monotonic_ns),
            _ => Onset::keys(self.at),
        };
        let labels = play.labels();
        let terms = Terms {
            at_tick,
            at_ms,
            at_monotonic_ns,
            on_edge_ms: edge.on_edge.or(terms.on_edge_ms.filter(|_| self.at.is_none())),
            stop_on_edge: edge.stop_on_edge || terms.stop_on_edge,
            endless: *endless || terms.endless,
            fit: if *fit == Fit::default() { terms.fit } else { *fit },
            late: if play.late == LatePolicy::default() { terms.late } else { play.late },
            replace: play.replace || terms.replace,
            open_loop: play.open_loop || terms.open_loop,
            session: play.named_session().or(terms.session).or_else(session_token::session),
            trial: play.trial.or(terms.trial),
            labels: if labels.is_empty() { terms.labels } else { labels },
            strict: *strict || terms.strict,
            ..terms
        };
        Ok(Order { name, items, terms })
    }
}

/// Reads an order from a file, or from stdin.
pub(super) fn read_order(file: &Path) -> Result<Order> {
    let (text, name) = files::text_or_stdin(file, MAX_BODY as u64, "an order")?;
    Kind::Pattern.check(&text, &name)?;
    Order::parse_file(&text).map_err(|problem| anyhow!("{name}: {problem}"))
}

pub(super) fn play(play: &Play) -> Result<ExitCode> {
    let order = play.order()?;
    let mut client = play.options.client()?;
    let json = play.options.output.json;
    if !play.wait {
        let played = client.play(&order)?;
        return give(json, &played, || match order.one() {
            Some(_) => text::accepted(&played, &play.what),
            None => format!("play {}: {} items", played.id, order.items.len()),
        });
    }
    let mut events = client.events()?;
    let ending = Ending::listen(&play.options)?;
    let played = ending.order(|| client.play(&order))?;
    let mut progress = Progress::new(played.ordered_ms.map(|ms| ms / 1e3), json);
    let mut receipt = follow(&mut client, &mut events, played.id, &mut progress)?;
    ending.set_over();
    if receipt.items.is_none() {
        // The event has not the items of a play of several.
        receipt = client.get(&format!("/v1/plays/{}", played.id))?;
    }
    give(json, &receipt, || text::receipt(&receipt))?;
    Ok(if receipt.all_played() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Waits for the end of a play.
pub(super) fn follow(
    client: &mut Client,
    events: &mut Events,
    id: u64,
    progress: &mut Progress,
) -> Result<Receipt> {
    let mut heard = Instant::now();
    let ended = loop {
        // Receiving events is not a sign of life of this command; a request is.
        if heard.elapsed() >= SIGN_OF_LIFE {
            heard = Instant::now();
            // If the daemon is gone, the events end.
            let _ = client.get::<Status>("/v1/status");
        }
        let event = match events.next(Some(SIGN_OF_LIFE)) {
            Err(ClientError::Timeout { .. }) => continue,
            event => event?,
        };
        let Some(event) = event else {
            bail!("the daemon ended while play {id} was running: see its log");
        };
        match event {
            Event::Ended { receipt } if receipt.id == id => break *receipt,
            Event::Lost { .. } | Event::Lagged { .. } => {
                let receipt: Receipt = client.get(&format!("/v1/plays/{id}"))?;
                if receipt.state.is_over() {
                    break receipt;
                }
            }
            other => progress.show(id, &other)?,
        }
    };
    progress.finish();
    Ok(ended)
}
