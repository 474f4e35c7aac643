//! Tests whether a session is complete after full disks, clock jumps, removed and torn files, and kills.

use super::*;
use crate::session_record::ledger::SessionLosses;
use meissner_api::{Losses, Session, SessionPlays, Terms};
use std::path::PathBuf;

const ID: &str = "20261122T083000Z-9f3c";

fn session(plays: u64, reason: Option<&str>) -> Box<Session> {
    let (id, reason) = (ID.to_owned(), reason.map(str::to_owned));
    Box::new(Session { id, participant: "P07".to_owned(), plays, reason, ..Session::default() })
}

fn entry(event: Event) -> Entry {
    Entry::of(&event, None).unwrap()
}

fn begins() -> Entry {
    entry(Event::SessionStarted { session: session(0, None) })
}

fn ends(plays: u64) -> Entry {
    entry(Event::SessionEnded { session: session(plays, Some("request")) })
}

fn play(id: u64) -> Entry {
    let mut receipt = Receipt { id, ..Receipt::new("edge-45", "0", 1, &Terms::default()) };
    (receipt.order.terms.session, receipt.device.boot) = (Some(ID.to_owned()), Some(1));
    entry(Event::Ended { receipt: Box::new(receipt) })
}

/// The session, as read from the record.
fn read(dir: &Path, known: &[SessionLosses]) -> SessionPlays {
    let dir = dir.join("logbook");
    let sessions = reader::sessions(&dir, known, None).unwrap().recorded;
    assert_eq!(sessions.len(), 1);
    reader::plays(&dir, sessions.into_iter().next().unwrap(), 0).unwrap()
}

/// All lines of the record, by number.
fn all(dir: &Path) -> Vec<Value> {
    let files = fs::read_dir(dir.join("logbook")).unwrap().map(|file| file.unwrap().path());
    let files = files.filter(|file| file.extension().is_some_and(|end| end == "jsonl"));
    let text: String = files.map(|file| fs::read_to_string(file).unwrap()).collect();
    let mut lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    lines.sort_by_key(|line| line["number"].as_u64());
    lines
}

fn order(read: &SessionPlays) -> Vec<u64> {
    read.plays.iter().map(|play| play.receipt.id).collect()
}

fn day(dir: &Path, day: &str) -> PathBuf {
    dir.join("logbook").join(format!("{day}.jsonl"))
}

/// Runs a daemon whose clock shows these times.
fn at(dir: &Path, entries: impl IntoIterator<Item = (&'static str, Entry)>) {
    let mut writer = writer(dir, REAL);
    for (number, (wall, entry)) in entries.into_iter().enumerate() {
        writer.write_next(stamp(wall, number as u64 + 1), entry);
    }
    writer.finish();
}

/// A session of four plays at these times.
fn four_plays(dir: &Path, walls: [&'static str; 6]) {
    at(dir, walls.into_iter().zip([begins(), play(1), play(2), play(3), play(4), ends(4)]));
}

#[test]
fn clocks_that_jump_change_neither_order_nor_completeness() {
    let noon = "2026-11-22T12:00:00Z";
    for walls in [
        [noon; 6],
        // Back by two days, by years, forwards by years, and back over midnight.
        [noon, noon, "2026-11-20T12:00:00Z", "2026-11-20T12:00:01Z", noon, noon],
        [
            noon,
            "2020-01-01T00:00:00Z",
            "1970-01-01T00:00:00Z",
            "2031-01-01T00:00:00Z",
            noon,
            "2026-11-19T12:00:00Z",
        ],
        [noon, "2026-11-22T23:00:05Z", "2026-11-22T22:59:55Z", "2026-11-22T23:00:06Z", noon, noon],
        ["2031-01-01T00:00:00Z", noon, noon, noon, noon, noon],
    ] {
        let dir = tempfile::tempdir().unwrap();
        four_plays(dir.path(), walls);
        // Another daemon continues, at another date.
        at(dir.path(), [("2019-01-01T12:00:00Z", started())]);
        let read = read(dir.path(), &[]);
        assert_eq!(
            (order(&read), &read.missing, read.complete),
            (vec![1, 2, 3, 4], &vec![], true),
            "{walls:?}"
        );
    }
}

/// Clocks jump while old files are removed: those of the running session stay.
#[test]
fn the_files_of_the_running_session_stay() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = Writer::new(location(dir.path(), 1)).on(REAL, TimeZone::UTC);
    let mut write =
        |hour: u64, wall: &str, entry| writer.write_next(stamp(wall, hour * 3_600_000_000_000), entry);
    write(1, "2026-11-01T12:00:00Z", started());
    write(25, "2026-11-02T12:00:00Z", begins());
    for (number, wall) in
        ["2026-11-03", "2026-11-09", "2029-01-01", "2029-01-03", "2026-12-01"].iter().enumerate()
    {
        write(49 + 24 * number as u64, &format!("{wall}T12:00:00Z"), play(number as u64 + 1));
    }
    assert!(!day(dir.path(), "2026-11-01").exists(), "old files are removed");
    write(49 + 24 * 5, "2026-12-02T12:00:00Z", ends(5));
    let read = read(dir.path(), &[]);
    assert_eq!((order(&read), read.complete), (vec![1, 2, 3, 4, 5], true), "{:?}", read.missing);
    // Once the session is over, its files are old like others.
    for number in 0..4 {
        write(49 + 24 * (6 + number), &format!("2029-02-0{}T12:00:00Z", number + 1), started());
    }
    assert!(!day(dir.path(), "2026-11-02").exists());
}

/// The disk is full from the start of the session to its end, and longer than the daemon lives.
#[test]
fn a_full_disk_is_told_from_memory_then_in_a_line_and_after_a_restart() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = writer(dir.path(), SMALL);
    let noon = |ns| stamp("2026-11-22T12:00:00Z", ns);
    writer.write_next(noon(1), started());
    ROOM.set(0);
    let ledger = writer.ledger();
    let mut lose = |ns: u64, entry: Entry| {
        ledger.lock().unwrap().see(&entry, ns);
        let tag = Tag { session: Some(ID.into()), name: entry.kind().2 };
        writer.write(Added {
            stamp: noon(ns),
            number: ns,
            missed: Counts::default(),
            tag,
            entry,
            told: None,
        });
    };
    lose(2, begins());
    (1..=8).for_each(|number| lose(2 + number, play(number)));
    lose(11, ends(8));
    let known: Vec<_> = ledger.lock().unwrap().sessions().cloned().collect();
    let whole = read(dir.path(), &known);
    assert_eq!(
        (whole.session.plays, whole.session.lost.plays, whole.plays_missing, whole.lost),
        (8, 8, 8, 10)
    );
    assert_eq!(whole.session.reason.as_deref(), Some("request"));
    assert!(
        !whole.complete && whole.missing[0] == "8 of 8 plays are missing, or their ends are",
        "{:?}",
        whole.missing
    );
    // The disk takes bytes again: the line is written without waiting for an entry.
    ROOM.set(usize::MAX);
    let due = writer.due().unwrap();
    writer.wake(due);
    let told = all(dir.path()).pop().unwrap();
    assert_eq!((&told["event"], &told["entries"], &told["number"]), (&json!("lost"), &json!(10), &json!(11)));
    let kinds = json!({"ended": 8, "session-ended": 1, "session-started": 1});
    assert_eq!(told["of"], json!([{"session": ID, "kinds": kinds}]));
    // Read the record with and without the daemon's memory.
    let known: Vec<_> = ledger.lock().unwrap().sessions().cloned().collect();
    for known in [&known[..], &[]] {
        let after = read(dir.path(), known);
        assert_eq!((after.session.plays, after.session.lost.plays, after.lost), (8, 8, 10));
        assert_eq!(after.missing, whole.missing);
    }
    // The disk gets full again, and the daemon ends in this state, so there is a gap before the next one's lines.
    ROOM.set(0);
    writer.write_next(noon(12), started());
    writer.write_next(noon(13), started());
    drop(log_of(|| writer.finish()));
    ROOM.set(usize::MAX);
    at(dir.path(), [("2026-11-22T13:00:00Z", started())]);
    let told: Vec<_> = all(dir.path())[2..].iter().map(|line| line["number"].as_u64()).collect();
    assert_eq!(told, [Some(14)], "12 and 13 are missing");
}

/// The disk is full only in the middle; some lines are torn, removed or cut off by others; the daemon is killed.
#[test]
fn whatever_is_missing_of_a_session_is_counted() {
    let walls = ["2026-11-22T12:00:00Z"; 6];
    let damaged = |damage: &dyn Fn(Vec<String>) -> Vec<String>| {
        let dir = tempfile::tempdir().unwrap();
        four_plays(dir.path(), walls);
        let file = day(dir.path(), "2026-11-22");
        let lines = fs::read_to_string(&file).unwrap().lines().map(str::to_owned).collect();
        fs::write(&file, damage(lines).join("\n") + "\n").unwrap();
        // The next daemon.
        at(dir.path(), [("2026-11-22T13:00:00Z", started())]);
        read(dir.path(), &[])
    };
    let without = |number: usize| {
        damaged(&move |mut lines| {
            lines.remove(number);
            lines
        })
    };
    assert!(damaged(&|lines| lines).complete);
    for (read, says) in [
        (
            without(2),
            "1 of 4 plays are missing, or their ends are; the record lost 1 entries during the session",
        ),
        (without(0), "its start is not recorded"),
        (
            without(5),
            "its end is not recorded: the daemon was killed, or could not write; what came last may be missing; \
             the record lost 1 entries during the session",
        ),
        (
            damaged(&|lines| lines.iter().map(|line| line.replace("\"id\":3,", "\"id\":\"3")).collect()),
            "1 of 4 plays are missing, or their ends are",
        ),
        (
            damaged(&|lines| vec![lines[0].clone(), lines[1].clone(), lines[2][..40].to_owned()]),
            "the record lost 4 entries during the session",
        ),
    ] {
        let missing = read.missing.join("; ");
        assert!(!read.complete && missing.contains(says), "{missing}");
    }
}

#[test]
fn a_file_that_is_removed_or_cut_meanwhile_shows_as_a_gap() {
    for removed in [true, false] {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = writer(dir.path(), REAL);
        let file = day(dir.path(), "2026-11-22");
        let mut write = |ns, entry| writer.write_next(stamp("2026-11-22T12:00:00Z", ns), entry);
        write(1, begins());
        write(2, play(1));
        if removed {
            fs::remove_file(&file).unwrap();
        } else {
            // In the middle of a line.
            let length = fs::metadata(&file).unwrap().len();
            File::options().write(true).open(&file).unwrap().set_len(length - 10).unwrap();
        }
        write(3, play(2));
        write(4, ends(2));
        writer.finish();
        let read = read(dir.path(), &[]);
        assert_eq!(
            (order(&read), read.plays_missing, read.complete),
            (vec![2], 1, false),
            "{:?}",
            read.missing
        );
        assert!(lines(dir.path(), "2026-11-22").iter().all(|line| line["number"].is_u64()));
    }
}

/// Left-out entries are reported with the session; plays are never among them.
#[test]
fn entries_that_were_left_out_are_told_with_the_session() {
    let dir = tempfile::tempdir().unwrap();
    let log = SessionRecord::with(writer(dir.path(), REAL), Arc::default(), WAITING).unwrap();
    log.add(begins());
    let mut long = CommandEntry::new("stop", Peer::local(12, 0));
    let texts: Vec<_> = (0..100).map(|_| "x".repeat(100)).collect();
    long.set_arguments(json!({ "texts": texts }));
    (0..7).for_each(|_| log.add(Note::Command(long.clone())));
    log.add(play(1));
    log.add(ends(1));
    log.close(Duration::from_secs(60));
    let read = read(dir.path(), &[]);
    assert_eq!((read.left_out, read.complete), (7, true), "{:?}", read.missing);
}

/// Others send requests faster than the disk takes them. The queue keeps room for the session's own entries.
#[test]
fn requests_that_find_the_queue_full_count_against_no_session() {
    let dir = tempfile::tempdir().unwrap();
    let held = hold();
    let log = SessionRecord::with(writer(dir.path(), STUCK), Arc::default(), 16).unwrap();
    log.add(begins());
    for _ in 0..100 {
        let mut refused = CommandEntry::new("play", Peer::local(12, 0));
        refused.answer = "bad-request".to_owned();
        log.add(Note::Command(refused));
    }
    log.add(play(1));
    log.add(ends(1));
    assert!(log.lost() >= 90, "{}", log.lost());
    assert_eq!(log.lost_of(ID), Losses::default());
    drop(held);
    log.close(Duration::from_secs(300));
    let read = read(dir.path(), &[]);
    assert!(read.complete, "{:?}", read.missing);
}
