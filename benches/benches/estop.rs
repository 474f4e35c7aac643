//! How long an emergency stop takes while other clients load the daemon: `cargo bench -p meissner-benches --bench estop`.
//!
//! For each load it orders emergency stops, one after the other: on the socket for these, and every tenth also as `POST
//! /v1/estop` on a new connection, to the API's socket and over TCP. It prints the time from before `connect` until the board, at the far end of a serial line, has read the
//! order, and how many orders failed, which the times leave out: no order at the board within a second, or no answer within ten.
//!
//! The daemon and the load are processes of their own. The daemon is this executable, or the program that `MEISSNER_PROGRAM` names (an older one has no
//! socket for emergency stops: that column stays empty, and all orders go by HTTP). `ROUNDS` sets the orders per load, `LOADS` the loads by their
//! first word. The client that measures and the board run in real time where the system allows it. It asserts nothing.

use meissner_api::Status;
use meissner_benches::board::Board;
use meissner_benches::loads::{CHILD, LOADS, Place, exchange, exchange_tcp};
use meissner_client::{Client, Endpoint, STOPPED, estop_socket};
use meissner_stream::device::priority;
use std::error::Error;
use std::io::{self, Read};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Set for the child that makes this load.
const LOAD: &str = "MEISSNER_BENCH_LOAD";
const TOLD_WITHIN: Duration = Duration::from_secs(1);

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

fn run() -> Result<(), Box<dyn Error>> {
    let rounds = std::env::var("ROUNDS").ok().map_or(Ok(10_000), |rounds| rounds.parse())?;
    let wanted = std::env::var("LOADS").unwrap_or_default();
    let dir = tempfile::tempdir()?;
    // The daemon takes the port that this finds free.
    let tcp = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
    let place = Place { socket: dir.path().join("m.sock"), tcp, program: program()? };
    let board = Board::start()?;
    let config = dir.path().join("meissner.toml");
    std::fs::write(
        &config,
        format!("patterns_dir = {:?}\nlease_ms = 5000\nlisten = \"{tcp}\"\n", dir.path()),
    )?;
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
    println!(
        "{:<66} {:^35}  {:^35}  {:^35}",
        "", "socket for emergency stops", "POST /v1/estop, socket", "POST /v1/estop, TCP"
    );
    let columns = format!("{:>7} {:>7} {:>8} {:>10}", "p50", "p99", "max", "failures");
    println!("{:<66} {columns}  {columns}  {columns}", "load");
    let first = |name: &str| name.split([':', ' ']).next().unwrap_or_default().to_owned();
    for (number, (name, _)) in LOADS.into_iter().enumerate() {
        if !wanted.is_empty() && !wanted.split([',', ' ']).any(|word| word == first(name)) {
            continue;
        }
        let mut load = Command::new(std::env::current_exe()?);
        load.env(LOAD, number.to_string()).env("MEISSNER_SOCKET", &place.socket);
        load.env("MEISSNER_BENCH_TCP", tcp.to_string()).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut load = Process(load.spawn()?);
        // The load needs a moment to build up.
        thread::sleep(Duration::from_secs(if number == 0 { 0 } else { 2 }));
        let columns = thread::scope(|scope| scope.spawn(|| measure(&place, &board, rounds)).join());
        let said = load.0.stdout.take();
        drop(load);
        let [socket, http, tcp] = columns.map_err(|_| "the measuring thread panicked")?;
        println!("{name:<66} {socket}  {http}  {tcp}");
        if let Some(mut said) = said {
            let mut text = String::new();
            said.read_to_string(&mut text)?;
            if !text.is_empty() {
                println!("  {}", text.trim_end());
            }
        }
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

/// The columns of a load.
fn measure(place: &Place, board: &Board, rounds: usize) -> [String; 3] {
    let _ = priority::fifo(priority::BELOW_STREAMER);
    let has_socket = estop_socket(&place.socket).exists();
    let mut columns = [const { Vec::new() }; 3];
    let mut failures = [0; 3];
    for round in 0..rounds {
        for way in 0..3 {
            // The answer by HTTP takes as long as the load makes other clients wait.
            if (way == 0 && !has_socket) || (way > 0 && has_socket && round % 10 != 0) {
                continue;
            }
            while board.estops().try_recv().is_ok() {}
            let begun = Instant::now();
            let answered = match way {
                0 => by_socket(place),
                1 => by_http(place),
                _ => by_tcp(place),
            };
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
    is_stopped(exchange(&place.socket, request("x").as_bytes()))
}

fn by_tcp(place: &Place) -> bool {
    is_stopped(exchange_tcp(place.tcp, request(&place.tcp.to_string()).as_bytes()))
}

fn request(host: &str) -> String {
    format!("POST /v1/estop HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\ncontent-length: 0\r\n\r\n")
}

fn is_stopped(answer: io::Result<String>) -> bool {
    answer.is_ok_and(|answer| answer.starts_with("HTTP/1.1 200"))
}
