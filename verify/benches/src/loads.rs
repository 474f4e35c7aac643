//! Loads for the benchmark of emergency stops: clients that send too many requests, on the socket and over TCP.

use serde_json::json;
use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// A load: it runs until its process is killed, or until the flag is set.
pub type Load = fn(&Place, &AtomicBool);

/// Set for the child that is the daemon, or another command.
pub const CHILD: &str = "MEISSNER_BENCH_CHILD";
/// A window of the page asks so often for the status.
const POLLED: Duration = Duration::from_millis(250);
/// How long a client waits for an answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(10);

/// All loads, with their names.
pub const LOADS: [(&str, Load); 19] = [
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
    ("tcp-connects: TCP connections reset at once, without a pause", tcp_connects),
    ("tcp-slow: 64 TCP clients that send a byte of a header per second", tcp_slow),
    ("tcp-hostile: eight with a wrong Host, Origin or token", tcp_hostile),
    ("tcp-pages: 30 pages in browsers, 60 connections, and plays", tcp_pages),
    ("heads: 128 that send a byte of a head every 2 s", |place, over| slow(place, over, STATUS)),
    ("slow-bodies: 128 that send sequences and stops byte by byte", slow_bodies),
    ("readers: 30 that list the sessions of a long record, and plays", readers),
    ("all: every load above at once, but the shells", all),
];

/// How often a slow client sends a byte.
const SLOW: Duration = Duration::from_secs(2);

const PATTERN: &str = "GET /v1/patterns/rotating-edge HTTP/1.1\r\nhost: x\r\n\r\n";
const STATUS: &str = "GET /v1/status HTTP/1.1\r\nhost: x\r\n\r\n";

/// Where the daemon listens, and its program.
#[derive(Clone, Debug)]
pub struct Place {
    /// Its socket.
    pub socket: PathBuf,
    /// Its address.
    pub tcp: SocketAddr,
    /// Its program.
    pub program: PathBuf,
}

impl Place {
    /// A command of the program.
    pub fn command(&self) -> Command {
        let mut command = Command::new(&self.program);
        command.env(CHILD, "1").env("MEISSNER_SOCKET", &self.socket).env_remove("RUST_LOG");
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command
    }
}

/// Sends a request to a socket, and reads until the daemon closes the connection.
///
/// # Errors
/// If the daemon cannot be reached, or gives no answer in time.
pub fn exchange(socket: &Path, request: &[u8]) -> io::Result<String> {
    let stream = UnixStream::connect(socket)?;
    stream.set_read_timeout(Some(ANSWER_WITHIN))?;
    answer(stream, request)
}

/// The same over TCP.
///
/// # Errors
/// As [`exchange`].
pub fn exchange_tcp(address: SocketAddr, request: &[u8]) -> io::Result<String> {
    let stream = TcpStream::connect_timeout(&address, ANSWER_WITHIN)?;
    stream.set_read_timeout(Some(ANSWER_WITHIN))?;
    answer(stream, request)
}

fn answer(mut stream: impl Read + Write, request: &[u8]) -> io::Result<String> {
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
            // This ends the reader, too.
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
    plays(place, over);
}

/// Short plays, one after the other.
fn plays(place: &Place, over: &AtomicBool) {
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
        // A fixed sequence per thread: mostly truncated requests, some altered ones, some random bytes.
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

/// Four threads connect and reset the connection, so that no port stays in TIME_WAIT.
fn tcp_connects(place: &Place, over: &AtomicBool) {
    let (count, begun) = (AtomicU64::new(0), Instant::now());
    threads(4, over, |_| {
        let stream = TcpStream::connect_timeout(&place.tcp, Duration::from_millis(100))?;
        rustix::net::sockopt::set_socket_linger(&stream, Some(Duration::ZERO))?;
        count.fetch_add(1, Ordering::Relaxed);
        Ok(())
    });
    println!("{:.0} connections/s", count.into_inner() as f64 / begun.elapsed().as_secs_f64());
}

fn tcp_slow(place: &Place, over: &AtomicBool) {
    threads(64, over, |_| {
        let mut stream = TcpStream::connect_timeout(&place.tcp, Duration::from_millis(100))?;
        for byte in STATUS.as_bytes().iter().cycle() {
            stream.write_all(&[*byte])?;
            for _ in 0..100 {
                if over.load(Ordering::Relaxed) {
                    return Ok(());
                }
                thread::sleep(Duration::from_millis(10));
            }
        }
        Ok(())
    });
}

fn tcp_hostile(place: &Place, over: &AtomicBool) {
    let count = AtomicU64::new(0);
    let begun = Instant::now();
    threads(8, over, |number| {
        let host = place.tcp;
        let (host, header) = match number % 4 {
            0 => ("attacker.example".to_owned(), ""),
            1 => (host.to_string(), "origin: http://attacker.example\r\n"),
            2 => (host.to_string(), "authorization: Bearer mst_wrong\r\n"),
            _ => (host.to_string(), "sec-fetch-site: cross-site\r\n"),
        };
        let request = format!("POST /v1/estop HTTP/1.1\r\nhost: {host}\r\n{header}content-length: 0\r\n\r\n");
        let mut stream = TcpStream::connect_timeout(&place.tcp, Duration::from_millis(100))?;
        rustix::net::sockopt::set_socket_linger(&stream, Some(Duration::ZERO))?;
        stream.set_read_timeout(Some(Duration::from_secs(1)))?;
        let mut bytes = vec![0; 1 << 12];
        while !over.load(Ordering::Relaxed) {
            stream.write_all(request.as_bytes())?;
            let read = stream.read(&mut bytes)?;
            if !bytes[..read].starts_with(b"HTTP/1.1 4") {
                break;
            }
            count.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    });
    println!("{:.0} refusals/s", count.into_inner() as f64 / begun.elapsed().as_secs_f64());
}

/// 30 windows of the page, and plays.
fn tcp_pages(place: &Place, over: &AtomicBool) {
    let bytes = AtomicU64::new(0);
    let begun = Instant::now();
    thread::scope(|scope| {
        scope.spawn(|| threads(60, over, |number| window(place.tcp, number % 2 == 0, over, &bytes)));
        plays(place, over);
    });
    println!("{:.0} kB/s to all", bytes.into_inner() as f64 / begun.elapsed().as_secs_f64() / 1e3);
}

/// One of the two connections of a window of the page, until the end: a stream of events, or the status four times a second. Counts the bytes
/// that it gets.
///
/// # Errors
/// If the daemon cannot be reached, or closes the connection.
pub fn window(tcp: SocketAddr, polls: bool, over: &AtomicBool, bytes: &AtomicU64) -> io::Result<()> {
    let path = if polls { "/v1/status" } else { "/v1/events" };
    let request = format!("GET {path} HTTP/1.1\r\nhost: {tcp}\r\n\r\n");
    let mut stream = TcpStream::connect(tcp)?;
    stream.set_read_timeout(Some(Duration::from_millis(100)))?;
    let mut asked: Option<Instant> = None;
    let mut buffer = vec![0; 1 << 16];
    while !over.load(Ordering::Relaxed) {
        if asked.is_none_or(|asked| polls && asked.elapsed() >= POLLED) {
            stream.write_all(request.as_bytes())?;
            asked = Some(Instant::now());
        }
        match stream.read(&mut buffer) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(read) => _ = bytes.fetch_add(read as u64, Ordering::Relaxed),
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// 128 clients that send this byte by byte, and connect again when the daemon has closed the connection.
fn slow(place: &Place, over: &AtomicBool, request: &str) {
    threads(128, over, |_| {
        let mut stream = UnixStream::connect(&place.socket)?;
        stream.set_read_timeout(Some(SLOW))?;
        for byte in request.as_bytes().iter().cycle() {
            stream.write_all(&[*byte])?;
            for _ in 0..100 {
                if over.load(Ordering::Relaxed) {
                    return Ok(());
                }
                stream.set_read_timeout(Some(SLOW / 100))?;
                if matches!(stream.read(&mut [0; 512]), Ok(0)) {
                    return Ok(());
                }
            }
        }
        Ok(())
    });
}

fn slow_bodies(place: &Place, over: &AtomicBool) {
    let paths = ["/v1/play/check", "/v1/stop", "/v1/play", "/v1/status"];
    threads(128, over, |number| {
        let mut stream = UnixStream::connect(&place.socket)?;
        let path = paths[number % paths.len()];
        let head = format!("POST {path} HTTP/1.1\r\nhost: x\r\ncontent-length: 9000\r\n\r\n");
        stream.write_all(head.as_bytes())?;
        stream.set_read_timeout(Some(Duration::from_millis(100)))?;
        while !over.load(Ordering::Relaxed) {
            stream.write_all(b" ")?;
            if matches!(stream.read(&mut [0; 512]), Ok(0)) {
                break;
            }
        }
        Ok(())
    });
}

/// 30 observers, and plays beside them.
fn readers(place: &Place, over: &AtomicBool) {
    let request = "GET /v1/sessions HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n";
    thread::scope(|scope| {
        scope.spawn(|| {
            threads(30, over, |_| {
                let answer = exchange(&place.socket, request.as_bytes())?;
                // Too many clients read the events: this one waits before it asks again.
                if !answer.starts_with("HTTP/1.1 200") {
                    thread::sleep(Duration::from_millis(100));
                }
                Ok(())
            });
        });
        plays(place, over);
    });
}

fn all(place: &Place, over: &AtomicBool) {
    thread::scope(|scope| {
        for (name, load) in LOADS {
            if !["idle", "shells", "all"].iter().any(|other| name.starts_with(other)) {
                scope.spawn(move || load(place, over));
            }
        }
    });
}
