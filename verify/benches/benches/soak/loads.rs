//! The loads of a busy lab PC.

use meissner_api::Rendering;
use meissner_benches::loads::window;
use meissner_client::Client;
use serde_json::json;
use std::hint::black_box;
use std::io::{Seek, SeekFrom, Write as _};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

/// A load: it runs until the flag is set.
type Load = fn(&Place, &AtomicBool);

/// The loads, one after the other.
pub(crate) const PHASES: [(&str, Load); 8] = [
    ("idle", |_, _| {}),
    ("four busy loops", busy),
    ("files written and synced", writes),
    ("2 GB touched and given back", touches),
    ("programs started", starts),
    ("24 windows of the page", windows),
    ("renderings", renderings),
    ("all of these", everything),
];

/// What the loads need to know.
pub(crate) struct Place {
    pub(crate) dir: PathBuf,
    pub(crate) socket: PathBuf,
    pub(crate) tcp: SocketAddr,
}

/// Calls a step until the load is over.
pub(crate) fn repeat(over: &AtomicBool, mut step: impl FnMut()) {
    while !over.load(Ordering::Relaxed) {
        step();
    }
}

fn busy(_: &Place, over: &AtomicBool) {
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| repeat(over, || _ = (0..10_000_u64).map(black_box).count()));
        }
    });
}

fn writes(place: &Place, over: &AtomicBool) {
    let Ok(mut file) = tempfile::tempfile_in(&place.dir) else { return };
    let block = vec![0x5a; 1 << 20];
    repeat(over, || {
        for _ in 0..256 {
            if over.load(Ordering::Relaxed) || file.write_all(&block).is_err() {
                break;
            }
        }
        let _ = file.sync_all();
        let _ = file.seek(SeekFrom::Start(0));
        let _ = file.set_len(0);
    });
}

fn touches(_: &Place, over: &AtomicBool) {
    repeat(over, || {
        let mut pages = Vec::new();
        for _ in 0..2_000 {
            if over.load(Ordering::Relaxed) {
                break;
            }
            pages.push(black_box(vec![1_u8; 1_000_000]));
        }
    });
}

fn starts(_: &Place, over: &AtomicBool) {
    thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| {
                repeat(over, || {
                    let _ =
                        Command::new("sh").args(["-c", "ls / | sort | wc"]).stdout(Stdio::null()).status();
                });
            });
        }
    });
}

fn windows(place: &Place, over: &AtomicBool) {
    let bytes = AtomicU64::new(0);
    thread::scope(|scope| {
        for number in 0..48 {
            let bytes = &bytes;
            scope.spawn(move || repeat(over, || _ = window(place.tcp, number % 2 == 0, over, bytes)));
        }
    });
}

fn renderings(place: &Place, over: &AtomicBool) {
    repeat(over, || {
        let begun = Client::new(&place.socket).ok().and_then(|mut client| {
            client.post::<Rendering>("/v1/renderings", &json!({"object": "rotating-edge"})).ok()
        });
        thread::sleep(Duration::from_millis(if begun.is_some() { 5_000 } else { 500 }));
    });
}

fn everything(place: &Place, over: &AtomicBool) {
    thread::scope(|scope| {
        for load in [busy, writes, touches, starts, windows, renderings] {
            scope.spawn(move || load(place, over));
        }
    });
}
