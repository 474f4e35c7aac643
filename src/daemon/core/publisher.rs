//! Events on their way to listeners and to the session record.
//!
//! An event is written once, as the bytes of its server-sent event; all listeners share them.
//!
//! Bounds: a listener may be up to [`EVENTS`] events behind; beyond that it gets [`Event::Lagged`]. Waiting events take at most 34
//! MB, because a receipt has at most 32 KiB, and so have 32 items of a sequence.

use crate::session_record::{Entry, Peer, SessionRecord};
use axum::body::Bytes;
use meissner_api::Event;
use tokio::sync::broadcast;

/// Events a listener may be behind.
const EVENTS: usize = 1024;

/// An event as listeners get it: one server-sent event, whose data is one line.
pub(in crate::daemon) fn frame(event: &Event) -> Bytes {
    let mut frame = format!("event: {}\ndata: ", event.name()).into_bytes();
    // Writing to a vector does not fail, and events can be serialized.
    let _ = serde_json::to_writer(&mut frame, event);
    frame.extend_from_slice(b"\n\n");
    frame.into()
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Publisher {
    pub(in crate::daemon) session_record: SessionRecord,
    /// None once the daemon ends: listeners get what was published before, then the end.
    listeners: Option<broadcast::Sender<Bytes>>,
}

impl Publisher {
    pub(in crate::daemon) fn new(session_record: SessionRecord) -> Self {
        Self { session_record, listeners: Some(broadcast::channel(EVENTS).0) }
    }

    /// Publishes an event; `client` is the owner of the play that it is about.
    pub(in crate::daemon) fn publish(&self, event: &Event, client: Option<Peer>) {
        if let Some(entry) = Entry::of(event, client) {
            self.session_record.add(entry);
        }
        self.announce(event);
    }

    /// Publishes an event to the listeners alone.
    pub(in crate::daemon) fn announce(&self, event: &Event) {
        if let Some(listeners) = self.listeners.as_ref().filter(|listeners| listeners.receiver_count() > 0) {
            // An error means that the last listener has gone.
            let _ = listeners.send(frame(event));
        }
    }

    /// A listener to everything from now on; none once the daemon ends.
    pub(in crate::daemon) fn subscribe(&self) -> Option<broadcast::Receiver<Bytes>> {
        Some(self.listeners.as_ref()?.subscribe())
    }

    /// Ends the streams of all listeners.
    pub(in crate::daemon) fn close(&mut self) {
        self.listeners = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_api::{
        BurstCounts, DurationRecord, ErrorSource, FollowedMotion, LateCause, LateCounts, LateStroke,
        LatenessRecord, LinkTraffic, LiveRecord, LoweredPin, LoweredReason, LoweredRecord, MAX_DRIVES_LISTED,
        MAX_LISTED, MAX_WARNINGS_LISTED, MotorRestError, MovedPin, OffsetRecord, OnsetRecord, OrderedCounts,
        PlayState, PulseCounts, ReachedDrive, Receipt, RefusedStroke, UpdateTimes,
    };

    #[test]
    fn listeners_share_the_bytes_of_an_event() {
        let publisher = Publisher::new(SessionRecord::none());
        let mut listeners = [(); 2].map(|()| publisher.subscribe().unwrap());
        publisher.publish(&Event::Lost { events: 3 }, None);
        let [first, second] = listeners.each_mut().map(|listener| listener.try_recv().unwrap());
        assert_eq!(&*first, b"event: lost\ndata: {\"event\":\"lost\",\"notices\":3}\n\n");
        assert_eq!(first.as_ptr(), second.as_ptr());
    }

    #[test]
    fn the_longest_event_has_24_kib() {
        let (most, number) = (u64::MAX, -123.456_789_012_345_67);
        let times = UpdateTimes { p50_ms: number, p99_ms: number, longest_ms: number };
        let late = LateStroke { motor: 23, tick: most, late_ms: number, cause: LateCause::Device };
        let reason = "the motor's on-time limit: fewer pulses per second, please".to_owned();
        let refused = RefusedStroke { motor: 23, tick: most, reason };
        let lowered = LoweredPin { motor: 23, tick: most, reason: LoweredReason::Late };
        let receipt = Receipt {
            state: PlayState::Stopped,
            cause: Some("x".repeat(64).into()),
            onset: Some(OnsetRecord {
                requested_tick: most,
                actual_tick: most,
                monotonic_ns: most,
                uncertainty_ns: most,
            }),
            onset_latency_ms: Some(number),
            bursts: Some(BurstCounts {
                planned: most,
                played: most,
                late: most,
                dropped: most,
                refused: most,
                replaced: u64::MAX,
                amended: most,
                shortened: most,
            }),
            pulses: Some(PulseCounts { planned: most, played: most }),
            live: Some(LiveRecord {
                updates: most,
                applied: most,
                merged: most,
                repeats: most,
                decided: Some(times),
                first_motor: Some(times),
                last_motor: Some(times),
            }),
            lateness: LatenessRecord {
                counts: LateCounts { host: most, link: most, device: most, worst_ms: number },
                strokes: vec![late; MAX_LISTED],
            },
            refusals: vec![refused; MAX_LISTED],
            lowered: LoweredRecord { count: most, pins: vec![lowered; LoweredRecord::MAX_PINS] },
            wire: Some(LinkTraffic { bytes_to_device: most, bytes_per_burst: Some(number) }),
            rest_error_um: Some(vec![number as f32; 24]),
            offset: Some(OffsetRecord { tick: most, monotonic_ns: most, uncertainty_ns: most }),
            cut_after_ms: Some(number),
            duration_ms: DurationRecord {
                ordered: Some(number),
                compiled: Some(number),
                played: Some(number),
            },
            ordered: Some(OrderedCounts { bursts: most, pulses: Some(most) }),
            rest_errors: Some(vec![
                MotorRestError {
                    motor: 23,
                    onset_um: Some(number as f32),
                    onset_source: Some(ErrorSource::DeadReckoning),
                    offset_um: number as f32,
                    offset_source: ErrorSource::DeadReckoning,
                };
                24
            ]),
            drives: vec![
                ReachedDrive {
                    drive: 4096,
                    motor: 23,
                    ordered_um: 399.999,
                    reached_um: 399.999,
                    surplus_um: 119.999,
                    strokes: Some(most),
                };
                MAX_DRIVES_LISTED
            ],
            motions: vec![
                FollowedMotion {
                    motor: 23,
                    highest_um: 399.999,
                    error_um: 399.999,
                    error_share: 10.123,
                    step_error_um: 399.999,
                    too_slow_from_s: Some(99_999_999.999),
                    moves_per_s: 999.999,
                    measured_s: 239.999,
                };
                24
            ],
            pins: Some(vec![MovedPin { motor: 23, first_pulse_tick: most, offset_tick: most }; 24]),
            warnings: vec!["x".repeat(160); MAX_WARNINGS_LISTED + 2],
            ..Receipt::new(most, &"x".repeat(64), &"0".repeat(64), Some(number))
        };
        let frame = frame(&Event::Ended { receipt: Box::new(receipt) });
        assert!((34 << 10..40 << 10).contains(&frame.len()), "{} bytes", frame.len());
    }
}
