//! The rules that hold whatever happens, each in a sentence.

use super::{Life, World};
use crate::daemon::tests::bench::Client;
use meissner_api::{ErrorSource, PlayState, Receipt, Session, SessionList, SessionPlays, Status};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Duration;

/// By how much vibration may pass a limit without a pause, s: a stop or disarm is never refused, its return counts, and up to half a
/// second before it.
const CONTINUOUS_OVER_S: f64 = 0.6;
/// The same in a day.
const DAY_OVER_S: f64 = 4.0;
/// By how much more than the status says a pin may be off its rest, µm: a pulse.
const PULSE_UM: f64 = 0.95 / 7.0;
/// A cut burst that was corrected has moved its pin by up to 30 % more than its level, which is at most `max_amplitude_um`. The status
/// says so as long as telemetry comes, µm. A bad line loses corrections, each burst's: only the status bounds their sum.
const CORRECTED_UM: f64 = 30.0;
/// By dead reckoning the status says a root mean square, and the first burst of the seeds' motors after a rest is two standard deviations
/// (0.1 each) from the description: 1 instead of 0.8.
const DEVIATIONS: f64 = 2.0;

/// A return of all pins, and the report of it, s.
const RETURN_S: f64 = 0.2;
/// Reports that do not come within this time close the link, and with it the plays, s.
const REPORTED_S: f64 = 5.0;
/// The device answers an `arm` within this time, s.
const ARMED_S: f64 = 0.1;
/// What waits for the disk is written within this time, s: the writer pauses for a millisecond, and the runtime ends pauses at whole ones.
const WRITTEN_S: f64 = 0.002;

/// What was known before a kill.
#[derive(Debug)]
pub(super) struct Before {
    at_s: f64,
    /// Vibration of the day, if the disk has it.
    day_used_s: Option<f64>,
    /// Whether an order is so young that what it has written may still wait for the disk.
    is_young: bool,
    stalls: bool,
    /// Entries that the status says are lost.
    lost: u64,
}

/// Who shows the token of a session that is over may change nothing, and during an exclusive session only its owner may.
pub(super) fn may_act(world: &World, client: &Client) -> bool {
    let token = client.token();
    let is_old = token.is_some_and(|token| world.old_tokens.iter().any(|old| old == token));
    let is_out = world.life.session.as_ref().is_some_and(|session| {
        session.exclusive && token != Some(&*session.token) && world.now_s() < session.heard_s + 19.0
    });
    !is_old && !is_out
}

/// Whom [`may_act`] keeps out gets nothing done.
pub(super) fn keeps_out(may: bool, what: &str, done: bool) {
    assert!(may || !done, "{what} of a client that may not");
}

/// After a stop was answered, pins come down and nothing moves until the next order.
pub(super) fn stops(world: &mut World) {
    world.pass(Duration::from_secs(4));
    let now_s = world.now_s();
    let quiet = world.truth.last_s < now_s - 1.0;
    assert!(quiet || !world.trouble.array_is_good(now_s), "a stop is obeyed");
}

/// No limit for participants is passed by the lines, and after an emergency stop no line is high until a reset.
pub(super) fn after_look(world: &mut World) {
    let is_alone = world.trouble.lease_is_over(world.now_s());
    // An array that no longer hears the daemon lowers its pins by itself.
    assert!(!is_alone || are_down(world), "pins stay up without a host");
    let truth = &world.truth;
    assert!(truth.stretch_s <= 4.0 + CONTINUOUS_OVER_S, "{} s without a pause", truth.stretch_s);
    for (of, day_s) in truth.days.iter().chain(&truth.passed) {
        assert!(*day_s <= 8.0 + DAY_OVER_S, "{day_s} s of {of:?}");
    }
    if let Some(stopped_s) = world.life.estopped_s
        && world.trouble.array_is_good(world.now_s())
    {
        assert!(
            truth.last_s <= stopped_s + 0.02,
            "a line is high {} s after an e-stop",
            truth.last_s - stopped_s
        );
    }
}

/// What holds after each step.
pub(super) fn hold(world: &mut World) {
    let status = world.status();
    let (now_s, good) = (world.now_s(), world.trouble.array_is_good(world.now_s()));
    world.state.clone_from(&status.state);
    let returning_s = world.life.array.returning_s.unwrap_or(now_s);
    world.life.array.returning_s = (status.state == "returning").then_some(returning_s);
    world.life.array.stands &= !["armed", "returning"].contains(&&*status.state);
    world.truth.person = status.session.as_ref().map(|session| session.participant.clone());
    nothing_plays_unarmed(world, &status, now_s);
    silence_disarms(world, &status, now_s);
    trouble_of_the_disk_is_said(world, &status, now_s);
    losses_are_said(world, &status);
    if good {
        no_pin_stays_up(world, &status, now_s);
    }
}

/// While the motors are off or an emergency stop is latched, nothing plays or waits. A play ends once the device's reports of it have come:
/// over a bad line that takes longer.
fn nothing_plays_unarmed(world: &mut World, status: &Status, now_s: f64) {
    if status.state != "disarmed" && status.state != "faulted" {
        world.life.array.unarmed_s = None;
        return;
    }
    let since_s = *world.life.array.unarmed_s.get_or_insert(now_s);
    let may_end = !world.trouble.array_is_good(now_s) && now_s < since_s + REPORTED_S;
    // A play that follows an `arm` waits for the device's answer, also if the client of the `arm` is gone.
    let may_wait = status.state == "disarmed" && now_s < world.life.array.arming_s + ARMED_S;
    assert!(
        may_end || may_wait || status.play.is_none() && status.queued.is_empty(),
        "nothing plays: {status:?}"
    );
}

/// Motors do not stay armed when all clients are silent.
fn silence_disarms(world: &World, status: &Status, now_s: f64) {
    let silent = now_s > world.life.heard_s + 30.0 + 3.0;
    assert!(!silent || status.state != "armed", "armed, and silent since {}", world.life.heard_s);
}

/// A second after an order the status says that the disk has not taken it.
fn trouble_of_the_disk_is_said(world: &mut World, status: &Status, now_s: f64) {
    let Some(since_s) = world.trouble.takes_nothing_since(now_s) else { return };
    let due = since_s < world.life.ordered_s && world.life.ordered_s + 1.0 < now_s;
    assert!(!due || status.daemon.logbook_problem.is_some(), "the disk takes nothing since {since_s}");
}

/// Entries are lost only while the record names a problem.
fn losses_are_said(world: &mut World, status: &Status) {
    let (lost, problem) = (status.daemon.logbook_lost, &status.daemon.logbook_problem);
    let life = &mut world.life;
    let is_said = life.disk_says || problem.is_some() || life.lost.is_none_or(|before| lost <= before);
    assert!(is_said, "{lost} entries are lost, {:?} before, and no problem", life.lost);
    (life.lost, life.disk_says) = (Some(lost), problem.is_some());
}

/// No pin stays up without a move: a minute in a play, and seconds outside of one, but after an emergency stop or a fault.
fn no_pin_stays_up(world: &World, status: &Status, now_s: f64) {
    let is_idle = status.play.is_none() && status.queued.is_empty();
    let longest_s = if is_idle { 5.0 } else { 65.0 };
    let cut = ["estop", "output", "panic", "watchdog"].contains(&&*status.cause);
    // A pin that stood while its place was not known comes down after the next `arm`.
    let returns = world.life.array.returning_s.is_some_and(|since_s| now_s < since_s + RETURN_S);
    let may_stand = status.state == "faulted" && cut || returns || world.life.array.stands;
    for motor in 0..status.motors.len() {
        let rests_s = now_s - world.truth.pulsed_s[motor].max(world.life.began_s);
        let is_due = rests_s > longest_s && status.position == "known" && !may_stand;
        let off_um = off_um(world, status, motor).filter(|_| is_due);
        assert_eq!(off_um, None, "pin {motor} since {rests_s} s, said: {:?}", status.motors[motor]);
    }
}

/// What must be true after the kill that comes now.
pub(super) fn before_kill(world: &mut World) -> Before {
    let (status, at_s) = (world.status(), world.now_s());
    let is_set = world.machine.wall_set != world.life.wall_set;
    let is_young = at_s <= world.life.ordered_s + WRITTEN_S;
    // What was answered is on the disk.
    let is_answered = at_s > world.life.unanswered_s + WRITTEN_S;
    let known = status.session.is_none() && world.trouble.disk_is_good(at_s) && !is_set && is_answered;
    let day_used_s = known.then_some(status.participant.day_used_s);
    let lost = status.daemon.logbook_lost;
    Before { at_s, day_used_s, is_young, stalls: world.trouble.disk_stalls(at_s), lost }
}

/// What must be true after a kill.
pub(super) fn recorded(world: &mut World, before: &Before, life: &Life) {
    let lines = world.read_record(before.at_s);
    let of = |event: &str, place: &str| -> Vec<u64> {
        let all = lines.iter().filter(|line| line["event"] == event);
        all.filter_map(|line| line.pointer(place)?.as_u64()).collect()
    };
    each_answer_is_recorded(life, &of("answered", "/play"));
    let lost = of("lost", "/entries").iter().sum();
    each_play_is_recorded_or_lost(before, life, &of("ended", "/receipt/id"), lost);
    sums_survive(world, before);
    sessions_are_whole_or_not_complete(world, before, life);
}

/// An answer that was acknowledged has a line, and one only unless an earlier one may still have been written.
fn each_answer_is_recorded(life: &Life, lines: &[u64]) {
    let kept: BTreeSet<u64> = lines.iter().copied().collect();
    let sure = |id: &&u64| !life.unsure_answers.contains(id);
    assert_eq!(kept.iter().filter(sure).count(), lines.iter().filter(sure).count(), "an answer has one line");
    assert!(life.answered.is_subset(&kept), "acknowledged: {:?}, recorded: {kept:?}", life.answered);
    let unknown: Vec<_> = kept.difference(&life.answered).collect();
    assert!(
        unknown.iter().all(|id| life.unsure_answers.contains(id)),
        "no client has sent the answers {unknown:?}"
    );
}

/// Each play whose end was told has a line, and one only, or the record says that entries are lost.
fn each_play_is_recorded_or_lost(before: &Before, life: &Life, lines: &[u64], lost: u64) {
    let kept: BTreeSet<u64> = lines.iter().copied().collect();
    assert_eq!(kept.len(), lines.len(), "a play has one line");
    let unknown = kept.iter().filter(|id| !life.accepted.contains_key(id)).count() as u64;
    assert!(unknown <= life.unsure, "plays that no client has ordered: {kept:?}");
    // The record's thread writes every millisecond, unless the disk stalls.
    let due = |at_s: f64| !before.stalls && at_s < before.at_s - 0.1;
    let missing = life.ended.iter().filter(|&(id, &at_s)| due(at_s) && !kept.contains(id)).count() as u64;
    assert!(
        missing <= lost.max(before.lost),
        "{missing} plays are missing, {lost} entries are said to be, and {} by the status",
        before.lost
    );
}

/// A kill makes no sum of vibration smaller.
fn sums_survive(world: &mut World, before: &Before) {
    let after = world.status().participant;
    if let Some(used_s) = before.day_used_s {
        let same_day = world.now_s() < before.at_s + 60.0;
        assert!(!same_day || after.day_used_s >= used_s - 1e-6, "{used_s} s were {} s", after.day_used_s);
    }
}

/// Who sets the clock of a running daemon makes no sum smaller.
pub(super) fn clock_gives_no_new_day(world: &mut World, used_s: f64) {
    let after_s = world.status().participant.day_used_s;
    assert!(after_s >= used_s, "the clock was set: {used_s} s were {after_s} s");
}

/// A session whose record counts as complete has all of its plays, and one whose daemon was killed never counts as complete.
fn sessions_are_whole_or_not_complete(world: &mut World, before: &Before, life: &Life) {
    let observer = world.observer.clone();
    let known = life.ended_sessions.iter().map(|(id, plays)| (id, plays, true));
    let open = life.session.iter().map(|session| (&session.id, &session.plays, false));
    for (id, plays, has_ended) in known.chain(open) {
        let path = format!("/v1/sessions/{id}/plays");
        let shown =
            world.call::<SessionPlays>(&observer, super::NEVER, ("GET", &path, &Value::Null)).unwrap();
        let Ok(shown) = shown else {
            assert!(!world.trouble.disk_is_good(before.at_s), "session {id} is not in the record");
            continue;
        };
        let told: BTreeSet<u64> = shown.plays.iter().map(|play| play.receipt.id).collect();
        assert!(has_ended || !shown.complete, "session {id} was open when the daemon was killed");
        assert!(shown.session.reason.is_some(), "session {id} was over before this daemon");
        let all = plays.is_subset(&told) && told.len() as u64 <= plays.len() as u64 + life.unsure;
        assert!(!shown.complete || all, "session {id} has {plays:?}, and is shown complete with {told:?}");
        // On the bench the end of a session does not wait for the disk, as that of the program does.
        let is_good = world.trouble.disk_is_good(before.at_s) && life.disk_was_good && !before.is_young;
        if has_ended && is_good {
            assert!(shown.complete, "session {id}: {:?}", shown.missing);
        }
    }
    let list = world.call::<SessionList>(&observer, super::NEVER, ("GET", "/v1/sessions", &Value::Null));
    let list = list.unwrap().unwrap();
    let mut ids: Vec<&String> = list.sessions.iter().map(|Session { id, .. }| id).collect();
    ids.sort();
    ids.dedup();
    assert_eq!(ids.len(), list.sessions.len(), "each session is listed once");
}

/// How far a pin is off its rest, µm, if that is more than the status says. It says nothing while pins stand, and before telemetry or dead
/// reckoning.
fn off_um(world: &World, status: &Status, motor: usize) -> Option<f64> {
    let (of, height_um) = (&status.motors[motor], world.daemon.faults().heights_um[motor].abs());
    let once_um = if world.telemetry { CORRECTED_UM } else { 0.0 };
    let sums_up = world.telemetry && !world.life.array.was_good;
    let most_um = if sums_up { f64::INFINITY } else { once_um };
    let um = f64::from(of.rest_error_um).abs();
    let said_um = match of.source {
        _ if status.standing.is_some() => once_um,
        ErrorSource::None => um.max(once_um),
        ErrorSource::DeadReckoning => DEVIATIONS * um,
        ErrorSource::Telemetry | ErrorSource::LowerStop => um,
    };
    (height_um > said_um.min(most_um) + PULSE_UM).then_some(height_um)
}

/// Whether a person who looks sees all pins at rest.
pub(super) fn look_at_rest(world: &World) -> bool {
    world.daemon.faults().heights_um.iter().all(|um| um.abs() <= PULSE_UM)
}

/// Whether every pin is at rest, as far as the status says.
pub(super) fn are_down(world: &mut World) -> bool {
    let status = world.status();
    (0..status.motors.len()).all(|motor| off_um(world, &status, motor).is_none())
}

/// When all faults are over, the accounts of all plays close, pins are down, and the motors can be armed.
pub(super) fn at_rest(world: &mut World) {
    let client = world.observer.clone();
    let status = world.status();
    assert!(status.play.is_none() && status.queued.is_empty() && status.session.is_none(), "{status:?}");
    let are_down = are_down(world);
    assert!(are_down || status.position != "known", "all pins are down: {status:?}");
    let ids: Vec<(u64, bool)> = world.life.accepted.iter().map(|(id, has_end)| (*id, *has_end)).collect();
    for (id, has_end) in ids {
        let path = format!("/v1/plays/{id}");
        let receipt =
            world.call::<Receipt>(&client, super::NEVER, ("GET", &path, &Value::Null)).unwrap().unwrap();
        if let Some(bursts) = receipt.counts.bursts {
            let sum = bursts.played + bursts.late + bursts.dropped + bursts.refused + bursts.replaced;
            assert_eq!(bursts.planned, sum, "{receipt:?}");
        }
        assert!(receipt.state.is_over() && world.life.ended.contains_key(&id), "{receipt:?}");
        assert_eq!(receipt.cause.is_none(), receipt.state == PlayState::Done, "{receipt:?}");
        let passes = receipt.cause == Some(meissner_api::EndCause::ParticipantLimit) && has_end;
        assert!(
            !passes || !world.life.array.was_good,
            "a play that was accepted and has an end passes no limit: {receipt:?}"
        );
    }
    if !look_at_rest(world) {
        return;
    }
    let armed = world.asked::<Value>(&client, "/v1/arm", &json!({"assume_rest": true, "checked": "Ada"}));
    assert!(armed.is_ok(), "{armed:?}");
    let _ = world.asked::<Value>(&client, "/v1/disarm", &json!({})).unwrap();
}
