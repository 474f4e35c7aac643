//! What is told of a session, in two places: lines for the log, and everything for the logbook.
//!
//! A play is one line of the log, at its end; any other command is one line, when it is answered. The logbook gets each command and
//! each event but the frequent ones, with all there is to know. Neither is waited for. Names of users are looked up on a thread that
//! nobody waits for either: until one is known, its number is told.
//!
//! Invariants: nothing here comes once per burst; a command is in the logbook's hands before its client has the answer.

use super::engine::Engine;
use crate::session_record::{CommandEntry, Note, Peer, SessionRecord, Users};
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp, Zoned};
use meissner_api::Problem;
use meissner_api::{Event, PlayState, Receipt};
use meissner_stream::ANOTHER_DEVICE;
use meissner_stream::time::HostInstant;
use serde::Serialize;
use serde_json::Value;
use std::fmt::Write;
use std::sync::Arc;
use tracing::{debug, info, warn};

/// Characters of a refusal's reason, at the most.
const MOST_OF_A_DETAIL: usize = 500;

/// What makes numbers readable: users' names, and the time of the place.
#[derive(Debug)]
pub(super) struct Names {
    pub(super) users: Arc<Users>,
    /// As it was at the start: it is in a file.
    zone: TimeZone,
}

impl Default for Names {
    fn default() -> Self {
        Self { users: Arc::default(), zone: TimeZone::system() }
    }
}

impl Names {
    /// A user as far as is known at once.
    fn user(&self, uid: u32) -> String {
        match self.users.known(uid).flatten() {
            Some(name) => name,
            None if uid == u32::MAX => "an unknown user".to_owned(),
            None => format!("uid {uid}"),
        }
    }

    /// A client as far as is known at once.
    fn client(&self, who: Peer) -> String {
        match self.users.known(who.uid).flatten() {
            Some(name) => format!("{name} (uid {}, pid {})", who.uid, who.pid),
            None => format!("{} (pid {})", self.user(who.uid), who.pid),
        }
    }
}

/// A command that is being carried out. Dropped, it is noted; without an outcome its client has hung up.
#[derive(Debug)]
pub(super) struct Asked {
    engine: Arc<Engine>,
    book: SessionRecord,
    command: CommandEntry,
    who: Peer,
    /// How the log calls it.
    title: String,
}

impl Asked {
    pub(super) fn new(engine: &Arc<Engine>, command: &'static str, who: Peer) -> Self {
        let (engine, book) = (Arc::clone(engine), engine.lock().book.clone());
        Self {
            engine,
            book,
            command: CommandEntry::new(command, who, Value::Null),
            who,
            title: command.to_owned(),
        }
    }

    /// With what it was asked for.
    pub(super) fn with(&mut self, asked: &impl Serialize) {
        // What was parsed can be written.
        self.command.asked = serde_json::to_value(asked).unwrap_or_default();
    }

    /// What the log calls it, if its name is not enough.
    pub(super) fn call(&mut self, title: String) {
        self.title = title;
    }

    /// The play it has begun.
    pub(super) const fn began(&mut self, play: u64) {
        self.command.play = Some(play);
    }

    /// Notes what came of it, and passes that on.
    pub(super) fn outcome<T, E: AsRef<Problem>>(mut self, outcome: Result<T, E>) -> Result<T, E> {
        let problem = outcome.as_ref().err().map(AsRef::as_ref);
        self.command.answer = problem.map_or_else(|| "ok".to_owned(), |problem| problem.code.clone());
        // It may repeat what it was asked for.
        self.command.detail = problem.map(|problem| problem.detail.chars().take(MOST_OF_A_DETAIL).collect());
        outcome
    }
}

impl Drop for Asked {
    fn drop(&mut self) {
        let Peer { pid, uid } = self.who;
        let (title, client) = (&self.title, self.engine.names.client(self.who));
        let answer = match (&self.command.detail, &*self.command.answer) {
            (Some(detail), code) => format!("refused ({code}): {detail}"),
            (None, "ok") => "done".to_owned(),
            (None, _) => "they hung up before it was answered".to_owned(),
        };
        // What comes of a play its own line tells at its end; refused ones may come by the thousand.
        if self.command.command == "play" {
            debug!(pid, uid, play_id = self.command.play, "{title} by {client}: {answer}");
        } else {
            info!(pid, uid, "{title} by {client}: {answer}");
        }
        self.book.note(Note::Command(self.command.clone()));
    }
}

impl Engine {
    /// Logs an event, if it is for the log.
    pub(super) fn log(&self, event: &Event) {
        match event {
            Event::Connected { device } => {
                let (kind, firmware, boot) = (&*device.kind, &*device.firmware, device.boot);
                info!(kind, firmware, boot, "device connected: {kind}, firmware {firmware}, boot {boot}");
            }
            Event::Disconnected { reason } if reason == ANOTHER_DEVICE => info!("{reason}"),
            Event::Disconnected { reason } => {
                warn!(cause = reason, "device disconnected: {reason}; it is looked for again");
            }
            Event::Ended { receipt } => self.log_play(receipt),
            Event::SensorFault { motor, fault } => {
                let cause = fault.text();
                warn!(motor, cause, "motor {motor}: {cause}; it plays in open loop until the next `arm`");
            }
            Event::Drifted { um } => {
                warn!(
                    um,
                    "without telemetry pins may be {um:.0} um off: `meissner home` between plays, or level them by hand"
                );
            }
            Event::Calibrated { id, motors, problem: None } => {
                info!(play_id = id, "{} motors calibrated by play {id} and stored", motors.len());
            }
            Event::Calibrated { id, problem: Some(problem), .. } => {
                warn!(play_id = id, cause = problem, "play {id} calibrated nothing: {problem}");
            }
            Event::Lost { events } => {
                warn!(
                    notices = events,
                    "the daemon was too slow for the streamer: {events} events are missing"
                );
            }
            _ => {}
        }
    }

    /// The one line of a play.
    fn log_play(&self, receipt: &Receipt) {
        let who = self.lock().players.remove(&receipt.id);
        let by = who.map_or_else(|| "the daemon".to_owned(), |who| self.names.user(who.uid));
        let (id, pattern, cause) = (receipt.id, &*receipt.pattern, receipt.cause.as_deref());
        let (uid, tick) = (who.map(|who| who.uid), receipt.onset.map(|onset| onset.actual_tick));
        let came_to =
            outcome(receipt, HostInstant::now(), &Timestamp::now().to_zoned(self.names.zone.clone()));
        info!(play_id = id, pattern, tick, cause, uid, "play {id} {pattern} by {by}: {came_to}");
    }
}

/// What came of a play that has just ended.
fn outcome(receipt: &Receipt, now: HostInstant, wall: &Zoned) -> String {
    let mut text = receipt.state.name().to_owned();
    // Writing to a text cannot fail.
    if let Some(cause) = &receipt.cause {
        let _ = write!(text, " ({cause})");
    }
    let Some(onset) = receipt.onset else { return text + ", it did not begin" };
    let began = HostInstant::from_ns(onset.monotonic_ns);
    let (since, until) = (now.since(began), began.since(now));
    let since = SignedDuration::try_from(since).unwrap_or_default()
        - SignedDuration::try_from(until).unwrap_or_default();
    // By the clock as it stands now: if it was set meanwhile, this is when one would say today that it began.
    let at = wall.saturating_sub(since).strftime("%H:%M:%S%.6f");
    let (tick, us) = (onset.actual_tick, onset.uncertainty_ns.div_ceil(1000));
    let _ = write!(text, ", began {at} (tick {tick}, ±{us} us)");
    let asked = receipt.seconds.filter(|_| receipt.state == PlayState::Done);
    let seconds = since.as_secs_f64().max(0.0).min(asked.unwrap_or(f64::INFINITY));
    let _ = write!(text, ", {seconds:.1} s");
    let Some(bursts) = receipt.bursts else { return text };
    let _ = if bursts.played == bursts.planned {
        write!(text, ", {} bursts", bursts.planned)
    } else {
        write!(text, ", {} of {} bursts", bursts.played, bursts.planned)
    };
    for (count, fate) in [(bursts.late, "late"), (bursts.dropped, "dropped"), (bursts.refused, "refused")] {
        if count > 0 {
            let _ = write!(text, ", {count} {fate}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session_record::Location;
    use meissner_api::BurstCounts;
    use meissner_api::OnsetRecord;
    use meissner_stream::Settings;
    use meissner_stream::queues::queues;
    use std::fs;
    use std::thread;
    use std::time::Duration;

    #[test]
    fn a_play_is_a_line_that_reads_alone() {
        let wall: Zoned = "2026-11-22T14:03:27.250000+01:00[+01:00]".parse().unwrap();
        let now = HostInstant::from_ns(20_126_544_000);
        let mut receipt = Receipt::new(3, "edge-45", "0", Some(5.0));
        receipt.state = PlayState::Stopped;
        receipt.cause = Some("stop".to_owned());
        assert_eq!(outcome(&receipt, now, &wall), "stopped (stop), it did not begin");
        let (requested_tick, actual_tick, monotonic_ns, uncertainty_ns) =
            (0, 123_456, 15_000_000_000, 11_001);
        receipt.onset = Some(OnsetRecord { requested_tick, actual_tick, monotonic_ns, uncertainty_ns });
        receipt.bursts =
            Some(BurstCounts { planned: 1200, played: 1190, late: 3, dropped: 7, ..BurstCounts::default() });
        let began = "began 14:03:22.123456 (tick 123456, ±12 us)";
        assert_eq!(
            outcome(&receipt, now, &wall),
            format!("stopped (stop), {began}, 5.1 s, 1190 of 1200 bursts, 3 late, 7 dropped")
        );
        (receipt.state, receipt.cause) = (PlayState::Done, None);
        receipt.bursts = Some(BurstCounts { planned: 1200, played: 1200, ..BurstCounts::default() });
        assert_eq!(outcome(&receipt, now, &wall), format!("done, {began}, 5.0 s, 1200 bursts"));
    }

    #[test]
    fn a_client_that_hangs_up_is_noted() {
        let dir = tempfile::tempdir().unwrap();
        let (_port, orders, _notices) = queues().unwrap();
        let folder = dir.path().join("logbook");
        let keep = Location { dir: folder.clone(), days: 1 };
        let book = SessionRecord::start(Some(keep), Arc::default()).unwrap();
        let (settings, wanted) = (Settings::default(), "mock".to_owned());
        let engine = Arc::new(Engine::new(orders, settings, wanted, None));
        engine.lock().book = book.clone();
        drop(Asked::new(&engine, "home", Peer { pid: 7, uid: 0 }));
        book.close(Duration::from_secs(10));
        let file = fs::read_dir(folder).unwrap().next().unwrap().unwrap().path();
        let line: Value = serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap();
        let said = ["event", "command", "user", "answer"].map(|key| line[key].as_str().unwrap());
        assert_eq!(said, ["command", "home", "root", "hung-up"]);
    }

    #[test]
    fn who_it_was_is_told_as_far_as_it_is_known() {
        let names = Names::default();
        let root = Peer { pid: 7, uid: 0 };
        assert_eq!((names.client(root), names.user(0)), ("uid 0 (pid 7)".to_owned(), "uid 0".to_owned()));
        names.users.look_up(0);
        while names.users.known(0).is_none() {
            thread::yield_now();
        }
        assert_eq!(
            (names.client(root), names.user(0)),
            ("root (uid 0, pid 7)".to_owned(), "root".to_owned())
        );
        assert_eq!(names.client(Peer { pid: -1, uid: u32::MAX }), "an unknown user (pid -1)");
    }
}
