//! The real streamer's thread between threads that order emergency stops and send requests, for some seconds.
//!
//! It is for the thread sanitizer (`verify/races/run tsan`): the models stand in for rtrb, the event descriptors and the thread's loop,
//! here they are the real ones. Every request and every emergency stop must be answered.

use meissner_array::spec::Array;
use meissner_stream::device::{self, Spec};
use meissner_stream::queues::{
    Command, CommandQueue, ESTOP_TICKETS, EStopSwitch, EventQueue, Request, StreamEvent,
};
use meissner_stream::time::HostInstant;
use meissner_stream::{Settings, spawn};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Threads that order emergency stops.
const STOPPERS: u64 = 2;
/// What is not answered by then is lost.
const PATIENCE: Duration = Duration::from_secs(20);

/// Runs for `SECONDS` (the argument) with each simulated device.
pub(crate) fn main() -> ExitCode {
    let seconds = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(5.0);
    for spec in [Spec::Mock, Spec::Pty] {
        match run(&spec, Duration::from_secs_f64(seconds)) {
            Ok(report) => println!("{spec}: {report}"),
            Err(what) => {
                eprintln!("races: {spec}: {what}");
                return ExitCode::FAILURE;
            }
        }
    }
    ExitCode::SUCCESS
}

fn run(spec: &Spec, long: Duration) -> Result<String, String> {
    let (mut commands, events, _, streamer) =
        spawn(Settings::of(Array::paper())).map_err(|error| error.to_string())?;
    let device =
        device::open(spec, Array::paper(), &Default::default()).map_err(|error| error.to_string())?;
    let connect =
        Request { ticket: 0, issued_at: HostInstant::now(), command: Command::Connect(Box::new(device)) };
    commands.send(connect).map_err(|_| "there was no room")?;
    let (over, answered) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
    let listener = {
        let answered = Arc::clone(&answered);
        thread::spawn(move || listen(events, &answered))
    };
    let stoppers: Vec<_> = (1..=STOPPERS)
        .map(|pause| {
            let (switch, over) = (commands.estop_switch(), Arc::clone(&over));
            thread::spawn(move || order(&switch, Duration::from_millis(3 * pause), &over))
        })
        .collect();
    let sent = request(&mut commands, Instant::now() + long);
    over.store(true, Ordering::Relaxed);
    let stops = stoppers.into_iter().map(|it| it.join().map_err(|_| "a thread panicked".to_owned())?);
    let stops = stops.sum::<Result<u64, String>>()?;
    let begun = Instant::now();
    while answered.load(Ordering::Acquire) < sent {
        if begun.elapsed() > PATIENCE {
            return Err(format!("{} of {sent} requests were answered", answered.load(Ordering::Acquire)));
        }
        thread::sleep(Duration::from_millis(10));
    }
    let shutdown = Request { ticket: 0, issued_at: HostInstant::now(), command: Command::Shutdown };
    commands.send(shutdown).map_err(|_| "there was no room")?;
    streamer.join().map_err(|_| "the streamer panicked")?;
    let events = listener.join().map_err(|_| "the listener panicked")?;
    Ok(format!("{stops} e-stops and {sent} requests answered, {events} events"))
}

/// Orders emergency stops, and waits for the answer of each; returns how many.
fn order(switch: &EStopSwitch, pause: Duration, over: &AtomicBool) -> Result<u64, String> {
    let mut ordered = 0;
    while !over.load(Ordering::Relaxed) {
        let (number, since) = (switch.request(), Instant::now());
        while switch.answer(number).is_none() {
            if since.elapsed() > PATIENCE {
                return Err(format!("e-stop {number} was not answered"));
            }
            thread::yield_now();
        }
        ordered += 1;
        thread::sleep(pause);
    }
    Ok(ordered)
}

/// Sends requests until then; returns how many.
fn request(commands: &mut CommandQueue, until: Instant) -> u64 {
    let switch = commands.estop_switch();
    let mut sent = 0;
    while Instant::now() < until {
        let command = match sent % 3 {
            0 => Command::Reset { estops_seen: switch.newest(), keep: true },
            1 => Command::Arm { assume_rest: true },
            _ => Command::Disarm,
        };
        match commands.send(Request { ticket: sent + 1, issued_at: HostInstant::now(), command }) {
            Ok(()) => sent += 1,
            Err(_) => thread::sleep(Duration::from_millis(1)),
        }
        if sent % 8 == 0 {
            thread::sleep(Duration::from_millis(2));
        }
    }
    sent
}

/// Takes events until the streamer's thread ends; counts them, and the answers to requests.
fn listen(mut events: EventQueue, answered: &AtomicU64) -> u64 {
    let mut taken = 0;
    loop {
        let timeout = Timespec { tv_sec: 1, tv_nsec: 0 };
        let _ = poll(&mut [PollFd::new(&events, PollFlags::IN)], Some(&timeout));
        while let Some(event) = events.pop() {
            taken += 1;
            match event {
                StreamEvent::Answer { ticket: 1..ESTOP_TICKETS, .. } => {
                    answered.fetch_add(1, Ordering::Release);
                }
                StreamEvent::ThreadEnded => return taken,
                _ => {}
            }
        }
        while events.pop_measured().is_some() {}
    }
}
