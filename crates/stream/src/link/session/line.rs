//! What the line carries: what its transport says, checked by what was carried.
//!
//! It answers how much a play may need ([`Line::capacity`], [`Line::rate_beside`]) and how long the
//! session waits before it sends again. Now and then the session sends a ping right before moves and one
//! right behind them ([`Line::wants_check`]): the time between their answers, the moves took. So neither
//! a delay nor a lost frame is measured.
//!
//! Invariant: the rate is at most the nominal one. At least a frame may be unacknowledged, and no more
//! before something was carried.

use crate::link::session::pinger::Carried;
use crate::time::HostInstant;
use firmware_protocol::frame::MAX_FRAME;
use heapless::HistoryBuf;
use std::time::Duration;

/// The host retransmits a frame after a few round trips, within these bounds.
pub(super) const RETRY: (Duration, Duration) = (Duration::from_millis(3), Duration::from_millis(50));

/// The fastest of so many times counts: stalls of the device and slow answers make some too slow.
const TIMES: usize = 8;
/// Before it was checked it may be slower than it should be: moves are not sent again before this.
const UNCHECKED: Duration = Duration::from_millis(10);
/// How often the line is checked while moves are sent.
const CHECKED_EVERY: Duration = Duration::from_millis(100);
/// By so much an answer may be late without a slow line.
const JITTER: Duration = Duration::from_millis(1);
/// Frames after which older ones count half, and the fewest that tell a share.
const COUNTED: u32 = 64;

/// The rate of a line, bytes per second. It bounds what may wait in buffers that the host cannot reach.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineRate(pub u32);

impl LineRate {
    /// Bulk transfers of a full-speed USB device.
    pub const USB_FULL_SPEED: Self = Self(800_000);

    /// Bytes that may be unacknowledged: 2 ms of the line, at least one frame.
    fn window_bytes(self) -> usize {
        (self.0 as usize / 500).max(MAX_FRAME)
    }

    /// How long `bytes` occupy the line.
    #[must_use]
    pub fn time(self, bytes: usize) -> Duration {
        Duration::from_secs_f64(bytes as f64 / f64::from(self.0.max(1)))
    }
}

/// The line of a session.
#[derive(Clone, Debug)]
pub(super) struct Line {
    nominal: LineRate,
    /// What it carried, the last times, and when it was checked last.
    carried: HistoryBuf<u32, TIMES>,
    checked: HostInstant,
    is_checking: bool,
    /// Frames of moves sent lately, and how many of them again.
    frames: u32,
    again: u32,
}

impl Line {
    /// A line of this rate, as its transport knows it.
    pub(super) const fn new(nominal: LineRate) -> Self {
        let checked = HostInstant::from_ns(0);
        Self { nominal, carried: HistoryBuf::new(), checked, is_checking: false, frames: 0, again: 0 }
    }

    /// A frame of moves leaves, perhaps again.
    pub(super) const fn sent(&mut self, again: bool) {
        if self.frames >= 2 * COUNTED {
            (self.frames, self.again) = (self.frames / 2, self.again / 2);
        }
        (self.frames, self.again) = (self.frames + 1, self.again + again as u32);
    }

    /// Whether a ping is to be sent before the moves that leave now; the one behind them follows
    /// [`Self::is_checked`].
    pub(super) fn wants_check(&mut self, now: HostInstant) -> bool {
        let every = if self.carried.is_empty() { Duration::from_nanos(1) } else { CHECKED_EVERY };
        let is_due = now.since(self.checked) >= every;
        if is_due {
            (self.checked, self.is_checking) = (now, true);
        }
        is_due
    }

    /// Whether the moves that leave now are to be followed by a ping, once.
    pub(super) fn is_checked(&mut self, now: HostInstant) -> bool {
        std::mem::take(&mut self.is_checking) && self.checked == now
    }

    /// Moves were carried between two pings.
    pub(super) fn carried(&mut self, &Carried { bytes, took, is_pair }: &Carried) {
        let is_slow = took > self.nominal.time(bytes) + JITTER;
        // Without both answers a slow one may be late.
        if is_pair || !is_slow {
            let rate = if is_slow { bytes as f64 / took.as_secs_f64() } else { f64::INFINITY };
            self.carried.write((rate as u32).min(self.nominal.0));
        }
    }

    fn rate(&self) -> LineRate {
        LineRate(self.carried.iter().copied().max().unwrap_or(self.nominal.0))
    }

    /// The part of what is sent that gets through, in steps, so that chance does not change it all the time.
    fn share(&self) -> f64 {
        let share = 1.0 - f64::from(self.again) / f64::from(self.frames.max(COUNTED));
        ((share * 16.0).ceil() / 16.0).max(1.0 / 16.0)
    }

    /// Bytes of moves that may be unacknowledged.
    pub(super) fn window_bytes(&self) -> usize {
        if self.carried.is_empty() { MAX_FRAME } else { self.rate().window_bytes() }
    }

    /// See [`Session::capacity`](super::Session::capacity).
    pub(super) fn capacity(&self, round_trip: Duration) -> u32 {
        let (rate, under_way) = (self.rate(), (self.frames_under_way() * MAX_FRAME) as f64);
        let waiting = under_way / (round_trip + rate.time(MAX_FRAME)).as_secs_f64();
        (waiting.min(rate.0.into()) * self.share()) as u32
    }

    /// See [`Session::rate_beside`](super::Session::rate_beside).
    pub(super) fn rate_beside(&self, frames_per_s: u32, round_trip: Duration) -> (u32, f64) {
        let waiting = f64::from(frames_per_s) * self.ack_wait(round_trip).as_secs_f64() / self.share();
        ((f64::from(self.rate().0) * self.share()) as u32, waiting)
    }

    /// How long a frame that is sent now takes to the device behind so many bytes; `shortest` is the
    /// shortest round trip.
    pub(super) fn delivery(&self, waiting: usize, shortest: Duration) -> Duration {
        self.rate().time(waiting + MAX_FRAME) + shortest.min(RETRY.1) / 2
    }

    /// How long a frame waits, besides its bytes' time, until the device has acknowledged those before it.
    pub(super) fn ack_wait(&self, round_trip: Duration) -> Duration {
        round_trip / self.frames_under_way() as u32
    }

    /// How long the session waits for an answer before it asks again.
    pub(super) fn retry_after(&self, round_trip: Duration) -> Duration {
        let usual = (round_trip * 3).clamp(RETRY.0, RETRY.1);
        // A frame on a slow line is late, not lost.
        usual.max(round_trip.min(RETRY.1) + self.rate().time(self.rate().window_bytes() + MAX_FRAME))
    }

    /// How long it waits for an acknowledgement before it sends moves again: longer before the line was checked.
    pub(super) fn resend_after(&self, round_trip: Duration) -> Duration {
        let least = if self.carried.is_empty() { UNCHECKED } else { RETRY.0 };
        self.retry_after(round_trip).max(least)
    }

    /// Whole frames that may be unacknowledged at once.
    fn frames_under_way(&self) -> usize {
        self.rate().window_bytes() / MAX_FRAME
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDLE: Duration = Duration::from_millis(1);

    fn carried(bytes: usize, ms: u32, is_pair: bool) -> Carried {
        Carried { bytes, took: ms * IDLE, is_pair }
    }

    fn at(ms: u64) -> HostInstant {
        HostInstant::from_ns(ms * 1_000_000)
    }

    #[test]
    fn a_line_is_as_fast_as_its_transport_says_unless_all_moves_take_longer() {
        let mut line = Line::new(LineRate::USB_FULL_SPEED);
        let usb = line.capacity(IDLE);
        assert!(line.wants_check(at(1)) && !line.wants_check(at(1)) && line.is_checked(at(1)));
        assert!(!line.is_checked(at(1)) && line.wants_check(at(2)) && !line.is_checked(at(3)));
        assert_eq!((line.window_bytes(), line.resend_after(IDLE)), (MAX_FRAME, UNCHECKED));
        line.carried(&carried(200, 20, false));
        assert_eq!(line.window_bytes(), MAX_FRAME);
        line.carried(&carried(200, 20, true));
        assert_eq!((line.rate(), line.window_bytes()), (LineRate(10_000), MAX_FRAME));
        assert_eq!(line.resend_after(IDLE), IDLE + line.rate().time(2 * MAX_FRAME));
        assert!(!line.wants_check(at(101)) && line.wants_check(at(102)));
        line.carried(&carried(40, 1, false));
        assert_eq!((line.capacity(IDLE), line.window_bytes()), (usb, 1_600));
        (1..TIMES).for_each(|_| line.carried(&carried(200, 20, true)));
        assert_eq!(line.rate(), LineRate::USB_FULL_SPEED);
        line.carried(&carried(200, 25, true));
        assert_eq!(line.rate(), LineRate(10_000));
    }

    #[test]
    fn what_is_sent_again_is_not_carried() {
        let mut line = Line::new(LineRate::USB_FULL_SPEED);
        let usb = line.capacity(IDLE);
        (0..1000).for_each(|number| line.sent(number % 2 == 0));
        assert_eq!(line.capacity(IDLE), usb / 2);
    }
}
