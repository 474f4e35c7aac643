use crate::harness::{Daemon, printed};
use crate::rig::{OFF, bursts_on_the_lines};
use firmware_protocol::message::{Cause, State};
use meissner::device::{PtyMock, WallMock};
use meissner::plant::PlantConfig;
use meissner::record::Receipt;
use meissner::units::HostInstant;
use rustix::process::Signal;
use serde_json::json;
use std::thread::sleep;
use std::time::Duration;

/// A board of our own at the far end of a terminal: it outlives the daemon, and tells what its lines did.
fn board() -> PtyMock {
    let mut mock = WallMock::new(&PlantConfig::default(), HostInstant::now()).unwrap();
    mock.mock().record();
    PtyMock::spawn(mock).unwrap()
}

#[test]
fn a_session_over_a_terminal_plays_and_accounts() {
    let daemon = Daemon::on("pty");
    printed(daemon.meissner().args(["arm", "--assume-rest"]));
    let summary = printed(daemon.meissner().args(["play", "all-in-phase", "--seconds", "1", "--wait"]));
    assert!(summary.contains("2880 planned"), "{summary}");
    let receipt: Receipt = daemon.client().get("/v1/plays/last").unwrap();
    let bursts = receipt.bursts.unwrap();
    assert_eq!(bursts.planned, bursts.played + bursts.late + bursts.dropped + bursts.refused);
    let status = printed(daemon.meissner().args(["status", "--json"]));
    assert!(status.contains("\"kind\":\"pty:/dev/pts/"), "{status}");
    printed(daemon.meissner().arg("disarm"));
}

/// A daemon on a board of ours in mid-play, its pins half way.
fn in_mid_play() -> (PtyMock, Daemon) {
    let board = board();
    let daemon = Daemon::with(&format!("serial:{}", board.path().display()), "lease_ms = 600\n");
    let mut client = daemon.armed();
    // Without corrections each pin comes down as far as it went up, to the pulse.
    let request = json!({"pattern": "all-in-phase", "seconds": 60, "open_loop": true});
    let _: serde_json::Value = client.post("/v1/play", &request).unwrap();
    sleep(Duration::from_millis(500));
    (board, daemon)
}

/// All pins are back, every line is low, and the controller knows why.
fn assert_returned(board: PtyMock, causes: &[Cause]) {
    let mut wall = board.unwrap_mock().unwrap();
    let mock = wall.mock();
    let trace = mock.take_trace();
    let played = bursts_on_the_lines(&trace);
    assert!(played.pulses > 10_000, "{played:?}");
    assert_eq!(played.net, [0; 24]);
    assert_eq!(trace.last().unwrap().1.lines, OFF);
    assert_eq!(mock.controller().state(), State::Disarmed);
    assert!(causes.contains(&mock.controller().cause()), "{:?}", mock.controller().cause());
}

#[test]
fn a_daemon_told_to_end_in_mid_play_returns_the_pins() {
    let (board, mut daemon) = in_mid_play();
    daemon.signal(Signal::TERM);
    assert!(daemon.wait().success());
    assert!(!daemon.socket().exists());
    assert_returned(board, &[Cause::Shutdown]);
}

#[test]
fn a_daemon_killed_in_mid_play_leaves_a_board_that_returns_the_pins() {
    let (board, mut daemon) = in_mid_play();
    daemon.signal(Signal::KILL);
    daemon.wait();
    sleep(Duration::from_millis(600));
    assert_returned(board, &[Cause::LinkLost, Cause::Lease]);
}

#[test]
fn a_daemon_that_hangs_in_mid_play_leaves_a_board_that_returns_the_pins() {
    let (board, daemon) = in_mid_play();
    daemon.signal(Signal::STOP);
    sleep(Duration::from_millis(1500));
    daemon.signal(Signal::KILL);
    assert_returned(board, &[Cause::Lease]);
}
