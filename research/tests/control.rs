//! A corner of the grid of position control within the limits, and the same bytes on any cores.

use meissner_research::{ControlGrid, ControlRow, ControlTradeoff, Verdict, control_tradeoff};
use meissner_stream::{MotorRun, rest_bound_um};
use serde_json::Value;
use std::sync::LazyLock;

/// A corner of the grid, in which every quantity takes two values. It is short enough for a build without optimisation.
fn corner() -> ControlGrid {
    ControlGrid {
        frequencies_hz: vec![60.0, 300.0],
        amplitudes_um: vec![10.0, 80.0],
        leads_ms: vec![20.0, 500.0],
        ages_ms: vec![1.0, 20.0],
        scatters: vec![0.0, 0.1],
        asymmetries: vec![0.02],
        telemetry_hz: vec![1000.0, 50.0],
        seconds: 6.0,
        periods: 0.0,
    }
}

fn measured(grid: &ControlGrid) -> ControlTradeoff {
    control_tradeoff(grid).unwrap()
}

static FOUND: LazyLock<ControlTradeoff> = LazyLock::new(|| measured(&corner()));

#[test]
fn every_cell_is_complete_and_keeps_its_limit() {
    let found = &*FOUND;
    let document = serde_json::to_value(found).unwrap();
    assert_eq!((found.rows.len(), found.rates.len()), (32, 4));
    let documented = ["rows", "rates"].into_iter().flat_map(|key| document[key].as_array().unwrap());
    let names = "frequency_hz amplitude_um lead_ms age_ms scatter asymmetry rest_rms_um bound_um amplitude_error \
                 amplitude_se periods planned_um delay_ms room telemetry_hz corrected_share";
    for (row, told) in found.rows.iter().chain(&found.rates).zip(documented) {
        for name in names.split_whitespace() {
            assert!(told[name].as_f64().is_some_and(f64::is_finite), "{name}: {told}");
        }
        assert_eq!(told["doubt"], Value::Null, "{told}");
        assert_eq!(
            row.bound_um,
            rest_bound_um(
                row.run.array,
                row.run.frequency_hz,
                row.planned_um,
                row.run.scatter,
                row.delay_ms,
                row.run.telemetry_hz
            )
        );
        // 2 s of 6 are left out; chance averages out over a few hundred periods.
        assert!(row.periods as f64 >= 3.9 * row.run.frequency_hz, "{row:?}");
        assert!(row.verdict != Verdict::Misses, "{row:?}");
        if row.run.scatter == 0.0 {
            assert!(row.rest_rms_um <= 0.95 / 7.0 && row.amplitude_se < 0.002, "{row:?}");
        } else {
            let ratio = row.rest_rms_um / row.bound_um;
            assert!((0.8..=1.2).contains(&ratio), "{ratio}: {row:?}");
        }
    }
    let summary = &found.summary;
    assert_eq!((summary.hold + summary.chance, summary.miss, summary.doubts), (32, 0, 0));
    assert_eq!(summary.worst.iter().map(|worst| worst.cells).sum::<usize>(), 32);
    assert!(summary.worst.iter().all(|worst| worst.ratio <= worst.limit && worst.hold == worst.cells));
    // At 300 Hz 80 um do not fit into half a period, so the amplitude has no limit.
    let full =
        found.rows.iter().find(|row| row.run.frequency_hz == 300.0 && row.run.amplitude_um == 80.0).unwrap();
    assert!(full.planned_um < 20.0 && full.room < 1.1 && full.amplitude_limit.is_none(), "{full:?}");
}

/// Corrections use the telemetry from shortly before a burst, at every lead.
#[test]
fn the_lead_makes_no_difference_and_age_and_rate_do() {
    let found = &*FOUND;
    assert!(found.summary.leads_alike);
    let of = |lead_ms: f64| {
        let rows = found.rows.iter().filter(move |row| row.run.lead_ms == lead_ms);
        rows.map(|row| ControlRow { run: MotorRun { lead_ms: 0.0, ..row.run }, ..*row }).collect::<Vec<_>>()
    };
    assert_eq!(of(20.0), of(500.0));
    assert_eq!(of(20.0).len(), 16);
    let rest = |rows: &[ControlRow], age_ms: f64, telemetry_hz: f64| {
        let is = |row: &&ControlRow| {
            (
                row.run.frequency_hz,
                row.run.amplitude_um,
                row.run.scatter,
                row.run.age_ms,
                row.run.telemetry_hz,
            ) == (60.0, 80.0, 0.1, age_ms, telemetry_hz)
        };
        rows.iter().find(is).unwrap().rest_rms_um
    };
    assert!(rest(&found.rows, 20.0, 1000.0) > 1.3 * rest(&found.rows, 1.0, 1000.0));
    assert!(rest(&found.rates, 1.0, 50.0) > 1.3 * rest(&found.rates, 1.0, 1000.0));
}

#[test]
fn corrections_cost_bytes_and_keep_pins_near_rest() {
    let wire = &FOUND.wire;
    assert!(wire.on.bytes_per_burst <= 12.0 && wire.off.bytes_per_burst <= 3.0, "{wire:?}");
    assert!(wire.on.bytes_per_burst > wire.off.bytes_per_burst && wire.on.bursts == wire.off.bursts);
    assert!(wire.on.amended > wire.on.bursts / 2 && wire.off.amended == 0, "{wire:?}");
    assert!(wire.on.rest_rms_um < 12.0 && wire.off.rest_rms_um > 100.0, "{wire:?}");
}

#[test]
fn the_same_grid_makes_the_same_bytes_on_any_number_of_cores() {
    let grid = ControlGrid { leads_ms: vec![20.0], amplitudes_um: vec![80.0], ..corner() };
    let text = |found: &ControlTradeoff| serde_json::to_string(found).unwrap();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let found = measured(&grid);
    assert_eq!(text(&found), text(&one.install(|| measured(&grid))));
    assert!(found.recommendation.contains("um at 20 ms)"), "{}", found.recommendation);
    assert!(
        found.recommendation.contains("1000 at 60 Hz, 1000 at 300 Hz; take 1000"),
        "{}",
        found.recommendation
    );
}

#[test]
fn a_grid_that_no_motor_can_play_is_refused() {
    let grid = ControlGrid { frequencies_hz: vec![0.0], ..corner() };
    assert!(control_tradeoff(&grid).is_err());
}
