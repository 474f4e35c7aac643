//! Receipts made from events: of plays, devices, and losses.

use super::*;
use firmware_protocol::array::MotorSet;
use firmware_protocol::board::Counts;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::Cause;
use meissner_api::{
    DurationRecord, EdgeRecord, EndCause, ErrorSource, FollowedMotion, InstantRecord, ItemRecord, ItemState,
    LateCause, LatenessRecord, LiveRecord, LoweredReason, LoweredRecord, MAX_DRIVES_LISTED,
    MAX_WARNINGS_LISTED, OnsetRecord, OrderedCounts, PlayCounts, PlayReach, ReachedDrive, Terms,
    TriggerRecord, UpdateTimes,
};
use meissner_array::pattern::Pattern;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_stream::link::{Clock, Traffic};
use meissner_stream::queues::{End, Movement, Onset, Pins, Play, RestErrors, Stamp};
use meissner_stream::{PlayBoard, Settings};

/// The same estimate of every motor's rest error.
fn rest(um: f32, source: ErrorSource) -> RestErrors {
    RestErrors { um: PerMotor::all(Array::paper(), um), source: PerMotor::all(Array::paper(), source) }
}

fn snapshot(connected: bool, state: State, play: Option<(u64, f64)>) -> Snapshot {
    let (at, mut clock) = (HostInstant::from_ns(1_000_000_000), Clock::new(Array::paper().rate()));
    clock.round_trip(at, Tick(1000), at);
    Snapshot {
        at,
        connected,
        state,
        cause: Cause::Request,
        position_known: true,
        tick: Tick(1000),
        clock: clock.estimate(),
        play,
        lead_ms: 100.0,
        settings: Settings::of(meissner_array::spec::Array::paper()),
        pins: Pins {
            rest: RestErrors::none(Array::paper()),
            sensor_faults: PerMotor::all(Array::paper(), None),
            movements: PerMotor::all(Array::paper(), Movement::default()),
            standing: None,
            seen: true,
        },
        line_bytes_per_s: None,
        traffic: Traffic::default(),
        board: None,
        device_bad_frames: 0,
    }
}

fn onset() -> Onset {
    let tick = Tick(2000);
    Onset {
        requested: tick,
        actual: tick,
        at: HostInstant::from_ns(5),
        uncertainty_ns: 9,
        latency_ns: 4_000_000,
    }
}

fn ended(id: u64, end: End) -> StreamEvent {
    let pattern = Pattern::new(Array::paper(), "nothing", Some(1.0), Vec::new(), toml::Table::new()).unwrap();
    let strokes = Strokes::new(&pattern, &StrokeOptions::default()).unwrap();
    let play = Play::new(id, strokes);
    let outcome = Outcome {
        started_by: None,
        stopped_by: None,
        end,
        cause: (end != End::Done).then_some(EndCause::Stop),
        onset: Some(onset()),
        bursts: BurstCounts {
            planned: 10,
            played: 6,
            late: 2,
            dropped: 2,
            refused: 0,
            replaced: 0,
            amended: 1,
            shortened: 0,
        },
        pulses: PulseCounts { planned: 100, played: 60 },
        estimated: false,
        lateness: LateCounts { host: 1, ..LateCounts::default() },
        board: Some(PlayBoard { slack: Some(29), counts: Counts { stalls: Some(1), ..Counts::NONE } }),
        wire_bytes: 55,
        offset: Some(Stamp { tick: Tick(10_500), at: HostInstant::from_ns(100), uncertainty_ns: 9 }),
        cut_after: (end != End::Done).then_some(8_500),
        rest_at_onset: Some(rest(0.25, ErrorSource::Telemetry)),
        rest_at_end: rest(0.5, ErrorSource::DeadReckoning),
        play: Box::new(play),
    };
    StreamEvent::PlayEnded { id, outcome }
}

fn take(receipts: &mut Receipts, id: u64) {
    receipts.add(Receipt { id, ..Receipt::new("edge-45", "00ff", 1, &Terms::default()) }, Arc::default());
    assert!(matches!(receipts.settle(id, true), Some(Event::Queued { .. })));
}

#[test]
fn a_play_goes_from_queued_to_its_receipt() {
    let mut receipts = Receipts::new(Array::paper());
    take(&mut receipts, 1);
    take(&mut receipts, 2);
    assert_eq!(receipts.queued().map(|receipt| receipt.id).collect::<Vec<_>>(), [1, 2]);
    let event = receipts.apply(&StreamEvent::PlayStarted { id: 1, onset: onset() }).unwrap();
    assert_eq!(event.name(), "began");
    receipts.apply(&StreamEvent::Snapshot(snapshot(true, State::Armed, Some((1, 0.25)))));
    assert_eq!(receipts.running().unwrap().played_s, 0.25);
    assert_eq!(receipts.receipt(1).unwrap().state, PlayState::Running);
    assert_eq!(receipts.queued().count(), 1);
    let counts = LateCounts { host: 1, worst_ms: 1.5, ..LateCounts::default() };
    let (up, late_ms, cause) = (Tick(7), 1.5, LateCause::Host);
    receipts.apply(&StreamEvent::StrokeLate { id: 1, motor: 3, up, late_ms, cause, counts });
    let up = Tick(8);
    receipts.apply(&StreamEvent::StrokeRefused { id: 1, motor: 3, up, reason: Refusal::MotorOnTime });
    let [late, held] = [1 << 3, 1 << 4 | 1 << 5].map(MotorSet::from_bits);
    for _ in 0..10 {
        receipts.apply(&StreamEvent::PinsLowered { id: 1, tick: Tick(9), late, held });
    }
    let Some(Event::Ended { receipt }) = receipts.apply(&ended(1, End::Stopped)) else { panic!() };
    let pins: Vec<_> =
        receipt.counts.lowered.pins[..3].iter().map(|pin| (pin.motor, pin.tick, pin.reason)).collect();
    assert_eq!(pins, [(3, 9, LoweredReason::Late), (4, 9, LoweredReason::Held), (5, 9, LoweredReason::Held)]);
    assert_eq!((receipt.counts.lowered.count, receipt.counts.lowered.pins.len()), (30, 24));
    assert_eq!(Some(&*receipt), receipts.receipt(1));
    assert_eq!((receipt.state, receipt.cause.as_ref()), (PlayState::Stopped, Some(&EndCause::Stop)));
    assert_eq!((receipt.counts.lateness.strokes.len(), receipt.counts.refusals.len()), (1, 1));
    assert_eq!(receipt.device.wire.unwrap().bytes_per_burst, Some(5.5));
    let board = receipt.device.board.as_ref().unwrap();
    assert_eq!(
        (board.slack_ticks, board.counters["stalls"], board.counters["usb_recoveries"]),
        (Some(29), Some(1), None)
    );
    assert_eq!(receipt.onset.map(|onset| onset.latency_ms), Some(4.0));
    assert_eq!(receipts.last().unwrap().id, 2);
    assert!(receipts.running().is_none());
    assert_eq!(receipts.totals().plays, [0, 1, 0]);
    let json = serde_json::to_value(&receipt).unwrap();
    assert_eq!(
        (&json["counts"]["lateness"]["host"], &json["onset"]["actual_tick"]),
        (&1.into(), &2000.into())
    );
    assert_eq!(serde_json::from_value::<Receipt>(json).unwrap(), *receipt);
}

#[test]
fn a_play_that_was_not_accepted_leaves_nothing() {
    let mut receipts = Receipts::new(Array::paper());
    receipts.add(Receipt { id: 1, ..Receipt::new("a", "", 1, &Terms::default()) }, Arc::default());
    assert!(receipts.receipt(1).is_none(), "not before it is accepted");
    assert_eq!(receipts.settle(1, false), None);
    assert!(receipts.last().is_none());
    assert!(receipts.apply(&ended(1, End::Done)).is_none());
}

#[test]
fn receipts_and_lists_are_bounded() {
    let mut receipts = Receipts::new(Array::paper());
    for id in 1..=KEPT as u64 + 5 {
        take(&mut receipts, id);
        for link in 1..=MAX_LISTED as u64 + 1 {
            receipts.apply(&StreamEvent::StrokeLate {
                id,
                motor: 3,
                up: Tick(7),
                late_ms: 1.0,
                cause: LateCause::Link,
                counts: LateCounts { link, ..LateCounts::default() },
            });
        }
        assert_eq!(receipts.receipt(id).unwrap().counts.lateness.counts.link, MAX_LISTED as u64 + 1);
        receipts.apply(&ended(id, End::Done));
    }
    assert_eq!(receipts.finished.len(), KEPT);
    assert!(receipts.receipt(5).is_none());
    assert_eq!(receipts.receipt(6).unwrap().counts.lateness.strokes.len(), MAX_LISTED);
}

/// A receipt of the most text.
pub(crate) fn longest() -> Receipt {
    let (most, number, motor) = (u64::MAX, -123.456_789_012_345_67, 23);
    let times = Some(UpdateTimes { p50_ms: number, p99_ms: number, longest_ms: number });
    let instant = InstantRecord { tick: most, monotonic_ns: most, uncertainty_ns: most };
    let edge = EdgeRecord { number: u32::MAX, tick: most, monotonic_ns: most, uncertainty_ns: most };
    let late = LateStroke { motor, tick: most, late_ms: number, cause: LateCause::Device };
    let reason = "the motor's on-time limit: fewer pulses per second, please".to_owned();
    let error = MotorRestError {
        motor,
        onset_um: Some(number as f32),
        onset_source: Some(ErrorSource::DeadReckoning),
        offset_um: number as f32,
        offset_source: ErrorSource::DeadReckoning,
    };
    let drive = ReachedDrive {
        drive: 4096,
        motor,
        ordered_um: 399.999,
        reached_um: 399.999,
        surplus_um: 119.999,
        strokes: Some(most),
    };
    let motion = FollowedMotion {
        motor,
        highest_um: 399.999,
        error_um: 399.999,
        error_share: 10.123,
        step_error_um: 399.999,
        too_slow_from_s: Some(99_999_999.999),
        moves_per_s: 999.999,
        measured_s: 239.999,
    };
    Receipt {
        id: most,
        state: PlayState::Stopped,
        cause: Some("x".repeat(64).into()),
        edges: PlayEdges { start: Some(edge), stop: Some(edge) },
        onset: Some(OnsetRecord {
            requested_tick: most,
            actual_tick: most,
            monotonic_ns: most,
            uncertainty_ns: most,
            latency_ms: number,
        }),
        offset: Some(instant),
        duration_ms: DurationRecord {
            ordered: Some(number),
            compiled: Some(number),
            played: Some(number),
            cut_after: Some(number),
        },
        items: Some([longest_item()].into()),
        counts: PlayCounts {
            ordered: Some(OrderedCounts { bursts: most, pulses: most }),
            bursts: Some(BurstCounts {
                planned: most,
                played: most,
                late: most,
                dropped: most,
                refused: most,
                replaced: most,
                amended: most,
                shortened: most,
            }),
            pulses: Some(PulseCounts { planned: most, played: most }),
            estimated: false,
            lateness: LatenessRecord {
                counts: LateCounts { host: most, link: most, device: most, worst_ms: number },
                strokes: vec![late; MAX_LISTED],
            },
            refusals: vec![RefusedStroke { motor, tick: most, reason }; MAX_LISTED],
            lowered: LoweredRecord {
                count: most,
                pins: vec![
                    LoweredPin { motor, tick: most, reason: LoweredReason::Late };
                    LoweredRecord::MAX_PINS
                ],
            },
        },
        reach: PlayReach {
            drives: vec![drive; MAX_DRIVES_LISTED],
            motions: vec![motion; 24],
            warnings: vec!["x".repeat(160); MAX_WARNINGS_LISTED + 2],
        },
        live: Some(LiveRecord {
            updates: most,
            applied: most,
            merged: most,
            repeats: most,
            decided: times,
            first_motor: times,
            last_motor: times,
        }),
        pins: Some(PlayPins {
            rest_error_um: vec![number as f32; 24],
            rest_errors: vec![error; 24],
            moved: vec![MovedPin { motor, first_pulse_tick: most, offset_tick: most }; 24],
        }),
        device: PlayDevice {
            wire: Some(LinkTraffic { bytes_to_device: most, bytes_per_burst: Some(number) }),
            ..PlayDevice::default()
        },
        ..Receipt::new(&"x".repeat(64), &"0".repeat(64), 4096, &Terms::default())
    }
}

/// An item of the most text.
fn longest_item() -> ItemRecord {
    let instant = Some(InstantRecord { tick: u64::MAX, monotonic_ns: u64::MAX, uncertainty_ns: u64::MAX });
    ItemRecord {
        item: 4095,
        pattern: "x".repeat(64).into(),
        pattern_sha256: "0".repeat(64).into(),
        scale: 0.123_456_789_012_345_6,
        ordered_um: Some(399.999),
        reached_um: Some(399.999),
        planned_onset_ticks: u64::MAX,
        ordered_ms: Some(12_345_678_901.234_56),
        state: ItemState::Incomplete,
        onset: instant,
        first_pulse_tick: Some(u64::MAX),
        offset: instant,
        trigger: Some(TriggerRecord { tick: u64::MAX, width_ms: 123.456_789_012_345_6, code: Some(255) }),
        late_strokes: u32::MAX,
        refused_strokes: u32::MAX,
    }
}
