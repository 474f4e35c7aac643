//! How fast the daemon answers, on this machine, in wall time: `cargo bench -p meissner-benches --bench latency`.
//!
//! A daemon on the mock runs in this process; the benchmark sends requests over its real socket. It also prints how late this
//! machine's timers wake an ordinary thread: no tail can be shorter than that. It asserts nothing.

use meissner::config::{Config, PatternsDir};
use meissner::daemon::Daemon;
use meissner_api::{Event, Receipt};
use meissner_api::{Item, Order, Status, Terms};
use meissner_client::Client;
use meissner_stream::device::Spec;
use serde_json::{Value, json};
use std::error::Error;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

const CALLS: usize = 10_000;
const PLAYS: usize = 200;
const STOPS: usize = 200;
const TIMEOUT: Option<Duration> = Some(Duration::from_secs(10));

fn main() -> Result<(), Box<dyn Error>> {
    let dir = tempfile::tempdir()?;
    let config = Config {
        device: Spec::Mock,
        socket: dir.path().join("bench.sock"),
        patterns: PatternsDir::None,
        ..Config::default()
    };
    let hosted = Daemon::start(&config)?.host()?;
    let mut client = Client::new(&config.socket)?;
    while !client.get::<Status>("/v1/status")?.is_connected() {
        thread::sleep(Duration::from_millis(5));
    }
    print("timer wake-up, 1 ms", wake_ups());
    print("API round trip (status)", round_trips(&config.socket)?);
    let _: Status = client.post("/v1/arm", &json!({"assume_rest": true}))?;
    print("play to first pulse", plays(&mut client)?);
    print("e-stop to the device's answer", stops(&mut client)?);
    println!("real time: {:?}", hosted.realtime());
    Ok(hosted.stop()?)
}

fn print(what: &str, mut us: Vec<f64>) {
    us.sort_by(f64::total_cmp);
    let at = |per_mille: usize| us[(us.len() * per_mille / 1000).min(us.len() - 1)];
    println!(
        "{what:<30} p50 {:>8.1} us   p99 {:>8.1} us   max {:>8.1} us   (n = {})",
        at(500),
        at(990),
        at(1000),
        us.len()
    );
}

fn elapsed_us(begun: Instant) -> f64 {
    begun.elapsed().as_secs_f64() * 1e6
}

fn wake_ups() -> Vec<f64> {
    let sleep = Duration::from_millis(1);
    let late = |_| {
        let begun = Instant::now();
        thread::sleep(sleep);
        (begun.elapsed() - sleep).as_secs_f64() * 1e6
    };
    (0..1000).map(late).collect()
}

/// Round trips without the client's code: one write, then reads until the body is complete.
fn round_trips(socket: &Path) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut stream = UnixStream::connect(socket)?;
    let mut answer = vec![0; 1 << 16];
    (0..CALLS)
        .map(|_| {
            let begun = Instant::now();
            stream.write_all(b"GET /v1/status HTTP/1.1\r\nhost: x\r\n\r\n")?;
            let mut read = 0;
            // A status is one JSON object in one piece.
            while !answer[..read].ends_with(b"}") {
                read += stream.read(&mut answer[read..])?;
            }
            Ok(elapsed_us(begun))
        })
        .collect()
}

fn plays(client: &mut Client) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut events = client.events()?;
    let request = Order::new(Item { seconds: Some(0.05), ..Item::of("pin-60") }, Terms::default());
    let mut us = Vec::new();
    while us.len() < PLAYS {
        // Armed and idle for a while, as between two trials. The pauses differ, so that no rhythm helps.
        thread::sleep(Duration::from_millis(us.len() as u64 * 7 % 90));
        let _: Value = client.post("/v1/play", &request)?;
        while !matches!(events.next(TIMEOUT)?, None | Some(Event::Ended { .. })) {}
        let receipt: Receipt = client.get("/v1/plays/last")?;
        us.push(receipt.onset.map(|onset| onset.latency_ms).ok_or("a play has no onset")? * 1e3);
    }
    Ok(us)
}

fn stops(client: &mut Client) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut us = Vec::new();
    while us.len() < STOPS {
        let _: Value = client
            .post("/v1/play", &Order::new(Item::of("wave"), Terms { endless: true, ..Terms::default() }))?;
        thread::sleep(Duration::from_millis(20));
        let begun = Instant::now();
        let _: Status = client.post("/v1/estop", &json!({}))?;
        us.push(elapsed_us(begun));
        let _: Status = client.post("/v1/reset", &json!({}))?;
        let _: Status = client.post("/v1/arm", &json!({"assume_rest": true}))?;
    }
    Ok(us)
}
