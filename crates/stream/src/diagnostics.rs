//! Diagnoses a device's link: its identity, its round trips, what its line carries, how its clock drifts.
//!
//! [`measure`] opens a session of its own and sends only frames that move nothing: pings, and the link probe's frames, which
//! the device ignores. It never arms; an armed device returns its pins, as it does for every new host. It blocks for some
//! seconds; the streamer does not use it.
//!
//! Invariant: [`measure`] ends within `TIMEOUT`.

use crate::device::Device;
use crate::link::{Budget, Event, LostReason, RoundTrip, Session};
use crate::time::HostInstant;
use firmware_protocol::board::{Board, SelfTestState};
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::DeviceHello;
use meissner_array::spec::Array;
use meissner_array::units::TickRate;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::time::Duration;

/// Round trips measured at least, and the time they span at least: a drift of 1 ppm is 2 µs in 2 s.
pub const PINGS: usize = 500;
const SPAN: Duration = Duration::from_millis(2200);
const PING_EVERY: Duration = Duration::from_millis(4);
/// The budget for measuring throughput: two dozen rounds on USB, a second of a slow line.
const PROBE: Budget = Budget { bytes: 64_000, time: Duration::from_secs(1) };
/// Round trips that a drift is fitted to, at least.
const MIN_POINTS: usize = 24;
/// The measurement gives up after this time.
const TIMEOUT: Duration = Duration::from_secs(20);
/// A port that takes no bytes for so long is stuck.
const STUCK: Duration = Duration::from_millis(500);
/// The least and the most that a turn of the loop waits; the mock has no descriptor to wait for.
const TURN: (Duration, Duration) = (Duration::from_micros(50), Duration::from_millis(1));

/// What was measured.
#[derive(Clone, Copy, Debug)]
pub struct LinkReport {
    /// How the device introduced itself.
    pub hello: DeviceHello,
    /// Its round trips.
    pub round_trip: RoundTripStats,
    /// Bytes per second that it acknowledged; `None` if it answered no frame of the probe, or the host stood still in every round.
    pub throughput_bytes_per_s: Option<u32>,
    /// Its clock's drift against the host's.
    pub drift: Drift,
    /// Its board report.
    pub board: Board,
    /// How its self-test ended, if one was asked for.
    pub self_test: Option<SelfTestState>,
}

/// Round trips of pings, µs.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct RoundTripStats {
    /// How many.
    pub count: usize,
    /// The median.
    pub p50_us: f64,
    /// The 99th percentile.
    pub p99_us: f64,
    /// The longest.
    pub max_us: f64,
}

/// A clock's drift against the host's.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Drift {
    /// Parts per million; positive if the device's clock is fast. Not a number if too few round trips were measured.
    pub ppm: f64,
    /// Two standard errors of that: from the spread of round trips, or from residuals if those are larger.
    pub uncertainty_ppm: f64,
    /// The time it was measured over, s.
    pub seconds: f64,
}

/// Why the measurement failed; [`LinkReportError::advice`] says what to do.
#[derive(Debug, thiserror::Error)]
pub enum LinkReportError {
    /// The device is gone.
    #[error("it was unplugged ({0})")]
    Gone(#[source] io::Error),
    /// Its port takes no bytes.
    #[error("it took no bytes for {} ms", STUCK.as_millis())]
    Stuck,
    /// It is no board, speaks another protocol, or answers no more.
    #[error("{}", .0.found())]
    Lost(LostReason),
    /// It answers too slowly.
    #[error("only {trips} of {PINGS} pings were answered in {} s", TIMEOUT.as_secs())]
    Slow {
        /// Pings answered.
        trips: usize,
    },
}

impl LinkReportError {
    /// What to do.
    pub const fn advice(&self) -> &'static str {
        match self {
            Self::Gone(_) => "plug it in again, and check its cable and power",
            Self::Stuck => LostReason::NoBoard.advice(),
            Self::Lost(reason) => reason.advice(),
            Self::Slow { .. } => "check its cable, and what else uses it",
        }
    }
}

/// Measures the link of `device`, which should drive this array; blocks for some seconds. With `self_test`, the device then tests
/// itself.
///
/// # Errors
/// If it is no board, goes away or answers too slowly.
pub fn measure(device: &mut Device, array: Array, self_test: bool) -> Result<LinkReport, LinkReportError> {
    let begun = HostInstant::now();
    let id = RandomState::new().hash_one(begun.as_ns()) as u32;
    let mut run = Measurement {
        session: Session::new(array, id, device.rate(), begun),
        hello: None,
        lost: None,
        trips: Vec::new(),
        board: None,
        self_test: None,
    };
    let until = |run: &mut Measurement, device: &mut Device, done: &dyn Fn(&Measurement) -> bool| {
        while !done(run) {
            let now = HostInstant::now();
            if now.since(begun) > TIMEOUT {
                return Err(LinkReportError::Slow { trips: run.trips.len() });
            }
            run.turn(device, now)?;
        }
        Ok(())
    };
    until(&mut run, device, &|run| run.session.is_probed())?;
    run.trips.clear();
    until(&mut run, device, &|run| {
        let span =
            |first: &RoundTrip| run.trips.last().map_or(Duration::ZERO, |last| last.sent.since(first.sent));
        run.trips.len() >= PINGS && run.trips.first().map(span) >= Some(SPAN)
    })?;
    run.session.probe(PROBE);
    until(&mut run, device, &|run| run.session.is_probed())?;
    until(&mut run, device, &|run| run.board.is_some())?;
    if self_test {
        run.session.ask_self_test();
        until(&mut run, device, &|run| run.self_test.is_some())?;
    }
    let board = run.board.ok_or(LinkReportError::Lost(LostReason::NoAnswer))?;
    let hello = run.hello.ok_or(LinkReportError::Lost(LostReason::NoAnswer))?;
    Ok(LinkReport {
        hello,
        round_trip: round_trip(&run.trips),
        throughput_bytes_per_s: run.session.capacity(),
        drift: drift(&run.trips, array.rate()),
        board,
        self_test: run.self_test,
    })
}

/// A measurement under way.
struct Measurement {
    session: Session,
    hello: Option<DeviceHello>,
    lost: Option<LostReason>,
    trips: Vec<RoundTrip>,
    board: Option<Board>,
    self_test: Option<SelfTestState>,
}

impl Measurement {
    fn turn(&mut self, device: &mut Device, now: HostInstant) -> Result<(), LinkReportError> {
        let Self { session, hello, lost, trips, board, self_test } = self;
        let mut on_event = |event| match event {
            Event::Opened(who) => *hello = Some(who),
            Event::Lost(reason) => *lost = Some(reason),
            Event::Board(report) => *board = Some(report),
            Event::SelfTest(state) => *self_test = Some(state),
            _ => {}
        };
        let mut bytes = [0; 1024];
        loop {
            let len = device.read(HostInstant::now(), &mut bytes).map_err(LinkReportError::Gone)?;
            if len == 0 {
                break;
            }
            session.receive(HostInstant::now(), &bytes[..len], &mut on_event);
        }
        trips.extend(session.take_round_trip());
        session.check_silence(now, &mut on_event);
        if session.is_probed() && trips.last().is_none_or(|last| now.since(last.sent) >= PING_EVERY) {
            session.request_status();
        }
        let mut frame = [0; MAX_FRAME];
        loop {
            let len = session.transmit(HostInstant::now(), &mut frame, &mut on_event);
            if len == 0 {
                break;
            }
            let mut unsent = &frame[..len];
            while !unsent.is_empty() {
                let sent = device.write(unsent).map_err(LinkReportError::Gone)?;
                unsent = &unsent[sent..];
                if !unsent.is_empty() {
                    if HostInstant::now().since(now) > STUCK {
                        return Err(LinkReportError::Stuck);
                    }
                    wait(device, TURN.0, PollFlags::OUT);
                }
            }
        }
        if let Some(reason) = *lost {
            return Err(LinkReportError::Lost(reason));
        }
        let due = session.wake_at(now).since(HostInstant::now()).clamp(TURN.0, TURN.1);
        wait(device, due, PollFlags::IN);
        Ok(())
    }
}

/// Waits until the device is ready, or for `time`.
fn wait(device: &Device, time: Duration, what: PollFlags) {
    let timeout = Timespec { tv_sec: 0, tv_nsec: time.subsec_nanos().into() };
    // An early return only costs an idle turn.
    let _ = match device.wake() {
        Some(wake) if what == PollFlags::IN || device.polls_writable() => {
            poll(&mut [PollFd::from_borrowed_fd(wake, what)], Some(&timeout))
        }
        _ => poll(&mut [], Some(&timeout)),
    };
}

/// The value that so many of 1000 sorted values lie below; not a number if there are none.
pub fn quantile(sorted: &[f64], per_mille: usize) -> f64 {
    let index = (sorted.len() * per_mille / 1000).min(sorted.len().saturating_sub(1));
    sorted.get(index).copied().unwrap_or(f64::NAN)
}

fn round_trip(trips: &[RoundTrip]) -> RoundTripStats {
    let mut us: Vec<f64> =
        trips.iter().map(|trip| trip.received.since(trip.sent).as_secs_f64() * 1e6).collect();
    us.sort_by(f64::total_cmp);
    let at = |per_mille| quantile(&us, per_mille);
    RoundTripStats { count: us.len(), p50_us: at(500), p99_us: at(990), max_us: at(1000) }
}

/// Fits a line through (host time, tick) of the round trips that nothing delayed, at least [`MIN_POINTS`] of them.
fn drift(trips: &[RoundTrip], rate: TickRate) -> Drift {
    let hz = f64::from(rate.hz());
    let ends = trips.first().zip(trips.last());
    let seconds = ends.map_or(0.0, |(first, last)| last.sent.since(first.sent).as_secs_f64());
    let half_s = |trip: &RoundTrip| trip.received.since(trip.sent).as_secs_f64() / 2.0;
    let mut sorted: Vec<&RoundTrip> = trips.iter().collect();
    sorted.sort_by(|a, b| half_s(a).total_cmp(&half_s(b)));
    let Some(first) = sorted.first().copied().filter(|_| sorted.len() >= MIN_POINTS) else {
        return Drift { ppm: f64::NAN, uncertainty_ppm: f64::NAN, seconds };
    };
    let shortest = half_s(first);
    // On a link whose round trips all differ, take the shortest.
    let good = sorted.partition_point(|trip| half_s(trip) <= 1.5 * shortest + 20e-6).max(MIN_POINTS);
    let mut error2 = 0.0;
    let points: Vec<(f64, f64)> = sorted[..good]
        .iter()
        .map(|trip| {
            // It may have waited on either side for all the time that it took beyond the shortest.
            error2 += (half_s(trip) - shortest).powi(2);
            let at = trip.sent.ns_since(first.sent) * 1e-9 + half_s(trip);
            (at, trip.tick.since(first.tick) as f64 / hz)
        })
        .collect();
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (mean_t, mean_k) = (mean(|point| point.0), mean(|point| point.1));
    let sum =
        |of: &dyn Fn(f64, f64) -> f64| points.iter().map(|(t, k)| of(t - mean_t, k - mean_k)).sum::<f64>();
    let (tt, tk) = (sum(&|t, _| t * t), sum(&|t, k| t * k));
    let slope = tk / tt;
    // Points may lie on a line by chance: their error is at least each point's bound, and a tick's width.
    let residual = sum(&|t, k| (k - slope * t).powi(2)) / (count - 2.0);
    let bound = error2 / count + hz.recip().powi(2) / 12.0;
    Drift {
        ppm: (slope - 1.0) * 1e6,
        uncertainty_ppm: 2.0 * (residual.max(bound) / tt).sqrt() * 1e6,
        seconds,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_protocol::tick::Tick;
    use meissner_test_support::paper::RATE;

    #[test]
    fn delayed_round_trips_do_not_hide_a_fast_clock() {
        let trips: Vec<_> = (0..550u64)
            .map(|i| {
                let sent = 1_000_000_000 + i * 4_000_000;
                let held = if i % 10 == 3 { 9_000_000 } else { i % 7 * 10_000 };
                let ticks = (sent + 200_000) as f64 * (1.0 + 35e-6) * 85_000.0 * 1e-9;
                let received = HostInstant::from_ns(sent + 400_000 + held);
                RoundTrip { sent: HostInstant::from_ns(sent), tick: Tick(ticks as u64), received }
            })
            .collect();
        let drift = drift(&trips, RATE);
        assert!((drift.ppm - 35.0).abs() <= drift.uncertainty_ppm.max(1.5), "{drift:?}");
        assert!(drift.uncertainty_ppm < 5.0 && drift.seconds > 2.0, "{drift:?}");
        let trip = round_trip(&trips);
        assert!(trip.count == 550 && trip.p50_us < 470.0 && trip.p99_us > 9000.0, "{trip:?}");
    }

    /// The drift of equal clocks, if round trip `i` takes `trip_us(i)` and waits only on its way to the device.
    fn drift_of(trip_us: impl Fn(u64) -> u64) -> Drift {
        let trips: Vec<_> = (0..550u64)
            .map(|i| {
                let sent = 1_000_000_000 + i * 4_000_000;
                let trip = trip_us(i) * 1000;
                let ticks = (sent + trip - 100_000) as f64 * 85_000.0 * 1e-9;
                let received = HostInstant::from_ns(sent + trip);
                RoundTrip { sent: HostInstant::from_ns(sent), tick: Tick(ticks as u64), received }
            })
            .collect();
        drift(&trips, RATE)
    }

    #[test]
    fn few_quick_round_trips_do_not_make_a_drift_certain() {
        // Two quick ones side by side; two far apart; one; and none that are alike.
        let jitter = |i: u64| 5_000 + i * 7_919 % 30_011;
        type Trips = Box<dyn Fn(u64) -> u64>;
        let links: [Trips; 4] = [
            Box::new(move |i| if (300..302).contains(&i) { 200 } else { jitter(i) }),
            Box::new(move |i| if i % 500 == 20 { 200 } else { jitter(i) }),
            Box::new(move |i| if i == 77 { 200 } else { jitter(i) }),
            Box::new(jitter),
        ];
        for trip_us in links {
            let drift = drift_of(trip_us);
            assert!(drift.ppm.abs() <= drift.uncertainty_ppm, "{drift:?}");
            // The points are known to about a millisecond in two seconds.
            assert!((100.0..20_000.0).contains(&drift.uncertainty_ppm), "{drift:?}");
        }
        let quiet = drift_of(|i| 200 + i % 3);
        assert!(quiet.ppm.abs() <= quiet.uncertainty_ppm && quiet.uncertainty_ppm < 3.0, "{quiet:?}");
    }
}
