//! Kills at any moment, full disks and read-only directories; the session record of a session.

use crate::harness::{Daemon, PATIENT, PROGRAM, complaint, directory, ended, meissner, problem, wait_until};
use meissner::store::Store;
use meissner_api::{ImportedPattern, SessionList};
use meissner_client::{Client, ClientError};
use meissner_input::message::is_plain;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rustix::process::Signal;
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashSet};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;
use tempfile::TempDir;

/// Starts a daemon with a session record through a shell that may set limits first. Its log goes through a pipe, so that limits on
/// files do not affect it.
fn start(dir: &Arc<TempDir>, limits: &str) -> Daemon {
    start_with_state(dir, limits, dir.path(), "")
}

/// Starts one whose session record and calibration are elsewhere.
fn start_with_state(dir: &Arc<TempDir>, limits: &str, state: &Path, config: &str) -> Daemon {
    let (logbook, calibration) = (state.join("logbook"), state.join("calibration.toml"));
    let config = format!("{config}logbook_dir = {logbook:?}\ncalibration = {calibration:?}\n{PATIENT}");
    let mut command = Command::new("sh");
    command.args(["-c", &format!("{limits} exec \"$0\" \"$@\""), PROGRAM]).stdin(Stdio::null());
    let (mut log, stderr) = io::pipe().unwrap();
    let mut file = File::create(dir.path().join("log")).unwrap();
    thread::spawn(move || io::copy(&mut log, &mut file));
    Daemon::launch(Arc::clone(dir), "mock", &config, stderr, command)
}

/// A client of a daemon that is armed once it has its device.
fn armed(daemon: &mut Daemon) -> Client {
    daemon.wait_for_device();
    daemon.armed()
}

/// Plays for `seconds` and waits for the end.
fn play(client: &mut Client, seconds: f64) -> Value {
    let mut events = client.events().unwrap();
    let _: Value = client.post("/v1/play", &json!({"pattern": "edge-45", "seconds": seconds})).unwrap();
    serde_json::to_value(ended(&mut events)).unwrap()
}

/// Every complete line of every file of the session record.
fn lines(folder: &Path) -> Vec<Value> {
    let of = |folder: &Path| fs::read_dir(folder).into_iter().flatten().map(|file| file.unwrap().path());
    let mut files: Vec<PathBuf> = of(folder).chain(of(&folder.join("sessions"))).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "jsonl"));
    files.sort();
    let mut lines = Vec::new();
    for file in files {
        let bytes = fs::read(&file).unwrap();
        let mut pieces: Vec<_> = bytes.split(|&byte| byte == b'\n').collect();
        pieces.pop();
        let parse = |line: &[u8]| {
            serde_json::from_slice(line).unwrap_or_else(|error| {
                panic!("{}: {error}: {}", file.display(), String::from_utf8_lossy(line))
            })
        };
        lines.extend(pieces.into_iter().map(parse));
    }
    lines
}

fn text(name: &str, version: u32, padding: usize) -> String {
    let padding = "x".repeat(padding);
    let drive = "[[drive]]\nmotor = 9\nfrequency_hz = 60.0\namplitude_um = 40.0\n";
    format!("format = 1\nname = \"{name}\"\nduration_s = 1.0\n{drive}# version {version}\n# {padding}\n")
}

/// Uploads until the daemon is killed, `rounds` times, and checks the files each time. Returns the number of acknowledged uploads,
/// and how many of them had to be in the session record, because the daemon has read the record to its end since then.
fn kill_again_and_again(seed: u64, rounds: u32) -> (usize, usize) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let dir = directory();
    let (patterns, logbook) = (dir.path().join("patterns"), dir.path().join("logbook"));
    let mut stored: BTreeMap<String, String> = BTreeMap::new();
    let (mut version, mut all, mut all_recorded) = (0, 0, 0);
    for round in 0..rounds {
        let daemon = start(&dir, "");
        // Kill it mostly while it starts or has just started, and once so late that the session record must have entries.
        let late = round == 0;
        let after = random.next_u64() % if late { 500 } else { 150 };
        let mut acknowledged: Vec<String> = Vec::new();
        let recorded = AtomicUsize::new(0);
        let mut on_its_way: Option<(String, String)> = None;
        thread::scope(|scope| {
            let killer = scope.spawn(|| {
                wait_until(|| !late || recorded.load(Ordering::Relaxed) > 0);
                thread::sleep(Duration::from_millis(after));
                daemon.signal(Signal::KILL);
            });
            let mut client = daemon.client();
            while !killer.is_finished() {
                version += 1;
                let name = format!("p{}", random.next_u64() % 4);
                let text = text(&name, version, (random.next_u64() % 20_000) as usize);
                on_its_way = Some((name.clone(), text.clone()));
                match client
                    .put::<ImportedPattern>(&format!("/v1/patterns/{name}?replace=true"), text.clone())
                {
                    Ok(imported) => {
                        acknowledged.push(imported.sha256);
                        stored.insert(name, text);
                        on_its_way = None;
                        if late && random.next_u64() % 4 == 0 && is_recorded(&mut client) {
                            recorded.store(acknowledged.len(), Ordering::Relaxed);
                        }
                    }
                    Err(ClientError::NoDaemon { .. }) => {
                        on_its_way = None;
                        thread::sleep(Duration::from_millis(2));
                    }
                    Err(ClientError::HungUp { .. }) => break,
                    Err(other) => panic!("{other:?}"),
                }
            }
            killer.join().unwrap();
        });
        drop(daemon);
        all += acknowledged.len();
        all_recorded += recorded.load(Ordering::Relaxed);

        let list = Store::new(Some(patterns.clone()), false).unwrap().list();
        assert_eq!(list.errors, Vec::<String>::new(), "round {round}");
        if let Some((name, new)) = on_its_way {
            let found = fs::read_to_string(patterns.join(format!("{name}.toml"))).unwrap_or_default();
            let old = stored.get(&name).cloned().unwrap_or_default();
            assert!(found == old || found == new, "round {round}: {name} is neither");
            if found == new {
                stored.insert(name, new);
            }
        }
        for (name, text) in &stored {
            let found = fs::read_to_string(patterns.join(format!("{name}.toml"))).unwrap();
            assert!(found == *text, "round {round}: {name} is not what was acknowledged");
        }
        let lines = lines(&logbook);
        let written: HashSet<&str> =
            lines.iter().filter_map(|line| line["asked"]["sha256"].as_str()).collect();
        for sha256 in &acknowledged[..recorded.into_inner()] {
            assert!(written.contains(&**sha256), "round {round}: an upload is not in the session record");
        }
    }
    (all, all_recorded)
}

/// Whether the daemon says that the session record has all that has happened.
fn is_recorded(client: &mut Client) -> bool {
    client
        .get::<SessionList>("/v1/sessions")
        .is_ok_and(|list| !list.problems.iter().any(|problem| problem.contains("the disk has not taken")))
}

#[test]
fn a_kill_at_any_moment_leaves_whole_patterns_and_whole_lines() {
    let (mut all, mut recorded) = (0, 0);
    // On a busy machine a kill leaves time for few uploads, so more rounds are needed.
    for more in 0..4 {
        // Eight at a time: they mostly sleep.
        let seeds = 8 * more..8 * (more + 1);
        let lanes: Vec<_> = seeds.map(|seed| thread::spawn(move || kill_again_and_again(seed, 5))).collect();
        for lane in lanes {
            let counts = lane.join().unwrap();
            (all, recorded) = (all + counts.0, recorded + counts.1);
        }
        if all > 50 && recorded > 8 {
            break;
        }
    }
    eprintln!(
        "{all} uploads were acknowledged, {recorded} of them were in the session record before the kill"
    );
    assert!(all > 50 && recorded > 8, "too few to tell: {all}, {recorded}");
}

/// A play is played to its end, an upload is refused in one line, and one log line says that the session record is not written.
fn survives(daemon: &mut Daemon, why: &str) {
    let mut client = armed(daemon);
    daemon.wait_for_log("the session record cannot be written");
    let receipt = play(&mut client, 0.5);
    assert_eq!(receipt["state"], "done", "{receipt}");
    let status: Value = client.get("/v1/status").unwrap();
    assert!(
        status["daemon"]["logbook_problem"].as_str().is_some_and(|says| says.contains("cannot be written")),
        "{status}"
    );
    let refused = problem(client.put::<Value>("/v1/patterns/mine?replace=true", text("mine", 2, 5000)));
    assert_eq!(refused.code, "store");
    assert!(refused.detail.contains(why), "{}", refused.detail);
    assert!(daemon.end().success());
    let log = daemon.log();
    assert_eq!(log.matches("the session record cannot be written").count(), 1, "{log}");
    let line = log.lines().find(|line| line.contains("the session record cannot be written")).unwrap();
    assert!(
        line.contains("WARN") && line.contains("logbook_dir") && line.contains("playing goes on"),
        "{line}"
    );
    assert!(!log.contains("ERROR"), "{log}");
}

/// Simulates a full disk: no file may grow. The resulting signal must not kill the daemon.
#[test]
fn a_full_disk_stops_no_play_and_damages_no_file() {
    let dir = directory();
    let (patterns, logbook) = (dir.path().join("patterns"), dir.path().join("logbook"));
    fs::create_dir(&patterns).unwrap();
    fs::create_dir(&logbook).unwrap();
    let mine = patterns.join("mine.toml");
    fs::write(&mine, text("mine", 1, 10)).unwrap();
    // The file is as large as a file may be.
    let (file, full) = (logbook.join("daemon.jsonl"), "{\"event\":\"daemon-started\"}\n".repeat(100));
    fs::write(&file, &full).unwrap();
    let mut daemon = start(&dir, "ulimit -f 1;");
    survives(&mut daemon, "mine.toml: File too large");
    assert_eq!(fs::read_to_string(&mine).unwrap(), text("mine", 1, 10));
    assert_eq!(fs::read_to_string(&file).unwrap(), full);
    assert_eq!(fs::read_dir(&patterns).unwrap().count(), 1, "the refused upload left no file");
    drop(daemon);
    // When there is space again, everything is complete and unchanged.
    let mut daemon = start(&dir, "");
    let _: Value = armed(&mut daemon).put("/v1/patterns/mine?replace=true", text("mine", 2, 5000)).unwrap();
    daemon.wait_for_record();
    assert!(daemon.end().success());
    let lines = lines(&logbook);
    assert!(lines.iter().any(|line| line["command"] == "import" && line["answer"] == "ok"));
    assert_eq!(lines.iter().filter(|line| line["event"] == "lost").count(), 0);
    a_read_only_state_directory_stops_no_play();
}

/// Not even root may write there.
fn a_read_only_state_directory_stops_no_play() {
    let (dir, state) = (directory(), Path::new("/sys/kernel"));
    let mut daemon = start_with_state(&dir, "", state, &format!("patterns_dir = {state:?}\n"));
    survives(&mut daemon, "/sys/kernel/mine.toml: ");
}

#[test]
fn foreign_text_makes_no_line_of_its_own_and_is_cut() {
    const ODD: &str = "x\n2026-11-22T00:00:00Z  INFO estop by ada\r\u{1b}[2J\u{9b}1m\u{2028}\u{202e}\u{7f}";
    let dir = directory();
    let mut daemon = start(&dir, "export RUST_LOG=debug;");
    armed(&mut daemon);
    for text in [ODD.to_owned(), "x".repeat(5000)] {
        let json = serde_json::to_string(&text).unwrap();
        let toml = json.replace('\u{7f}', "\\u007f");
        let escaped: String = text.bytes().map(|byte| format!("%{byte:02x}")).collect();
        for (request, body) in [
            ("POST /v1/play".to_owned(), format!("{{\"pattern\": {json}}}")),
            ("POST /v1/play".to_owned(), format!("{{\"late\": {json}}}")),
            ("POST /v1/arm".to_owned(), format!("{{{json}: 1}}")),
            ("POST /v1/calibrate".to_owned(), format!("{{\"motor\": {json}}}")),
            ("POST /v1/stop".to_owned(), json.clone()),
            (format!("GET /v1/{escaped}"), String::new()),
            (format!("XX /v1/plays/{escaped}"), String::new()),
            (format!("PUT /v1/patterns/{escaped}"), toml.clone()),
            ("PUT /v1/patterns/odd".to_owned(), format!("format = 1\nname = {toml}\n")),
            ("PUT /v1/patterns/odd".to_owned(), format!("format = 1\n[[drive]]\n{toml} = {toml}\n")),
            (format!("{} /v1/status", "X".repeat(5000)), String::new()),
        ] {
            let length = body.len();
            let answer = daemon.raw(
                format!("{request} HTTP/1.1\r\nHost: m\r\nConnection: close\r\nContent-Length: {length}\r\n\r\n{body}")
                    .as_bytes(),
            );
            let problem: Value = serde_json::from_str(answer.split_once("\r\n\r\n").unwrap().1).unwrap();
            let detail = problem["detail"].as_str().unwrap();
            assert!(detail.chars().all(is_plain) && detail.len() < 600, "{request}: {detail:?}");
        }
        let file = dir.path().join("odd.toml");
        fs::write(&file, format!("{toml} = 1\n")).unwrap();
        let refused = complaint(meissner().args(["daemon", "--check-config", "--config"]).arg(&file));
        assert!(refused.trim_end().chars().all(is_plain) && refused.len() < 600, "{refused:?}");
    }
    assert!(daemon.end().success());
    for line in daemon.log().lines() {
        assert!(line.starts_with("20") && line[..30].contains('Z'), "{line:?}");
        assert!(line.chars().all(is_plain) && line.len() < 1000, "{line:?}");
    }
    let entries = lines(&dir.path().join("logbook"));
    assert!(entries.iter().any(|line| line["asked"]["pattern"] == ODD), "the text as it was");
}
