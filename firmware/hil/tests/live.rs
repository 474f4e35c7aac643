//! A live play of the host's streamer on the chip: its updates replace strokes, also over a line that loses, repeats and damages frames.

use crate::play::armed;
use meissner_array::motor::SquareWave;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_array::strokes::LiveStrokes;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::rig::Faults;
use meissner_hil::time::{MS, host};
use meissner_stream::Source;
use meissner_stream::queues::{Applied, Command, End, LiveResult, LiveUpdate, Play, StreamEvent};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::time::Duration;

const UPDATES: u64 = 120;
const EVERY: u64 = 20 * MS;
const TIMEOUT: Duration = Duration::from_millis(500);

/// A random drive, as often silent as any other. Frequencies repeat, so that updates also change amplitude or phase alone.
fn wave(random: &mut ChaCha8Rng) -> SquareWave {
    let mut of = |count: u32| random.next_u32() % count;
    let frequency_hz = [23.0, 60.0, 100.0, 180.0][of(4) as usize];
    SquareWave::new(Array::paper(), frequency_hz, f64::from(of(5)) * 30.0, f64::from(of(4)) / 4.0).unwrap()
}

/// What became of a live play of [`UPDATES`] random updates.
struct Played {
    applied: Vec<Applied>,
    merged: usize,
}

fn play(seed: u64, faults: Faults) -> Played {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut rig = armed(ChipOptions::new(seed));
    rig.set_faults(faults);
    let waves = PerMotor::all(Array::paper(), SquareWave::new(Array::paper(), 60.0, 60.0, 0.0).unwrap());
    let live = Play::new(1, Source::Live(Box::new(LiveStrokes::new(waves))));
    rig.order(Command::Play(Box::new(Play { open_loop: true, live: Some(TIMEOUT), ..live })));
    for number in 1..=UPDATES {
        rig.run_to(rig.now() + EVERY).unwrap();
        let mut update = LiveUpdate::new(Array::paper(), 1, number, host(rig.now()));
        for new in &mut update.motions {
            *new = random.next_u32().is_multiple_of(3).then(|| wave(&mut random).into());
        }
        rig.order(Command::UpdateLive(Box::new(update)));
    }
    rig.run_to(rig.now() + 100 * MS).unwrap();
    rig.order(Command::EndLive(1));
    let outcome = rig.run_to_end(1, 2_000).unwrap();
    let bursts = outcome.bursts;
    assert_eq!(outcome.end, End::Stopped);
    assert!(bursts.replaced > 0 && bursts.refused == 0, "{bursts:?}");
    let sum = bursts.played + bursts.late + bursts.dropped + bursts.refused + bursts.replaced;
    assert_eq!(bursts.planned, sum, "{bursts:?}");
    // Pins return after a stop.
    rig.run_to(rig.now() + 100 * MS).unwrap();
    let (boots, events) = rig.finish();
    let judged = boots.last().unwrap().judge();
    let findings: Vec<String> = judged.findings.iter().map(ToString::to_string).collect();
    assert!(findings.is_empty(), "seed {seed}: {bursts:?}\n{}", findings.join("\n"));
    let result = |event: &StreamEvent| match event {
        StreamEvent::LiveUpdated(update) => Some(update.result),
        _ => None,
    };
    let results: Vec<LiveResult> = events.iter().filter_map(result).collect();
    assert_eq!(results.len() as u64, UPDATES, "each update comes back once");
    let applied = results.iter().filter_map(|result| match result {
        LiveResult::Applied(applied) => Some(*applied),
        _ => None,
    });
    let merged = results.iter().filter(|result| matches!(result, LiveResult::Merged { .. })).count();
    let played = Played { applied: applied.collect(), merged };
    let repeats: u32 = played.applied.iter().map(|applied| applied.repeats).sum();
    println!(
        "seed {seed}: {} applied, {merged} merged, {repeats} sent again; {bursts:?}",
        played.applied.len()
    );
    played
}

#[test]
fn updates_replace_strokes_on_the_chip() {
    let Played { applied, merged } = play(1, Faults::default());
    assert_eq!((applied.len() as u64, merged), (UPDATES, 0));
    assert!(applied.iter().all(|applied| applied.repeats == 0), "an update came too late");
}

#[test]
fn updates_over_a_line_that_loses_repeats_and_damages_frames() {
    for seed in 1..=3 {
        let Played { applied, merged } = play(seed, Faults { loss: 0.05, repeat: 0.05, corrupt: 0.05 });
        assert!(applied.len() as u64 > UPDATES / 2, "{} applied, {merged} merged", applied.len());
        assert!(applied.iter().any(|applied| applied.repeats > 0), "no frame of an update was late");
    }
}
