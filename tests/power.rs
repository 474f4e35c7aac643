//! What survives when the daemon is killed at any moment, the disk is full or nothing may be written; and the session record of a
//! session.

use crate::harness::TIMEOUT;
use jiff::Zoned;
use meissner::store::Store;
use meissner_api::{ImportedPattern, Problem, Status};
use meissner_client::{Client, ClientError};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// A daemon with a session record, started by a shell that may set limits first. Dropping this kills it.
struct Recorded {
    child: Child,
    dir: PathBuf,
    /// Its log, through a pipe: limits on files do not concern it.
    log: Arc<Mutex<String>>,
}

impl Recorded {
    fn start(dir: &Path, limits: &str) -> Self {
        Self::with(dir, limits, &dir.join("patterns"), dir)
    }

    /// Starts one with patterns and other state elsewhere.
    fn with(dir: &Path, limits: &str, patterns: &Path, state: &Path) -> Self {
        let (logbook, calibration) = (state.join("logbook"), state.join("calibration.toml"));
        let config = format!(
            "patterns_dir = {patterns:?}\nlogbook_dir = {logbook:?}\ncalibration = {calibration:?}\nlease_ms = 5000\n"
        );
        fs::write(dir.join("meissner.toml"), config).unwrap();
        let mut child = Command::new("sh")
            .args(["-c", &format!("{limits} exec \"$0\" \"$@\""), env!("CARGO_BIN_EXE_meissner")])
            .args(["daemon", "--device", "mock", "--config"])
            .arg(dir.join("meissner.toml"))
            .env("MEISSNER_SOCKET", dir.join("m.sock"))
            .env_remove("RUST_LOG")
            .env_remove("STATE_DIRECTORY")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let log = Arc::new(Mutex::new(String::new()));
        let (lines, kept) = (BufReader::new(child.stderr.take().unwrap()), Arc::clone(&log));
        thread::spawn(move || {
            for line in lines.lines().map_while(Result::ok) {
                kept.lock().unwrap().push_str(&(line + "\n"));
            }
        });
        Self { child, dir: dir.to_owned(), log }
    }

    fn client(&self) -> Client {
        Client::new(&self.dir.join("m.sock")).unwrap()
    }

    /// A client, once the device is armed.
    fn armed(&self) -> Client {
        let (begun, mut client) = (Instant::now(), self.client());
        while !client.get::<Status>("/v1/status").is_ok_and(|status| status.is_connected()) {
            assert!(begun.elapsed() < TIMEOUT, "no device:\n{}", self.log());
            thread::sleep(Duration::from_millis(5));
        }
        let _: Status = client.post("/v1/arm", &json!({"assume_rest": true})).unwrap();
        client
    }

    fn log(&self) -> String {
        self.log.lock().unwrap().clone()
    }

    fn wait_for_log(&self, what: &str) {
        let begun = Instant::now();
        while !self.log().contains(what) {
            assert!(begun.elapsed() < TIMEOUT, "no `{what}`:\n{}", self.log());
            thread::sleep(Duration::from_millis(5));
        }
    }

    fn end(&mut self) -> ExitStatus {
        kill_process(Pid::from_child(&self.child), Signal::TERM).unwrap();
        let begun = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(begun.elapsed() < TIMEOUT, "it does not end:\n{}", self.log());
            thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Recorded {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        if thread::panicking() {
            eprintln!("the daemon's log:\n{}", self.log());
        }
    }
}

/// Plays for so long and waits for the end.
fn play(client: &mut Client, seconds: f64) -> Value {
    let mut events = client.events().unwrap();
    let _: Value = client.post("/v1/play", &json!({"pattern": "edge-45", "seconds": seconds})).unwrap();
    loop {
        let event = events.next(Some(TIMEOUT)).unwrap().expect("the daemon lives");
        if let meissner_api::Event::Ended { receipt } = event {
            return serde_json::to_value(receipt).unwrap();
        }
    }
}

fn problem(answer: Result<ImportedPattern, ClientError>) -> Problem {
    match answer {
        Err(ClientError::Problem(problem)) => problem,
        other => panic!("{other:?}"),
    }
}

/// Every complete line of every file of the session record, in order of days.
fn lines(folder: &Path) -> Vec<Value> {
    let entries = fs::read_dir(folder).map(|files| files.map(|file| file.unwrap().path()).collect());
    let mut files: Vec<PathBuf> = entries.unwrap_or_default();
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
    format!("format = 1\nname = \"{name}\"\nduration_s = 1.0\n# version {version}\n# {padding}\n")
}

/// Uploads until the power fails, again and again, and checks each time what is left. Returns how many uploads were acknowledged, and
/// how many of them so long before the failure that they had to be in the session record.
fn fail_again_and_again(seed: u64, rounds: u32) -> (usize, usize) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let dir = tempfile::tempdir().unwrap();
    let (patterns, logbook) = (dir.path().join("patterns"), dir.path().join("logbook"));
    fs::create_dir(&patterns).unwrap();
    let mut stored: BTreeMap<String, String> = BTreeMap::new();
    let (mut version, mut all, mut long_before) = (0, 0, 0);
    for round in 0..rounds {
        let daemon = Recorded::start(dir.path(), "");
        let pid = Pid::from_child(&daemon.child);
        // Mostly while it starts or has just started; now and then so late that something has to be in the session record.
        let after = if round % 20 == 0 { 1200 + random.next_u64() % 300 } else { random.next_u64() % 150 };
        let mut acknowledged: Vec<(Instant, String)> = Vec::new();
        let mut on_its_way: Option<(String, String)> = None;
        let killed = thread::scope(|scope| {
            let killer = scope.spawn(move || {
                thread::sleep(Duration::from_millis(after));
                let at = Instant::now();
                kill_process(pid, Signal::KILL).unwrap();
                at
            });
            let mut client = daemon.client();
            while !killer.is_finished() {
                version += 1;
                let name = format!("p{}", random.next_u64() % 4);
                let text = text(&name, version, (random.next_u64() % 20_000) as usize);
                on_its_way = Some((name.clone(), text.clone()));
                match client.put::<ImportedPattern>(&format!("/v1/patterns/{name}"), text.clone()) {
                    Ok(imported) => {
                        acknowledged.push((Instant::now(), imported.sha256));
                        stored.insert(name, text);
                        on_its_way = None;
                    }
                    Err(ClientError::NoDaemon { .. }) => {
                        on_its_way = None;
                        thread::sleep(Duration::from_millis(2));
                    }
                    Err(ClientError::HungUp { .. }) => break,
                    Err(other) => panic!("{other:?}"),
                }
            }
            killer.join().unwrap()
        });
        drop(daemon);
        all += acknowledged.len();

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
        for (at, sha256) in acknowledged {
            let long_ago = killed.saturating_duration_since(at) > Duration::from_secs(1);
            long_before += usize::from(long_ago);
            assert!(
                !long_ago || written.contains(&*sha256),
                "round {round}: an upload is not in the session record"
            );
        }
    }
    (all, long_before)
}

#[test]
fn power_that_fails_at_any_moment_leaves_whole_patterns_and_whole_lines() {
    // Four at a time: they mostly sleep.
    let lanes: Vec<_> = (0..4).map(|seed| thread::spawn(move || fail_again_and_again(seed, 50))).collect();
    let mut uploads = 0;
    for lane in lanes {
        let (all, long_before) = lane.join().unwrap();
        eprintln!(
            "{all} uploads were acknowledged, {long_before} of them more than a second before the power failed"
        );
        assert!(long_before > 0, "too few to tell: {all}, {long_before}");
        uploads += all;
    }
    assert!(uploads > 200, "too few to tell: {uploads}");
}

/// A play goes to its end, an upload is refused in one line, and one line of the log says that the session record is not written.
fn survives(daemon: &mut Recorded, why: &str) {
    let mut client = daemon.armed();
    daemon.wait_for_log("the session record cannot be written");
    let receipt = play(&mut client, 0.5);
    assert_eq!(receipt["state"], "done", "{receipt}");
    let status: Value = client.get("/v1/status").unwrap();
    assert!(
        status["logbook_problem"].as_str().is_some_and(|says| says.contains("cannot be written")),
        "{status}"
    );
    let refused = problem(client.put("/v1/patterns/mine", text("mine", 2, 5000)));
    assert_eq!(refused.code, "store");
    assert!(refused.detail.contains(why) && !refused.detail.contains('\n'), "{}", refused.detail);
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

/// As if the disk were full: no file may grow. The signal for that must not kill the daemon.
#[test]
fn a_full_disk_stops_no_play_and_costs_nothing_that_was_there() {
    let dir = tempfile::tempdir().unwrap();
    let (patterns, logbook) = (dir.path().join("patterns"), dir.path().join("logbook"));
    fs::create_dir(&patterns).unwrap();
    fs::create_dir(&logbook).unwrap();
    let mine = patterns.join("mine.toml");
    fs::write(&mine, text("mine", 1, 10)).unwrap();
    // Today's file is as large as a file may be, and so is tomorrow's.
    let (today, full) = (Zoned::now().date(), "{\"event\":\"daemon-started\"}\n".repeat(100));
    let days = [today, today.tomorrow().unwrap()].map(|day| logbook.join(format!("{day}.jsonl")));
    for day in &days {
        fs::write(day, &full).unwrap();
    }
    let mut daemon = Recorded::start(dir.path(), "ulimit -f 1;");
    survives(&mut daemon, "mine.toml: File too large");
    assert_eq!(fs::read_to_string(&mine).unwrap(), text("mine", 1, 10));
    assert!(days.iter().all(|day| fs::read_to_string(day).unwrap() == full));
    assert_eq!(fs::read_dir(&patterns).unwrap().count(), 1, "nothing is left of what was refused");
    drop(daemon);
    // With room again, everything is as it was, and whole.
    let mut daemon = Recorded::start(dir.path(), "");
    let _: ImportedPattern = daemon.armed().put("/v1/patterns/mine", text("mine", 2, 5000)).unwrap();
    assert!(daemon.end().success());
    let lines = lines(&logbook);
    assert!(lines.iter().any(|line| line["command"] == "import" && line["answer"] == "ok"));
    assert_eq!(lines.iter().filter(|line| line["event"] == "lost").count(), 0);
}

/// Not even root may write there.
#[test]
fn a_state_directory_that_cannot_be_written_to_stops_no_play() {
    let (dir, state) = (tempfile::tempdir().unwrap(), Path::new("/sys/kernel"));
    let mut daemon = Recorded::with(dir.path(), "", state, state);
    survives(&mut daemon, "/sys/kernel/mine.toml: ");
}

#[test]
fn the_session_record_tells_a_session_from_start_to_end() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("patterns")).unwrap();
    let mut daemon = Recorded::start(dir.path(), "");
    let mut client = daemon.armed();
    let receipt = play(&mut client, 0.2);
    let refused: Result<Value, _> = client.post("/v1/play", &json!({"pattern": "edge-46"}));
    assert!(refused.is_err());
    // A request that breaks off.
    let mut stream = UnixStream::connect(dir.path().join("m.sock")).unwrap();
    stream.write_all(b"POST /v1/stop HTTP/1.1\r\nHost: m\r\nContent-Length: 9\r\n\r\n{").unwrap();
    drop(stream);
    daemon.wait_for_log("the body broke off");
    assert!(daemon.end().success());

    let lines = lines(&dir.path().join("logbook"));
    let names: Vec<_> = lines.iter().map(|line| line["event"].as_str().unwrap()).collect();
    assert_eq!((names[0], names[names.len() - 1]), ("daemon-started", "daemon-ended"), "{names:?}");
    let of = |event: &str| lines.iter().position(|line| line["event"] == event).unwrap();
    assert!(of("connected") < of("queued") && of("queued") < of("began") && of("began") < of("ended"));
    assert_eq!(lines[of("ended")]["receipt"]["bursts"], receipt["bursts"]);
    let (pid, uid) = (std::process::id(), rustix::process::getuid().as_raw());
    assert_eq!(lines[of("ended")]["uid"], uid, "whose play it was");
    let mut commands = lines.iter().filter(|line| line["event"] == "command");
    for (command, answer) in [("arm", "ok"), ("play", "ok"), ("play", "not-found"), ("stop", "bad-request")] {
        let line = commands.next().unwrap();
        assert_eq!((&line["command"], &line["answer"]), (&json!(command), &json!(answer)), "{line}");
        assert_eq!((&line["pid"], &line["uid"]), (&json!(pid), &json!(uid)), "{line}");
    }
    let times: Vec<_> = lines.iter().map(|line| line["monotonic_ns"].as_u64().unwrap()).collect();
    assert!(times.is_sorted());
    assert!(!names.iter().any(|name| ["state", "late", "refused", "lost"].contains(name)), "{names:?}");

    let log = daemon.log();
    let plays: Vec<_> = log.lines().filter(|line| line.contains("edge-45")).collect();
    assert_eq!(plays.len(), 1, "{log}");
    assert!(plays[0].contains("INFO play 1 edge-45 by ") && plays[0].contains(": done, began "), "{log}");
    let armed = log.lines().filter(|line| line.contains("arm, assuming rest, by ")).collect::<Vec<_>>();
    assert!(armed.len() == 1 && armed[0].contains(&format!("pid {pid})")), "{log}");
}

/// An administrator may move it while the daemon runs.
#[test]
fn a_reload_moves_the_session_record() {
    let (dir, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    fs::create_dir(dir.path().join("patterns")).unwrap();
    // Without a terminal, SIGHUP means reload.
    let mut daemon = Recorded::start(dir.path(), "trap '' HUP;");
    daemon.armed();
    let file = dir.path().join("meissner.toml");
    let logbook = |state: &Path| format!("logbook_dir = {:?}", state.join("logbook"));
    let config = fs::read_to_string(&file).unwrap();
    fs::write(&file, config.replace(&logbook(dir.path()), &logbook(other.path()))).unwrap();
    kill_process(Pid::from_child(&daemon.child), Signal::HUP).unwrap();
    daemon.wait_for_log("`logbook_dir` and `logbook_days` at once");
    let _: Status = daemon.client().post("/v1/disarm", &json!({})).unwrap();
    assert!(daemon.end().success());
    let told = |state: &Path| -> Vec<String> {
        let told = |line: &Value| line["command"].as_str().or(line["event"].as_str()).unwrap().to_owned();
        lines(&state.join("logbook")).iter().map(told).collect()
    };
    assert_eq!(told(dir.path()), ["daemon-started", "connected", "arm"]);
    assert_eq!(told(other.path())[..2], ["reloaded", "disarm"]);
}
