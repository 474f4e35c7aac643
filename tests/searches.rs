//! Targets and searches over the API: a search's process, its result, its end, and what is refused.

use crate::harness::{
    Daemon, PATIENT, PROGRAM, document, ended, meissner, next, printed, problem, refusal, wait_until,
};
use meissner_api::{
    Event, RemovedTarget, Search, SearchState, Status, StoredTarget, TargetDetails, TargetList, TokenCreated,
};
use meissner_array::pattern::Pattern;
use meissner_client::{Client, Events};
use meissner_design::Target;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;

const TEXT: &str = "name = \"my-edge\"\nshape = \"segment\"\npoints = [[-4, 0], [4, 0]]\n";

/// A search that runs until it is cancelled.
fn long() -> Value {
    json!({"target": "rotating-edge", "seconds": 600, "robust": true})
}

/// The event that ends a search.
fn over(events: &mut Events) -> (u64, SearchState, Option<String>) {
    next(events, |event| match event {
        Event::Search { id, state, problem, .. } if state != SearchState::Running => {
            Some((id, state, problem))
        }
        _ => None,
    })
}

/// Waits until a search has made evaluations.
fn works(events: &mut Events) {
    next(events, |event| match event {
        Event::Search { progress, .. } if progress.evaluations > 0 => Some(()),
        _ => None,
    });
}

/// The processes that a daemon has started and that have not ended.
pub(crate) fn children(daemon: &Daemon) -> Vec<i32> {
    let status: Status = daemon.client().get("/v1/status").unwrap();
    let threads = fs::read_dir(format!("/proc/{}/task", status.pid)).unwrap();
    let of =
        |thread: std::io::Result<fs::DirEntry>| fs::read_to_string(thread.unwrap().path().join("children"));
    let all: String = threads.filter_map(|thread| of(thread).ok()).collect();
    all.split_whitespace().map(|pid| pid.parse().unwrap()).filter(|&pid| runs(pid)).collect()
}

/// The fields of a process's `stat` from its state on; none if it has ended.
fn stat(pid: i32) -> Option<Vec<String>> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let fields: Vec<_> = stat.rsplit_once(')')?.1.split_whitespace().map(str::to_owned).collect();
    (fields[0] != "Z" && fields[0] != "X").then_some(fields)
}

fn runs(pid: i32) -> bool {
    stat(pid).is_some()
}

fn start(client: &mut Client, request: &Value) -> Search {
    client.post("/v1/searches", request).unwrap()
}

#[test]
fn a_search_finds_what_the_command_finds_and_it_plays() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    let mut events = client.events().unwrap();
    let request =
        json!({"target": "edge-45", "evaluations": 60, "model": "membrane", "objective": "contrast"});
    let begun = start(&mut client, &request);
    assert_eq!((begun.id, begun.state, &*begun.target), (1, SearchState::Running, "edge-45"));
    assert_eq!(over(&mut events), (1, SearchState::Done, None));
    let search: Search = client.get("/v1/searches/last").unwrap();
    let found = search.result.unwrap();
    let command = ["optimise", "edge-45", "--budget", "60", "--model", "membrane", "--objective", "contrast"];
    assert_eq!(found.pattern.trim_end(), printed(meissner().args(command)).trim_end());
    let told = document(meissner().args(command).arg("--json"));
    for (verdicts, told) in found.models.iter().zip(told["models"].as_array().unwrap()) {
        assert_eq!(verdicts.model, told["model"].as_str().unwrap());
        let rules = &told["baselines"];
        for (own, told) in
            [(verdicts.found, told), (verdicts.naive_reach, &rules[0]), (verdicts.naive_pitch, &rules[1])]
        {
            assert_eq!(
                json!([own.on, own.off, own.contrast]),
                json!([told["on_hz"], told["off_hz"], told["cost_hz"]])
            );
        }
    }
    let response = &found.response;
    for rates in [&response.found, &response.naive_reach, &response.naive_pitch, &response.on] {
        assert_eq!((rates.len(), response.places_mm.len()), (306, 306));
    }
    let mean = |wanted: f64| {
        let of = response.on.iter().zip(&response.found).filter(|(on, _)| **on == wanted).map(|(_, hz)| *hz);
        let rates: Vec<f64> = of.collect();
        rates.iter().sum::<f64>() / rates.len() as f64
    };
    assert!((mean(1.0) - mean(0.0) - found.models[0].found.contrast).abs() < 1e-9);
    assert_eq!(found.outline, [[[-4.242640687119285; 2], [4.242640687119285; 2]]]);
    // The pattern is not stored, but can be played.
    let shown: Value = client.get("/v1/patterns/search:1").unwrap();
    assert_eq!(
        (&shown["sha256"], &shown["pattern"]["name"]),
        (&found.sha256.clone().into(), &"edge-45".into())
    );
    let play = json!({"pattern": "search:1", "seconds": 0.2, "pattern_sha256": found.sha256});
    let _: Value = client.post("/v1/play", &play).unwrap();
    let receipt = ended(&mut events);
    assert_eq!((&*receipt.pattern, &receipt.pattern_sha256), ("edge-45", &found.sha256));
    assert_eq!(receipt.bursts.unwrap().planned, receipt.bursts.unwrap().played);
    let other = json!({"pattern": "search:1", "seconds": 0.2, "pattern_sha256": "0".repeat(64)});
    assert_eq!(refusal(client.post("/v1/play", &other)), ("not-found".into(), 404));
    assert_eq!(refusal(client.post("/v1/play", &json!({"pattern": "search:2"}))), ("not-found".into(), 404));
    assert_eq!(
        refusal(client.post("/v1/play", &json!({"pattern": "search:x"}))),
        ("bad-request".into(), 400)
    );
}

#[test]
fn a_drawn_target_is_found_and_stored_with_its_pattern() {
    let daemon = Daemon::start();
    let mut client = daemon.client();
    let mut events = client.events().unwrap();
    let drawn = json!({"name": "my-edge", "shape": "segment", "points": [[-4, 0], [4, 0]]});
    start(&mut client, &json!({"target": drawn, "evaluations": 20, "model": "membrane"}));
    assert_eq!(over(&mut events).1, SearchState::Done);
    let search: Search = client.get("/v1/searches/1").unwrap();
    let found = search.result.unwrap();
    let _: Value = client.put("/v1/patterns/my-edge", found.pattern.clone()).unwrap();
    let stored: StoredTarget = client.put("/v1/targets/my-edge", TEXT.to_owned()).unwrap();
    assert_eq!((&*stored.name, stored.replaced_sha256), ("my-edge", None));
    // The pattern knows the target that it was made for.
    let text = fs::read_to_string(daemon.path("patterns/my-edge.toml")).unwrap();
    let pattern = Pattern::parse(&text, "p").unwrap();
    let target =
        Target::read(&fs::read_to_string(daemon.path("patterns/targets/my-edge.toml")).unwrap(), "t")
            .unwrap();
    assert_eq!(Target::made_for(&pattern).as_ref(), Some(&target));
    let details: TargetDetails = client.get("/v1/targets/my-edge").unwrap();
    assert_eq!((details.target, details.outline), (found.definition, found.outline));
    let list: TargetList = client.get("/v1/targets").unwrap();
    let names: Vec<_> = list.targets.iter().map(|target| (&*target.name, target.library)).collect();
    assert!(
        names.contains(&("my-edge", false)) && names.contains(&("edge-45", true)) && list.errors.is_empty()
    );
    // The search by the target's name gives the same result.
    start(&mut client, &json!({"target": "my-edge", "evaluations": 20, "model": "membrane"}));
    assert_eq!(over(&mut events).1, SearchState::Done);
    let again: Search = client.get("/v1/searches/2").unwrap();
    assert_eq!(again.result.unwrap().pattern, found.pattern);
    let removed: RemovedTarget = client.delete("/v1/targets/my-edge").unwrap();
    assert_eq!(removed.sha256, stored.sha256);
    assert_eq!(refusal(client.get("/v1/targets/my-edge")), ("not-found".into(), 404));
    let _: Value = client.delete("/v1/patterns/my-edge").unwrap();
}

#[test]
fn one_search_runs_at_a_time_and_is_cancelled_at_once() {
    let daemon = Daemon::start();
    let mut client = daemon.client();
    let mut events = client.events().unwrap();
    assert_eq!(refusal(client.get("/v1/searches/last")), ("not-found".into(), 404));
    start(&mut client, &long());
    works(&mut events);
    let busy = problem(client.post("/v1/searches", &long()));
    assert_eq!((&*busy.code, busy.status), ("search-running", 409));
    assert!(busy.detail.contains("search 1 for `rotating-edge` runs"), "{busy}");
    assert_eq!(refusal(client.get("/v1/patterns/search:1")), ("not-found".into(), 404));
    let [process] = children(&daemon)[..] else { panic!("{:?}", children(&daemon)) };
    // The process has low priority, bounded memory that is not locked, and none of the daemon's files.
    let niceness = |pid: i32| stat(pid).unwrap()[16].parse::<i32>().unwrap();
    assert!(niceness(process) >= 10);
    let limits = fs::read_to_string(format!("/proc/{process}/limits")).unwrap();
    let data = limits.lines().find(|line| line.starts_with("Max data size")).unwrap();
    assert!(data.contains(&meissner::search::MEMORY.to_string()), "{data}");
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    assert!(status.lines().any(|line| line.split_whitespace().eq(["VmLck:", "0", "kB"])), "{status}");
    let files: Vec<_> =
        fs::read_dir(format!("/proc/{process}/fd")).unwrap().map(|file| file.unwrap().file_name()).collect();
    assert_eq!(files, ["0", "1", "2"]);
    let cancelled: Search = client.delete("/v1/searches/1").unwrap();
    assert_eq!((cancelled.state, cancelled.result), (SearchState::Cancelled, None));
    assert_eq!(over(&mut events), (1, SearchState::Cancelled, None));
    wait_until(|| !runs(process));
    // The place is free again, and an ended search does not change.
    start(&mut client, &json!({"target": "dot", "evaluations": 5, "model": "membrane"}));
    assert_eq!(over(&mut events), (2, SearchState::Done, None));
    let done: Search = client.delete("/v1/searches/last").unwrap();
    assert_eq!((done.id, done.state, done.result.is_some()), (2, SearchState::Done, true));
    wait_until(|| children(&daemon).is_empty());
}

#[test]
fn a_search_whose_process_ends_has_failed() {
    let daemon = Daemon::start();
    let mut client = daemon.client();
    let mut events = client.events().unwrap();
    start(&mut client, &long());
    works(&mut events);
    kill_process(Pid::from_raw(children(&daemon)[0]).unwrap(), Signal::KILL).unwrap();
    let (id, state, problem) = over(&mut events);
    assert_eq!((id, state), (1, SearchState::Failed));
    let problem = problem.unwrap();
    assert!(problem.contains("ended without a result") && problem.contains("256 MiB"), "{problem}");
    let failed: Search = client.get("/v1/searches/1").unwrap();
    assert_eq!((failed.state, failed.problem, failed.result), (SearchState::Failed, Some(problem), None));
}

#[test]
fn a_search_ends_with_its_daemon() {
    for signal in [Signal::TERM, Signal::KILL] {
        let mut daemon = Daemon::start();
        let mut client = daemon.client();
        let mut events = client.events().unwrap();
        start(&mut client, &long());
        works(&mut events);
        let process = children(&daemon)[0];
        daemon.signal(signal);
        daemon.wait();
        wait_until(|| !runs(process));
    }
}

#[test]
fn an_emergency_stop_works_while_a_search_runs() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    let mut events = client.events().unwrap();
    start(&mut client, &long());
    works(&mut events);
    let _: Value = client.post("/v1/play", &json!({"pattern": "edge-45", "seconds": 60})).unwrap();
    let stopped: Status = client.post("/v1/estop", &json!({})).unwrap();
    assert_eq!((&*stopped.state, &*stopped.cause), ("faulted", "estop"));
    // The search goes on: it has nothing to do with the motors.
    let search: Search = client.get("/v1/searches/last").unwrap();
    assert_eq!(search.state, SearchState::Running);
    let _: Search = client.delete("/v1/searches/last").unwrap();
}

#[test]
fn what_is_no_target_is_refused_in_one_line() {
    let daemon = Daemon::start();
    let mut client = daemon.client();
    let mut ask = |target: Value| problem(client.post("/v1/searches", &json!({"target": target})));
    let unknown = ask(json!("egde-45"));
    assert_eq!((&*unknown.code, unknown.status), ("not-found", 404));
    assert!(unknown.detail.contains("no target is called `egde-45`: did you mean `edge-45`?"), "{unknown}");
    for name in ["../edge-45", "/etc/passwd", "", "a\nb"] {
        assert_eq!(ask(json!(name)).code, "not-found");
    }
    for (target, says) in [
        (
            json!({"name": "a", "shape": "segment", "points": [[0, 0], [20, 0]]}),
            "`points[1]` is at [20, 0] mm: must be on the pad",
        ),
        (
            json!({"name": "a", "shape": "segment", "points": [[0, 0]]}),
            "`points` is a list of 1: must be the 2 ends of a segment",
        ),
        (
            json!({"name": "../a", "shape": "dots", "points": [[0, 0]]}),
            "`name` is `../a`: must be 1 to 64 of a-z, 0-9 and -",
        ),
        (
            json!({"name": "a", "shape": "dots", "points": [[0, 0]], "ponts": 1}),
            "unknown key `ponts`: did you mean `points`?",
        ),
        (
            json!({"name": "a", "shape": "dots", "points": [[8, 0]], "reach_mm": 0}),
            "none of the 306 afferents is within reach",
        ),
        (json!({}), "`name` is missing"),
    ] {
        let refused = ask(target);
        assert_eq!((&*refused.code, refused.status), ("bad-target", 422), "{refused}");
        assert!(refused.detail.contains(says), "{refused}");
    }
    assert_eq!(ask(json!(7)).code, "bad-request");
    let mut client = daemon.client();
    for (name, text, code) in [
        ("edge-45", TEXT, "exists"),
        ("other", TEXT, "bad-target"),
        ("my-edge", "nane = 1", "bad-target"),
        ("..%2Fmy-edge", TEXT, "bad-target"),
    ] {
        assert_eq!(problem(client.put(&format!("/v1/targets/{name}"), text.to_owned())).code, code, "{name}");
    }
    let large = format!("{TEXT}# {}", "x".repeat(64 << 10));
    assert_eq!(refusal(client.put("/v1/targets/my-edge", large)), ("too-large".into(), 413));
    assert_eq!(refusal(client.delete("/v1/targets/edge-45")), ("exists".into(), 409));
    assert_eq!(refusal(client.delete("/v1/targets/..%2F..%2Fm.sock")), ("not-found".into(), 404));
    assert!(!daemon.path("patterns/targets").exists());
}

#[test]
fn a_full_disk_keeps_the_stored_target() {
    let daemon = Daemon::start();
    let mut client = daemon.client();
    let stored: StoredTarget = client.put("/v1/targets/my-edge", TEXT.to_owned()).unwrap();
    daemon.limit_files(Some(0));
    let full = problem(client.put("/v1/targets/my-edge?replace=true", format!("# new\n{TEXT}")));
    assert_eq!((&*full.code, full.status), ("store", 500));
    assert!(full.detail.contains("check that it exists, that the disk has space"), "{full}");
    daemon.limit_files(None);
    let kept: TargetDetails = client.get("/v1/targets/my-edge").unwrap();
    assert_eq!(kept.sha256, stored.sha256);
    assert_eq!(
        fs::read_dir(daemon.path("patterns/targets")).unwrap().count(),
        1,
        "no temporary file is left"
    );
}

#[test]
fn observers_read_and_operators_search() {
    let daemon =
        Daemon::with("mock", &format!("{PATIENT}listen = \"127.0.0.1:0\"\nlisten_token = \"always\"\n"));
    let status: Status = daemon.client().get("/v1/status").unwrap();
    let address = status.network.unwrap().address;
    let token = |role: &str| -> TokenCreated {
        daemon.client().post("/v1/tokens", &json!({"role": role, "name": "a test"})).unwrap()
    };
    let tokens = [None, Some(token("observe").token), Some(token("operate").token)];
    let ask = |line: &str, body: &str, token: Option<&String>| -> u16 {
        let mut stream = TcpStream::connect(&address).unwrap();
        let bearer = token.map_or_else(String::new, |token| format!("authorization: Bearer {token}\r\n"));
        let length = body.len();
        let head = format!(
            "{line} HTTP/1.1\r\nhost: {address}\r\n{bearer}content-length: {length}\r\nconnection: close\r\n\r\n"
        );
        stream.write_all((head + body).as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer[9..12].parse().unwrap()
    };
    let search = json!({"target": "dot", "evaluations": 5, "model": "membrane"}).to_string();
    for (line, body, statuses) in [
        ("GET /v1/targets", "", [401, 200, 200]),
        ("GET /v1/targets/edge-45", "", [401, 200, 200]),
        ("PUT /v1/targets/my-edge", TEXT, [401, 403, 201]),
        ("DELETE /v1/targets/my-edge", "", [401, 403, 200]),
        ("POST /v1/searches", &search, [401, 403, 202]),
        ("GET /v1/searches/last", "", [401, 200, 200]),
        ("DELETE /v1/searches/last", "", [401, 403, 200]),
    ] {
        let answers: Vec<u16> = tokens.iter().map(|token| ask(line, body, token.as_ref())).collect();
        assert_eq!(answers, statuses, "{line}");
    }
}

/// During an exclusive session only its owner may search or store.
#[test]
fn an_exclusive_session_keeps_others_from_searching() {
    let daemon = Daemon::start();
    let mut client = daemon.client();
    let started: Value =
        client.post("/v1/sessions", &json!({"participant": "P07", "exclusive": true})).unwrap();
    let request = json!({"target": "dot", "evaluations": 5, "model": "membrane"});
    assert_eq!(refusal(client.post("/v1/searches", &request)), ("session-exclusive".into(), 409));
    assert_eq!(
        refusal(client.put("/v1/targets/my-edge", TEXT.to_owned())),
        ("session-exclusive".into(), 409)
    );
    assert_eq!(refusal(client.delete("/v1/targets/my-edge")), ("session-exclusive".into(), 409));
    client.set_token(started["token"].as_str().map(str::to_owned));
    let mut events = client.events().unwrap();
    start(&mut client, &request);
    assert_eq!(over(&mut events).1, SearchState::Done);
}

/// The program, started under the name of a search but without a daemon, does nothing.
#[test]
fn a_search_without_a_daemon_ends() {
    use std::os::unix::process::CommandExt;
    let mut command = std::process::Command::new(PROGRAM);
    let output = command.arg0("meissner-search").stdin(std::process::Stdio::null()).output().unwrap();
    assert!(!output.status.success() && output.stdout.is_empty() && output.stderr.is_empty());
}
