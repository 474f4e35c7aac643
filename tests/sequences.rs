//! Orders of many items through the command line.

use crate::harness::{Daemon, complaint, document, printed};
use assert_cmd::Command;
use std::fs;

pub(crate) fn the_command_plays_a_file_and_prints_the_receipt(daemon: &Daemon) {
    daemon.armed();
    let file = daemon.path("block.toml");
    let text = "name = \"block\"\n[[items]]\npattern = \"pin-60\"\nseconds = 0.1\ntrigger.code = 7\n[[items]]\npattern = \"pin-60\"\nseconds = 0.1\ngap_ms = 100\n";
    fs::write(&file, text).unwrap();
    let run = |arguments: &[&str]| {
        let mut command: Command = daemon.meissner();
        command.arg("play").args(arguments);
        command
    };
    let receipt = document(&mut run(&["block.toml", "--wait", "--json"]));
    assert_eq!(receipt["items"][0]["trigger"]["code"], 7);
    assert_eq!(receipt["items"][1]["state"], "played");
    let text = printed(run(&["-", "--wait", "--at", "+50"]).write_stdin(fs::read_to_string(&file).unwrap()));
    assert!(text.contains("items") && text.contains("2: 2 played, 0 incomplete"), "{text}");
    let jump = "[[items]]\npattern.ramp = [{motor = 9, to_um = 100.0, rise_s = 0.0, hold_s = 0.2}]\n";
    for (text, arguments, says) in [
        ("[[items]]\npattern = \"pin-60\"\nsecods = 1\n", &[][..], "did you mean `seconds`?"),
        (jump, &["--strict"], "motor 9 is too slow for its motion"),
    ] {
        fs::write(&file, text).unwrap();
        let refused = complaint(run(&["block.toml"]).args(arguments));
        assert!(refused.contains(says), "{refused}");
    }
    // A file of a pattern is played as it is; an object is none.
    fs::write(
        &file,
        "format = 1\nname = \"tap\"\n[[drive]]\nmotor = 9\nfrequency_hz = 60.0\namplitude_um = 40.0\n",
    )
    .unwrap();
    let tap = document(&mut run(&["block.toml", "--seconds", "0.1", "--wait", "--json"]));
    assert_eq!((&tap["name"], &tap["duration_ms"]["ordered"]), (&"tap".into(), &100.0.into()));
    fs::write(&file, "shape = \"dots\"\n").unwrap();
    let refused = complaint(&mut run(&["block.toml"]));
    assert!(refused.contains("this is an object, not a pattern: make a pattern of it"), "{refused}");
    let play = "play pin-60 --seconds 0.1 --scale 0.5 --code 9 --wait";
    let text = printed(daemon.meissner().args(play.split(' ')));
    assert!(text.contains("code 9 of 4.00 ms at tick"), "{text}");
}
