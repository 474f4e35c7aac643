//! Decides what to send when: the newest state of the source, at a bounded rate, and signs of life in between.
//!
//! The loop passes on the source's messages ([`Pace::hear`]) and asks for the message to send now ([`Pace::due`]). This module
//! reads no clock and sends nothing.
//!
//! Bounds: one message waits, and newer ones are merged into it; at most 16 are unanswered; the end waits for at least 2 s.
//! Invariant: without `keep_alive`, each message of the source causes at most one sign of life, and a silent source causes none.

use meissner_api::LiveMessage;
use std::time::{Duration, Instant};

/// Unanswered updates, at most. The daemon refuses more than 32.
const UNANSWERED: u32 = 16;
/// Signs of life per timeout of the daemon.
const SIGNS: u32 = 4;
/// The shortest time that the end waits for the answer to the last update. A renderer may take 200 ms.
const LAST: Duration = Duration::from_secs(2);

#[derive(Debug)]
pub(super) struct Pace {
    /// Least time between updates.
    gap: Duration,
    /// Time without a message after which a sign of life is due.
    quiet: Duration,
    timeout: Duration,
    keep_alive: bool,
    /// When the play ends even without the last answer; set once the source has ended.
    ends_by: Option<Instant>,
    waiting: Option<LiveMessage>,
    /// Whether the source has sent something since our last message.
    heard: bool,
    /// When the last update was sent.
    updated_at: Option<Instant>,
    /// When the last message was sent.
    sent_at: Option<Instant>,
    unanswered: u32,
}

/// Whether a message changes nothing.
fn is_empty(message: &LiveMessage) -> bool {
    *message == LiveMessage::default()
}

/// Merges a newer message: for keys of both, the newer one wins.
fn merge(older: &mut LiveMessage, newer: LiveMessage) {
    let LiveMessage { drives, pose, um, glide_ms, scale, .. } = newer;
    // A motor has a drive or a level, whichever came last.
    if let Some(changed) = &mut older.drives {
        changed.retain(|old| !um.contains_key(&old.motor));
    }
    if let Some(drives) = drives {
        let changed = older.drives.get_or_insert_default();
        changed.retain(|old| drives.iter().all(|drive| drive.motor != old.motor));
        older.um.retain(|motor, _| drives.iter().all(|drive| drive.motor != *motor));
        changed.extend(drives);
    }
    older.um.extend(um);
    older.glide_ms = glide_ms.or(older.glide_ms);
    older.pose = pose.or(older.pose);
    older.scale = scale.or(older.scale);
}

/// The rest of a time that began at `begun`.
fn left(begun: Option<Instant>, time: Duration, now: Instant) -> Duration {
    begun.map_or(Duration::ZERO, |begun| time.saturating_sub(now.saturating_duration_since(begun)))
}

impl Pace {
    /// A pace for `updates_hz` updates a second, and a daemon that ends the play after `timeout` of silence.
    pub(super) fn new(updates_hz: f64, timeout: Duration, keep_alive: bool) -> Self {
        Self {
            gap: Duration::from_secs_f64(1.0 / updates_hz),
            quiet: timeout / SIGNS,
            timeout,
            keep_alive,
            ends_by: None,
            // The daemon has accepted the play, with the source's first state, and waits for a message.
            waiting: Some(LiveMessage::default()),
            heard: false,
            updated_at: None,
            sent_at: None,
            unanswered: 0,
        }
    }

    /// Notes that the source has ended: its last message is still sent, with signs of life until the answer.
    pub(super) fn end(&mut self, now: Instant) {
        self.keep_alive = true;
        self.ends_by.get_or_insert(now + self.gap + self.timeout.max(LAST));
    }

    /// Takes a message of the source.
    pub(super) fn hear(&mut self, message: LiveMessage) {
        self.heard = true;
        if !is_empty(&message) {
            merge(self.waiting.get_or_insert_default(), message);
        }
    }

    /// Notes that the daemon has answered a message.
    pub(super) const fn answered(&mut self) {
        self.unanswered = self.unanswered.saturating_sub(1);
    }

    /// Whether an update may be sent, and none waits.
    pub(super) fn is_free(&self, now: Instant) -> bool {
        self.waiting.is_none() && self.may_send(now)
    }

    /// Whether the play may end: the last update was answered and has lasted as long as the others, or the end has waited long
    /// enough.
    pub(super) fn is_done(&self, now: Instant) -> bool {
        let is_late = self.ends_by.is_some_and(|ends_by| now >= ends_by);
        is_late || (self.is_free(now) && self.unanswered == 0)
    }

    fn may_send(&self, now: Instant) -> bool {
        self.unanswered < UNANSWERED && left(self.updated_at, self.gap, now).is_zero()
    }

    /// The message to send now, if any.
    pub(super) fn due(&mut self, now: Instant) -> Option<LiveMessage> {
        let update = if self.may_send(now) { self.waiting.take() } else { None };
        if update.is_some() {
            self.updated_at = Some(now);
        }
        let sign = || {
            let is_quiet = left(self.sent_at, self.quiet, now).is_zero();
            (is_quiet && (self.keep_alive || self.heard)).then(LiveMessage::default)
        };
        let message = update.or_else(sign)?;
        self.heard = false;
        self.sent_at = Some(now);
        self.unanswered += 1;
        Some(message)
    }

    /// How long nothing is due, unless the source or the daemon sends something; `None`: no limit. `wants_next`: whether the caller
    /// has more when [`Self::is_free`].
    pub(super) fn wait(&self, now: Instant, wants_next: bool) -> Option<Duration> {
        let wants_next = if self.ends_by.is_some() { self.unanswered == 0 } else { wants_next };
        let wants_next = wants_next || self.waiting.is_some();
        let can_send = wants_next && self.unanswered < UNANSWERED;
        let update = can_send.then(|| left(self.updated_at, self.gap, now));
        let sign = (self.keep_alive || self.heard).then(|| left(self.sent_at, self.quiet, now));
        let end = self.ends_by.map(|ends_by| ends_by.saturating_duration_since(now));
        [update, sign, end].into_iter().flatten().min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_api::{LiveDrive, LivePose};
    use proptest::prelude::*;

    fn pose(x_mm: f64) -> LiveMessage {
        let pose = LivePose { x_mm, ..LivePose::default() };
        LiveMessage { pose: Some(pose), ..LiveMessage::default() }
    }

    fn drive(motor: u8, amplitude_um: f64) -> LiveDrive {
        LiveDrive { motor, frequency_hz: 60.0, amplitude_um, phase: 0.0 }
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// A mouse of 1000 events a second, for a second.
    #[test]
    fn a_fast_source_sends_its_newest_state_at_the_rate() {
        let (mut pace, begun) = (Pace::new(50.0, ms(500), true), Instant::now());
        let mut sent = Vec::new();
        for at in 0..1000_u32 {
            let now = begun + Duration::from_millis(at.into());
            pace.hear(pose(f64::from(at)));
            if let Some(message) = pace.due(now) {
                sent.push(message.pose.unwrap().x_mm);
                pace.answered();
            }
        }
        let each_20th: Vec<f64> = (0..50).map(|n| f64::from(20 * n)).collect();
        assert_eq!(sent, each_20th);
    }

    #[test]
    fn without_answers_nothing_queues() {
        let (mut pace, begun) = (Pace::new(1000.0, ms(1000), true), Instant::now());
        let sent: Vec<_> = (0..200)
            .filter_map(|at| {
                pace.hear(pose(f64::from(at)));
                pace.due(begun + ms(at as u64))
            })
            .collect();
        assert_eq!(sent.len(), 16);
        // A sign of life is sent anyway.
        assert_eq!(pace.due(begun + ms(300)), Some(LiveMessage::default()));
        assert_eq!(pace.wait(begun + ms(300), false), Some(ms(250)));
        pace.answered();
        pace.answered();
        assert_eq!(pace.due(begun + ms(301)), Some(pose(199.0)));
    }

    #[test]
    fn signs_of_life_of_a_mouse_held_still() {
        let (mut pace, begun) = (Pace::new(50.0, ms(400), true), Instant::now());
        let mut now = begun;
        for _ in 0..10 {
            assert_eq!(pace.due(now), Some(LiveMessage::default()));
            pace.answered();
            let wait = pace.wait(now, false).unwrap();
            assert_eq!(wait, ms(100));
            now += wait;
        }
    }

    #[test]
    fn a_silent_source_that_must_speak_gives_none() {
        let (mut pace, begun) = (Pace::new(50.0, ms(400), false), Instant::now());
        // The play's first message.
        assert_eq!(pace.due(begun), Some(LiveMessage::default()));
        assert_eq!((pace.due(begun + ms(900)), pace.wait(begun + ms(900), false)), (None, None));
        pace.hear(pose(1.0));
        let begun = begun + ms(1000);
        assert_eq!(pace.due(begun), Some(pose(1.0)));
        // The source sends only an empty line.
        pace.hear(LiveMessage::default());
        assert_eq!((pace.due(begun), pace.wait(begun, false)), (None, Some(ms(100))));
        assert_eq!(pace.due(begun + ms(100)), Some(LiveMessage::default()));
        assert_eq!((pace.due(begun + ms(900)), pace.wait(begun + ms(900), false)), (None, None));
    }

    #[test]
    fn the_last_update_is_answered_and_lasts_before_the_end() {
        let (mut pace, begun) = (Pace::new(50.0, ms(400), false), Instant::now());
        pace.hear(pose(1.0));
        pace.end(begun);
        assert_eq!((pace.is_done(begun), pace.due(begun)), (false, Some(pose(1.0))));
        let (sooner, later) = (begun + ms(5), begun + ms(30));
        assert_eq!(
            (pace.is_done(later), pace.wait(later, true)),
            (false, Some(ms(70))),
            "a sign of life is next"
        );
        // The play ends even without an answer.
        assert_eq!((pace.is_done(begun + ms(2_019)), pace.is_done(begun + ms(2_020))), (false, true));
        pace.answered();
        assert_eq!((pace.is_done(sooner), pace.wait(sooner, true)), (false, Some(ms(15))));
        assert!(pace.is_done(later));
    }

    /// Updates are rarer than signs of life.
    #[test]
    fn a_slow_rate_sends_updates_between_signs_of_life() {
        let (mut pace, begun) = (Pace::new(5.0, ms(400), true), Instant::now());
        let mut updates = Vec::new();
        for at in 0..1_000 {
            let now = begun + ms(at);
            pace.hear(pose(at as f64));
            if let Some(message) = pace.due(now) {
                updates.extend(message.pose.map(|pose| pose.x_mm));
                pace.answered();
            }
        }
        assert_eq!(updates, [0.0, 200.0, 400.0, 600.0, 800.0]);
    }

    #[test]
    fn merged_drives_are_the_newest_of_each_motor() {
        let drives =
            |drives: &[LiveDrive]| LiveMessage { drives: Some(drives.to_vec()), ..LiveMessage::default() };
        let (mut pace, now) = (Pace::new(50.0, ms(400), false), Instant::now());
        pace.hear(drives(&[drive(1, 10.0), drive(2, 20.0)]));
        pace.hear(LiveMessage { scale: Some(0.5), ..LiveMessage::default() });
        pace.hear(drives(&[drive(1, 11.0), drive(3, 30.0)]));
        let sent = pace.due(now).unwrap();
        assert_eq!(sent.drives.unwrap(), [drive(2, 20.0), drive(1, 11.0), drive(3, 30.0)]);
        assert_eq!(sent.scale, Some(0.5));
    }

    #[test]
    fn merged_levels_are_the_newest_of_each_motor_and_take_the_place_of_drives() {
        let levels = |um: &[(u8, f64)], glide_ms| LiveMessage {
            um: um.iter().copied().collect(),
            glide_ms,
            ..LiveMessage::default()
        };
        let drives = |drive| LiveMessage { drives: Some(vec![drive]), ..LiveMessage::default() };
        let (mut pace, now) = (Pace::new(50.0, ms(400), false), Instant::now());
        pace.hear(levels(&[(1, 10.0), (2, 20.0)], Some(5.0)));
        pace.hear(drives(drive(2, 40.0)));
        pace.hear(drives(drive(3, 40.0)));
        pace.hear(levels(&[(1, 11.0), (3, 30.0)], None));
        let sent = pace.due(now).unwrap();
        assert_eq!(sent.drives.unwrap(), [drive(2, 40.0)]);
        assert_eq!((sent.um, sent.glide_ms), ([(1, 11.0), (3, 30.0)].into(), Some(5.0)));
    }

    #[derive(Clone, Debug)]
    enum Op {
        Hear(Option<i8>),
        Answer,
        Pass(u16),
    }

    fn op() -> impl Strategy<Value = Op> {
        prop_oneof![
            prop::option::of(any::<i8>()).prop_map(Op::Hear),
            Just(Op::Answer),
            (0..200_u16).prop_map(Op::Pass)
        ]
    }

    proptest! {
        /// In all cases the rate is kept, the newest state arrives, and no false sign of life is sent.
        #[test]
        fn its_promises_hold(
            ops in prop::collection::vec(op(), 1..200),
            keep_alive: bool,
            gap_ms in 1_u64..500,
            quiet_ms in 10_u64..500,
        ) {
            let (gap, quiet) = (ms(gap_ms), ms(quiet_ms));
            let mut pace = Pace::new(1e3 / gap_ms as f64, 4 * quiet, keep_alive);
            let mut now = Instant::now();
            let (mut newest, mut shown, mut heard, mut sent) = (None, None, true, 0_u32);
            let (mut sent_at, mut updated_at): (Option<Instant>, Option<Instant>) = (None, None);
            for op in ops {
                match op {
                    Op::Hear(None) => {
                        heard = true;
                        pace.hear(LiveMessage::default());
                    }
                    Op::Hear(Some(x_mm)) => {
                        heard = true;
                        newest = Some(pose(x_mm.into()));
                        pace.hear(pose(x_mm.into()));
                    }
                    Op::Answer => {
                        sent = sent.saturating_sub(1);
                        pace.answered();
                    }
                    Op::Pass(passed) => now += ms(passed.into()),
                }
                // The time since the play's first message counts like that since an update.
                let message = pace.due(now);
                let is_update = message.as_ref().is_some_and(|message| !is_empty(message));
                let is_new = newest != shown && sent < UNANSWERED;
                prop_assert!(is_update || !is_new || updated_at.is_some_and(|at| now - at < gap));
                let Some(message) = message else { continue };
                prop_assert!(is_update || heard || keep_alive);
                let (since, least) = if is_update { (updated_at, gap) } else { (sent_at, quiet) };
                prop_assert!(since.is_none_or(|since| now - since >= least), "{:?}", since);
                if is_update {
                    prop_assert_eq!(Some(&message), newest.as_ref());
                    shown = newest.clone();
                }
                if is_update || sent_at.is_none() {
                    updated_at = Some(now);
                }
                (heard, sent_at) = (false, Some(now));
                sent += 1;
            }
        }
    }
}
