//! A daemon on a mock behind a real pseudo-terminal plays, ends, hangs, dies, and loses its board.

use crate::harness::{Daemon, complaint, document, printed, wait_until};
use firmware_protocol::message::{Cause, State};
use meissner_api::{EndCause, PlayState, Receipt, Status};
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_client::estop_socket;
use meissner_stream::device::{PtyMock, WallMock};
use meissner_stream::time::HostInstant;
use meissner_test_support::assert_accounts;
use meissner_test_support::rig::{OFF, bursts_on_the_lines};
use rustix::process::Signal;
use serde_json::json;
use std::os::unix::fs::symlink;
use std::thread::sleep;
use std::time::Duration;

/// A board at the far end of a terminal. It survives the daemon and records its lines.
fn board() -> PtyMock {
    let mut mock =
        WallMock::new(Array::paper(), &SimulatedMotorsConfig::default(), HostInstant::now()).unwrap();
    mock.mock().record();
    PtyMock::spawn(mock).unwrap()
}

#[test]
fn a_session_over_a_terminal_plays_and_accounts() {
    let mut daemon = Daemon::on("pty");
    let status = printed(daemon.meissner().args(["status", "--json"]));
    assert!(status.contains("\"kind\":\"pty:/dev/pts/"), "{status}");
    // A machine that stands still makes strokes late, and then the command fails: they are in the account. If it stands still for
    // longer, the board does not answer: then again.
    wait_until(|| {
        let _ = daemon.meissner().args(["arm", "--assume-rest"]).output().unwrap();
        let play = ["play", "all-in-phase", "--seconds", "1", "--wait"];
        let play = daemon.meissner().args(play).output().unwrap();
        play.stderr.is_empty() && String::from_utf8(play.stdout).unwrap().contains("2880 planned")
    });
    let receipt = document(daemon.meissner().args(["receipt", "--json"]));
    assert_eq!(receipt["state"], "done", "{receipt}");
    assert_accounts(&receipt);
    begin_endless(&daemon);
    assert!(daemon.end().success() && !daemon.socket().exists());
}

/// A host watchdog timeout that a busy machine does not reach by itself.
const LEASE_MS: u32 = 2000;

/// A daemon with this host watchdog timeout on such a board in mid-play, its pins half way up.
fn in_mid_play(lease_ms: u32) -> (PtyMock, Daemon) {
    let board = board();
    let config = format!("lease_ms = {lease_ms}\n");
    let daemon = Daemon::with(&format!("serial:{}", board.path().display()), &config);
    // Without corrections each pin goes down by as many pulses as it went up.
    let request = json!({"pattern": "all-in-phase", "seconds": 60, "open_loop": true});
    // A machine that stands still delays the onset, loses the board or ends the play: then again.
    wait_until(|| {
        let mut client = daemon.armed();
        if client.post::<serde_json::Value>("/v1/play", &request).is_err() {
            return false;
        }
        let mut last = client.get::<Receipt>("/v1/plays/last").unwrap();
        while last.onset.is_none() && matches!(last.state, PlayState::Queued | PlayState::Running) {
            sleep(Duration::from_millis(5));
            last = client.get("/v1/plays/last").unwrap();
        }
        sleep(Duration::from_millis(500));
        last.onset.is_some() && client.get::<Status>("/v1/status").unwrap().play.is_some()
    });
    (board, daemon)
}

/// Asserts that all pins are back at rest, that every line is low, and that the controller reports one of these causes.
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

/// Asserts the same of the board of a daemon that has ended in mid-play.
///
/// On a machine that stands still the board does not answer in time: the daemon says so, and the board may first find that the daemon is gone.
/// If it stands still for as long as the host watchdog waits, the play is over before its daemon ends: then again.
fn assert_shut_down(ended: impl Fn() -> (PtyMock, Daemon)) {
    wait_until(|| {
        let (board, daemon) = ended();
        let log = daemon.log();
        if log.contains("the PC was silent") {
            return false;
        }
        let silent =
            ["the device does not answer", "device disconnected"].iter().any(|line| log.contains(line));
        let causes = [Cause::Shutdown, Cause::LinkLost];
        assert_returned(board, &causes[..if silent { 2 } else { 1 }]);
        true
    });
}

#[test]
fn a_daemon_killed_or_hanging_in_mid_play_leaves_a_board_that_returns_the_pins() {
    for (signal, causes) in
        [(Signal::KILL, &[Cause::LinkLost, Cause::HostTimeout][..]), (Signal::STOP, &[Cause::HostTimeout])]
    {
        let (board, daemon) = in_mid_play(LEASE_MS);
        daemon.signal(signal);
        sleep(Duration::from_millis(2 * u64::from(LEASE_MS)));
        daemon.signal(Signal::KILL);
        assert_returned(board, causes);
    }
}

/// Begins a play without end. A machine that stands still loses the board: then again.
fn begin_endless(daemon: &Daemon) {
    let request = json!({"pattern": "wave", "endless": true, "open_loop": true});
    let mut client = daemon.client();
    wait_until(|| {
        if client.get::<Status>("/v1/status").unwrap().play.is_some() {
            return true;
        }
        // Each is refused until the board has answered, and while the play begins.
        let _: Result<Status, _> = client.post("/v1/arm", &json!({"assume_rest": true}));
        let _: Result<serde_json::Value, _> = client.post("/v1/play", &request);
        false
    });
}

/// A board is unplugged in mid-play and another plugged in at the same name: the daemon connects to it, disarmed.
#[test]
fn a_board_that_is_plugged_in_again_is_found_and_disarmed() {
    let dir = tempfile::tempdir().unwrap();
    let name = dir.path().join("board");
    let first = board();
    symlink(first.path(), &name).unwrap();
    let daemon = Daemon::on(&format!("serial:{}", name.display()));
    begin_endless(&daemon);
    let until = |wanted: &dyn Fn(&Status) -> bool| {
        wait_until(|| wanted(&daemon.client().get("/v1/status").unwrap()));
    };
    drop(first);
    until(&|status| !status.is_connected());
    let receipt: Receipt = daemon.client().get("/v1/plays/last").unwrap();
    assert_eq!(receipt.cause.as_ref(), Some(&EndCause::Unplugged));
    let bursts = receipt.counts.bursts.unwrap();
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

/// SIGTERM in mid-play returns the pins, also after the sockets were removed: no command reaches the daemon then, and it plays on.
#[test]
fn a_daemon_whose_sockets_are_removed_plays_on_and_ends_well() {
    let ended = |are_removed: bool| {
        let (board, mut daemon) = in_mid_play(5000);
        let socket = daemon.socket();
        if are_removed {
            std::fs::remove_file(estop_socket(&socket)).unwrap();
            std::fs::remove_file(&socket).unwrap();
            assert!(complaint(daemon.meissner().arg("stop")).contains("no daemon"));
            sleep(Duration::from_millis(300));
        }
        assert!(daemon.end().success());
        assert!(!socket.exists());
        (board, daemon)
    };
    assert_shut_down(|| ended(false));
    assert_shut_down(|| ended(true));
}

/// The cables of two boards are swapped in mid-play: each daemon finds the other board, disarmed, and plays nothing on it by itself.
#[test]
fn two_boards_that_swap_places_are_disarmed() {
    let dir = tempfile::tempdir().unwrap();
    let boards = [board(), board()];
    let names = ["left", "right"].map(|name| dir.path().join(name));
    for (board, name) in boards.iter().zip(&names) {
        symlink(board.path(), name).unwrap();
    }
    let daemons = names.each_ref().map(|name| Daemon::on(&format!("serial:{}", name.display())));
    let boots = daemons.each_ref().map(|daemon| {
        begin_endless(daemon);
        let status: Status = daemon.client().get("/v1/status").unwrap();
        status.device.unwrap().boot
    });
    sleep(Duration::from_millis(500));
    // Each board loses its terminal, and its mock continues at a new one, like a cable that is moved from one port to another.
    let [left, right] = boards.map(|board| PtyMock::spawn(board.into_mock().unwrap()).unwrap());
    for (name, board) in names.iter().zip([&right, &left]) {
        std::fs::remove_file(name).unwrap();
        symlink(board.path(), name).unwrap();
    }
    for (daemon, other) in daemons.iter().zip([boots[1], boots[0]]) {
        wait_until(|| {
            let status: Status = daemon.client().get("/v1/status").unwrap();
            let boot = status.device.as_ref().map(|device| device.boot);
            status.is_connected() && boot == Some(other) && status.state == "disarmed"
        });
        let receipt: Receipt = daemon.client().get("/v1/plays/last").unwrap();
        assert!(receipt.cause.is_some(), "{receipt:?}");
        let bursts = receipt.counts.bursts.unwrap();
        assert_eq!(bursts.planned, bursts.played + bursts.late + bursts.dropped + bursts.refused);
    }
    let logs = daemons.map(|daemon| daemon.log());
    for board in [left, right] {
        let mut wall = board.into_mock().unwrap();
        let controller = wall.mock().controller();
        let (state, cause) = (controller.state(), controller.cause());
        let trace = wall.mock().take_trace();
        let played = bursts_on_the_lines(&trace);
        assert!(played.pulses > 0);
        // A daemon that distrusts its device stops it at once: then pins stay up until the next `arm`.
        assert_eq!(played.net, [0; 24], "{state:?} {cause:?} {logs:#?}");
        assert_eq!(trace.last().unwrap().1.lines, OFF);
    }
}
