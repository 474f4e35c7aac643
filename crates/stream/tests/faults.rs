//! Plays every case of `tests/faults` in virtual time, with three patterns of the library, and keeps the table of the book.
//!
//! A case says what happens when, and what must be true after. It is judged on the recorded lines of the device. Renew the table with
//! `MEISSNER_RENEW=1 cargo test -p meissner-stream --test tests -- faults`.

use firmware_protocol::controller::Run;
use firmware_protocol::message::{DeviceMessage, State};
use firmware_protocol::stroke::{Lines, MOTORS, Stroke};
use firmware_protocol::tick::Tick;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_stream::Line;
use meissner_stream::link::BadFrames;
use meissner_stream::queues::{At, Command, End, Outcome, Snapshot, StreamEvent};
use meissner_stream::time::HostInstant;
use meissner_test_support::rig::{self, Rig, answer, assert_closed, bursts_on_the_lines};
use serde::Deserialize;
use serde::de::Error as _;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

const MS: Duration = Duration::from_millis(1);
/// One amplitude everywhere; bursts at many phases; motors that follow each other.
const PATTERNS: [&str; 3] = ["pin-60", "edge-45", "wave"];
/// How long a play lasts, and from when on a phase is looked for.
const PLAY_S: f64 = 2.0;
const PHASE_AFTER: u64 = 42_500;
/// Ticks from the order to the onset.
const ONSET: u64 = 17_000;
/// A lost device is opened again after this time.
const REOPENED: Duration = Duration::from_millis(250);

/// A case file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    /// What happens in a lab that is like it.
    why: String,
    /// Each is a kind of its own; the faults name it as `"value"`.
    #[serde(default = "one_value")]
    values: Vec<f64>,
    /// What the values are.
    #[serde(default)]
    unit: String,
    fault: Vec<Fault>,
    expect: Expect,
}

fn one_value() -> Vec<f64> {
    vec![0.0]
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Fault {
    /// Milliseconds after the order to play, or a phase of the first stroke half a second after the onset.
    at: Moment,
    what: What,
    /// Milliseconds; without it the fault lasts until the play has ended.
    #[serde(default)]
    lasts_ms: Option<Number>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Phase {
    BeforeOnset,
    Up,
    Hold,
    Down,
    Between,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Moment {
    Ms(f64),
    Phase(Phase),
}

/// A number, or the value of the kind.
#[derive(Clone, Copy, Debug)]
struct Number(Option<f64>);

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: serde::Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Either {
            Number(f64),
            Text(String),
        }
        match Either::deserialize(from)? {
            Either::Number(number) => Ok(Self(Some(number))),
            Either::Text(text) if text == "value" => Ok(Self(None)),
            Either::Text(text) => {
                Err(D::Error::custom(format!("`{text}` is neither a number nor \"value\"")))
            }
        }
    }
}

impl Number {
    fn of(self, value: f64) -> f64 {
        self.0.unwrap_or(value)
    }

    fn ms(self, value: f64) -> Duration {
        Duration::from_secs_f64(self.of(value) / 1e3)
    }
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum What {
    /// The line, both ways or one.
    Line(LineFault),
    /// The host does nothing for so many ms.
    Stall(Number),
    /// The host is suspended for so many ms: its clock stands still.
    Suspend(Number),
    /// The host's program dies, and another begins so many ms later.
    Die(Number),
    /// The cable is out for so many ms.
    Unplug(Number),
    /// The board restarts.
    Restart,
    /// The board hangs, until its watchdog restarts it after so many ms.
    Hang(Number),
    /// The device's clock runs fast by so many millionths.
    ClockPpm(Number),
    /// So many bytes of nonsense come from the device.
    Nonsense(Number),
    /// A frame of an older protocol version comes.
    OlderVersion,
    /// The device lies in all its statuses.
    Lie(Lie),
    /// What the sensors say is wrong.
    Telemetry(Telemetry),
    /// An order.
    Order(Order),
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Order {
    Stop,
    Disarm,
    Estop,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Lie {
    Clock,
    Credits,
    State,
    Counters,
    Sequence,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Telemetry {
    Stuck,
    Scaled,
    Swapped,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum To {
    Device,
    Host,
    #[default]
    Both,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LineFault {
    #[serde(default)]
    to: To,
    #[serde(default)]
    loses_percent: Option<Number>,
    #[serde(default)]
    repeats_percent: Option<Number>,
    #[serde(default)]
    damages_percent: Option<Number>,
    #[serde(default)]
    loses_bytes_percent: Option<Number>,
    #[serde(default)]
    delay_ms: Option<Number>,
    #[serde(default)]
    jitter_ms: Option<Number>,
}

impl LineFault {
    fn line(&self, value: f64) -> Line {
        let share = |number: Option<Number>| number.map_or(0.0, |number| number.of(value) / 100.0);
        let time = |number: Option<Number>| number.map_or(Duration::ZERO, |number| number.ms(value));
        Line {
            loss: share(self.loses_percent),
            repeat: share(self.repeats_percent),
            corrupt: share(self.damages_percent),
            byte_loss: share(self.loses_bytes_percent),
            delay: time(self.delay_ms),
            jitter: time(self.jitter_ms),
            bytes_per_s: 0,
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Expect {
    /// `done`: the play comes to its end; `cut`: it does not; `any`.
    play: Ends,
    /// Of a play that is cut, all lines are low for good so many ms after the last fault began, at most.
    #[serde(default)]
    safe_ms: Option<f64>,
    /// The device is latched at the end.
    #[serde(default)]
    latched: bool,
    /// What shows that the fault has happened.
    #[serde(default)]
    shows: Option<Evidence>,
    /// Bursts that are not played, percent at most. Of a play that is done; 0 if it is left out.
    #[serde(default)]
    lost_percent: f64,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "kebab-case")]
enum Evidence {
    /// Frames were sent again.
    Resent,
    /// The host could not read frames.
    Unread,
    /// The device could not read frames.
    UnreadByDevice,
    /// The daemon was told that the device contradicts itself.
    Contradictions,
    /// The host's estimate of the device's clock runs off by at least 50 millionths.
    Rate,
    /// A sensor was set aside.
    SensorSetAside,
}

impl Expect {
    fn check_evidence(&self, player: &Player<'_>) -> Result<(), String> {
        let Some(evidence) = self.shows else { return Ok(()) };
        let snapshots = player.events.iter().filter_map(|event| match event {
            StreamEvent::Snapshot(snapshot) => Some(snapshot),
            _ => None,
        });
        let snapshots: Vec<&Snapshot> = snapshots.filter(|snapshot| snapshot.connected).collect();
        let unread = |frames: BadFrames| frames.crc + frames.malformed + frames.too_long;
        let shown = match evidence {
            Evidence::Resent => snapshots.iter().any(|snapshot| snapshot.retransmitted > 0),
            Evidence::Unread => snapshots.iter().any(|snapshot| unread(snapshot.bad_frames) > 0),
            Evidence::UnreadByDevice => player.rig.mock.controller().counters().bad_frames > 0,
            Evidence::Contradictions => player.rig.contradictions() > 0,
            Evidence::Rate => snapshots.windows(8).any(|some| {
                let (first, last) = (some[0], some[7]);
                let ticks = last.tick.since(first.tick) as f64;
                (ticks / 85_000.0 / last.at.since(first.at).as_secs_f64() - 1.0).abs() > 50e-6
            }),
            Evidence::SensorSetAside => {
                player.events.iter().any(|event| matches!(event, StreamEvent::SensorFault { .. }))
            }
        };
        if shown { Ok(()) } else { Err(format!("nothing shows that the fault happened: {evidence:?}")) }
    }
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "kebab-case")]
enum Ends {
    Done,
    Cut,
    Any,
}

/// What one run has shown.
struct Seen {
    end: End,
    /// Of a play that was cut: from the last fault until all lines were low for good.
    safe_ms: Option<f64>,
    lost: u64,
    planned: u64,
}

/// A play of one pattern that meets the faults of a case.
struct Player<'a> {
    rig: Rig,
    pattern: &'a str,
    value: f64,
    events: Vec<StreamEvent>,
    /// When the last fault began.
    fault_tick: Option<Tick>,
    restarts: u32,
    /// Of the board that was there before a restart: when its last pulse was, milliseconds after the fault.
    gone_high_ms: Option<f64>,
    estopped: bool,
    /// The e-stop is to arrive: the device must be latched at the end.
    must_latch: bool,
}

impl Player<'_> {
    /// Runs as the daemon does: a device that was lost is opened again.
    fn run_to(&mut self, until: HostInstant) {
        while self.rig.now() < until {
            let step = until.since(self.rig.now()).min(10 * MS);
            self.rig.run(step);
            if self.rig.streamer.take_disconnect_reason().is_some() {
                self.rig.run(REOPENED);
                self.rig.connect();
                let _ = self.rig.streamer.take_disconnect_reason();
            }
        }
        self.events.extend(self.rig.take_events());
    }

    fn run(&mut self, time: Duration) {
        self.run_to(self.rig.now() + time);
    }

    /// Begins a fault. Returns what ends it, if anything must.
    fn begin(&mut self, what: &What) {
        let value = self.value;
        self.fault_tick = Some(self.rig.device_tick_at(self.rig.now()));
        match what {
            What::Line(fault) => {
                let bad = fault.line(value);
                match fault.to {
                    To::Device => self.rig.set_lines(bad, Line::default()),
                    To::Host => self.rig.set_lines(Line::default(), bad),
                    To::Both => self.rig.set_lines(bad, bad),
                }
            }
            What::Stall(ms) => {
                self.rig.stall(ms.ms(value));
                self.rig.wake();
            }
            What::Suspend(ms) => {
                self.rig.suspend(ms.ms(value));
                self.rig.wake();
            }
            What::Die(ms) => {
                // Nothing says goodbye: the device hears no more, then another session.
                self.rig.stall(ms.ms(value));
                self.reconnect();
            }
            What::Unplug(ms) => {
                self.rig.unplug();
                self.rig.stall(ms.ms(value));
                self.reconnect();
            }
            What::Restart => self.restart(),
            What::Hang(ms) => {
                self.rig.hang();
                let until = self.rig.now() + ms.ms(value);
                self.run_to(until);
                self.restart();
            }
            What::ClockPpm(ppm) => self.rig.set_clock_error(ppm.of(value)),
            What::Nonsense(bytes) => {
                let nonsense: Vec<u8> = (0..bytes.of(value) as u32).map(|i| (i * 73 % 251) as u8).collect();
                self.rig.inject(&nonsense);
            }
            What::OlderVersion => self.rig.inject(&older_frame()),
            What::Lie(lie) => {
                let lie = *lie;
                self.rig.lie(move |message| {
                    if let DeviceMessage::Status(status) = message {
                        match lie {
                            Lie::Clock => status.tick = Tick(0).wire(),
                            Lie::Credits => status.credits = u16::MAX,
                            Lie::State => status.state = State::Disarmed,
                            Lie::Counters => status.counters.played = 0,
                            Lie::Sequence => status.next_seq = status.next_seq.wrapping_add(100),
                        }
                    }
                });
            }
            What::Telemetry(kind) => self.rig.mock.distort_telemetry(match kind {
                Telemetry::Stuck => |sample| sample.y = [700; MOTORS],
                Telemetry::Scaled => |sample| sample.y.iter_mut().for_each(|y| *y *= 3),
                Telemetry::Swapped => |sample| sample.y.reverse(),
            }),
            What::Order(order) => {
                self.estopped |= matches!(order, Order::Estop);
                self.rig.send(match order {
                    Order::Stop => Command::Stop,
                    Order::Disarm => Command::Disarm,
                    Order::Estop => Command::EStop,
                });
            }
        }
    }

    fn restart(&mut self) {
        self.restarts += 1;
        // What the board that goes has played, on its own clock. Its successor starts with all lines low.
        let trace = self.rig.mock.take_trace();
        self.gone_high_ms = Some(high_until(&trace, self.fault_tick));
        self.fault_tick = None;
        self.rig.restart(&SimulatedMotorsConfig::default(), self.restarts).unwrap();
        self.rig.mock.record();
        let _ = self.rig.streamer.take_disconnect_reason();
    }

    fn reconnect(&mut self) {
        self.rig.connect();
        let _ = self.rig.streamer.take_disconnect_reason();
    }

    /// Everything is as it should be again.
    fn mend(&mut self) {
        self.rig.set_line(Line::default());
        self.rig.set_clock_error(0.0);
        self.rig.stop_lying();
        self.rig.mock.distort_telemetry(|_| ());
    }
}

/// A frame whose version is one below ours, whole in all else.
fn older_frame() -> Vec<u8> {
    let mut body = vec![firmware_protocol::frame::PROTOCOL - 1, 1, 2, 3];
    let crc = !body.iter().fold(!0_u32, |crc, &byte| {
        (0..8).fold(
            crc ^ u32::from(byte),
            |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 },
        )
    });
    body.extend(crc.to_le_bytes());
    let mut frame = vec![0];
    let mut code = 0;
    for byte in body {
        if byte == 0 {
            frame[code] = (frame.len() - code) as u8;
            code = frame.len();
        }
        frame.push(byte);
    }
    frame[code] = (frame.len() - code) as u8;
    frame.push(0);
    // What came before ends here.
    frame.insert(0, 0);
    frame
}

/// When an event of the case happens, by the host's clock.
fn instant(at: &Moment, ordered: (HostInstant, Tick), strokes: &[Stroke]) -> HostInstant {
    let phase = match at {
        Moment::Ms(ms) => return ordered.0 + Duration::from_secs_f64(ms / 1e3),
        Moment::Phase(phase) => phase,
    };
    let first = strokes.iter().position(|stroke| stroke.up >= ordered.1 + ONSET + PHASE_AFTER).unwrap();
    let stroke = strokes[first];
    let next = strokes[first..].iter().skip(1).find(|next| next.motor == stroke.motor).unwrap();
    let tick = match phase {
        Phase::BeforeOnset => ordered.1 + (ONSET - 850),
        Phase::Up => stroke.up + u64::from(stroke.up_pulses / 2),
        Phase::Hold => stroke.up + (u64::from(stroke.up_pulses) + (stroke.down - stroke.up)) / 2,
        Phase::Down => stroke.down + u64::from(stroke.down_pulses / 2),
        Phase::Between => stroke.end() + (next.up - stroke.end()) / 2,
    };
    ordered.0 + Duration::from_secs_f64((tick - ordered.1) as f64 / 85_000.0)
}

fn play(case: &Case, value: f64, pattern: &str, seed: u64) -> Result<Seen, String> {
    let rig = Rig::armed(Line::default(), seed);
    let (events, fault_tick) = (Vec::new(), None);
    let mut player = Player {
        rig,
        pattern,
        value,
        events,
        fault_tick,
        restarts: 0,
        gone_high_ms: None,
        estopped: false,
        must_latch: case.expect.latched,
    };
    player.rig.mock.take_trace();
    let closed = case.fault.iter().any(|fault| matches!(fault.what, What::Telemetry(_)));
    let ordered = player.rig.now();
    let mut play = player.rig.play(&rig::pattern(player.pattern), Some(PLAY_S));
    play.open_loop = !closed;
    let order_tick = player.rig.device_tick_at(ordered);
    let onset = order_tick + ONSET;
    play.at = At::Tick(onset);
    let (id, mut compiled) = (play.id, play.strokes.clone());
    player.rig.send(Command::Play(Box::new(play)));
    compiled.begin(onset);
    let strokes: Vec<Stroke> = compiled.map(Result::unwrap).collect();
    for fault in &case.fault {
        player.run_to(instant(&fault.at, (ordered, order_tick), &strokes));
        player.begin(&fault.what);
        if let Some(lasts) = fault.lasts_ms {
            player.run(lasts.ms(value));
            player.mend();
        }
    }
    // The end of the play, and the seconds in which the link may doubt the device.
    player.run(Duration::from_secs_f64(PLAY_S) + 3_000 * MS);
    player.mend();
    player.run(6_000 * MS);
    let trace = player.rig.mock.take_trace();
    let outcome = player.events.iter().find_map(|event| match event {
        StreamEvent::PlayEnded { id: ended, outcome, .. } if *ended == id => Some(outcome),
        _ => None,
    });
    let outcome = outcome.ok_or("the play did not end")?;
    assert_closed(outcome);
    let safe_ms = (outcome.end != End::Done)
        .then(|| high_until(&trace, player.fault_tick).max(player.gone_high_ms.unwrap_or(0.0)));
    if player.must_latch && player.rig.mock.controller().state() != State::Faulted {
        return Err("the e-stop did not reach the device".to_owned());
    }
    case.expect.check_evidence(&player)?;
    let seen = Seen { end: outcome.end, safe_ms, lost: lost(outcome), planned: outcome.bursts.planned };
    judge(case, &seen)?;
    recovers(&mut player)?;
    if !closed && player.restarts == 0 {
        let mut all = trace;
        all.extend(player.rig.mock.take_trace());
        let net = bursts_on_the_lines(&all).net;
        if net != [0; MOTORS] {
            return Err(format!("pins are not where they began, pulses: {net:?}"));
        }
    }
    Ok(seen)
}

fn lost(outcome: &Outcome) -> u64 {
    outcome.bursts.planned - outcome.bursts.played
}

/// Milliseconds from the fault to the last pulse.
fn high_until(trace: &[(Tick, Run)], fault: Option<Tick>) -> f64 {
    let high = trace.iter().rev().find(|(_, run)| run.lines != Lines::OFF);
    let last = high.map_or(Tick(0), |(tick, run)| *tick + u64::from(run.ticks));
    // A board that has just started was not there when the fault began: all its pulses come after it.
    let fault = fault.or(trace.first().map(|(tick, _)| *tick));
    fault.map_or(0.0, |fault| (last.since(fault).max(0)) as f64 / 85.0)
}

fn judge(case: &Case, seen: &Seen) -> Result<(), String> {
    let Expect { play, safe_ms, lost_percent, .. } = case.expect;
    let is_done = seen.end == End::Done;
    if (play == Ends::Done) != is_done && play != Ends::Any {
        return Err(format!("it ended as {:?}, expected {play:?}", seen.end));
    }
    if let (Some(most), Some(ms)) = (safe_ms, seen.safe_ms)
        && ms > most
    {
        return Err(format!("lines were high until {ms:.2} ms after the fault, expected {most} ms at most"));
    }
    let lost = 100.0 * seen.lost as f64 / seen.planned.max(1) as f64;
    if is_done && lost > lost_percent {
        return Err(format!("{lost:.1} % of the bursts were lost, expected {lost_percent} % at most"));
    }
    Ok(())
}

/// A person resets, arms and plays again: then nothing is lost.
fn recovers(player: &mut Player<'_>) -> Result<(), String> {
    player.events.clear();
    if player.rig.mock.controller().state() == State::Faulted || player.estopped {
        player.rig.send(Command::Reset { estops_seen: u64::MAX });
        player.run(100 * MS);
    }
    if player.rig.mock.controller().state() != State::Armed {
        // Only a board that has started again does not know where its pins are.
        let ticket = player.rig.send(Command::Arm { assume_rest: player.restarts > 0 });
        player.run(300 * MS);
        let armed = answer(&player.events, ticket);
        if armed != Some(Ok(())) {
            return Err(format!("it does not arm again: {armed:?}"));
        }
    }
    let id = player.rig.start(&rig::pattern(player.pattern), Some(0.5));
    player.run(1_500 * MS);
    let outcome = player.events.iter().find_map(|event| match event {
        StreamEvent::PlayEnded { outcome, .. } => Some(outcome),
        _ => None,
    });
    match outcome {
        Some(outcome) if outcome.end == End::Done && lost(outcome) == 0 => Ok(()),
        other => Err(format!("the next play ({id}) is not whole: {other:?}")),
    }
}

fn cases() -> Vec<(String, Case)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/faults");
    let mut files: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    let read = |path: PathBuf| {
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let case = toml::from_str(&fs::read_to_string(&path).unwrap());
        (name.clone(), case.unwrap_or_else(|error| panic!("tests/faults/{name}.toml: {error}")))
    };
    files.into_iter().filter(|path| path.extension().is_some_and(|ext| ext == "toml")).map(read).collect()
}

#[test]
fn every_fault_ends_as_its_case_says() {
    let (mut table, mut kinds, mut problems) = (String::new(), 0, Vec::new());
    for (name, case) in cases() {
        let mut why = case.why.as_str();
        for &value in &case.values {
            kinds += 1;
            let (mut ends, mut safe, mut lost) = (Vec::new(), None::<f64>, 0.0_f64);
            for (seed, pattern) in (1..).zip(PATTERNS) {
                match play(&case, value, pattern, seed) {
                    Ok(seen) => {
                        ends.push(if seen.end == End::Done { "done" } else { "cut" });
                        safe = seen.safe_ms.map(|ms| safe.map_or(ms, |safe| safe.max(ms))).or(safe);
                        lost = lost.max(100.0 * seen.lost as f64 / seen.planned.max(1) as f64);
                    }
                    Err(problem) => problems.push(format!("{name}, {value}, {pattern}: {problem}")),
                }
            }
            ends.dedup();
            let value = if case.unit.is_empty() { String::new() } else { format!("{value} {}", case.unit) };
            let safe = safe.map_or("–".to_owned(), |ms| format!("{ms:.1}"));
            let why = std::mem::take(&mut why);
            let _ =
                writeln!(table, "| {name} | {value} | {why} | {} | {safe} | {lost:.1} % |", ends.join(", "));
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
    assert!(kinds >= 60, "{kinds} kinds");
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/reference/faults.md");
    let text = format!("{}{table}", HEAD.replace("KINDS", &kinds.to_string()));
    if std::env::var_os("MEISSNER_RENEW").is_some() {
        fs::write(&page, &text).unwrap();
    }
    assert!(
        fs::read_to_string(page).unwrap() == text,
        "docs/reference/faults.md is old: see the head of this file"
    );
}

const HEAD: &str = "# Faults, and what happens

Made from the cases in `tests/faults` by `MEISSNER_RENEW=1 cargo test -p meissner-stream --test tests -- faults`, in virtual time on
the simulated array: KINDS kinds of fault, each in the middle of plays of two seconds of `pin-60`, `edge-45` and `wave`. The worst of
the three is shown. *Low after*: of plays that are cut, milliseconds from the (last) fault to the last pulse, with the return of the
pins. *Lost*: of the bursts that the host had sent or was to send by then, those not played; the receipt counts each of them.

After each fault the same play has to run whole: reset, armed again where that is necessary, without a burst lost. Where the position
stays known, all pins are where they began, counted in pulses on the lines.

| fault | value | as when | play | low after, ms | lost |
|---|---|---|---|---|---|
";
