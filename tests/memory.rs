use crate::harness::{Daemon, NOBODY, PATIENT, TIMEOUT, problem};
use meissner::daemon::MEMORY_BOUND;
use meissner_api::MAX_CLIENTS;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

/// The most memory that imports and plays may add to the daemon in these tests, kB: a tenth of the bound.
const SMALL_KB: usize = 64 << 10;

/// The most memory that the daemon has had, kB.
fn peak_kb(daemon: &Daemon) -> usize {
    let status: Value = daemon.client().get("/v1/status").unwrap();
    peak_of(&status["daemon"]["pid"])
}

fn peak_of(pid: &Value) -> usize {
    let process = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let peak = process.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    peak.trim().trim_end_matches(" kB").parse().unwrap()
}

/// A megabyte of keys with 60 dots each: half a million tables.
fn dotted(name: &str) -> String {
    let mut text = format!("format = 1\nname = \"{name}\"\nduration_s = 60.0\n[provenance]\n");
    for key in 0..8000 {
        let _ = writeln!(text, "k{key}{} = 1", ".a".repeat(60));
    }
    text
}

/// The most drives that a pattern may have, with every key.
fn longest(name: &str) -> String {
    let mut text = format!("format = 1\nname = \"{name}\"\nduration_s = 105.0\n");
    for number in 0..4096 {
        let (motor, start_s) = (number % 24, f64::from(number / 24) * 0.6);
        let _ = write!(
            text,
            "[[drive]]\nmotor = {motor}\nfrequency_hz = 60.125\namplitude_um = 10.125\nphase = 0.125\n\
             start_s = {start_s}\nstop_s = {}\n",
            start_s + 0.55
        );
    }
    text
}

fn files_that_would_fill_the_memory_are_refused_and_leave_nothing(daemon: &Daemon) {
    let before = peak_kb(daemon);
    thread::scope(|scope| {
        for number in 0..6 {
            let (name, mut client) = (format!("d{number}"), daemon.client());
            scope.spawn(move || {
                let refused = problem(client.put(&format!("/v1/patterns/{name}"), dotted(&name)));
                assert_eq!((refused.code.as_str(), refused.status), ("bad-pattern", 422));
                assert!(refused.detail.contains("more than 8192 tables"), "{}", refused.detail);
            });
        }
    });
    let added = peak_kb(daemon) - before;
    assert!(added < SMALL_KB, "{added} kB");
    assert_eq!(fs::read_dir(daemon.path("patterns")).unwrap().count(), 0);
}

fn a_full_queue_of_the_longest_pattern_takes_little_memory(daemon: &Daemon) {
    let mut client = daemon.armed();
    let before = peak_kb(daemon);
    let _: Value = client.put("/v1/patterns/longest", longest("longest")).unwrap();
    for _ in 0..17 {
        let _: Value = client.post("/v1/play", &json!({"pattern": "longest"})).unwrap();
    }
    let shown: Value = client.get("/v1/patterns/longest").unwrap();
    assert_eq!(shown["pattern"]["drive"].as_array().unwrap().len(), 4096);
    let _: Value = client.post("/v1/estop", &json!({})).unwrap();
    let added = peak_kb(daemon) - before;
    assert!(added < SMALL_KB, "{added} kB");
}

/// The daemon handles four imports at a time; the other bodies stay in their sockets.
fn the_bodies_of_64_clients_do_not_pile_up(daemon: &Daemon) {
    let status: Value = daemon.client().get("/v1/status").unwrap();
    let before = peak_of(&status["daemon"]["pid"]);
    let request = "PUT /v1/patterns/x HTTP/1.1\r\nhost: x\r\ncontent-length: 1048576\r\n\r\n";
    let request = format!("{request}{}", "#".repeat((1 << 20) - 1));
    let uploads: Vec<_> = (0..MAX_CLIENTS)
        .map(|_| {
            let stream = UnixStream::connect(daemon.socket()).unwrap();
            stream.set_nonblocking(true).unwrap();
            stream
        })
        .collect();
    let mut sent = vec![0; MAX_CLIENTS];
    let (mut idle_rounds, begun) = (0, Instant::now());
    let whole = |sent: &[usize]| sent.iter().filter(|&&sent| sent == request.len()).count();
    while idle_rounds < 50 || whole(&sent) < 4 && begun.elapsed() < TIMEOUT {
        idle_rounds += 1;
        for (mut stream, sent) in uploads.iter().zip(&mut sent) {
            if let Ok(more) = stream.write(&request.as_bytes()[*sent..])
                && more > 0
            {
                (*sent, idle_rounds) = (*sent + more, 0);
            }
        }
        thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(whole(&sent), 4, "{sent:?}");
    let added = peak_of(&status["daemon"]["pid"]) - before;
    assert!(added < SMALL_KB, "{added} kB");
}

/// The page and the unit must name the program's bound.
#[test]
fn the_page_and_the_unit_name_the_bound() {
    let read = |file: &str| fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
    let mib = MEMORY_BOUND >> 20;
    assert!(read("docs/safety.md").contains(&format!("at most {mib} MiB")));
    let unit = read("deploy/meissner.service");
    let most = unit.lines().find_map(|line| line.strip_prefix("MemoryMax=")).unwrap();
    let most: usize = most.strip_suffix('M').unwrap().parse().unwrap();
    assert!((mib..=2 * mib).contains(&most), "{most}");
}

#[test]
fn bodies_files_and_queues_do_not_fill_the_memory() {
    let daemon = Daemon::with("mock", &format!("{PATIENT}{NOBODY}"));
    files_that_would_fill_the_memory_are_refused_and_leave_nothing(&daemon);
    the_bodies_of_64_clients_do_not_pile_up(&daemon);
    a_full_queue_of_the_longest_pattern_takes_little_memory(&daemon);
}
