//! Runs a daemon for hours of real time beside the load of a busy lab PC: `HOURS=2 cargo bench -p meissner-benches --bench soak`.
//!
//! The daemon has the default lead and host watchdog, and its session record on the disk. Its device is the mock, or, with
//! `DEVICE=board`, a board at the far end of a pseudo-terminal, whose clock runs 30 millionths fast. The kernel moves bytes of
//! terminals in threads of normal priority: on an overloaded machine the board shows how long these wait.
//!
//! Plays of 5 to 60 s follow each other; every tenth is ended by an e-stop. Meanwhile the loads of [`loads::PHASES`] run one after
//! the other, twice. The benchmark takes a sample every ten seconds: lost bursts, the daemon's memory, descriptors, threads and
//! processor time. At each onset the daemon's clock model is compared with the device's clock: the board's own, or, for the mock,
//! the host's since the first onset. A real-time thread of the highest priority measures how long the machine itself stands still.
//! A play that such a stall ends is counted, and the next one begins.
//!
//! It prints a row for each phase, and writes all samples to `soak.csv`, and the daemon's log to `soak.log` in the
//! folder `OUT` [.]. It asserts nothing, but it ends with an error if the daemon does.
//!
//! - [`loads`]: what runs beside it.
//! - [`table`]: the samples as a file.

mod loads;
mod table;

use firmware_protocol::tick::Tick;
use loads::{PHASES, Place, repeat};
use meissner_api::{PlayAccepted, PlayState, Receipt, Status};
use meissner_benches::board::Board;
use meissner_benches::loads::exchange;
use meissner_client::{Client, ClientError, STOPPED, estop_socket};
use meissner_stream::device::priority;
use meissner_test_support::paper::TICK_HZ;
use serde_json::json;
use std::error::Error;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use std::{env, fs, thread};

type Done<T = ()> = Result<T, Box<dyn Error>>;

const ROUNDS: usize = 2;
/// How far the board's clock is off, millionths.
const FAST_PPM: f64 = 30.0;
const SAMPLED: Duration = Duration::from_secs(10);
/// Every so many plays are ended by an e-stop.
const CUT_EVERY: u64 = 10;
const PATTERNS: [&str; 6] = ["edge-45", "all-in-phase", "wave", "two-dots", "rotating-edge", "pin-60"];
const TOLD_WITHIN: Duration = Duration::from_secs(2);

/// What was counted so far.
#[derive(Clone, Copy, Default)]
struct Counts {
    plays: u64,
    planned: u64,
    late: u64,
    /// Bursts dropped or refused in plays that the benchmark did not end.
    lost: u64,
    /// Plays that ended early although the benchmark did not end them.
    broken: u64,
    estops: u64,
    slowest_estop_ms: f64,
    first_onset: Option<(Tick, u64)>,
    /// The time of an onset's tick, as the daemon states it, minus the true one, and the error that the daemon allows for.
    clock_error_us: f64,
    allowed_us: f64,
    largest_error_us: f64,
    /// The longest wait of a real-time thread with a higher priority than the daemon's, ms.
    stall_ms: f64,
}

/// What a sample holds.
#[derive(Clone, Copy)]
struct Sample {
    minute: f64,
    counts: Counts,
    memory_mb: f64,
    descriptors: usize,
    threads: usize,
    processor_s: f64,
}

fn main() -> ExitCode {
    // Cargo passes `--bench`. Without it this executable is `meissner`: the daemon, or a rendering of the daemon, which has no
    // argument.
    if env::args().all(|argument| argument != "--bench") {
        return meissner::cli::main();
    }
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("soak: {error}");
            ExitCode::FAILURE
        }
    }
}

struct Daemon(Child);

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn run() -> Done {
    let hours: f64 = env::var("HOURS").ok().map_or(Ok(2.0), |hours| hours.parse())?;
    let out = PathBuf::from(env::var_os("OUT").unwrap_or_else(|| ".".into()));
    fs::create_dir_all(&out)?;
    let dir = tempfile::tempdir()?;
    // The daemon takes the port that this finds free.
    let tcp = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
    let place = Place { dir: dir.path().to_owned(), socket: dir.path().join("m.sock"), tcp };
    let board = match env::var("DEVICE").as_deref() {
        Ok("board") => Some(Board::with_clock_error(FAST_PPM)?),
        Ok("mock") | Err(_) => None,
        Ok(other) => return Err(format!("DEVICE={other}: mock or board").into()),
    };
    let device =
        board.as_ref().map_or("mock".to_owned(), |board| format!("serial:{}", board.path().display()));
    let config = dir.path().join("meissner.toml");
    // A board has no sensor, and no person levels its pins.
    let text = format!(
        "patterns_dir = {:?}\nlogbook_dir = {:?}\nlisten = \"{tcp}\"\ndrift_limit_um = 10000\n\
         [participant]\nmax_continuous_s = 86400\nmax_session_s = 86400\nmax_day_s = 86400\n",
        dir.path().join("patterns"),
        dir.path().join("record"),
    );
    fs::create_dir(dir.path().join("patterns"))?;
    fs::write(&config, text)?;
    let mut command = Command::new(env::current_exe()?);
    command.env_remove("RUST_LOG").stdin(Stdio::null()).stderr(fs::File::create(out.join("soak.log"))?);
    command.args(["daemon", "--device", &device, "--config"]);
    command.arg(&config).arg("--socket").arg(&place.socket);
    let daemon = Daemon(command.spawn()?);
    wait_for_device(&place.socket)?;

    let phase = Duration::from_secs_f64(hours * 3600.0 / (ROUNDS * PHASES.len()) as f64);
    let (counts, over, ended) =
        (Mutex::new(Counts::default()), AtomicBool::new(false), AtomicBool::new(false));
    let (begun, mut samples, mut bounds) = (Instant::now(), Vec::new(), Vec::new());
    thread::scope(|scope| {
        scope.spawn(|| watch_machine(&counts, &over));
        let player = scope.spawn(|| {
            let played =
                play(&place.socket, board.as_ref(), &counts, &over).map_err(|error| error.to_string());
            ended.store(true, Ordering::Relaxed);
            played
        });
        println!(
            "{:<30} {:>6} {:>9} {:>5} {:>5} {:>6} {:>9} {:>8} {:>9} {:>7} {:>4} {:>8} {:>6}",
            "load",
            "plays",
            "bursts",
            "late",
            "lost",
            "broken",
            "stall",
            "e-stop",
            "clock",
            "memory",
            "fds",
            "threads",
            "cpu"
        );
        let mut sampled = Ok(());
        for (name, load) in PHASES.iter().cycle().take(ROUNDS * PHASES.len()) {
            let phase_over = AtomicBool::new(false);
            let (place, from) = (&place, Instant::now());
            {
                let mut counts = counts.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                (counts.slowest_estop_ms, counts.largest_error_us, counts.stall_ms) = (0.0, 0.0, 0.0);
            }
            let first = sample(&daemon.0, begun, &counts)?;
            bounds.push((first.minute, *name));
            thread::scope(|scope| {
                scope.spawn(|| load(place, &phase_over));
                while from.elapsed() < phase && !ended.load(Ordering::Relaxed) && sampled.is_ok() {
                    thread::sleep(SAMPLED.min(phase));
                    match sample(&daemon.0, begun, &counts) {
                        Ok(sample) => samples.push(sample),
                        Err(error) => sampled = Err(error),
                    }
                }
                phase_over.store(true, Ordering::Relaxed);
            });
            if let Some(last) = samples.last() {
                row(name, &first, last);
                // Write the files after each phase, in case a later one never ends.
                table::keep(&out, &samples, &bounds)?;
            }
            if ended.load(Ordering::Relaxed) || sampled.is_err() {
                break;
            }
        }
        over.store(true, Ordering::Relaxed);
        sampled?;
        Ok(player.join().map_err(|_| "the player panicked")??)
    })
}

/// Prints a phase.
fn row(name: &str, first: &Sample, last: &Sample) {
    let (from, to) = (first.counts, last.counts);
    println!(
        "{name:<30} {:>6} {:>9} {:>5} {:>5} {:>6} {:>6.1} ms {:>5.1} ms {:>6.1} us {:>4.0} MB {:>4} {:>8} {:>4.1} %",
        to.plays - from.plays,
        to.planned - from.planned,
        to.late - from.late,
        to.lost - from.lost,
        to.broken - from.broken,
        to.stall_ms,
        to.slowest_estop_ms,
        to.largest_error_us,
        last.memory_mb,
        last.descriptors,
        last.threads,
        100.0 * (last.processor_s - first.processor_s) / (60.0 * (last.minute - first.minute)).max(1.0),
    );
}

fn sample(daemon: &Child, begun: Instant, counts: &Mutex<Counts>) -> Done<Sample> {
    let folder = PathBuf::from(format!("/proc/{}", daemon.id()));
    let status = fs::read_to_string(folder.join("status"))?;
    let field = |key: &str| -> Done<f64> {
        let line = status.lines().find_map(|line| line.strip_prefix(key)).ok_or("the daemon has ended")?;
        Ok(line.split_whitespace().next().unwrap_or_default().parse()?)
    };
    // The process name, in parentheses, may have spaces. Processor times are in hundredths of a second.
    let stat = fs::read_to_string(folder.join("stat"))?;
    let times = stat.rsplit(") ").next().unwrap_or_default().split(' ').skip(11).take(2);
    Ok(Sample {
        minute: begun.elapsed().as_secs_f64() / 60.0,
        counts: *counts.lock().unwrap_or_else(std::sync::PoisonError::into_inner),
        memory_mb: field("VmRSS:")? * 1024.0 / 1e6,
        descriptors: fs::read_dir(folder.join("fd"))?.count(),
        threads: field("Threads:")? as usize,
        processor_s: times.filter_map(|time| time.parse::<f64>().ok()).sum::<f64>() / 100.0,
    })
}

fn wait_for_device(socket: &Path) -> Done {
    let until = Instant::now() + Duration::from_secs(60);
    while !Client::new(socket)?.get::<Status>("/v1/status").is_ok_and(|status| status.is_connected()) {
        if Instant::now() > until {
            return Err("the daemon has no device after 60 s".into());
        }
        thread::sleep(Duration::from_millis(50));
    }
    Ok(())
}

/// Plays one pattern, until it ends.
fn play(socket: &Path, board: Option<&Board>, counts: &Mutex<Counts>, over: &AtomicBool) -> Done {
    let mut client = Client::new(socket)?;
    arm(&mut client)?;
    for number in 0_u64.. {
        if over.load(Ordering::Relaxed) {
            break;
        }
        let seconds = 5.0 + (number * 37 % 56) as f64;
        let pattern = PATTERNS[number as usize % PATTERNS.len()];
        let request = json!({"pattern": pattern, "seconds": seconds});
        let accepted = client.post::<PlayAccepted>("/v1/play", &request);
        let Ok(PlayAccepted { id, .. }) = accepted else {
            // A play that was broken leaves the motors off, or no device.
            wait_for_device(socket)?;
            arm(&mut client)?;
            continue;
        };
        let cut = number % CUT_EVERY == CUT_EVERY - 1;
        let mut estop_ms = 0.0;
        if cut {
            thread::sleep(Duration::from_millis(1_000 + number * 131 % 900));
            estop_ms = e_stop(socket, board)?;
        }
        let receipt = loop {
            let receipt: Receipt = client.get(&format!("/v1/plays/{id}?wait=1"))?;
            if !matches!(receipt.state, PlayState::Queued | PlayState::Running) {
                break receipt;
            }
        };
        if cut {
            client.post::<Status>("/v1/reset", &json!({}))?;
            arm(&mut client)?;
        }
        count(counts, board, &receipt, cut, estop_ms);
    }
    Ok(())
}

/// Notes by how much the sleep of a real-time thread exceeds a millisecond, at most.
fn watch_machine(counts: &Mutex<Counts>, over: &AtomicBool) {
    let millisecond = Duration::from_millis(1);
    let _ = priority::fifo(priority::FIFO_PRIORITY + 1);
    let mut longest_ms = 0.0;
    repeat(over, || {
        let asked = Instant::now();
        thread::sleep(millisecond);
        let late_ms = asked.elapsed().saturating_sub(millisecond).as_secs_f64() * 1e3;
        // This thread never waits for the lock: another thread may hold it while the machine stalls.
        longest_ms = late_ms.max(longest_ms);
        if let Ok(mut counts) = counts.try_lock() {
            counts.stall_ms = counts.stall_ms.max(std::mem::take(&mut longest_ms));
        }
    });
}

fn arm(client: &mut Client) -> Result<Status, ClientError> {
    client.post("/v1/arm", &json!({"assume_rest": true, "checked": "a benchmark"}))
}

/// Orders an e-stop; returns how long it took to the board, or to the answer of the mock, ms.
fn e_stop(socket: &Path, board: Option<&Board>) -> Done<f64> {
    while board.is_some_and(|board| board.estops().try_recv().is_ok()) {}
    let begun = Instant::now();
    let answer = exchange(&estop_socket(socket), b"!")?;
    let told = match board {
        Some(board) => board.estops().recv_timeout(TOLD_WITHIN)?.1,
        None => Instant::now(),
    };
    if answer.trim_end() != STOPPED {
        return Err(format!("an e-stop is answered with {answer:?}").into());
    }
    Ok((told - begun).as_secs_f64() * 1e3)
}

fn count(counts: &Mutex<Counts>, board: Option<&Board>, receipt: &Receipt, cut: bool, estop_ms: f64) {
    let mut counts = counts.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    counts.plays += 1;
    counts.estops += u64::from(cut);
    counts.slowest_estop_ms = counts.slowest_estop_ms.max(estop_ms);
    if !cut && receipt.state != PlayState::Done {
        counts.broken += 1;
        println!("  play {} has ended, {:?}: {:?}", receipt.id, receipt.state, receipt.cause);
    }
    if let Some(bursts) = &receipt.counts.bursts {
        counts.planned += bursts.planned;
        counts.late += bursts.late;
        counts.lost += if cut { 0 } else { bursts.dropped + bursts.refused };
    }
    if let Some(onset) = &receipt.onset {
        let (tick, ns) = (Tick(onset.actual_tick), onset.monotonic_ns);
        let (first_tick, first_ns) = *counts.first_onset.get_or_insert((tick, ns));
        let true_ns = board.map_or_else(
            || first_ns as f64 + tick.since(first_tick) as f64 / f64::from(TICK_HZ) * 1e9,
            |board| board.begin_of_ns(tick) as f64,
        );
        let error_us = (ns as f64 - true_ns) / 1e3;
        (counts.clock_error_us, counts.allowed_us) = (error_us, onset.uncertainty_ns as f64 / 1e3);
        counts.largest_error_us = counts.largest_error_us.max(error_us.abs());
    }
}
