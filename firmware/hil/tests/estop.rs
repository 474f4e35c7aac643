//! An e-stop turns all lines off within a pulse period of its USB packet, at any phase and under full load.

use crate::play::{armed, job};
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::scenario::pattern;
use meissner_hil::time::{MS, TICK};
use meissner_stream::queues::Command;

/// Number of tries, each at another phase of tick, block and USB frame.
const TRIES: u64 = 12;

/// Cycles from the packet to the last fall.
fn latency(rig: &mut meissner_hil::rig::Rig, name: &str, phase: u64) -> u64 {
    rig.order(job(&pattern(name).unwrap(), 5.0));
    rig.run_to(rig.now() + 60 * MS + phase).unwrap();
    rig.chip().unwrap().e_stopped.clear();
    rig.order(Command::EStop);
    rig.run_to(rig.now() + 50 * MS).unwrap();
    let chip = rig.chip().unwrap();
    // Later packets repeat it.
    let packet = chip.e_stopped[0];
    let low = chip.pins.low_since(u64::MAX).unwrap();
    // High until the e-stop, even between pulses.
    let off = chip.pins.enable.last().unwrap().to;
    assert!(packet < off && off < packet + 50 * MS, "{name}: drivers off at {off}, packet at {packet}");
    assert!(chip.pins.still_high().is_none(), "{name}: lines go on 50 ms after the e-stop was sent");
    rig.order(Command::Reset { estops_seen: u64::MAX });
    rig.run_to(rig.now() + 20 * MS).unwrap();
    rig.order(Command::Arm { assume_rest: true });
    rig.run_to(rig.now() + 20 * MS).unwrap();

    off.max(low) - packet
}

fn sweep(name: &str) {
    let mut rig = armed(ChipOptions::new(1));
    let tries = 0..TRIES;
    let mut cycles: Vec<_> =
        tries.map(|n| latency(&mut rig, name, n * (16 * TICK + TICK / TRIES) / 3)).collect();
    cycles.sort_unstable();
    let (least, median, most) = (cycles[0], cycles[cycles.len() / 2], cycles[cycles.len() - 1]);
    println!(
        "{name}: e-stop, packet to all lines low: {least} / {median} / {most} cycles (least, median, most)"
    );
    assert!(most <= TICK, "{most} cycles");
    let (boots, _) = rig.finish();
    for boot in boots {
        let findings: Vec<_> = boot.judge().findings.iter().map(ToString::to_string).collect();
        assert!(findings.is_empty(), "{}", findings.join("\n"));
    }
}

#[test]
fn lines_are_low_within_a_pulse_period() {
    sweep("edge-45");
}

#[test]
fn lines_are_low_within_a_pulse_period_under_full_load() {
    sweep("full-load");
}
