//! A daemon on a mock behind a real pseudo-terminal: it plays, ends, hangs, dies, and loses its board.

use crate::harness::{Daemon, assert_accounts, complaint, document, printed, wait_until};
use firmware_protocol::message::{Cause, State};
use meissner_api::{Receipt, Status};
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_stream::device::{PtyMock, WallMock};
use meissner_stream::time::HostInstant;
use meissner_test_support::rig::{OFF, bursts_on_the_lines};
use rustix::process::Signal;
use serde_json::json;
use std::os::unix::fs::symlink;
use std::thread::sleep;
use std::time::Duration;

/// A board at the far end of a terminal. It survives the daemon and records its lines.
fn board() -> PtyMock {
    let mut mock = WallMock::new(&SimulatedMotorsConfig::default(), HostInstant::now()).unwrap();
    mock.mock().record();
    PtyMock::spawn(mock).unwrap()
}

#[test]
fn a_session_over_a_terminal_plays_and_accounts() {
    let mut daemon = Daemon::on("pty");
    let status = printed(daemon.meissner().args(["status", "--json"]));
    assert!(status.contains("\"kind\":\"pty:/dev/pts/"), "{status}");
    printed(daemon.meissner().args(["arm", "--assume-rest"]));
    let summary = printed(daemon.meissner().args(["play", "all-in-phase", "--seconds", "1", "--wait"]));
    assert!(summary.contains("2880 planned"), "{summary}");
    let receipt = document(daemon.meissner().args(["receipt", "--json"]));
    assert_eq!(receipt["state"], "done", "{receipt}");
    assert_accounts(&receipt);
    printed(daemon.meissner().args(["play", "wave", "--endless"]));
    assert!(daemon.end().success() && !daemon.socket().exists());
}

/// A daemon on such a board in mid-play, its pins half way up.
fn in_mid_play() -> (PtyMock, Daemon) {
    let board = board();
    let daemon = Daemon::with(&format!("serial:{}", board.path().display()), "lease_ms = 600\n");
    let mut client = daemon.armed();
    // Without corrections each pin goes down by as many pulses as it went up.
    let request = json!({"pattern": "all-in-phase", "seconds": 60, "open_loop": true});
    let _: serde_json::Value = client.post("/v1/play", &request).unwrap();
    sleep(Duration::from_millis(500));
    (board, daemon)
}

/// All pins are back at rest, every line is low, and the controller gives one of these causes.
fn assert_returned(board: PtyMock, causes: &[Cause]) {
    let mut wall = board.into_mock().unwrap();
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
fn a_daemon_that_ends_in_mid_play_returns_the_pins() {
    let (board, mut daemon) = in_mid_play();
    assert!(daemon.end().success());
    assert!(!daemon.socket().exists());
    assert_returned(board, &[Cause::Shutdown]);
}

#[test]
fn a_daemon_killed_in_mid_play_leaves_a_board_that_returns_the_pins() {
    let (board, mut daemon) = in_mid_play();
    daemon.signal(Signal::KILL);
    daemon.wait();
    sleep(Duration::from_millis(600));
    assert_returned(board, &[Cause::LinkLost, Cause::HostTimeout]);
}

#[test]
fn a_daemon_that_hangs_in_mid_play_leaves_a_board_that_returns_the_pins() {
    let (board, daemon) = in_mid_play();
    daemon.signal(Signal::STOP);
    sleep(Duration::from_millis(1500));
    daemon.signal(Signal::KILL);
    assert_returned(board, &[Cause::HostTimeout]);
}

/// A board is unplugged in mid-play and another plugged in at the same name: the daemon connects to it, disarmed.
#[test]
fn a_board_that_is_plugged_in_again_is_found_and_disarmed() {
    let dir = tempfile::tempdir().unwrap();
    let name = dir.path().join("board");
    let first = board();
    symlink(first.path(), &name).unwrap();
    let daemon = Daemon::on(&format!("serial:{}", name.display()));
    let mut client = daemon.armed();
    let _: serde_json::Value = client.post("/v1/play", &json!({"pattern": "wave", "endless": true})).unwrap();
    let until = |wanted: &dyn Fn(&Status) -> bool| {
        wait_until(|| wanted(&daemon.client().get("/v1/status").unwrap()));
    };
    until(&|status| status.play.is_some());
    drop(first);
    until(&|status| !status.is_connected());
    let receipt: Receipt = client.get("/v1/plays/last").unwrap();
    assert_eq!(receipt.cause.as_deref(), Some("the device was unplugged"));
    let bursts = receipt.bursts.unwrap();
    assert_eq!(bursts.planned, bursts.played + bursts.late + bursts.dropped + bursts.refused);

    let second = board();
    std::fs::remove_file(&name).unwrap();
    symlink(second.path(), &name).unwrap();
    until(&|status| status.is_connected() && status.state == "disarmed");
    assert!(daemon.log().matches("not there").count() <= 1, "once per reason: {}", daemon.log());
    let refused = complaint(daemon.meissner().args(["play", "wave", "--endless"]));
    assert!(refused.contains("disarmed"), "{refused}");
    let mut wall = second.into_mock().unwrap();
    assert!(wall.mock().take_trace().iter().all(|(_, run)| run.lines == OFF));
}
