//! The self-test of the board: a sound chip passes, the test finds planted faults, and an e-stop or `arm` ends it.

use crate::play::{armed, job, pattern};
use firmware_protocol::array::MotorSet;
use firmware_protocol::board::Output::{Line, Trigger};
use firmware_protocol::board::{Counts, LineTest, Outputs, Reset, SelfTest, SelfTestState};
use firmware_protocol::message::{HostMessage, State};
use meissner_hil::bench::CpuEvent;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::pins::PinTrain;
use meissner_hil::rig::Rig;
use meissner_hil::tap::Event;
use meissner_hil::time::{MS, TICK};
use meissner_stream::queues::Command;

/// The newest state of the self-test `run`.
fn state(rig: &Rig, run: u16) -> Option<SelfTestState> {
    rig.tap().events.iter().rev().find_map(|(_, event)| match event {
        Event::SelfTest(of, state) if *of == run => Some(*state),
        _ => None,
    })
}

/// A disarmed board.
fn disarmed() -> Rig {
    let mut rig = armed(ChipOptions::new(1));
    rig.order(Command::Disarm);
    rig.run_to(rig.now() + 20 * MS).unwrap();
    assert_eq!(rig.tap().status().unwrap().state, State::Disarmed);
    rig
}

/// Runs a self-test to its end.
fn test(rig: &mut Rig, run: u16) -> SelfTest {
    rig.message(&HostMessage::SelfTest { run });
    for _ in 0..50 {
        rig.run_to(rig.now() + 10 * MS).unwrap();
        match state(rig, run) {
            Some(SelfTestState::Done(test)) => return test,
            None | Some(SelfTestState::Running) => {}
            Some(other) => panic!("{other:?}"),
        }
    }
    panic!("no end of the self-test");
}

fn is_sound(test: &SelfTest) -> bool {
    let wave = test.wave.unwrap();
    let ticks = u64::from(wave.timer_us) * 85 / 1000;
    test.lines == Some(LineTest::default())
        && u64::from(wave.ticks).abs_diff(ticks) <= 2
        && wave.words.abs_diff(4 * wave.ticks) <= 70
        && test.ram.is_some_and(|ram| ram.bad.is_none() && ram.bytes > 10_000)
        && test.work_us.is_some_and(|us| us < 200)
}

#[test]
fn a_sound_board_passes_and_is_as_before() {
    let mut rig = disarmed();
    let enabled = rig.chip.pins.enable.len();
    let begun = rig.now();
    let result = test(&mut rig, 1);
    println!("{result:?}, over within {:.0} ms", (rig.now() - begun) as f64 / MS as f64);
    assert!(is_sound(&result), "{result:?}");
    let chip = &mut rig.chip;
    assert!(chip.pins.still_high().is_none() && chip.pins.strays.is_empty());
    assert_eq!(chip.pins.enable.len(), enabled, "the drivers stay off");
    for line in &chip.pins.lines {
        // Once, for at most 25 µs: interrupts may come in between.
        let [train] = line[..] else { panic!("{line:?}") };
        assert!(train.pulses == 1 && train.width <= MS / 40, "{train:?}");
    }
    let status = rig.tap().status().unwrap();
    assert!(status.state == State::Disarmed && status.position_known);
    // It plays as before.
    rig.order(Command::Arm { assume_rest: false });
    rig.run_to(rig.now() + 20 * MS).unwrap();
    rig.order(job(&pattern("full-load"), 0.2));
    let played = rig.run_to_end(1, 1000).unwrap();
    assert!(played.bursts.planned > 100 && played.bursts.played == played.bursts.planned, "{played:?}");
    let board = played.board.unwrap();
    println!("during a play: {board:?}");
    assert!(board.slack.is_some_and(|slack| (20..45).contains(&slack)), "{board:?}");
    assert_eq!(board.counts, Counts { stalls: Some(0), usb_recoveries: Some(0), output_faults: 0 });
    // Armed again, it refuses.
    rig.message(&HostMessage::SelfTest { run: 2 });
    rig.run_to(rig.now() + 5 * MS).unwrap();
    assert_eq!(state(&rig, 2), Some(SelfTestState::Refused));
}

fn of(lines: u64) -> Outputs {
    Outputs { lines: MotorSet::from_bits(lines), ..Outputs::NONE }
}

#[test]
fn each_fault_of_the_wiring_is_found_and_named() {
    let lines = LineTest::default();
    type Wiring = (u32, u32, &'static [[u8; 2]]);
    let faults: [(Wiring, LineTest); 6] = [
        ((1 << 5, 0, &[]), LineTest { stuck_high: of(1 << 5), ..lines }),
        ((0, 1 << 26, &[]), LineTest { stuck_low: of(1 << 23), ..lines }),
        ((0, 0, &[[10, 11]]), LineTest { shorted: of(3 << 10), pair: Some((Line(10), Line(11))), ..lines }),
        (
            (0, 0, &[[26, 27]]),
            LineTest {
                shorted: Outputs { trigger: true, ..of(1 << 23) },
                pair: Some((Line(23), Trigger)),
                ..lines
            },
        ),
        // The enable is driven low, and wins.
        ((0, 0, &[[22, 28]]), LineTest { stuck_low: of(1 << 22), ..lines }),
        ((1 << 28, 0, &[]), LineTest { stuck_high: Outputs { enable: true, ..Outputs::NONE }, ..lines }),
    ];
    let mut rig = disarmed();
    for ((wiring, expected), run) in faults.into_iter().zip(1..) {
        rig.chip.wiring(wiring.0, wiring.1, wiring.2).unwrap();
        assert_eq!(test(&mut rig, run).lines, Some(expected), "{wiring:?}");
    }
    rig.chip.wiring(0, 0, &[]).unwrap();
    assert!(is_sound(&test(&mut rig, 100)));
}

#[test]
fn a_slow_core_and_a_slow_clock_are_found() {
    let mut rig = armed(ChipOptions { slow: 1.5, ..ChipOptions::new(1) });
    rig.order(Command::Disarm);
    rig.run_to(rig.now() + 20 * MS).unwrap();
    let result = test(&mut rig, 1);
    println!("core slower by half: {result:?}");
    assert!(result.work_us.unwrap() > 150 && result.lines == Some(LineTest::default()));
    // CLK_SYS_DIV: the system clock, and with it the waveform, runs 1.5 % too slow. The system timer does not.
    let mut rig = disarmed();
    rig.chip.register(0x4000_8040, 1 << 8 | 4).unwrap();
    let result = test(&mut rig, 1);
    println!("clock slower by 1.5 %: {result:?}");
    let wave = result.wave.unwrap();
    let ppm = (f64::from(wave.ticks) / (f64::from(wave.timer_us) * 0.085) - 1.0) * 1e6;
    assert!((-16_000.0..-15_000.0).contains(&ppm), "{ppm}");
}

/// At many phases of the lines' part, which takes some five milliseconds.
#[test]
fn an_e_stop_and_an_arm_end_a_self_test() {
    for phase in 0..24 {
        let mut rig = disarmed();
        rig.message(&HostMessage::SelfTest { run: 1 });
        rig.run_to(rig.now() + MS + phase * (TICK * 3 + 217)).unwrap();
        if phase % 2 == 0 {
            rig.order(Command::EStop);
        } else {
            rig.order(Command::Arm { assume_rest: false });
        }
        let asked = rig.now();
        rig.run_to(asked + 5 * MS).unwrap();
        assert_eq!(state(&rig, 1), Some(SelfTestState::Ended), "{phase}");
        let now = rig.tap().status().unwrap().state;
        assert_eq!(now, if phase % 2 == 0 { State::Faulted } else { State::Armed }, "{phase}");
        let chip = &mut rig.chip;
        assert!(chip.pins.still_high().is_none(), "{phase}");
        let last = chip.pins.lines.iter().filter_map(|line| line.last()).map(PinTrain::end).max();
        // The packet, and the step under way.
        assert!(last.is_none_or(|last| last <= asked + 2 * MS), "{phase}: {last:?}, asked at {asked}");
    }
}

#[test]
fn an_output_that_is_high_at_the_start_is_reported() {
    let mut rig = disarmed();
    for (high, reported) in [(1 << 26 | 1 << 28, Outputs { enable: true, ..of(1 << 23) }), (0, Outputs::NONE)]
    {
        rig.chip.wiring(high, 0, &[]).unwrap();
        rig.chip.cpu(CpuEvent::Run).unwrap();
        rig.run_to(rig.now() + 1500 * MS).unwrap();
        let board = rig.tap().events.iter().rev().find_map(|(_, event)| match event {
            Event::Board(board) => Some(*board),
            _ => None,
        });
        let board = board.expect("a report since the start");
        assert_eq!((board.high_at_boot, board.reset), (Some(reported), Reset::RunPin));
    }
}
