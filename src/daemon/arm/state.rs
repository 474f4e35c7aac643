//! The clients for which the motors are armed, and the silence that disarms them.
//!
//! A client that arms states how long it may be silent. The daemon watches those that have armed, and the one that ordered motion
//! last, whose signs of life count for the client that armed last. Any request of theirs, from its head to its answer, and any message
//! of a live play, is a sign of life. When a client is silent for the time that it has stated, and no other one that has armed was heard
//! in that time, the daemon stops and disarms, as at its own end.
//!
//! A client that leaves takes back what it has armed: the motors stay armed for the others.
//!
//! Invariant: while motors are armed there is a holder, except between the device's answer and the next event.

use crate::daemon::sessions::caller::Caller;
use meissner_api::{ArmedStatus, EndCause, Event};
use meissner_stream::queues::StreamEvent;
use meissner_stream::time::HostInstant;
use std::time::Duration;

/// See the module.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Armed {
    /// Those that have armed since the motors were off, the last one last; [`MOST`] at most.
    holders: Vec<Holder>,
    /// The client that has ordered motion last since then.
    mover: Option<Caller>,
    /// Clients whose requests are being answered: a client that waits for an answer is not silent.
    answering: Vec<(u64, Caller)>,
    /// The silence of a client that does not state one.
    default: Duration,
    /// The number of holders and requests so far.
    last: u64,
    /// Whether the last disarm was because of silence.
    was_silent: bool,
}

/// The most clients that are watched: of more, the one that armed first is forgotten.
const MOST: usize = 16;

/// A client that has armed.
#[derive(Debug)]
struct Holder {
    number: u64,
    caller: Caller,
    name: String,
    /// How long it may be silent; none: without limit.
    silence: Option<Duration>,
    heard: HostInstant,
    /// Since when it is the last one to have armed.
    since: HostInstant,
}

/// The silence that a client states when it arms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::daemon) enum Silence {
    /// The client states nothing.
    Default,
    For(Duration),
    /// The motors may stay armed without it.
    Unattended,
}

impl Armed {
    pub(in crate::daemon) const fn set_default(&mut self, silence: Duration) {
        self.default = silence;
    }

    fn next(&mut self) -> u64 {
        self.last += 1;
        self.last
    }

    /// Makes this client the holder. Returns the number of its watch.
    pub(in crate::daemon) fn hold(&mut self, caller: Caller, name: String, silence: Silence) -> u64 {
        let silence = match silence {
            Silence::Default => Some(self.default),
            Silence::For(silence) => Some(silence),
            Silence::Unattended => None,
        };
        let (number, heard) = (self.next(), HostInstant::now());
        let armed_last = self.holders.last().filter(|last| last.caller.is_same(&caller));
        let since = armed_last.map_or(heard, |last| last.since);
        self.forget(&caller);
        if self.holders.len() == MOST {
            self.holders.remove(0);
        }
        self.holders.push(Holder { number, caller, name, silence, heard, since });
        (self.mover, self.was_silent) = (None, false);
        number
    }

    fn forget(&mut self, caller: &Caller) {
        self.holders.retain(|holder| !holder.caller.is_same(caller));
    }

    /// Whether signs of life of this client count for this holder.
    fn speaks_for(&self, caller: &Caller, holder: &Holder) -> bool {
        let is_last = self.holders.last().is_some_and(|last| last.number == holder.number);
        let moves = || self.mover.as_ref().is_some_and(|mover| mover.is_same(caller));
        holder.caller.is_same(caller) || is_last && moves()
    }

    /// Notes a sign of life of this client: a request, a message, or the end of an answer.
    pub(in crate::daemon) fn hear(&mut self, caller: &Caller) {
        let heard: Vec<_> = self.holders.iter().map(|holder| self.speaks_for(caller, holder)).collect();
        for (holder, _) in self.holders.iter_mut().zip(heard).filter(|(_, heard)| *heard) {
            holder.heard = HostInstant::now();
        }
    }

    /// Notes that this client has ordered motion.
    pub(in crate::daemon) fn moves(&mut self, caller: Caller) {
        self.mover = Some(caller.clone());
        self.hear(&caller);
    }

    /// Notes that a request of this client is being answered, until [`Self::answered`] is called with the number.
    pub(in crate::daemon) fn answers(&mut self, caller: &Caller) -> u64 {
        let number = self.next();
        self.answering.push((number, caller.clone()));
        number
    }

    pub(in crate::daemon) fn answered(&mut self, number: u64) {
        let Some(at) = self.answering.iter().position(|(of, _)| *of == number) else { return };
        let (_, caller) = self.answering.swap_remove(at);
        self.hear(&caller);
    }

    /// For how long this client has been silent.
    fn silent(&self, holder: &Holder) -> Duration {
        let waits = self.answering.iter().any(|(_, caller)| self.speaks_for(caller, holder));
        if waits { Duration::ZERO } else { HostInstant::now().since(holder.heard) }
    }

    /// The rest of the stated time; none without a limit.
    fn left(&self, holder: &Holder) -> Option<Duration> {
        Some(holder.silence?.saturating_sub(self.silent(holder)))
    }

    /// Forgets the client with this watch, if another one that has armed was heard in the silence of this one. Returns whether.
    fn passes_on(&mut self, number: u64) -> bool {
        let silence = self.holders.iter().find(|holder| holder.number == number).and_then(|of| of.silence);
        let is_there = |other: &Holder| {
            other.number != number && silence.is_some_and(|silence| self.silent(other) < silence)
        };
        let passes = self.holders.iter().any(is_there);
        if passes {
            self.holders.retain(|holder| holder.number != number);
        }
        passes
    }

    /// Takes back what this client has armed. Returns whether the motors stay armed, for another client whose time is not over. One
    /// without a time does not count: it may have ended long ago.
    pub(in crate::daemon) fn give_back(&mut self, caller: &Caller) -> bool {
        let holds = |holder: &Holder| {
            !holder.caller.is_same(caller) && self.left(holder).is_some_and(|left| !left.is_zero())
        };
        let stays = self.holders.iter().any(holds);
        if stays {
            self.forget(caller);
            self.mover.take_if(|mover| mover.is_same(caller));
        }
        stays
    }

    /// The shortest time until the client with this watch can have been silent for too long; none if the watch is over.
    pub(in crate::daemon) fn until_silent(&self, number: u64) -> Option<Duration> {
        self.left(self.holders.iter().find(|holder| holder.number == number)?)
    }

    pub(in crate::daemon) fn status(&self) -> Option<ArmedStatus> {
        let holder = self.holders.last()?;
        Some(ArmedStatus {
            by: holder.name.clone(),
            for_s: HostInstant::now().since(holder.since).as_secs_f64(),
            silence_s: holder.silence.map(|silence| silence.as_secs_f64()),
            left_s: self.left(holder).map(|left| left.as_secs_f64()),
        })
    }

    /// Whether the client with this watch has been silent for too long, and no other one that has armed was heard meanwhile.
    pub(in crate::daemon) fn is_silent(&mut self, number: u64) -> bool {
        self.until_silent(number).is_some_and(|left| left.is_zero()) && !self.passes_on(number)
    }

    /// Notes that the motors are disarmed because of the silence of the client with this watch. Returns the event that tells of it, the
    /// first time.
    pub(in crate::daemon) fn fall_silent(&mut self, number: u64) -> Option<Event> {
        if std::mem::replace(&mut self.was_silent, true) {
            return None;
        }
        let holder = self.holders.iter().find(|holder| holder.number == number)?;
        Some(Event::OwnerSilent { by: holder.name.clone(), silence_s: holder.silence?.as_secs_f64() })
    }

    /// Names the silence as the cause of a play's end.
    pub(in crate::daemon) fn follow(&self, streamed: &mut StreamEvent) {
        match streamed {
            StreamEvent::PlayEnded { outcome, .. }
                if self.was_silent && outcome.cause == Some(EndCause::Disarm) =>
            {
                outcome.cause = Some(EndCause::OwnerSilent);
            }
            _ => {}
        }
    }

    /// Ends the watch: the motors are off.
    pub(in crate::daemon) fn end(&mut self) {
        self.holders.clear();
        self.mover = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Peer;

    fn process(pid: i32) -> Caller {
        Caller::new(Peer::local(pid, 0), None, None, None)
    }

    /// Puts the last sign of life so far into the past.
    fn wait(armed: &mut Armed, seconds: u64) {
        for holder in &mut armed.holders {
            for at in [&mut holder.heard, &mut holder.since] {
                *at = HostInstant::from_ns(at.as_ns().saturating_sub(seconds * 1_000_000_000));
            }
        }
    }

    fn left_s(armed: &Armed) -> f64 {
        armed.status().unwrap().left_s.unwrap().ceil()
    }

    #[test]
    fn only_who_armed_and_who_moves_is_heard() {
        let mut armed = Armed::default();
        let watch = armed.hold(process(10), "a".to_owned(), Silence::For(Duration::from_secs(10)));
        wait(&mut armed, 4);
        armed.hear(&process(11));
        assert_eq!(left_s(&armed), 6.0, "another client reads");
        armed.hear(&process(10));
        assert_eq!(left_s(&armed), 10.0);
        wait(&mut armed, 4);
        armed.moves(process(11));
        assert_eq!(left_s(&armed), 10.0, "another client plays");
        for pid in [10, 11] {
            wait(&mut armed, 4);
            armed.hear(&process(pid));
            assert_eq!(left_s(&armed), 10.0);
        }
        armed.moves(process(12));
        wait(&mut armed, 4);
        armed.hear(&process(11));
        assert_eq!(left_s(&armed), 6.0, "it was not the last one");
        wait(&mut armed, 7);
        assert_eq!(armed.until_silent(watch), Some(Duration::ZERO));
        // The next one has a watch of its own; who arms again has another one.
        let next = armed.hold(process(13), "b".to_owned(), Silence::Default);
        assert!(armed.until_silent(watch).is_some() && armed.until_silent(next).is_some());
        armed.hold(process(10), "a".to_owned(), Silence::Default);
        assert!(armed.until_silent(watch).is_none());
        wait(&mut armed, 3);
        armed.hold(process(13), "b".to_owned(), Silence::Unattended);
        assert_eq!(armed.status().unwrap().for_s.round(), 0.0, "another one had armed last");
        wait(&mut armed, 4);
        armed.hold(process(13), "b".to_owned(), Silence::Unattended);
        assert_eq!(armed.status().unwrap().for_s.round(), 4.0, "armed again, it is armed since then");
        let status = armed.status().unwrap();
        assert_eq!((status.by.as_str(), status.silence_s, status.left_s), ("b", None, None));
    }

    #[test]
    fn who_waits_for_an_answer_is_not_silent() {
        let mut armed = Armed::default();
        let watch = armed.hold(process(10), "a".to_owned(), Silence::For(Duration::from_secs(2)));
        let [own, other] = [10, 11].map(|pid| armed.answers(&process(pid)));
        wait(&mut armed, 60);
        assert_eq!(left_s(&armed), 2.0);
        armed.answered(own);
        assert_eq!(left_s(&armed), 2.0, "it has the answer now");
        wait(&mut armed, 60);
        assert_eq!(armed.until_silent(watch), Some(Duration::ZERO), "another one waits");
        armed.answered(other);
        assert_eq!(armed.until_silent(watch), Some(Duration::ZERO));
    }

    #[test]
    fn who_leaves_or_falls_silent_disarms_nobody_else() {
        let mut armed = Armed::default();
        let for_s = |seconds| Silence::For(Duration::from_secs(seconds));
        let first = armed.hold(process(10), "a".to_owned(), for_s(600));
        let second = armed.hold(process(11), "b".to_owned(), for_s(10));
        wait(&mut armed, 11);
        assert_eq!(armed.until_silent(second), Some(Duration::ZERO));
        assert!(!armed.passes_on(second), "the first one was not heard in the last 10 s");
        armed.hear(&process(10));
        assert!(armed.passes_on(second), "the first one is there");
        assert!(armed.until_silent(second).is_none() && armed.until_silent(first).is_some());
        armed.hold(process(11), "b".to_owned(), for_s(10));
        assert!(armed.give_back(&process(11)), "the first one may be silent for 600 s");
        assert_eq!(armed.status().unwrap().by, "a");
        assert!(!armed.give_back(&process(10)), "nobody else has armed");
        armed.hold(process(11), "b".to_owned(), for_s(10));
        wait(&mut armed, 11);
        assert!(!armed.give_back(&process(10)), "the time of the other one is over");
        armed.hold(process(12), "d".to_owned(), Silence::Unattended);
        assert!(!armed.give_back(&process(10)), "nobody knows whether it is there");
        for pid in 0..100 {
            armed.hold(process(pid), "c".to_owned(), for_s(10));
        }
        assert_eq!(armed.holders.len(), MOST);
    }
}
