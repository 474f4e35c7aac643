//! The daemon's load from open windows of the page, and the time until the first pulse of a drawn edge:
//! `cargo bench -p meissner-benches --bench watch`.
//!
//! All 64 clients watch while all pins vibrate for `WATCHED` seconds [30]: 24 windows over TCP, which hold a stream of events and
//! ask for the status four times a second, and streams of events on the socket. The benchmark prints the daemon's processor time
//! with and without them, its memory, late bursts, and bytes. Then it renders things, as the page does when the pen is lifted, and plays what
//! is found. Finally it orders emergency stops while a rendering runs. It asserts nothing.

use meissner_api::{Event, PlayAccepted, Receipt, Rendering, RenderingState, Status};
use meissner_benches::daemon::Daemon;
use meissner_benches::loads::window;
use meissner_client::{Client, ClientError, Events};
use meissner_test_support::paper::MOTORS;
use serde_json::{Value, json};
use std::error::Error;
use std::net::{SocketAddr, TcpListener};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Each takes two of the 48 places of network clients.
const WINDOWS: usize = 24;
/// The socket's clients; this benchmark's own three make it 64.
const ON_SOCKET: usize = 13;
/// Renderings of each shape.
const RENDERINGS: u64 = 5;
const STOPS: usize = 1000;

type Done<T = ()> = Result<T, Box<dyn Error>>;

fn main() -> Done {
    // The daemon takes the port that this finds free.
    let tcp = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
    // Emergency stops leave pins where they are, a thousand of them farther from rest than a person would let them.
    let daemon = Daemon::start(&format!("listen = \"{tcp}\"\ndrift_limit_um = 500.0\n"))?;
    let mut client = daemon.client()?;
    client.post::<Status>("/v1/arm", &json!({"assume_rest": true}))?;
    let seconds = std::env::var("WATCHED").ok().map_or(Ok(30.0), |seconds| seconds.parse())?;
    put_all_pins(&mut client)?;
    for watched in [false, true] {
        watch(&daemon, &mut client, tcp, watched, seconds)?;
    }
    first_pulses(&daemon, &mut client)?;
    stops(&daemon, &mut client)
}

fn put_all_pins(client: &mut Client) -> Done {
    let drive = |motor: u32| {
        format!(
            "[[drive]]\nmotor = {motor}\nfrequency_hz = 60.0\namplitude_um = 80.0\nphase = {:.3}\n",
            f64::from(motor) / MOTORS as f64
        )
    };
    let drives: String = (0..MOTORS as u32).map(drive).collect();
    client.put::<Value>("/v1/patterns/all-pins", format!("format = 1\nname = \"all-pins\"\n{drives}"))?;
    Ok(())
}

/// Plays while windows watch.
fn watch(daemon: &Daemon, client: &mut Client, tcp: SocketAddr, watched: bool, seconds: f64) -> Done {
    let (windows, on_socket) = if watched { (WINDOWS, ON_SOCKET) } else { (0, 0) };
    let (over, bytes) = (AtomicBool::new(false), AtomicU64::new(0));
    thread::scope(|scope| {
        for _ in 0..windows {
            for polls in [false, true] {
                let (over, bytes) = (&over, &bytes);
                scope.spawn(move || {
                    if let Err(error) = window(tcp, polls, over, bytes) {
                        println!("a window has ended: {error}");
                    }
                });
            }
        }
        for _ in 0..on_socket {
            scope.spawn(|| {
                let listened = daemon.client().and_then(|client| listen(&mut client.events()?, &over));
                if let Err(error) = listened {
                    println!("a client has ended: {error}");
                }
            });
        }
        let measured = (|| {
            let mut events = daemon.client()?.events()?;
            // Windows and simulated array settle.
            thread::sleep(Duration::from_secs(2));
            let [before_mb, _] = daemon.memory_mb()?;
            let (used_s, begun, sent) =
                (daemon.processor_s()?, Instant::now(), bytes.load(Ordering::Relaxed));
            let play: PlayAccepted =
                client.post("/v1/play", &json!({"pattern": "all-pins", "seconds": seconds}))?;
            let bursts = receipt(&mut events, play.id)?.bursts.ok_or("the play has no account")?;
            let wall_s = begun.elapsed().as_secs_f64();
            let share = 100.0 * (daemon.processor_s()? - used_s) / wall_s;
            let [after_mb, peak_mb] = daemon.memory_mb()?;
            let kb_s = (bytes.load(Ordering::Relaxed) - sent) as f64 / wall_s / 1e3;
            println!(
                "{windows} windows and {on_socket} clients on the socket, all pins at 60 Hz for {seconds} s: {share:.1} % of a core, {} of {} bursts late, memory {before_mb} MB, then \
                 {after_mb} MB (peak {peak_mb}), {kb_s:.0} kB/s to all windows",
                bursts.late, bursts.planned
            );
            Done::Ok(())
        })();
        over.store(true, Ordering::Relaxed);
        measured
    })
}

/// Reads events on the socket until the benchmark ends.
fn listen(events: &mut Events, over: &AtomicBool) -> Done {
    while !over.load(Ordering::Relaxed) {
        match events.next(Some(Duration::from_millis(100))) {
            Ok(Some(_)) | Err(ClientError::Timeout { .. }) => {}
            Ok(None) => return Err("the daemon has closed the events".into()),
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

fn receipt(events: &mut Events, play: u64) -> Done<Receipt> {
    match wait_for(events, |event| matches!(event, Event::Ended { receipt } if receipt.id == play))? {
        Event::Ended { receipt } => Ok(*receipt),
        _ => unreachable!("it has ended"),
    }
}

fn wait_for(events: &mut Events, is_it: impl Fn(&Event) -> bool) -> Done<Event> {
    loop {
        let event = events.next(None)?.ok_or("the daemon has closed the events")?;
        if is_it(&event) {
            return Ok(event);
        }
    }
}

/// From the order to render until the first pulse.
fn first_pulses(daemon: &Daemon, client: &mut Client) -> Done {
    for shape in ["bar", "edge"] {
        let object = |number: u64| {
            let mut object = json!({
                "kind": "object", "name": "drawn", "shape": shape, "angle_deg": 5 * number,
                "touch": {"press": {"depth_um": 500, "hold_s": 0.3}}
            });
            if shape == "bar" {
                object["length_mm"] = json!(12);
                object["width_mm"] = json!(0.8);
            }
            json!({"object": object})
        };
        first_pulse(daemon, client, &format!("a rendered {shape}, pressed"), object)?;
    }
    Ok(())
}

/// Orders a rendering as soon as the one before has ended, and plays what it has found as soon as that can be played.
fn first_pulse(daemon: &Daemon, client: &mut Client, what: &str, request: impl Fn(u64) -> Value) -> Done {
    let mut taken = Vec::new();
    for number in 0..RENDERINGS {
        let mut events = daemon.client()?.events()?;
        let begun = Instant::now();
        let rendering = client.post::<Rendering>("/v1/renderings", &request(number))?.id;
        wait_for(
            &mut events,
            |event| matches!(event, Event::Rendering { id, found: true, .. } if *id == rendering),
        )?;
        let found_s = begun.elapsed().as_secs_f64();
        let play: PlayAccepted = client.post(
            "/v1/play",
            &json!({"pattern": format!("rendering:{rendering}"), "seconds": 0.1, "replace": true}),
        )?;
        wait_for(&mut events, |event| matches!(event, Event::Began { id, .. } if *id == play.id))?;
        taken.push((begun.elapsed().as_secs_f64(), found_s));
        receipt(&mut events, play.id)?;
        while client.get::<Rendering>(&format!("/v1/renderings/{rendering}"))?.state
            == RenderingState::Running
        {
            thread::sleep(Duration::from_millis(20));
        }
    }
    taken.sort_by(|a, b| a.0.total_cmp(&b.0));
    let [least, middle, most] = [taken[0], taken[taken.len() / 2], taken[taken.len() - 1]];
    println!(
        "{what}: first pulse {:.3}, {:.3} and {:.3} s (least, median, most) after the order, of which finding takes {:.3}, {:.3} and {:.3} s",
        least.0, middle.0, most.0, least.1, middle.1, most.1
    );
    Ok(())
}

/// Emergency stops, each of a play, while a rendering runs.
fn stops(daemon: &Daemon, client: &mut Client) -> Done {
    // The earlier plays may have left more drift than the daemon allows at a play's start.
    client.post::<Status>("/v1/disarm", &json!({}))?;
    client.post::<Status>("/v1/arm", &json!({"assume_rest": true, "checked": "a benchmark"}))?;
    // Half a minute: it is judged for long.
    let long = json!({"object": {
        "kind": "object", "name": "long", "shape": "edge", "touch": {"press": {"depth_um": 500, "hold_s": 29}}
    }});
    for renders in [false, true] {
        let rendering =
            if renders { Some(client.post::<Rendering>("/v1/renderings", &long)?.id) } else { None };
        thread::sleep(Duration::from_secs(u64::from(renders)));
        let mut times_ms = Vec::with_capacity(STOPS);
        for _ in 0..STOPS {
            client.post::<PlayAccepted>("/v1/play", &json!({"pattern": "all-pins", "seconds": 5.0}))?;
            let begun = Instant::now();
            meissner_client::estop(&daemon.socket())?;
            times_ms.push(1e3 * begun.elapsed().as_secs_f64());
            client.post::<Status>("/v1/reset", &json!({}))?;
            client.post::<Status>("/v1/arm", &json!({"assume_rest": true, "checked": "a benchmark"}))?;
        }
        times_ms.sort_by(f64::total_cmp);
        let at = |share: f64| times_ms[((times_ms.len() - 1) as f64 * share) as usize];
        println!(
            "{STOPS} emergency stops of a play {}: answered p50 {:.2} ms, p99 {:.2} ms, at most {:.2} ms",
            if renders { "beside a rendering" } else { "alone" },
            at(0.5),
            at(0.99),
            at(1.0)
        );
        if let Some(id) = rendering {
            client.delete::<Rendering>(&format!("/v1/renderings/{id}"))?;
        }
    }
    Ok(())
}
