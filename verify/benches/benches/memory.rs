//! How much memory a daemon takes under the loads that clients can put on it: `cargo bench -p meissner-benches --bench memory`.
//!
//! Each load gets a new daemon on the mock, in its own process: `MEISSNER_PROGRAM`, or the `meissner` that `cargo build --release`
//! made. A row shows the resident memory and its peak after the load, and the resident memory after an emergency stop, beside the
//! stated bound. It asserts nothing. Words after `--` choose loads by their names.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use meissner::daemon::MEMORY_BOUND;
use meissner_api::{Item, Order, Status, Terms};
use meissner_benches::daemon::Daemon;
use meissner_client::Events;
use meissner_test_support::paper::MOTORS;
use serde_json::{Value, json};
use std::env;
use std::error::Error;
use std::fmt::Write as _;
use std::io::{ErrorKind, Write};
use std::os::unix::net::UnixStream;
use std::thread;
use std::time::{Duration, Instant};

/// A load: returns what must stay open while the memory is read.
type Load = fn(&Daemon) -> Result<Kept, Box<dyn Error>>;

#[derive(Default)]
struct Kept {
    _streams: Vec<UnixStream>,
    _events: Vec<Events>,
}

const LOADS: [(&str, Load); 13] = [
    ("idle", |_| Ok(Kept::default())),
    ("import, 1 MB of dotted keys", |daemon| imports(daemon, 1, dotted)),
    ("six of them in parallel", |daemon| imports(daemon, 6, dotted)),
    ("six of the largest valid, five times", |daemon| {
        (0..5).try_fold(Kept::default(), |_, _| imports(daemon, 6, largest))
    }),
    ("17 plays of dotted keys", |daemon| plays(daemon, |_| dotted("p0"))),
    ("17 plays of the largest valid", |daemon| plays(daemon, |_| largest("p0"))),
    ("17 plays of 17 such", |daemon| plays(daemon, |number| largest(&format!("p{number}")))),
    ("import, ten minutes at 1 kHz on all pins", |daemon| {
        daemon.client()?.put::<Value>("/v1/patterns/p0", packed("p0"))?;
        Ok(Kept::default())
    }),
    ("17 plays of that", |daemon| {
        daemon.client()?.put::<Value>("/v1/patterns/p0", packed("p0"))?;
        let mut client = daemon.client()?;
        client.post::<Status>("/v1/arm", &json!({"assume_rest": true}))?;
        for _ in 0..17 {
            let _ = client.play(&Order::new(Item::of("p0"), Terms::default()));
        }
        Ok(Kept::default())
    }),
    ("64 clients with 1 MB bodies", bodies),
    ("48 event streams that do not read", streams),
    ("5000 refused plays, names of 15 kB", |daemon| {
        let mut client = daemon.client()?;
        for _ in 0..5000 {
            let _ = client.post::<Value>("/v1/play", &json!({"pattern": "x".repeat(15_000)}));
        }
        Ok(Kept::default())
    }),
    ("10000 stops", |daemon| {
        let mut client = daemon.client()?;
        for _ in 0..10_000 {
            client.post::<Status>("/v1/stop", &json!({}))?;
        }
        Ok(Kept::default())
    }),
];

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    println!("stated bound: {} MiB", MEMORY_BOUND >> 20);
    println!("{:<38} {:>9} {:>9} {:>18}", "load", "resident", "peak", "after the e-stop");
    for (name, load) in LOADS {
        if !words.is_empty() && !words.iter().any(|word| name.contains(word)) {
            continue;
        }
        let daemon = Daemon::start("")?;
        let kept = load(&daemon)?;
        let [resident, peak] = daemon.memory_mb()?;
        // A full daemon has places for emergency stops only.
        let _: Status = daemon.client()?.post("/v1/estop", &json!({}))?;
        drop(kept);
        thread::sleep(Duration::from_secs(2));
        let [after, _] = daemon.memory_mb()?;
        println!("{name:<38} {resident:>6} MB {peak:>6} MB {after:>15} MB");
    }
    Ok(())
}

fn head(name: &str) -> String {
    format!("format = 1\nname = \"{name}\"\nduration_s = 10000.0\n")
}

/// A megabyte of keys with 60 dots each.
fn dotted(name: &str) -> String {
    let mut text =
        head(name) + "[[drive]]\nmotor = 1\nfrequency_hz = 60.0\namplitude_um = 10.0\n[provenance]\n";
    for key in 0..8000 {
        let _ = writeln!(text, "k{key}{} = 1", ".a".repeat(60));
    }
    text
}

/// As many drives as a pattern may have, with every key and comments, and as much provenance as fits.
fn largest(name: &str) -> String {
    let mut text = head(name);
    for number in 0..4096 {
        let (motor, start_s) = (number % MOTORS, (number / MOTORS) as f64 * 5.5);
        let _ = write!(
            text,
            "[[drive]] #\nmotor = {motor} #\nfrequency_hz = 60.125 #\namplitude_um = 10.125 #\nphase = 0.125 #\n\
             start_s = {start_s} #\nstop_s = {} #\n",
            start_s + 5.25
        );
    }
    text += "[provenance]\n";
    for key in 0..2040 {
        let _ = writeln!(text, "k{key} = {{ a = 1, b = [[1], [2]] }}");
    }
    text
}

/// Ten minutes of packed samples at 1 kHz for every motor: 77 MB.
fn packed(name: &str) -> String {
    let height = |sample: u32| 20.0 + (sample.wrapping_mul(2_654_435_761) >> 28) as f32;
    let samples = |motor: usize| -> Vec<u8> {
        (0..600_000).flat_map(|sample| height(sample + motor as u32).to_le_bytes()).collect()
    };
    let mut text = format!("format = 1\nname = \"{name}\"\nduration_s = 600.0\n");
    for motor in 0..MOTORS {
        let _ = write!(
            text,
            "[[wave]]\nmotor = {motor}\nrate_hz = 1000\nsamples = \"{}\"\n",
            STANDARD.encode(samples(motor))
        );
    }
    text
}

fn imports(daemon: &Daemon, count: usize, text: fn(&str) -> String) -> Result<Kept, Box<dyn Error>> {
    let clients: Vec<_> = (0..count).map(|_| daemon.client()).collect::<Result<_, _>>()?;
    thread::scope(|scope| {
        for (number, mut client) in clients.into_iter().enumerate() {
            scope.spawn(move || {
                let name = format!("p{number}");
                client.put::<Value>(&format!("/v1/patterns/{name}"), text(&name))
            });
        }
    });
    Ok(Kept::default())
}

/// Fills the queue. If the daemon refuses the pattern, it refuses the plays, too.
fn plays(daemon: &Daemon, text: fn(usize) -> String) -> Result<Kept, Box<dyn Error>> {
    let mut client = daemon.client()?;
    client.post::<Status>("/v1/arm", &json!({"assume_rest": true}))?;
    for number in 0..17 {
        let text = text(number);
        let name = text.split('"').nth(1).unwrap_or_default().to_owned();
        if number == 0 || name != "p0" {
            let _ = client.put::<Value>(&format!("/v1/patterns/{name}"), text);
        }
        let _ = client.post::<Value>("/v1/play", &json!({"pattern": name}));
    }
    Ok(Kept::default())
}

/// Sends all but the last byte of each body, as far as the daemon reads it within five seconds.
fn bodies(daemon: &Daemon) -> Result<Kept, Box<dyn Error>> {
    let request = format!("PUT /v1/patterns/x HTTP/1.1\r\nhost: x\r\ncontent-length: {}\r\n\r\n", 1 << 20);
    let request = [request.as_bytes(), &vec![b'#'; (1 << 20) - 1]].concat();
    let mut streams = Vec::new();
    for _ in 0..64 {
        let stream = UnixStream::connect(daemon.socket())?;
        stream.set_nonblocking(true)?;
        streams.push((stream, &request[..]));
    }
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(5) {
        for (stream, rest) in &mut streams {
            match stream.write(rest) {
                Ok(written) => *rest = &rest[written..],
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Err(error.into()),
            }
        }
        thread::sleep(Duration::from_millis(1));
    }
    Ok(Kept { _streams: streams.into_iter().map(|(stream, _)| stream).collect(), ..Kept::default() })
}

/// Two thousand plays, whose events no listener reads.
fn streams(daemon: &Daemon) -> Result<Kept, Box<dyn Error>> {
    let mut client = daemon.client()?;
    let events: Vec<_> = (0..48).map(|_| client.events()).collect::<Result<_, _>>()?;
    client.post::<Status>("/v1/arm", &json!({"assume_rest": true}))?;
    for _ in 0..2000 {
        let _ = client.post::<Value>("/v1/play", &json!({"pattern": "pin-60", "seconds": 1.0}));
        let _ = client.post::<Value>("/v1/stop", &json!({}));
    }
    Ok(Kept { _events: events, ..Kept::default() })
}
