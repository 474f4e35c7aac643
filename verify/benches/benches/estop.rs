//! How long an emergency stop takes while other clients load the daemon, and how long `stop` and `status` take:
//! `cargo bench -p meissner-benches --bench estop`.
//!
//! For each load it orders emergency stops, one after the other, on the e-stop socket. Every tenth time it also sends
//! `POST /v1/estop` on a new connection, to the API's socket and to the TCP port for emergency stops. It measures the time from before `connect` until the
//! board, at the far end of a serial line, has read the order. Every tenth time it also sends `POST /v1/stop` and `GET /v1/status`
//! on new connections, and measures the time until the whole answer is there. Times leave out failed orders: the board got none
//! within a second, no answer came within ten, or the daemon answered that it has no free connection.
//!
//! Run by root, it prints two tables: for a daemon with SCHED_FIFO, and for one of an ordinary user (`DAEMON_UID`, 65534 unless
//! set) without. The daemon and the load run in separate processes. The daemon is this executable, or the program that
//! `MEISSNER_PROGRAM` names. `ROUNDS` sets the orders per load, `LOADS` chooses loads by their first word, `RECORD_MB` the length
//! of the session record that the readers read. The measuring client and the board run at real-time priority where the system
//! allows it. So do the kernel's workers that move the bytes of the board's pseudo-terminal ([`Workers`]), unless `KEEP_WORKERS` is
//! set. It asserts nothing.

use meissner_api::Status;
use meissner_benches::board::Board;
use meissner_benches::loads::{CHILD, LOADS, Place, exchange, exchange_tcp};
use meissner_benches::workers::Workers;
use meissner_client::{Client, Endpoint, STOPPED, estop_socket};
use meissner_stream::device::priority;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::error::Error;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener};
use std::os::unix::fs::chown;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Set for the child that makes this load.
const LOAD: &str = "MEISSNER_BENCH_LOAD";
const TOLD_WITHIN: Duration = Duration::from_secs(1);
/// Orders that take longer are written to stderr, as are those that fail.
const SLOW: Duration = Duration::from_millis(100);

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

/// Runs the load of this number until stdin is closed.
fn make_load(number: &str) -> Result<(), Box<dyn Error>> {
    let (_, load) = LOADS.get(number.parse::<usize>()?).ok_or("there is no such load")?;
    let socket = std::env::var_os("MEISSNER_SOCKET").ok_or("no MEISSNER_SOCKET")?.into();
    let tcp = std::env::var("MEISSNER_BENCH_TCP")?.parse()?;
    let place = Place { socket, tcp, program: program()? };
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

/// A number from the environment.
fn number(key: &str, usual: usize) -> Result<usize, Box<dyn Error>> {
    Ok(std::env::var(key).ok().map_or(Ok(usual), |number| number.parse())?)
}

fn run() -> Result<(), Box<dyn Error>> {
    let user = u32::try_from(number("DAEMON_UID", 65534)?)?;
    let workers = if std::env::var_os("KEEP_WORKERS").is_none() { Workers::raise() } else { None };
    println!(
        "the kernel's workers of the pseudo-terminal have {} priority",
        if workers.is_some() { "real-time" } else { "ordinary" }
    );
    if rustix::process::geteuid().is_root() {
        table(None)?;
        table(Some(user))
    } else {
        table(None)
    }
}

/// Measures all loads on a daemon of this user.
fn table(user: Option<u32>) -> Result<(), Box<dyn Error>> {
    let (rounds, wanted) = (number("ROUNDS", 10_000)?, std::env::var("LOADS").unwrap_or_default());
    let dir = tempfile::tempdir()?;
    // The daemon takes the port that this finds free.
    let tcp = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
    let place = Place { socket: dir.path().join("m.sock"), tcp, program: program()? };
    let board = Board::start()?;
    let record = dir.path().join("logbook");
    let old = record.join("sessions").join("20260101T000000Z-000000.jsonl");
    std::fs::create_dir_all(record.join("sessions"))?;
    write_record(&old, number("RECORD_MB", 286)?)?;
    let config = dir.path().join("meissner.toml");
    let text = format!(
        "patterns_dir = {:?}\nlogbook_dir = {record:?}\nlease_ms = 5000\nlisten = \"{tcp}\"\n",
        dir.path()
    );
    std::fs::write(&config, text + "[participant]\nmax_continuous_s = 86400\nmax_day_s = 86400\n")?;
    let mut command = place.command();
    command
        .args(["daemon", "--device", &format!("serial:{}", board.path().display()), "--config"])
        .arg(&config);
    let rtprio = getrlimit(Resource::Rtprio);
    if let Some(user) = user {
        for path in [dir.path(), &record, &record.join("sessions"), &old, board.path()] {
            chown(path, Some(user), Some(user))?;
        }
        command.uid(user).gid(user);
        setrlimit(Resource::Rtprio, Rlimit { current: Some(0), ..rtprio })?;
    }
    let daemon = command.spawn();
    setrlimit(Resource::Rtprio, rtprio)?;
    let daemon = Process(daemon?);
    let status = wait_for_device(&place.socket)?;
    let fifo = if status.daemon.realtime.fifo { "with" } else { "without" };
    let who = user.map_or_else(|| "this user".to_owned(), |user| format!("uid {user}"));
    println!(
        "daemon of {who}, {fifo} SCHED_FIFO; {rounds} orders on the socket per load, a tenth of that in the other columns"
    );
    println!("p50 / p99 / max in ms, and how many failed\n");
    println!(
        "| load | `SOCKET.estop` | `POST /v1/estop`, socket | `POST /v1/estop`, TCP | `stop` | `status` |"
    );
    println!("|---|---|---|---|---|---|");
    let first = |name: &str| name.split([':', ' ']).next().unwrap_or_default().to_owned();
    for (number, (name, _)) in LOADS.into_iter().enumerate() {
        if !wanted.is_empty() && !wanted.split([',', ' ']).any(|word| word == first(name)) {
            continue;
        }
        let mut load = Command::new(std::env::current_exe()?);
        load.env(LOAD, number.to_string()).env("MEISSNER_SOCKET", &place.socket);
        load.env("MEISSNER_BENCH_TCP", tcp.to_string()).stdin(Stdio::piped()).stdout(Stdio::null());
        let load = Process(load.spawn()?);
        // The load needs a moment to build up.
        thread::sleep(Duration::from_secs(if number == 0 { 0 } else { 2 }));
        let columns = thread::scope(|scope| scope.spawn(|| measure(&place, &board, rounds)).join());
        drop(load);
        println!("| {name} | {} |", columns.map_err(|_| "the measuring thread panicked")?.join(" | "));
        wait_for_device(&place.socket)?;
    }
    println!();
    drop(daemon);
    Ok(())
}

/// Writes a session of so many MB, which was never ended.
fn write_record(path: &Path, mb: usize) -> io::Result<()> {
    let mut file = io::BufWriter::new(std::fs::File::create(path)?);
    let filler = "x".repeat(900);
    for number in 1..=mb * 1000 {
        let time = "\"time\":\"2026-01-01T12:00:00Z\",\"monotonic_ns\":1";
        writeln!(file, "{{{time},\"number\":{number},\"event\":\"note\",\"text\":\"{filler}\"}}")?;
    }
    file.flush()
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

fn wait_for_device(socket: &Path) -> Result<Status, Box<dyn Error>> {
    let until = Instant::now() + Duration::from_secs(60);
    loop {
        let status = Client::at(Endpoint::at(socket))?.get::<Status>("/v1/status");
        match status {
            Ok(status) if status.is_connected() => return Ok(status),
            _ if Instant::now() > until => return Err("the daemon has no device after 60 s".into()),
            _ => thread::sleep(Duration::from_millis(50)),
        }
    }
}

/// The columns of a load.
fn measure(place: &Place, board: &Board, rounds: usize) -> [String; 5] {
    let _ = priority::fifo(priority::BELOW_STREAMER);
    let has_socket = estop_socket(&place.socket).exists();
    let mut columns = [const { Vec::new() }; 5];
    let mut failures = [0; 5];
    for round in 0..rounds {
        for way in 0..5 {
            // An answer by HTTP waits behind the load's requests, so it is measured only every tenth time.
            if (way == 0 && !has_socket) || (way > 0 && has_socket && round % 10 != 0) {
                continue;
            }
            while board.estops().try_recv().is_ok() {}
            let begun = Instant::now();
            let answered = match way {
                0 => by_socket(place),
                1 => by_http(place),
                2 => by_tcp(place),
                3 => is_served(exchange(&place.socket, STOP.as_bytes())),
                _ => is_served(exchange(&place.socket, STATUS.as_bytes())),
            };
            let done = match way {
                // The device is told before the client has its answer.
                0..3 => board.estops().recv_timeout(TOLD_WITHIN).ok().map(|(_, told)| told),
                _ => Some(Instant::now()),
            };
            let took = done.filter(|_| answered.is_ok()).map(|done| done - begun);
            match took {
                Some(took) => columns[way].push(took.as_secs_f64() * 1e3),
                None => failures[way] += 1,
            }
            if took.is_none_or(|took| way < 3 && took > SLOW) {
                let told = done.filter(|_| way < 3).map(|done| done - begun);
                eprintln!(
                    "order {round}: at the board after {told:.1?}; answer after {:.1?}: {answered:?}",
                    begun.elapsed()
                );
            }
        }
    }
    let mut ways = columns.into_iter().zip(failures);
    std::array::from_fn(|_| ways.next().map_or_else(String::new, |(ms, failures)| column(ms, failures)))
}

fn column(mut ms: Vec<f64>, failures: usize) -> String {
    let all = ms.len() + failures;
    ms.sort_by(f64::total_cmp);
    let at = |per_mille: usize| ms.get((ms.len() * per_mille / 1000).min(ms.len().saturating_sub(1)));
    let [p50, p99, max] = [500, 990, 1000].map(|at_most| at(at_most).copied().unwrap_or(f64::NAN));
    format!("{p50:.2} / {p99:.2} / {max:.2}, {failures} of {all}")
}

const STOP: &str = "POST /v1/stop HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: 2\r\n\r\n{}";
const STATUS: &str = "GET /v1/status HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n";

/// Whether the daemon handled the request. It refuses a `stop` after an emergency stop, because the fault is latched; that counts
/// as handled.
fn is_served(answer: io::Result<String>) -> Result<(), String> {
    expect(answer, |answer| ["HTTP/1.1 200", "HTTP/1.1 409"].iter().any(|status| answer.starts_with(status)))
}

fn by_socket(place: &Place) -> Result<(), String> {
    expect(exchange(&estop_socket(&place.socket), b"!"), |answer| answer.starts_with(STOPPED))
}

fn by_http(place: &Place) -> Result<(), String> {
    is_stopped(exchange(&place.socket, request("x").as_bytes()))
}

fn by_tcp(place: &Place) -> Result<(), String> {
    // The port for emergency stops.
    let address = SocketAddr::new(place.tcp.ip(), place.tcp.port() + 1);
    is_stopped(exchange_tcp(address, request(&address.to_string()).as_bytes()))
}

fn is_stopped(answer: io::Result<String>) -> Result<(), String> {
    expect(answer, |answer| answer.starts_with("HTTP/1.1 200"))
}

/// An error if the answer is not as expected, or if there was none.
fn expect(answer: io::Result<String>, is_right: impl Fn(&str) -> bool) -> Result<(), String> {
    match answer {
        Ok(answer) if is_right(&answer) => Ok(()),
        Ok(answer) => Err(answer),
        Err(error) => Err(error.to_string()),
    }
}

fn request(host: &str) -> String {
    format!("POST /v1/estop HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\ncontent-length: 0\r\n\r\n")
}
