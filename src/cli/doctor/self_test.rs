//! Judges a board's report and self-test (`doctor --board`), with one finding per check.
//!
//! The limits are here, each with its reason.

use crate::cli::text;
use crate::receipts::{board_status, outputs};
use firmware_protocol::board::{
    Board, LineTest, Output, Outputs, RamTest, Reset, SelfTest, SelfTestState, WaveTest,
};
use meissner_api::{Finding, Level};
use serde::Serialize;

/// Words of the waveform in a tick.
const WORDS: f64 = 4.0;
/// Words by which the DMA may be ahead or behind: the board reads it and the clock one after the other.
const READ_APART: f64 = 70.0;
/// Largest difference of tick clock and system timer. Both come from one crystal, so a wrong setting differs by much more; one of the 8 500
/// ticks that are counted is 118 ppm.
const SAME_CLOCK_PPM: f64 = 300.0;
/// Time to read the longest frame in the emulated chip, µs (`cargo test self_test -- --nocapture` in `verify/hil`).
const WORK_US: f64 = 167.0;
/// Ticks in which the board can render a block before the DMA fetches its first word (`docs/dev/board-timing.md`).
const HORIZON_TICKS: f64 = 45.0;
/// Time that the longest tasks take together in the emulated chip (the same page), µs.
const WORST_CASE_US: f64 = 235.0;

/// A self-test's figures, as the board sent them.
#[derive(Debug, Serialize)]
pub(super) struct Measured {
    /// Lines that are stuck, as numbers of motors; 64 is the trigger, 65 the driver enable.
    stuck_high: Option<Vec<u8>>,
    stuck_low: Option<Vec<u8>>,
    shorted: Option<Vec<u8>>,
    clock_ppm: Option<f64>,
    ram_bytes: Option<u32>,
    ram_bad: Option<u32>,
    work_us: Option<u32>,
}

impl Measured {
    pub(super) fn of(state: SelfTestState, tick_hz: u32) -> Option<Self> {
        let SelfTestState::Done(SelfTest { lines, wave, ram, work_us }) = state else { return None };
        Some(Self {
            stuck_high: lines.map(|lines| outputs(lines.stuck_high)),
            stuck_low: lines.map(|lines| outputs(lines.stuck_low)),
            shorted: lines.map(|lines| outputs(lines.shorted)),
            clock_ppm: wave.map(|wave| clock_ppm(&wave, tick_hz)),
            ram_bytes: ram.map(|ram| ram.bytes),
            ram_bad: ram.and_then(|ram| ram.bad),
            work_us,
        })
    }
}

/// The outputs, named as on the board.
fn named(outputs: Outputs) -> String {
    outputs.iter().map(name).collect::<Vec<_>>().join(", ")
}

fn name(output: Output) -> String {
    match output {
        Output::Line(line) => format!("line {line}"),
        Output::Trigger => "the trigger".to_owned(),
        Output::Enable => "the driver enable".to_owned(),
    }
}

fn clock_ppm(wave: &WaveTest, tick_hz: u32) -> f64 {
    let ticks = f64::from(wave.timer_us) * f64::from(tick_hz) / 1e6;
    (f64::from(wave.ticks) / ticks - 1.0) * 1e6
}

/// The board's report: why it started, and what has failed since.
pub(super) fn of_report(board: &Board) -> Vec<Finding> {
    let found = text::board(&board_status(board));
    let hung = matches!(board.reset, Reset::Watchdog | Reset::Panic);
    let failed = board.counts.iter().any(|(_, count)| count > Some(0));
    let advice =
        "its firmware hung or its outputs failed: power it off and on, and report this line if it comes back";
    let mut findings = vec![Finding::check("board", !hung && !failed, found, advice)];
    if let Some(high) = board.high_at_boot.filter(|high| !high.is_empty()) {
        let found = format!("{} high at the start, before anything drove them", named(high));
        findings.push(Finding::fail(
            "start",
            found,
            "remove the wire, and look for a short to 3.3 V or a missing pull-down",
        ));
    }
    findings
}

/// How the self-test ended, and each of its checks.
pub(super) fn judged(state: SelfTestState, motors: u8, tick_hz: u32) -> Vec<Finding> {
    match state {
        SelfTestState::Done(test) => {
            let SelfTest { lines, wave, ram, work_us } = test;
            vec![
                lines.map_or_else(|| missing("lines"), |lines| of_lines(&lines, motors)),
                wave.map_or_else(|| missing("waveform"), |wave| of_wave(&wave, tick_hz)),
                ram.map_or_else(|| missing("memory"), of_ram),
                work_us.map_or_else(|| missing("speed"), |us| of_work(us, tick_hz)),
            ]
        }
        SelfTestState::Refused => {
            let advice =
                "the board is not disarmed: `meissner reset`, or power it off and on, and run this again";
            vec![Finding::fail("self-test", "the board refused it", advice)]
        }
        SelfTestState::Ended | SelfTestState::Running => {
            let advice = "an e-stop or another host ended it: run this again";
            vec![Finding::fail("self-test", "it did not come to its end", advice)]
        }
    }
}

/// The finding for a check that the device does not have; it is not a fault.
fn missing(what: &'static str) -> Finding {
    Finding::warn(what, "not on this device", "name a board with --device")
}

fn of_lines(lines: &LineTest, motors: u8) -> Finding {
    let LineTest { stuck_high, stuck_low, shorted, pair } = *lines;
    let mut faults = Vec::new();
    if !stuck_high.is_empty() {
        faults.push(format!("stuck high: {}", named(stuck_high)));
    }
    if !stuck_low.is_empty() {
        faults.push(format!("stuck low: {}", named(stuck_low)));
    }
    if !shorted.is_empty() {
        let first = pair.map_or_else(String::new, |(a, b)| format!(" (first {} with {})", name(a), name(b)));
        faults.push(format!("connected with each other: {}{first}", named(shorted)));
    }
    if faults.is_empty() {
        return Finding::ok("lines", format!("{motors} lines and the trigger go high and low, each alone"));
    }
    let advice = "pull the plug with these lines and run this again: is it the board or the cable? Do not switch the 30 V on";
    Finding::fail("lines", faults.join("; "), advice)
}

fn of_wave(wave: &WaveTest, tick_hz: u32) -> Finding {
    let ppm = clock_ppm(wave, tick_hz);
    let apart = f64::from(wave.words) - WORDS * f64::from(wave.ticks);
    let good = ppm.abs() <= SAME_CLOCK_PPM && apart.abs() <= READ_APART && wave.timer_us > 0;
    let found = format!(
        "{} ticks and {} words in {} us by the system timer ({ppm:+.0} ppm)",
        wave.ticks, wave.words, wave.timer_us
    );
    let level = if good { Level::Ok } else { Level::Fail };
    Finding::new(
        "waveform",
        level,
        found,
        "the board's clocks are not as set: flash the firmware again, or take another board",
    )
}

fn of_ram(RamTest { bytes, bad }: RamTest) -> Finding {
    match bad {
        None => Finding::ok("memory", format!("{bytes} free bytes keep what is written")),
        Some(at) => Finding::fail(
            "memory",
            format!("address {at:#010x} does not keep what is written"),
            "take another board",
        ),
    }
}

fn of_work(us: u32, tick_hz: u32) -> Finding {
    let worst_case_us = WORST_CASE_US * f64::from(us) / WORK_US;
    let left = HORIZON_TICKS - worst_case_us * f64::from(tick_hz) / 1e6;
    let level = match left {
        left if left < HORIZON_TICKS / 4.0 => Level::Fail,
        left if left < HORIZON_TICKS / 2.0 => Level::Warn,
        _ => Level::Ok,
    };
    let found = format!(
        "{us} us to read the longest frame: about {left:.0} of {HORIZON_TICKS} ticks are left in the densest play"
    );
    Finding::new(
        "speed",
        level,
        found,
        "the core is slower than in the emulator: play no dense patterns, and report this line",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_protocol::array::MotorSet;

    const SOUND: SelfTest = SelfTest {
        lines: Some(LineTest {
            stuck_high: Outputs::NONE,
            stuck_low: Outputs::NONE,
            shorted: Outputs::NONE,
            pair: None,
        }),
        wave: Some(WaveTest { timer_us: 100_000, ticks: 8_500, words: 34_010 }),
        ram: Some(RamTest { bytes: 62_000, bad: None }),
        work_us: Some(167),
    };

    fn levels(test: SelfTest) -> Vec<Level> {
        judged(SelfTestState::Done(test), 24, 85_000).into_iter().map(|finding| finding.level).collect()
    }

    #[test]
    fn a_sound_board_is_go_and_each_fault_is_not() {
        assert_eq!(levels(SOUND), [Level::Ok; 4]);
        let of = |lines| Outputs { lines: MotorSet::from_bits(lines), ..Outputs::NONE };
        let lines = |high, low, shorted| SelfTest {
            lines: Some(LineTest {
                stuck_high: of(high),
                stuck_low: of(low),
                shorted: of(shorted),
                pair: None,
            }),
            ..SOUND
        };
        for test in [lines(1, 0, 0), lines(0, 1 << 23, 0), lines(0, 0, 3)] {
            assert_eq!(levels(test), [Level::Fail, Level::Ok, Level::Ok, Level::Ok], "{test:?}");
        }
        let wave =
            |ticks, words| SelfTest { wave: Some(WaveTest { timer_us: 100_000, ticks, words }), ..SOUND };
        for test in [wave(4_250, 17_000), wave(8_500, 33_000), wave(8_504, 34_016)] {
            assert_eq!(levels(test), [Level::Ok, Level::Fail, Level::Ok, Level::Ok], "{test:?}");
        }
        assert_eq!(
            levels(SelfTest { ram: Some(RamTest { bytes: 1, bad: Some(4) }), ..SOUND })[2],
            Level::Fail
        );
        for (us, level) in [(183, Level::Ok), (222, Level::Warn), (327, Level::Fail)] {
            assert_eq!(levels(SelfTest { work_us: Some(us), ..SOUND })[3], level);
        }
    }

    #[test]
    fn a_device_without_checks_passes_none() {
        assert_eq!(levels(SelfTest::default()), [Level::Warn; 4]);
        for state in [SelfTestState::Refused, SelfTestState::Ended] {
            assert!(judged(state, 24, 85_000).iter().all(|finding| finding.level == Level::Fail));
        }
    }

    #[test]
    fn outputs_have_names_that_a_person_finds() {
        let outputs = Outputs { lines: MotorSet::from_bits(1 << 5), trigger: true, enable: true };
        assert_eq!(named(outputs), "line 5, the trigger, the driver enable");
    }
}
