//! What ends a play: e-stops, lost links, other hosts and failures of the core. The pins do what the device says, and play again.

use crate::play::{armed, armed_with, job, pattern};
use firmware_protocol::frame::{MAX_FRAME, encode};
use firmware_protocol::message::{Cause, HostMessage, State, Status};
use firmware_protocol::tick::Tick;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::bench::{CpuEvent, Function};
use meissner_hil::judge::outcomes;
use meissner_hil::rig::{Rig, RigOptions};
use meissner_hil::time::{MS, TICK};
use meissner_stream::queues::{Command, StreamEvent};

/// Ticks of 400 ms: whole periods at 60 Hz, and at 300 Hz.
const LATER: u64 = 34_000;

/// A rig in the middle of a play, so many ticks and cycles after [`LATER`].
fn playing(name: &str, ticks: u64, cycles: u64) -> Rig {
    let mut rig = armed(ChipOptions::new(1));
    rig.order(job(&pattern(name), 1.0));
    rig.run_to(rig.now() + 300 * MS).unwrap();
    let at = rig.grid().cycle(rig.tap().onsets()[0] + LATER + ticks) + cycles;
    rig.run_to(at).unwrap();
    rig
}

fn run(rig: &mut Rig, ms: u64) {
    rig.run_to(rig.now() + ms * MS).unwrap();
}

/// Orders it, and tells whether it was carried out.
fn obeys(rig: &mut Rig, command: Command) -> bool {
    let ticket = rig.order(command);
    run(rig, 100);
    let answer = rig.notices.iter().find_map(|notice| match notice {
        StreamEvent::Answer { ticket: of, result } if *of == ticket => Some(result.is_ok()),
        _ => None,
    });
    answer.expect("an answer")
}

fn status(rig: &Rig) -> Status {
    rig.tap().status().unwrap()
}

fn half_frame() -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let len = encode(&HostMessage::Ping { token: 0, seen: 0 }, &mut frame).unwrap();
    frame[..len / 2].to_vec()
}

/// Arms, plays the pattern once more, whole, and judges the pins of all.
fn plays_again(mut rig: Rig, name: &str, assume_rest: bool) {
    assert!(obeys(&mut rig, Command::Arm { assume_rest }), "{name}");
    let Status { state, outstanding, .. } = status(&rig);
    assert_eq!((state, outstanding), (State::Armed, 0), "{name}");
    let ended = outcomes(&rig.notices).count();
    rig.order(job(&pattern(name), 0.2));
    run(&mut rig, 500);
    let bursts = outcomes(&rig.notices).nth(ended).expect("the end of the play").bursts;
    assert!(bursts.planned > 0 && bursts.played == bursts.planned, "{name}: {bursts:?}");
    let contradicts = |notice: &StreamEvent| matches!(notice, StreamEvent::Contradiction(_));
    assert!(!rig.notices.iter().any(contradicts), "{name}: the host doubts a true device");
    let wrong = rig.judged();
    assert!(wrong.is_empty(), "{name}:\n{}", wrong.join("\n"));
}

/// In the up burst, between bursts, in the down burst, and amid the bursts of all motors.
#[test]
fn estops_cut_bursts_and_the_next_arm_returns_the_pins() {
    for (name, ticks, cycles) in
        [("pin-60", 100, 333), ("pin-60", 500, 5), ("pin-60", 800, 1_499), ("full-load", 85, 1_100)]
    {
        let mut rig = playing(name, ticks, cycles);
        let asked = rig.now();
        rig.order(Command::EStop);
        run(&mut rig, 50);
        let found = status(&rig);
        assert_eq!((found.state, found.cause, found.position_known), (State::Faulted, Cause::EStop, true));
        assert!(found.outstanding > 0, "{name} after {ticks} ticks");
        assert!(rig.chip.pins.low_since(u64::MAX).unwrap() <= asked + 64 * TICK, "{name}: a line is high");
        assert!(!obeys(&mut rig, job(&pattern(name), 0.1)), "{name}: an array plays after an e-stop");
        assert!(obeys(&mut rig, Command::Reset { estops_seen: u64::MAX, keep: true }), "{name}");
        assert_eq!(status(&rig).state, State::Disarmed);
        plays_again(rig, name, false);
    }
}

/// Loses the link of a play by `lose`: the pins return, and after `find` the next play is whole.
fn loses_the_link(name: &str, ticks: u64, cause: Cause, lose: fn(&mut Rig), find: fn(&mut Rig)) {
    let mut rig = playing(name, ticks, 900);
    let lost = rig.now();
    lose(&mut rig);
    run(&mut rig, 200);
    assert!(rig.chip.pins.low_since(u64::MAX).unwrap() <= lost + 800 * TICK, "{name}: {cause:?}");
    find(&mut rig);
    run(&mut rig, 300);
    let found = status(&rig);
    let is_at_rest = found.position_known && found.outstanding == 0;
    assert_eq!((found.state, found.cause, is_at_rest), (State::Disarmed, cause, true), "{name}");
    plays_again(rig, name, false);
}

#[test]
fn pins_return_when_the_cable_is_unplugged() {
    let plug = |rig: &mut Rig| rig.plug(true).unwrap();
    let in_a_frame = |rig: &mut Rig| {
        rig.raw(&half_frame());
        rig.plug(false).unwrap();
    };
    loses_the_link("pin-60", 100, Cause::LinkLost, in_a_frame, plug);
    loses_the_link("full-load", 0, Cause::LinkLost, |rig| rig.plug(false).unwrap(), plug);
}

#[test]
fn pins_return_when_the_tty_is_closed() {
    let [close, open]: [fn(&mut Rig); 2] = [|rig| rig.close(true).unwrap(), |rig| rig.close(false).unwrap()];
    loses_the_link("edge-45-paper", 850, Cause::LinkLost, close, open);
}

#[test]
fn pins_return_when_another_host_takes_over_through_either_usb_function() {
    let cdc = |rig: &mut Rig| rig.take_over(Function::Cdc).unwrap();
    loses_the_link("edge-45-paper", 700, Cause::NewHost, cdc, |_| ());
    let bulk = |rig: &mut Rig| rig.take_over(Function::Bulk).unwrap();
    loses_the_link("pin-60", 100, Cause::NewHost, bulk, |_| ());
}

#[test]
fn a_core_that_fails_plays_what_it_has_rendered_and_starts_as_another_boot() {
    for (event, cause) in [
        (CpuEvent::Die, Cause::Watchdog),
        (CpuEvent::Panic, Cause::Panic),
        (CpuEvent::Hardfault, Cause::Panic),
    ] {
        let mut rig = playing("full-load", 33, 200);
        let boot = rig.tap().hello().unwrap().boot;
        rig.fail(event).unwrap();
        run(&mut rig, 300);
        rig.run_to_greeting(1_000).unwrap();
        assert_ne!(rig.tap().hello().unwrap().boot, boot, "{event:?}");
        let found = status(&rig);
        assert_eq!((found.state, found.cause, found.position_known), (State::Disarmed, cause, false));
        assert!(!obeys(&mut rig, Command::Arm { assume_rest: false }), "{event:?}: where are the pins?");
        plays_again(rig, "full-load", true);
    }
}

/// Bytes between frames, half a frame among them, and bytes for the USB function that no host uses.
#[test]
fn bytes_beside_the_frames_change_nothing_on_either_usb_function() {
    for function in [Function::Cdc, Function::Bulk] {
        let mut rig = armed_with(ChipOptions::new(1), RigOptions { function, ..RigOptions::default() });
        rig.order(job(&pattern("edge-45-paper"), 0.5));
        for noise in [&[0, 0x11, 0x22, 0, 0xff][..], &half_frame(), &[0], &[0xff; 33]] {
            run(&mut rig, 50);
            rig.raw(noise);
            rig.stray(noise).unwrap();
        }
        rig.raw(&[0]);
        let bursts = rig.run_to_end(1, 2_000).unwrap().bursts;
        assert!(bursts.planned > 0 && bursts.played == bursts.planned, "{bursts:?}");
        assert!(status(&rig).counters.bad_frames > 0);
        plays_again(rig, "edge-45-paper", true);
    }
}

#[test]
fn a_play_goes_on_over_the_wrap_of_the_clock() {
    let mut rig = armed(ChipOptions::new(1));
    assert!(obeys(&mut rig, Command::Disarm));
    let wrap = Tick((Tick::BOOT.0 | u64::from(u32::MAX)) + 1);
    let before = rig.grid().cycle(wrap) - 500 * MS;
    rig.run_to(before).unwrap();
    assert!(obeys(&mut rig, Command::Arm { assume_rest: false }));
    rig.order(job(&pattern("edge-45-paper"), 0.6));
    run(&mut rig, 1_200);
    let onset = rig.tap().onsets()[0];
    assert!(onset < wrap && wrap < onset + 51_000, "{onset:?}");
    plays_again(rig, "edge-45-paper", false);
}

#[test]
fn a_board_that_was_never_armed_does_nothing() {
    let mut rig = Rig::new(&ChipOptions::new(1), RigOptions::default()).unwrap();
    rig.run_to_greeting(3_000).unwrap();
    assert!(!obeys(&mut rig, Command::Arm { assume_rest: false }), "where are the pins?");
    assert!(!obeys(&mut rig, job(&pattern("pin-60"), 0.1)), "it plays disarmed");
    run(&mut rig, 500);
    let found = status(&rig);
    assert_eq!((found.state, found.position_known, found.outstanding), (State::Disarmed, false, 0));
    assert!(rig.chip.pins.first().is_none() && rig.chip.pins.enable.is_empty());
    assert_eq!(rig.judged(), Vec::<String>::new());
}
