//! `meissner live` against a real daemon: the command reads files line by line, so that the test can count every message, and pipes
//! as their lines come.

use crate::harness::{Daemon, PROGRAM, complaint, ended, meissner, wait_until};
use meissner_api::{EndCause, Receipt, Status};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::json;
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::thread;
use std::time::Duration;

/// A timeout that a stall of a busy machine does not reach.
const PATIENT: [&str; 2] = ["--timeout-ms", "20000"];

/// The command, following stdin.
fn live(daemon: &Daemon, args: &[&str], stdin: Stdio) -> Child {
    live_into(daemon, args, stdin, Stdio::piped())
}

/// The same with another stdout.
fn live_into(daemon: &Daemon, args: &[&str], stdin: Stdio, stdout: Stdio) -> Child {
    let mut command = Command::new(PROGRAM);
    command.args(["live", "--follow", "stdin"]).args(args);
    command.env("MEISSNER_SOCKET", daemon.socket()).env("XDG_RUNTIME_DIR", daemon.path(""));
    command.env_remove("MEISSNER_SESSION_TOKEN").current_dir(daemon.path(""));
    command.stdin(stdin).stdout(stdout).stderr(Stdio::piped()).spawn().unwrap()
}

/// The command with these lines in a file.
fn follow_file(daemon: &Daemon, args: &[&str], lines: &[String]) -> (i32, String, String) {
    fs::write(daemon.path("lines"), lines.join("\n")).unwrap();
    let file = File::open(daemon.path("lines")).unwrap();
    let mut child = live(daemon, &[args, &PATIENT].concat(), file.into());
    let out = child.stdout.take().unwrap();
    said(child, out)
}

/// The command with a pipe whose first line was written, when its play has begun.
struct Piped {
    child: Child,
    input: ChildStdin,
    out: BufReader<ChildStdout>,
    id: u64,
}

impl Piped {
    fn start(daemon: &Daemon, args: &[&str], first: &str) -> Self {
        let mut child = live(daemon, args, Stdio::piped());
        // Take it out of the child, whose `wait` would close it.
        let mut input = child.stdin.take().unwrap();
        writeln!(input, "{first}").unwrap();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        out.read_line(&mut line).unwrap();
        let id = line.strip_prefix("play ").and_then(|rest| rest.split_once(": ")).map(|(id, _)| id);
        assert!(line.contains("follows stdin; Ctrl-C ends it"), "{line}");
        Self { child, input, out, id: id.unwrap().parse().unwrap() }
    }

    fn write(&mut self, text: &str) {
        self.input.write_all(text.as_bytes()).unwrap();
    }

    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Waits for its end, with its input open: the exit code, the rest of stdout, stderr.
    fn wait(self) -> (i32, String, String) {
        let Self { child, input, out, .. } = self;
        let said = said(child, out);
        drop(input);
        said
    }

    /// Ends its input.
    fn end(self) -> (i32, String, String) {
        drop(self.input);
        said(self.child, self.out)
    }
}

fn said(mut child: Child, mut stdout: impl Read) -> (i32, String, String) {
    let code = child.wait().unwrap().code().unwrap();
    let (mut out, mut err) = (String::new(), String::new());
    stdout.read_to_string(&mut out).unwrap();
    child.stderr.take().unwrap().read_to_string(&mut err).unwrap();
    (code, out, err)
}

fn receipt(daemon: &Daemon, id: u64) -> Receipt {
    daemon.client().get(&format!("/v1/plays/{id}")).unwrap()
}

fn is_playing(daemon: &Daemon) -> bool {
    daemon.client().get::<Status>("/v1/status").unwrap().play.is_some()
}

fn drive(frequency_hz: f64, amplitude_um: f64) -> String {
    let drive = json!({"motor": 9, "frequency_hz": frequency_hz, "amplitude_um": amplitude_um});
    json!({"drives": [drive]}).to_string()
}

#[test]
fn a_file_of_poses_presses_an_object() {
    let daemon = Daemon::start();
    daemon.armed();
    let text = "kind = \"object\"\nname = \"bar\"\nshape = \"bar\"\nlength_mm = 12\nwidth_mm = 0.8\n\
                [touch]\npress = { depth_um = 500 }\n";
    fs::write(daemon.path("bar.toml"), text).unwrap();
    let mut lines = ["0 0", "0 2.9 10", "0 2.9 10 300", "0 2.9 10 0"].map(str::to_owned).to_vec();
    lines.extend([json!({"end": true}).to_string(), "what follows the end is not read".to_owned()]);
    let args = ["--object", "bar.toml", "--trial", "7", "--label", "what=file", "--code", "9"];
    let (code, out, err) = follow_file(&daemon, &args, &lines);
    assert_eq!((code, err.as_str()), (0, ""), "{out}");
    assert!(out.starts_with("play 1: bar.toml follows stdin; Ctrl-C ends it\nplay "), "{out}");
    let shown = receipt(&daemon, 1);
    let live = shown.live.unwrap();
    // The first line is a message, too.
    assert_eq!((live.updates, live.applied, live.merged), (4, 4, 0));
    assert_eq!((shown.trial, shown.labels["what"].as_str()), (Some(7), "file"));
    assert_eq!((shown.trigger.unwrap().code, shown.cause.as_ref()), (Some(9), Some(&EndCause::Stop)));
    fs::write(daemon.path("bad.toml"), text.replace("length_mm", "lenght_mm")).unwrap();
    for (object, says) in [
        ("./bad.toml", "lenght_mm"),
        ("nothing", "nothing"),
        ("moving-edge", "moves by itself: poses move a live object"),
    ] {
        let mut command = daemon.meissner();
        let bad =
            complaint(command.args(["live", "--object", object, "--follow", "stdin"]).write_stdin("0 0\n"));
        assert!(bad.contains(says) && bad.lines().count() == 1, "{bad}");
    }
}

#[test]
fn lines_of_drives_play_without_an_object_and_refused_ones_are_counted() {
    let daemon = Daemon::start();
    daemon.armed();
    // The first line allows 100 Hz.
    let lines =
        [drive(100.0, 40.0), drive(80.0, 60.0), drive(150.0, 1.0), drive(100.0, 20.0), drive(101.0, 2.0)];
    let (code, out, err) = follow_file(&daemon, &["--json"], &lines);
    let shown: Receipt = serde_json::from_str(&out).unwrap();
    assert_eq!((code, shown.live.unwrap().applied), (1, 3), "{err}");
    let lines: Vec<&str> = err.lines().collect();
    assert!(lines[0].starts_with("update 3 was refused: ") && lines[0].contains("at most 100 Hz"), "{err}");
    assert_eq!(lines[1..], ["one more update was refused"]);
    // Lines are poses with --object, and drives without it.
    let (code, _, err) = follow_file(&daemon, &[], &["0 0".to_owned()]);
    assert_eq!((code, err.contains("stdin: line 1: a pose moves an object: name an --object")), (1, true));
}

#[test]
fn pins_follow_levels_line_by_line() {
    let daemon = Daemon::start();
    daemon.armed();
    let lines = ["0 100", "50.5,100", "", "{\"um\": {\"9\": 40}, \"glide_ms\": 0}", "0 0"].map(str::to_owned);
    // Slow enough that no line gives way to the next.
    let args = ["--levels", "9,10", "--glide-ms", "5", "--updates-hz", "5", "--open-loop", "--json"];
    let (code, out, err) = follow_file(&daemon, &args, &lines);
    assert_eq!((code, err.as_str()), (0, ""), "{out}");
    let shown: Receipt = serde_json::from_str(&out).unwrap();
    let (updates, bursts) = (shown.live.unwrap(), shown.bursts.unwrap());
    assert_eq!((updates.updates, updates.applied, bursts.late + bursts.dropped), (4, 4, 0), "{updates:?}");
    // Every line of levels is an update; the empty one is none.
    let motors: Vec<u8> = shown.pins.unwrap().iter().map(|pin| pin.motor).collect();
    assert_eq!((motors, shown.cause.as_ref()), (vec![9, 10], Some(&EndCause::Stop)));
    assert!(bursts.played >= 6, "{bursts:?}");
    // What the lines cannot be.
    let (code, _, err) = follow_file(&daemon, &["--levels", "9,10"], &["0 1 2".to_owned()]);
    assert!(
        code == 1 && err.contains("line 1: `0 1 2` is not levels") && err.contains("motors 9,10"),
        "{err}"
    );
    let (code, _, err) = follow_file(&daemon, &["--levels", "9,9"], &[]);
    assert!(code == 1 && err.contains("--levels has motor 9 twice"), "{err}");
    let (code, _, err) = follow_file(&daemon, &["--levels", "9,24"], &[]);
    assert!(code == 1 && err.contains("motor 24: the array has motors 0 to 23"), "{err}");
}

#[test]
fn levels_that_stop_coming_end_the_play() {
    let daemon = Daemon::start();
    daemon.armed();
    let args = ["--levels", "9", "--timeout-ms", "300", "--open-loop"];
    let piped = Piped::start(&daemon, &args, "120");
    let id = piped.id;
    let (code, _, err) = piped.wait();
    assert!(code == 1 && err.contains("stdin was silent for longer than 300 ms"), "{err}");
    let receipt = receipt(&daemon, id);
    assert_eq!(receipt.cause.as_ref(), Some(&EndCause::ClientSilent));
    // The pin went up, and has come down.
    let [pin] = &receipt.pins.unwrap()[..] else { panic!("one pin") };
    assert_eq!(pin.motor, 9);
    assert_eq!(daemon.client().get::<Status>("/v1/status").unwrap().state, "armed");
}

#[test]
fn a_pipe_gives_its_newest_line() {
    let daemon = Daemon::start();
    daemon.armed();
    let mut child = live(&daemon, &[&PATIENT[..], &["--json"]].concat(), Stdio::piped());
    // One write that the system does not divide.
    let lines: String = (0..40).map(|n| format!("{}\n", drive(60.0, f64::from(n)))).collect();
    assert!(lines.len() < 4096);
    child.stdin.take().unwrap().write_all(lines.as_bytes()).unwrap();
    let out = child.stdout.take().unwrap();
    let (code, out, err) = said(child, out);
    assert_eq!((code, err.as_str()), (0, ""));
    let shown: Receipt = serde_json::from_str(&out).unwrap();
    assert_eq!(shown.live.unwrap().updates, 1, "the first line is the play's, 38 gave way to the last one");
}

#[test]
fn a_bad_line_ends_the_play_and_says_where() {
    let daemon = Daemon::start();
    daemon.armed();
    let mut piped = Piped::start(&daemon, &PATIENT, &drive(60.0, 40.0));
    let id = piped.id;
    piped.write(&format!("{}\n\n1 2 x\n{}\n", drive(60.0, 50.0), drive(60.0, 60.0)));
    let (code, out, err) = piped.wait();
    assert_eq!(code, 1);
    assert_eq!(
        err,
        "meissner: stdin: line 4: `1 2 x` is not a pose: write X_MM Y_MM [DEGREES], or a JSON object\n"
    );
    assert!(out.contains("state") && out.contains("updates"), "the receipt: {out}");
    assert_eq!((receipt(&daemon, id).cause.as_ref(), is_playing(&daemon)), (Some(&EndCause::Stop), false));
    // After a bad first line nothing was played.
    let first = complaint(
        daemon.meissner().args(["live", "--object", "edge-45", "--follow", "stdin"]).write_stdin("x,y\n"),
    );
    assert!(first.contains("stdin: line 1: `x,y` is not a pose"), "{first}");
    let none = complaint(
        daemon.meissner().args(["live", "--object", "edge-45", "--follow", "stdin"]).write_stdin("\n\n"),
    );
    assert!(none.contains("stdin: ends before its first line"), "{none}");
    assert_eq!(daemon.client().get::<Receipt>("/v1/plays/last").unwrap().id, id);
}

/// Whether a process has a handler for SIGTERM.
fn catches_sigterm(pid: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap();
    u64::from_str_radix(caught.trim(), 16).unwrap() >> (Signal::TERM.as_raw() - 1) & 1 == 1
}

#[test]
fn signals_end_the_play_and_print_the_receipt() {
    let daemon = Daemon::start();
    daemon.armed();
    for (signal, code) in [(Signal::INT, 130), (Signal::TERM, 143), (Signal::HUP, 129)] {
        let piped = Piped::start(&daemon, &PATIENT, &drive(60.0, 40.0));
        let id = piped.id;
        piped.signal(signal);
        let (exit, out, err) = piped.wait();
        assert_eq!((exit, err.as_str()), (code, ""));
        assert!(out.contains(&format!("{id} of live\n")) && out.contains("\nupdates "), "the receipt: {out}");
        assert_eq!(
            (receipt(&daemon, id).cause.as_ref(), is_playing(&daemon)),
            (Some(&EndCause::Stop), false)
        );
    }
    // Before the first line there is no play to end.
    let last = daemon.client().get::<Receipt>("/v1/plays/last").unwrap().id;
    let mut child = live(&daemon, &PATIENT, Stdio::piped());
    let input = child.stdin.take();
    wait_until(|| catches_sigterm(child.id()));
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    let output = child.wait_with_output().unwrap();
    drop(input);
    assert_eq!((output.status.code(), output.stdout.as_slice()), (Some(143), b"".as_slice()));
    assert_eq!(daemon.client().get::<Receipt>("/v1/plays/last").unwrap().id, last);
}

#[test]
fn a_play_that_the_daemon_ends_says_why() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    let mut ended_by = |path: &str| {
        let piped = Piped::start(&daemon, &PATIENT, &drive(60.0, 40.0));
        let id = piped.id;
        let _: Status = client.post(path, &json!({})).unwrap();
        let (code, out, err) = piped.wait();
        assert!(code == 1 && out.contains("of live") && err.lines().count() == 1, "{code} {out} {err}");
        err.replace(&format!("play {id} "), "play ")
    };
    assert_eq!(ended_by("/v1/stop"), "meissner: play was ended: another client stopped it\n");
    let estop = "meissner: play was ended: an emergency stop; find out why, then `meissner reset`\n";
    assert_eq!(ended_by("/v1/estop"), estop);
    // After an emergency stop no play can begin.
    let faulted =
        complaint(daemon.meissner().args(["live", "--follow", "stdin"]).write_stdin(drive(60.0, 40.0)));
    assert!(faulted.contains("reset"), "{faulted}");
}

#[test]
fn a_daemon_that_is_killed_ends_the_command() {
    let mut daemon = Daemon::start();
    daemon.armed();
    let piped = Piped::start(&daemon, &PATIENT, &drive(60.0, 40.0));
    let id = piped.id;
    daemon.signal(Signal::KILL);
    daemon.wait();
    let (code, out, err) = piped.wait();
    assert_eq!((code, out.as_str()), (1, ""));
    assert_eq!(err, format!("meissner: the daemon ended while play {id} was running: see its log\n"));
}

#[test]
fn a_silent_pipe_ends_the_play_unless_it_is_kept_alive() {
    let daemon = Daemon::start();
    daemon.armed();
    let silent = Piped::start(&daemon, &["--timeout-ms", "300"], &drive(60.0, 40.0));
    let id = silent.id;
    let (code, _, err) = silent.wait();
    assert!(code == 1 && err.contains("stdin was silent for longer than 300 ms; --timeout-ms"), "{err}");
    assert_eq!(receipt(&daemon, id).cause.as_ref(), Some(&EndCause::ClientSilent));
    let kept = Piped::start(&daemon, &["--timeout-ms", "3000", "--keep-alive"], &drive(60.0, 40.0));
    let id = kept.id;
    // This is longer than the daemon waits for a first message, and longer than the allowed silence.
    thread::sleep(Duration::from_millis(4000));
    assert!(is_playing(&daemon));
    let (code, _, err) = kept.end();
    assert_eq!((code, err.as_str()), (0, ""));
    let updates = receipt(&daemon, id).live.unwrap();
    assert!(updates.updates >= 3 && updates.applied == updates.updates, "{updates:?}");
}

/// No separate thread sends signs of life, so if the command cannot write its first line, the play ends.
#[test]
fn a_command_that_hangs_ends_its_play() {
    let daemon = Daemon::start();
    daemon.armed();
    let mut events = daemon.client().events().unwrap();
    let (mut reader, mut full) = std::io::pipe().unwrap();
    // A pipe takes 64 KiB, which nobody reads.
    full.write_all(&[b' '; 1 << 16]).unwrap();
    let args = ["--timeout-ms", "500", "--keep-alive"];
    let mut child = live_into(&daemon, &args, Stdio::piped(), full.into());
    let mut input = child.stdin.take().unwrap();
    writeln!(input, "{}", drive(60.0, 40.0)).unwrap();
    assert_eq!(ended(&mut events).cause.as_ref(), Some(&EndCause::ClientSilent));
    let reading = thread::spawn(move || {
        let mut out = String::new();
        reader.read_to_string(&mut out).map(|_| out)
    });
    let (code, _, err) = said(child, std::io::empty());
    assert!(code == 1 && err.contains("the daemon heard nothing for 500 ms"), "{code} {err}");
    assert!(reading.join().unwrap().unwrap().contains("follows stdin"));
}

/// Signs of life are more frequent than updates.
#[test]
fn a_slow_file_is_played_to_its_end() {
    let daemon = Daemon::start();
    daemon.armed();
    fs::write(daemon.path("lines"), [10.0, 20.0, 30.0].map(|um| drive(60.0, um)).join("\n")).unwrap();
    let file = File::open(daemon.path("lines")).unwrap();
    let args = ["--timeout-ms", "3000", "--updates-hz", "1", "--json"];
    let mut child = live(&daemon, &args, file.into());
    let out = child.stdout.take().unwrap();
    let (code, out, err) = said(child, out);
    assert_eq!((code, err.as_str()), (0, ""), "{out}");
    let receipt: Receipt = serde_json::from_str(&out).unwrap();
    assert!(receipt.cut_after_ms.unwrap() > 1_500.0, "each update lasts: {:?}", receipt.cut_after_ms);
}

#[test]
fn mistakes_are_refused_before_anything_moves() {
    let live = |args: &[&str]| {
        let mut command = meissner();
        command.args(["live", "--follow"]).args(args);
        command
    };
    let refused = |args: &[&str], says: &str| {
        let line = complaint(&mut live(args));
        assert!(line.contains(says), "{args:?}: {line}");
    };
    refused(&["stdin"], "no daemon answers");
    refused(&["stdin", "--updates-hz", "0"], "`updates_hz` is 0: must be 1 to 1000 Hz");
    refused(&["stdin", "--timeout-ms", "10"], "`timeout_ms` is 10");
    refused(
        &["evdev:/nonexistent", "--object", "edge-45"],
        "/nonexistent: cannot be opened as an input device",
    );
    refused(&["evdev:/dev/null", "--object", "edge-45"], "/dev/null: cannot be opened as an input device");
    for (args, says) in [
        (&["mouse"][..], "name an --object"),
        (&["trackball", "--object", "edge-45"], "must be stdin, mouse, or evdev:"),
    ] {
        let output = live(args).assert().code(2).get_output().clone();
        let err = String::from_utf8(output.stderr).unwrap();
        assert!(err.contains(says), "{args:?}: {err}");
    }
}
