//! How long an emergency stop takes while other clients load the daemon: `cargo bench -p meissner-benches --bench estop`.
//!
//! For each load it orders emergency stops, one after the other: on the socket for these, and every tenth also as `POST
//! /v1/estop` on a new connection. It prints the time from before `connect` until the board, at the far end of a serial line, has read the
//! order, and how many orders failed, which the times leave out: no order at the board within a second, or no answer within ten.
//!
//! The daemon and the load are processes of their own. The daemon is this executable, or the program that `MEISSNER_PROGRAM` names (an older one has no
//! socket for emergency stops: that column stays empty, and all orders go by HTTP). `ROUNDS` sets the orders per load, `LOADS` the loads by their
//! first word. The client that measures and the board run in real time where the system allows it. It asserts nothing.

use meissner_api::Status;
use meissner_benches::board::Board;
use meissner_client::{Client, Endpoint, STOPPED, estop_socket};
use meissner_stream::device::priority;
use serde_json::json;
use std::collections::VecDeque;
use std::error::Error;
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Set for the child that is the daemon, or another command.
const CHILD: &str = "MEISSNER_BENCH_CHILD";
/// Set for the child that makes this load.
const LOAD: &str = "MEISSNER_BENCH_LOAD";
const TOLD_WITHIN: Duration = Duration::from_secs(1);
const ANSWER_WITHIN: Duration = Duration::from_secs(10);

fn main() -> ExitCode {
    if std::env::var_os(CHILD).is_some() {
        return meissner::cli::main();
    }
    let done = match std::env::var(LOAD) {
        Ok(number) => make_load(&number),
        Err(_) => run(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// A load: it runs until its process is killed, or until the flag is set.
type Load = fn(&Place, &AtomicBool);

const LOADS: [(&str, Load); 11] = [
    ("idle", |_, _| {}),
    ("held: 64 idle clients, and 360 connections/s", held),
    ("connects: connections closed at once, without a pause", connects),
    ("patterns1: a client that pipelines GET rotating-edge", |place, over| pipeline(place, over, 1, PATTERN)),
    ("patterns8: eight of them", |place, over| pipeline(place, over, 8, PATTERN)),
    ("status8: eight that pipeline GET status", |place, over| pipeline(place, over, 8, STATUS)),
    ("bodies60: sixty that send commands of 16 kB", bodies),
    ("streams64: 64 event streams that are not read, and plays", streams),
    ("uploads: six that send patterns of 0.9 MB", uploads),
    ("fuzz: eight that send random bytes and half requests", fuzz),
    ("shells: 300 shells that loop `meissner status`", shells),
];

const PATTERN: &str = "GET /v1/patterns/rotating-edge HTTP/1.1\r\nhost: x\r\n\r\n";
const STATUS: &str = "GET /v1/status HTTP/1.1\r\nhost: x\r\n\r\n";

/// Where the daemon listens, and its program.
struct Place {
    socket: PathBuf,
    program: PathBuf,
}

/// Runs the load of this number until stdin is closed.
fn make_load(number: &str) -> Result<(), Box<dyn Error>> {
    let (_, load) = LOADS.get(number.parse::<usize>()?).ok_or("there is no such load")?;
    let socket = std::env::var_os("MEISSNER_SOCKET").ok_or("no MEISSNER_SOCKET")?.into();
    let place = Place { socket, program: program()? };
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| load(&place, &over));
        let _ = io::stdin().read(&mut [0; 1]);
        over.store(true, Ordering::Relaxed);
    });
    Ok(())
}

fn program() -> io::Result<PathBuf> {
    std::env::var_os("MEISSNER_PROGRAM").map_or_else(std::env::current_exe, |it| Ok(it.into()))
}

impl Place {
    fn command(&self) -> Command {
        let mut command = Command::new(&self.program);
        command.env(CHILD, "1").env("MEISSNER_SOCKET", &self.socket).env_remove("RUST_LOG");
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let rounds = std::env::var("ROUNDS").ok().map_or(Ok(10_000), |rounds| rounds.parse())?;
    let wanted = std::env::var("LOADS").unwrap_or_default();
    let program =
        std::env::var_os("MEISSNER_PROGRAM").map_or_else(std::env::current_exe, |it| Ok(it.into()))?;
    let dir = tempfile::tempdir()?;
    let place = Place { socket: dir.path().join("m.sock"), program };
    let board = Board::start()?;
    let config = dir.path().join("meissner.toml");
    std::fs::write(&config, format!("patterns_dir = {:?}\nlease_ms = 5000\n", dir.path()))?;
    let mut command = place.command();
    command
        .args([
            "daemon",
            "--no-record",
            "--device",
            &format!("serial:{}", board.path().display()),
            "--config",
        ])
        .arg(&config);
    let daemon = Process(command.spawn()?);
    wait_for_device(&place.socket)?;
    println!("{rounds} emergency stops per load; ms from the order to the board");
    println!("{:<58} {:^35}  {:^35}", "", "socket for emergency stops", "POST /v1/estop, new connection");
    let columns = format!("{:>7} {:>7} {:>8} {:>10}", "p50", "p99", "max", "failures");
    println!("{:<58} {columns}  {columns}", "load");
    let first = |name: &str| name.split([':', ' ']).next().unwrap_or_default().to_owned();
    for (number, (name, _)) in LOADS.into_iter().enumerate() {
        if !wanted.is_empty() && !wanted.split([',', ' ']).any(|word| word == first(name)) {
            continue;
        }
        let mut load = Command::new(std::env::current_exe()?);
        load.env(LOAD, number.to_string()).env("MEISSNER_SOCKET", &place.socket).stdin(Stdio::piped());
        let load = Process(load.spawn()?);
        // The load needs a moment to build up.
        thread::sleep(Duration::from_secs(if number == 0 { 0 } else { 2 }));
        let columns = thread::scope(|scope| scope.spawn(|| measure(&place, &board, rounds)).join());
        drop(load);
        let [socket, http] = columns.map_err(|_| "the measuring thread panicked")?;
        println!("{name:<58} {socket}  {http}");
        wait_for_device(&place.socket)?;
    }
    drop(daemon);
    Ok(())
}

struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        // A load ends when its stdin is closed, and then ends its own children.
        if self.0.stdin.take().is_none() {
            let _ = self.0.kill();
        }
        let _ = self.0.wait();
    }
}

fn wait_for_device(socket: &Path) -> Result<(), Box<dyn Error>> {
    let until = Instant::now() + Duration::from_secs(60);
    loop {
        let status = Client::at(Endpoint::at(socket))?.get::<Status>("/v1/status");
        match status {
            Ok(status) if status.is_connected() => return Ok(()),
            _ if Instant::now() > until => return Err("the daemon has no device after 60 s".into()),
            _ => thread::sleep(Duration::from_millis(50)),
        }
    }
}

/// Both columns of a load.
fn measure(place: &Place, board: &Board, rounds: usize) -> [String; 2] {
    let _ = priority::fifo(priority::BELOW_STREAMER);
    let has_socket = estop_socket(&place.socket).exists();
    let mut columns = [Vec::new(), Vec::new()];
    let mut failures = [0; 2];
    for round in 0..rounds {
        for way in 0..2 {
            // The answer by HTTP takes as long as the load makes other clients wait.
            if (way == 0 && !has_socket) || (way == 1 && has_socket && round % 10 != 0) {
                continue;
            }
            while board.estops().try_recv().is_ok() {}
            let begun = Instant::now();
            let answered = if way == 0 { by_socket(place) } else { by_http(place) };
            // The device is told before the client has its answer.
            match board.estops().recv_timeout(TOLD_WITHIN) {
                Ok((_, told)) if answered => columns[way].push((told - begun).as_secs_f64() * 1e3),
                _ => failures[way] += 1,
            }
        }
    }
    let mut ways = columns.into_iter().zip(failures);
    std::array::from_fn(|_| ways.next().map_or_else(String::new, |(ms, failures)| column(ms, failures)))
}

fn column(mut ms: Vec<f64>, failures: usize) -> String {
    if ms.is_empty() {
        return format!("{:>7} {:>7} {:>8} {failures:>10}", "", "", "");
    }
    ms.sort_by(f64::total_cmp);
    let at = |per_mille: usize| ms[(ms.len() * per_mille / 1000).min(ms.len() - 1)];
    format!("{:>7.2} {:>7.2} {:>8.2} {failures:>10}", at(500), at(990), at(1000))
}

fn by_socket(place: &Place) -> bool {
    exchange(&estop_socket(&place.socket), b"!").is_ok_and(|answer| answer.trim_end() == STOPPED)
}

fn by_http(place: &Place) -> bool {
    let request = b"POST /v1/estop HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: 0\r\n\r\n";
    exchange(&place.socket, request).is_ok_and(|answer| answer.starts_with("HTTP/1.1 200"))
}

fn exchange(socket: &Path, request: &[u8]) -> io::Result<String> {
    let mut stream = UnixStream::connect(socket)?;
    stream.set_read_timeout(Some(ANSWER_WITHIN))?;
    stream.write_all(request)?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    Ok(answer)
}

/// Repeats a step until the load is over; a step that fails waits a moment.
fn repeat(over: &AtomicBool, mut step: impl FnMut() -> io::Result<()>) {
    while !over.load(Ordering::Relaxed) {
        if step().is_err() {
            thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Runs a load on so many threads.
fn threads(count: usize, over: &AtomicBool, step: impl Fn(usize) -> io::Result<()> + Sync) {
    thread::scope(|scope| {
        for number in 0..count {
            let step = &step;
            scope.spawn(move || repeat(over, || step(number)));
        }
    });
}

fn held(place: &Place, over: &AtomicBool) {
    let mut clients: Vec<_> = (0..64).filter_map(|_| UnixStream::connect(&place.socket).ok()).collect();
    for client in &mut clients {
        let _ = client.write_all(STATUS.as_bytes());
    }
    // Each stays for a quarter of a second.
    let mut silent = VecDeque::new();
    repeat(over, || {
        silent.push_back(UnixStream::connect(&place.socket)?);
        if silent.len() > 90 {
            silent.pop_front();
        }
        thread::sleep(Duration::from_micros(2700));
        Ok(())
    });
}

fn connects(place: &Place, over: &AtomicBool) {
    repeat(over, || UnixStream::connect(&place.socket).map(drop));
}

/// A thread writes requests without a pause, another one reads the answers.
fn pipeline(place: &Place, over: &AtomicBool, clients: usize, request: &str) {
    threads(clients, over, |_| {
        let mut stream = UnixStream::connect(&place.socket)?;
        stream.set_write_timeout(Some(Duration::from_secs(1)))?;
        let mut reader = stream.try_clone()?;
        let requests = request.repeat(50);
        thread::scope(|scope| {
            scope.spawn(move || {
                let mut bytes = vec![0; 1 << 16];
                while matches!(reader.read(&mut bytes), Ok(1..)) {}
            });
            while !over.load(Ordering::Relaxed) && stream.write_all(requests.as_bytes()).is_ok() {}
            // Ends the reader, too.
            stream.shutdown(std::net::Shutdown::Both)
        })
    });
}

fn post(path: &str, method: &str, body: &str) -> String {
    format!("{method} {path} HTTP/1.1\r\nhost: x\r\ncontent-length: {}\r\n\r\n{body}", body.len())
}

fn bodies(place: &Place, over: &AtomicBool) {
    let request = post("/v1/play", "POST", &json!({"pattern": "x".repeat(15_000)}).to_string());
    threads(60, over, |_| {
        let mut stream = UnixStream::connect(&place.socket)?;
        stream.set_read_timeout(Some(Duration::from_secs(1)))?;
        let mut bytes = vec![0; 1 << 16];
        while !over.load(Ordering::Relaxed) {
            stream.write_all(request.as_bytes())?;
            if stream.read(&mut bytes)? == 0 {
                break;
            }
        }
        Ok(())
    });
}

fn streams(place: &Place, over: &AtomicBool) {
    let mut unread = Vec::new();
    for _ in 0..64 {
        let Ok(mut stream) = UnixStream::connect(&place.socket) else { continue };
        let _ = stream.write_all(b"GET /v1/events HTTP/1.1\r\nhost: x\r\n\r\n");
        unread.push(stream);
    }
    let body = json!({"pattern": "edge-45-paper", "seconds": 0.02}).to_string();
    let plays = [post("/v1/arm", "POST", r#"{"assume_rest":true}"#), post("/v1/play", "POST", &body)];
    repeat(over, || {
        for request in &plays {
            exchange(&place.socket, request.replace("\r\nhost", "\r\nconnection: close\r\nhost").as_bytes())?;
        }
        Ok(())
    });
}

fn uploads(place: &Place, over: &AtomicBool) {
    let drives: String = (0..)
        .map(|at| {
            let start = f64::from(at) * 0.1;
            let stop = start + 0.1;
            format!("[[drive]]\nmotor = 3\nfrequency_hz = 60.0\namplitude_um = 80.0\nphase = 0.0\nstart_s = {start:.1}\nstop_s = {stop:.1}\n")
        })
        .take(9000)
        .collect();
    threads(6, over, |number| {
        let name = format!("load-{number}");
        let text = format!("format = 1\nname = \"{name}\"\nduration_s = 1000.0\n{drives}");
        let request = post(&format!("/v1/patterns/{name}"), "PUT", &text);
        exchange(&place.socket, request.replace("\r\nhost", "\r\nconnection: close\r\nhost").as_bytes())
            .map(drop)
    });
}

fn fuzz(place: &Place, over: &AtomicBool) {
    threads(8, over, |number| {
        // A fixed sequence per thread: mostly requests that are cut, some that are changed, some bytes without sense.
        let mut random = number as u64 + 1;
        let mut next = |below: usize| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) as usize % below
        };
        for _ in 0..1000 {
            if over.load(Ordering::Relaxed) {
                break;
            }
            let mut bytes = match next(4) {
                0 => PATTERN.repeat(1 + next(20)).into_bytes(),
                1 => post("/v1/play", "POST", &json!({"pattern": "x".repeat(next(2000))}).to_string())
                    .into_bytes(),
                2 => post("/v1/arm", "POST", "{}").into_bytes(),
                _ => (0..next(2000)).map(|_| next(256) as u8).collect(),
            };
            for _ in 0..next(4) {
                let at = next(bytes.len().max(1));
                if let Some(byte) = bytes.get_mut(at) {
                    *byte = next(256) as u8;
                }
            }
            bytes.truncate(1 + next(bytes.len().max(1)));
            let mut stream = UnixStream::connect(&place.socket)?;
            stream.set_write_timeout(Some(Duration::from_millis(10)))?;
            let _ = stream.write_all(&bytes);
            if next(2) == 0 {
                let _ = stream.shutdown(std::net::Shutdown::Write);
            }
        }
        Ok(())
    });
}

fn shells(place: &Place, over: &AtomicBool) {
    let mut shells: Vec<Child> = (0..300)
        .filter_map(|_| {
            let mut shell = Command::new("sh");
            shell.args(["-c", "while :; do \"$0\" status; done"]).arg(&place.program);
            shell.env(CHILD, "1").env("MEISSNER_SOCKET", &place.socket);
            shell.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().ok()
        })
        .collect();
    while !over.load(Ordering::Relaxed) {
        thread::sleep(Duration::from_millis(10));
    }
    for shell in &mut shells {
        let _ = shell.kill();
        let _ = shell.wait();
    }
}
