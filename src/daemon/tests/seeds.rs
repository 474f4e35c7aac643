//! Days of the whole daemon under a seed: random orders of clients that die, disks that stall, fill and fail, clocks that are set, an
//! array that hangs or lies, and kills. A plain model judges all of it by the rules of `rules`.
//!
//! `SEEDS=N cargo test --lib seeds` tries N seeds, `SEED=N` one of them; `cargo run -p verify-daemon -- --seed N --days 30` runs days of
//! one. The same seed gives the same requests, answers, events and lines of the record, byte for byte: [`Report::trace`] is their hash.

mod faults;
mod rules;
mod truth;

use super::bench::{Bench, Client, Events, Live, Machine, record_files};
use crate::daemon::tests::seeds::faults::Trouble;
use crate::daemon::tests::seeds::truth::Truth;
use meissner_api::{EndCause, Event, LiveAccepted, PlayAccepted, Problem, SessionStarted, Status};
use meissner_stream::time::HostInstant;
use meissner_test_support::random::Random;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;
use std::process;
use std::sync::Arc;
use std::time::Duration;

/// Limits and silences that some orders meet, and motors whose every pulse counts the same: pins are where their pulses say.
const CONFIG: &str = "session_silence_s = 20\narmed_silence_s = 30\ndrift_limit_um = 10000\n\
    mock = {gain_sd = 0.0, asymmetry_sd = 0.0, transient_gain = 1.0, telemetry_hz = TELEMETRY}\n\
    [participant]\nmax_continuous_s = 4\npause_s = 1\nmax_day_s = 8\nmax_amplitude_um = 100\n";
const PATTERNS: [&str; 5] = ["pin-60", "edge-45", "disc", "wave", "no-such"];
/// Without an answer for so long, an order counts as never answered.
const NEVER: Duration = Duration::from_secs(600);
/// The longest time between two looks at events and pins.
const LOOK: Duration = Duration::from_millis(500);

/// What a seed has run.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Days that began.
    pub days: u32,
    /// Things that clients or the world did.
    pub steps: u64,
    /// Plays that were accepted.
    pub plays: u64,
    /// Faults, kills included.
    pub faults: u64,
    /// SHA-256 of all requests, answers, events and lines of the record.
    pub trace: String,
}

/// A session, as its owner knows it.
#[derive(Debug)]
struct Session {
    id: String,
    token: String,
    exclusive: bool,
    /// When its token was shown last, s.
    heard_s: f64,
    plays: BTreeSet<u64>,
}

/// What clients know of one run of the daemon.
#[derive(Debug, Default)]
struct Life {
    began_s: f64,
    /// The plays that the daemon has accepted, and whether each has an end.
    accepted: BTreeMap<u64, bool>,
    /// Orders of plays, sessions and answers whose clients died before the answer.
    unsure: u64,
    unsure_answers: BTreeSet<u64>,
    session: Option<Session>,
    /// Sessions that ended as ordered: their plays.
    ended_sessions: BTreeMap<String, BTreeSet<u64>>,
    /// Plays that have begun and ended by the events, and when they ended, s.
    began: BTreeSet<u64>,
    ended: BTreeMap<u64, f64>,
    /// Answers that the daemon has acknowledged.
    answered: BTreeSet<u64>,
    /// When an emergency stop was acknowledged, s, until somebody asks for its reset.
    estopped_s: Option<f64>,
    array: Array,
    /// When a client was heard last, and when one has ordered something, s.
    heard_s: f64,
    ordered_s: f64,
    /// What the wall clock was set by when the daemon began, ns.
    wall_set: i64,
    /// When a client died before the answer to its order, s.
    unanswered_s: f64,
    /// Entries lost by the last status, and whether the record has named a problem since that or in it.
    lost: Option<u64>,
    disk_says: bool,
    /// Whether the disk has taken all so far.
    disk_was_good: bool,
}

/// What is known of the array.
#[derive(Debug, Default)]
struct Array {
    /// Whether the daemon itself has stopped it, because it contradicted itself: pins stand until somebody arms.
    stands: bool,
    /// Since when the motors have been off by the status, s.
    unarmed_s: Option<f64>,
    /// Since when pins come down by the status, s.
    returning_s: Option<f64>,
    /// When a client died before the answer to its `arm`, s.
    arming_s: f64,
    /// Whether it and its line were good so far.
    was_good: bool,
}

/// The machine, the daemon on it, its clients, and what they know.
struct World {
    random: Random,
    machine: Machine,
    daemon: Bench,
    clients: Vec<Client>,
    observer: Client,
    events: Events,
    live: Option<(Live, u64)>,
    /// Whether the array tells where its pins are, and is corrected by that.
    telemetry: bool,
    /// The share of faults that happen on this day.
    badness: f64,
    trouble: Trouble,
    truth: Truth,
    /// What the daemon has said last about the motors.
    state: String,
    life: Life,
    /// Tokens of sessions that are over.
    old_tokens: Vec<String>,
    /// How far the files of the record were read.
    read: BTreeMap<PathBuf, usize>,
    trace: Sha256,
    report: Report,
}

/// Runs days of this many steps.
///
/// # Panics
/// If a rule is broken.
pub fn run_days(seed: u64, days: u32, steps: u32) -> Report {
    let mut random = Random::new(seed);
    let mut machine = Machine::new(Arc::new(tempfile::tempdir().unwrap()));
    (machine.seed, machine.faults) = (seed, true);
    let telemetry = random.chance(0.5);
    // The first day may be that of a change to or from daylight saving.
    machine.wall_set = [0, 80, 290][random.below(3)] * faults::DAY_NS;
    let mut world = World::start(random, machine, telemetry);
    for day in 0..days {
        world.report.days += 1;
        world.badness = [0.0, 0.2, 1.0][world.random.below(3)];
        for _ in 0..steps {
            world.report.steps += 1;
            if let Some(pause) = world.step() {
                world = world.restart(pause);
            }
            rules::hold(&mut world);
        }
        if day % 2 == 0 || day + 1 == days {
            world.recover();
        }
        let night_h = world.random.between(8.0, 16.0);
        world = world.restart(Duration::from_secs_f64(3600.0 * night_h));
    }
    faults::heal();
    world.report.trace = world.trace.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    world.report
}

/// The machine's clock.
fn seconds() -> f64 {
    HostInstant::now().as_ns() as f64 / 1e9
}

impl World {
    fn start(random: Random, machine: Machine, telemetry: bool) -> Self {
        let daemon = Bench::on(&machine, &CONFIG.replace("TELEMETRY", if telemetry { "1000" } else { "0" }));
        let clients = (0..3).map(|_| daemon.client()).collect();
        let (observer, events) = (daemon.client(), daemon.client().events());
        let mut new = Self {
            random,
            machine,
            daemon,
            clients,
            observer,
            events,
            live: None,
            telemetry,
            badness: 0.0,
            trouble: Trouble::default(),
            state: String::new(),
            truth: Truth::default(),
            life: Life::default(),
            old_tokens: Vec::new(),
            read: BTreeMap::new(),
            trace: Sha256::new(),
            report: Report::default(),
        };
        new.truth.began = new.machine.at;
        new.life.began_s = new.machine.at.as_secs_f64();
        (new.life.disk_was_good, new.life.array.was_good) = (true, true);
        new.life.heard_s = new.life.began_s;
        new.life.wall_set = new.machine.wall_set;
        new
    }

    fn now_s(&self) -> f64 {
        self.daemon.now(seconds)
    }

    /// Adds to the trace, without what differs between two machines.
    fn trace(&mut self, text: &str) {
        let dir = self.machine.dir.path().display().to_string();
        let text = text.replace(&dir, "DIR").replace(&format!("\"pid\":{}", process::id()), "\"pid\":0");
        if std::env::var_os("TRACE").is_some() {
            eprintln!("{text}");
        }
        self.trace.update(text);
        self.trace.update("\n");
    }

    /// A call of a client, which dies after `patience`. None: nobody knows the answer.
    fn call<T: DeserializeOwned>(
        &mut self,
        client: &Client,
        patience: Duration,
        call: (&str, &str, &Value),
    ) -> Option<Result<T, Problem>> {
        let (method, path, body) = call;
        let text = if method == "GET" { String::new() } else { body.to_string() };
        self.life.heard_s = self.now_s();
        if let Some(session) = self.life.session.as_mut().filter(|of| client.token() == Some(&*of.token)) {
            session.heard_s = self.life.heard_s;
        }
        let answer = client.answer_within(patience, method, path, text.clone().into_bytes());
        self.life.heard_s = self.now_s();
        if method != "GET" {
            self.life.ordered_s = self.life.heard_s;
        }
        let Some((status, answer)) = answer else {
            assert!(patience < NEVER, "{method} {path} {text} is never answered");
            self.life.unanswered_s = self.life.heard_s;
            if path == "/v1/arm" {
                self.life.array.arming_s = self.life.heard_s;
            }
            self.trace(&format!("{method} {path} {text} -> nobody"));
            return None;
        };
        self.trace(&format!("{method} {path} {text} -> {status} {}", String::from_utf8_lossy(&answer)));
        Some(if status >= 400 {
            Err(serde_json::from_slice(&answer).unwrap())
        } else {
            Ok(serde_json::from_slice(&answer).unwrap())
        })
    }

    /// A call whose client waits for the answer.
    fn asked<T: DeserializeOwned>(
        &mut self,
        client: &Client,
        path: &str,
        body: &Value,
    ) -> Result<T, Problem> {
        self.call(client, NEVER, ("POST", path, body)).unwrap()
    }

    /// The status, asked for by somebody who counts for nothing.
    fn status(&mut self) -> Status {
        let heard_s = self.life.heard_s;
        let status = self.call(&self.observer.clone(), NEVER, ("GET", "/v1/status", &Value::Null));
        self.life.heard_s = heard_s;
        let heights_um = self.daemon.faults().heights_um.clone();
        self.trace(&format!("pins at {heights_um:.1?} um"));
        status.unwrap().unwrap()
    }

    /// Lets time pass, and looks at events and pins.
    fn pass(&mut self, time: Duration) {
        let mut left = time;
        while !left.is_zero() {
            let part = left.min(LOOK);
            self.daemon.advance(part);
            self.look();
            left -= part;
        }
    }

    fn look(&mut self) {
        while let Some(frame) = self.events.come() {
            let text = String::from_utf8_lossy(&frame).into_owned();
            self.trace(&text);
            let data = text.lines().find_map(|line| line.strip_prefix("data:")).unwrap();
            let now_s = self.now_s();
            match serde_json::from_str(data).unwrap() {
                Event::Began { id, .. } => assert!(self.life.began.insert(id), "play {id} begins twice"),
                Event::Disconnected { reason: EndCause::Other(why) } => {
                    self.life.array.stands |= why.contains("contradicts itself");
                }
                Event::RecordProblem { problem, .. } => self.life.disk_says |= problem.is_some(),
                Event::Ended { receipt } => {
                    let before = self.life.ended.insert(receipt.id, now_s);
                    assert!(before.is_none(), "play {} ends twice", receipt.id);
                }
                _ => {}
            }
        }
        let played = std::mem::take(&mut self.daemon.faults().played);
        self.daemon.now(|| self.truth.see(&played));
        rules::after_look(self);
    }

    /// How long a client waits: some die before the answer.
    fn patience(&mut self) -> Duration {
        if self.random.chance(0.06) {
            self.report.faults += 1;
            Duration::from_secs_f64(self.random.between(0.0, 0.1))
        } else {
            NEVER
        }
    }

    /// One thing that a client or the world does. Returns for how long the daemon is gone if it is killed now.
    fn step(&mut self) -> Option<Duration> {
        let at = self.random.below(self.clients.len());
        let client = self.clients[at].clone();
        if self.state != "armed" && self.random.chance(0.3) {
            self.arm(&client);
        }
        match self.random.below(26) {
            0..6 => self.play(&client),
            6 => self.simple(&client, "/v1/stop"),
            7 | 8 => self.arm(&client),
            9 if self.random.chance(0.3) => self.simple(&client, "/v1/disarm"),
            10 if self.random.chance(0.3) => self.estop(&client),
            11 | 23 => self.session(at),
            12 | 13 => self.answer(&client),
            14 => {
                if let Some((&last, _)) = self.life.accepted.last_key_value() {
                    let (patience, path) = (self.patience(), format!("/v1/plays/{last}"));
                    let _ = self.call::<Value>(&client, patience, ("DELETE", &path, &Value::Null));
                }
            }
            15 if self.random.chance(0.1) => {
                let seconds = [40.0, 70.0, 700.0][self.random.below(3)];
                self.pass(Duration::from_secs_f64(seconds));
            }
            16 => self.simple(&client, "/v1/home"),
            17 => self.live(&client),
            18 => self.lose_token(at),
            19..22 if self.random.chance(self.badness) => faults::begin(self),
            22 if self.random.chance(0.5) => {
                return Some(Duration::from_secs_f64(self.random.between(0.1, 3.0)));
            }
            _ => {
                let time = Duration::from_secs_f64(self.random.between(0.0, 2.0));
                self.pass(time);
            }
        }
        self.move_live();
        self.look();
        self.life.disk_was_good &= self.trouble.disk_is_good(self.now_s());
        self.life.array.was_good &= self.trouble.array_is_good(self.now_s());
        faults::end_due(self);
        None
    }

    fn simple(&mut self, client: &Client, path: &str) {
        let (patience, open) = (self.patience(), rules::may_act(self, client));
        let answer = self.call::<Value>(client, patience, ("POST", path, &json!({})));
        let may_always = ["/v1/stop", "/v1/disarm"].contains(&path);
        rules::keeps_out(open || may_always, path, answer.as_ref().is_some_and(Result::is_ok));
        if path == "/v1/stop" && matches!(answer, Some(Ok(_))) && self.random.chance(0.3) {
            rules::stops(self);
        }
    }

    fn arm(&mut self, client: &Client) {
        let (patience, open) = (self.patience(), rules::may_act(self, client));
        if self.state == "faulted" && self.random.chance(0.8) {
            self.life.estopped_s = None;
            let answer = self.call::<Value>(client, patience, ("POST", "/v1/reset", &json!({"force": true})));
            rules::keeps_out(open, "reset", matches!(answer, Some(Ok(_))));
            return;
        }
        // Who says that pins are at rest has looked.
        let body = if rules::look_at_rest(self) {
            json!({"assume_rest": true, "checked": "Ada"})
        } else {
            json!({})
        };
        let answer = self.call::<Value>(client, patience, ("POST", "/v1/arm", &body));
        rules::keeps_out(open, "arm", matches!(answer, Some(Ok(_))));
    }

    fn order(&mut self) -> Value {
        let random = &mut self.random;
        let pattern = PATTERNS[random.below(PATTERNS.len())];
        let mut keys = match random.below(4) {
            0 => {
                let item = |random: &mut Random| json!({"pattern": PATTERNS[random.below(4)], "seconds": random.between(0.02, 0.6), "gap_ms": random.between(0.0, 200.0)});
                json!({"items": (0..=random.below(6)).map(|_| item(random)).collect::<Vec<_>>()})
            }
            1 => json!({"pattern": pattern, "endless": true}),
            2 => {
                json!({"pattern": {"ramp": [{"motor": random.below(24), "to_um": random.between(1.0, 120.0), "rise_s": 0.1, "hold_s": random.between(0.0, 3.0)}]}})
            }
            _ => {
                json!({"pattern": pattern, "seconds": random.between(0.0, 4.0), "scale": random.between(0.0, 1.0)})
            }
        };
        if random.chance(0.2) {
            keys["at_ms"] = json!(random.between(0.0, 1500.0));
        }
        if random.chance(0.15) {
            keys["replace"] = json!(true);
        }
        keys
    }

    fn play(&mut self, client: &Client) {
        let (order, patience, open) = (self.order(), self.patience(), rules::may_act(self, client));
        let stopped = self.life.estopped_s.is_some();
        let answer = self.call::<PlayAccepted>(client, patience, ("POST", "/v1/play", &order));
        rules::keeps_out(open, "play", matches!(answer, Some(Ok(_))));
        match answer {
            Some(Ok(PlayAccepted { id, .. })) => {
                assert!(!stopped, "play {id} is accepted after an emergency stop");
                self.accepted(id, order["endless"] != true);
                if self.random.chance(0.1 * self.badness) {
                    // The line dies while it plays.
                    let time = Duration::from_secs_f64(self.random.between(0.1, 1.0));
                    self.pass(time);
                    faults::line_dies(self);
                    self.pass(Duration::from_secs(1));
                }
            }
            Some(Err(_)) => {}
            None => self.life.unsure += 1,
        }
    }

    fn accepted(&mut self, id: u64, has_end: bool) {
        let last = self.life.accepted.last_key_value().map_or(0, |(&last, _)| last);
        let most = self.life.accepted.len() as u64 + self.life.unsure + 1;
        assert!(last < id && id <= most, "play {id} follows {last}, and no more than {most} were ordered");
        self.life.accepted.insert(id, has_end);
        self.report.plays += 1;
        if let Some(session) = &mut self.life.session {
            session.plays.insert(id);
        }
    }

    fn live(&mut self, client: &Client) {
        if self.live.take().is_some() {
            // Its client died in the middle of it.
            self.report.faults += 1;
            return;
        }
        let drive = json!({"motor": self.random.below(24), "frequency_hz": 60.0, "amplitude_um": 40.0});
        let request =
            json!({"drives": [drive], "timeout_ms": self.random.between(50.0, 2000.0), "levels": true});
        let (patience, open) = (self.patience(), rules::may_act(self, client));
        let answer = self.call::<LiveAccepted>(client, patience, ("POST", "/v1/live", &request));
        rules::keeps_out(open, "live", matches!(answer, Some(Ok(_))));
        match answer {
            Some(Ok(LiveAccepted { id, path, .. })) => {
                self.accepted(id, false);
                // Some clients never open the connection.
                if self.random.chance(0.9) {
                    self.live = client.live(&path).ok().map(|live| (live, 0));
                }
            }
            Some(Err(_)) => {}
            None => self.life.unsure += 1,
        }
    }

    fn move_live(&mut self) {
        if self.random.chance(0.3) {
            return;
        }
        let level = json!({self.random.below(24).to_string(): self.random.between(0.0, 90.0)});
        let Some((live, seq)) = &mut self.live else { return };
        *seq += 1;
        self.life.heard_s = self.daemon.now(seconds);
        let answer = live.send(&json!({"seq": *seq, "um": level}));
        self.trace(&format!("{answer:?}"));
    }

    fn estop(&mut self, client: &Client) {
        let is_good = self.trouble.array_is_good(self.now_s());
        match self.asked::<Status>(client, "/v1/estop", &json!({})) {
            Ok(stopped) => {
                assert_eq!(stopped.state, "faulted", "an emergency stop latches");
                assert!(!is_good || stopped.play.is_none() && stopped.queued.is_empty(), "{stopped:?}");
                self.life.estopped_s = Some(self.now_s());
            }
            // Over a bad line nobody may know whether the array has heard it.
            Err(problem) => assert!(!is_good && problem.code == "timeout", "{problem:?}"),
        }
        let time = Duration::from_secs_f64(self.random.between(0.0, 1.0));
        self.pass(time);
    }

    fn session(&mut self, at: usize) {
        let (client, patience) = (self.clients[at].clone(), self.patience());
        if let Some(session) = &self.life.session {
            if self.random.chance(0.2) {
                let mut owner = client;
                owner.set_token(Some(session.token.clone()));
                let path = format!("/v1/sessions/{}/end", session.id);
                let answer = self.call::<Value>(&owner, patience, ("POST", &path, &json!({})));
                match answer {
                    Some(Ok(_)) => self.end_session(true),
                    Some(Err(_)) => {}
                    None => self.end_session(false),
                }
            }
            return;
        }
        let participant = format!("P{}", self.random.below(3));
        let body = json!({"participant": participant, "exclusive": self.random.chance(0.5)});
        match self.call::<SessionStarted>(&client, patience, ("POST", "/v1/sessions", &body)) {
            Some(Ok(SessionStarted { id, token, .. })) => {
                self.clients[at].set_token(Some(token.clone()));
                let (exclusive, heard_s) = (body["exclusive"] == true, self.now_s());
                self.life.session = Some(Session { id, token, exclusive, heard_s, plays: BTreeSet::new() });
            }
            Some(Err(_)) => {}
            // The session may have begun, but no client got its token.
            None => self.end_unknown(),
        }
    }

    /// The session has ended; nobody knows that for sure if its client died.
    fn end_session(&mut self, is_sure: bool) {
        let Some(Session { id, token, plays, .. }) = self.life.session.take() else { return };
        if is_sure {
            self.life.ended_sessions.insert(id, plays);
            self.old_tokens.push(token);
        } else {
            self.end_unknown();
        }
    }

    /// Ends a session whose token no client has.
    fn end_unknown(&mut self) {
        self.pass(Duration::from_secs(25));
        let (client, path) = (self.observer.clone(), "/v1/sessions/running/end");
        for _ in 0..2 {
            let _ = self.asked::<Value>(&client, "/v1/stop", &json!({}));
            self.pass(Duration::from_secs(3));
            let _ = self.asked::<Value>(&client, path, &json!({}));
        }
    }

    fn answer(&mut self, client: &Client) {
        let Some((&id, _)) = self.life.accepted.iter().nth_back(self.random.below(3)) else { return };
        let (answer, patience) = (json!({"response": "left", "correct": true}), self.patience());
        match self.call::<Value>(client, patience, ("POST", &format!("/v1/plays/{id}/answer"), &answer)) {
            Some(Ok(_)) => assert!(self.life.answered.insert(id), "play {id} takes two answers"),
            Some(Err(_)) => {}
            None => _ = self.life.unsure_answers.insert(id),
        }
    }

    /// A client loses its token, comes back with it, or shows an old one.
    fn lose_token(&mut self, at: usize) {
        let token = match self.random.below(3) {
            0 => None,
            1 => self.life.session.as_ref().map(|session| session.token.clone()),
            _ => self.old_tokens.last().cloned(),
        };
        self.clients[at].set_token(token);
    }

    /// All faults are over: the daemon can be armed, and then brings all pins down.
    fn recover(&mut self) {
        faults::end_all(self);
        self.live = None;
        self.pass(Duration::from_secs(8));
        let mut client = self.observer.clone();
        let _: Status = self.asked(&client, "/v1/estop", &json!({})).unwrap();
        client.set_token(self.life.session.as_ref().map(|session| session.token.clone()));
        self.life.estopped_s = None;
        let reset: Status = self.asked(&client, "/v1/reset", &json!({"force": true})).unwrap();
        self.pass(Duration::from_secs(3));
        if reset.state == "no-device" {
            // The device that has come since may still have the emergency stop.
            let _: Status = self.asked(&client, "/v1/reset", &json!({"force": true})).unwrap();
            self.pass(Duration::from_secs(1));
        }
        if let Some(session) = &self.life.session {
            let path = format!("/v1/sessions/{}/end", session.id);
            let ended = self.asked::<Value>(&client, &path, &json!({}));
            assert!(ended.is_ok(), "{ended:?}");
            self.end_session(true);
        }
        self.pass(Duration::from_secs(2));
        rules::at_rest(self);
    }

    /// The daemon is killed, and starts again after a while.
    fn restart(mut self, pause: Duration) -> Self {
        self.report.faults += 1;
        self.look();
        let before = rules::before_kill(&mut self);
        let ended = self.now_s();
        let Self { random, mut machine, daemon, clients, observer, events, live, life, .. } = self;
        let Self { truth, mut old_tokens, read, trace, report, trouble, badness, telemetry, .. } = self;
        // The daemon goes with the last of these, and with it its clock.
        drop((live, clients, observer, events, daemon));
        machine.at = Duration::from_secs_f64(ended) + pause;
        machine.seed = machine.seed.wrapping_add(0x9e37_79b9);
        old_tokens.extend(life.session.as_ref().map(|session| session.token.clone()));
        let new = Self::start(random, machine, telemetry);
        let truth = Truth { began: new.truth.began, ..truth };
        let mut new =
            Self { truth, old_tokens, read, trace, report, badness, trouble: trouble.after_kill(), ..new };
        faults::end_due(&mut new);
        new.pass(Duration::from_secs(1));
        rules::recorded(&mut new, &before, &life);
        new
    }

    /// The lines of the record since the last call, up to this time of the machine's clock.
    fn read_record(&mut self, until_s: f64) -> Vec<Value> {
        let mut lines = Vec::new();
        for path in record_files(&self.machine.dir.path().join("logbook")) {
            let text = fs::read_to_string(&path).unwrap();
            let from = self.read.get(&path).copied().unwrap_or(0);
            let mut at = from;
            for text in text[from..].split_inclusive('\n') {
                let line: Value =
                    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"));
                if line["monotonic_ns"].as_u64().unwrap() as f64 / 1e9 > until_s {
                    break;
                }
                self.trace(text);
                lines.push(line);
                at += text.len();
            }
            self.read.insert(path, at);
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_test_support::at_length;
    use std::env;

    #[test]
    fn random_days_keep_the_rules() {
        let number = |name: &str| env::var(name).ok().map(|text| text.parse::<u64>().unwrap());
        let many = number("SEEDS").unwrap_or_else(|| at_length(1, 1000));
        let seeds = number("SEED").map_or(0..many, |seed| seed..seed + 1);
        for seed in seeds {
            eprintln!("SEED={seed}");
            eprintln!(
                "{:?}",
                run_days(seed, number("DAYS").unwrap_or(1) as u32, number("STEPS").unwrap_or(150) as u32)
            );
        }
    }

    #[test]
    fn a_seed_replays_to_the_byte() {
        assert_eq!(run_days(7, 1, 60), run_days(7, 1, 60));
    }
}
