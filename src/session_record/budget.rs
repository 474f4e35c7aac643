//! Bounds the bytes of the session record, and counts the entries that it leaves out.
//!
//! Each kind of entry has a reserve of bytes that refills with time ([`Rate`]): plays, e-stops, edges of the trigger input, the daemon's
//! own entries, and the other commands. For the other commands each user also has a separate reserve. If the reserve has no room for an entry, the entry
//! is left out and counted by client and command. Entries about plays are never left out: while their reserve is empty, the daemon
//! refuses new plays.
//!
//! Bounds: [`BYTES_PER_DAY`]; [`USERS`] and [`ROWS`].
//!
//! Invariant: an entry is taken or counted.

use super::entry::{Entry, Kind, LeftOut, Note};
use meissner_stream::time::HostInstant;
use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

/// Seconds of a day.
const DAY_S: u64 = 86_400;

/// A reserve of bytes.
#[derive(Debug)]
struct Rate {
    /// Its size.
    burst: u64,
    /// Bytes per second by which it refills.
    per_s: u64,
}

impl Rate {
    /// The most bytes that it gives in a day.
    const fn per_day(&self) -> u64 {
        self.burst + self.per_s * DAY_S
    }
}

/// Plays, with their receipts: a session of 27 000 plays of an edge at once, and one a second for ever.
const PLAYS: Rate = Rate { burst: 128 << 20, per_s: 4 << 10 };
/// E-stops: 4 000 at once, and one a second.
const ESTOPS: Rate = Rate { burst: 1 << 20, per_s: 256 };
/// Edges of the trigger input: 20 000 at once, and one a second.
const EDGES: Rate = Rate { burst: 4 << 20, per_s: 256 };
/// Entries that no client causes: starts, devices.
const DAEMON: Rate = Rate { burst: 1 << 20, per_s: 256 };
/// The other commands of a user: 28 000 at once, and three a second.
const USER: Rate = Rate { burst: 8 << 20, per_s: 1 << 10 };
/// The other commands of all users.
const ALL_USERS: Rate = Rate { burst: 16 << 20, per_s: 2 << 10 };
/// The most users with separate reserves at a time: more than a lab has. Further users share one.
const USERS: usize = 64;
/// The most rows of an entry about left-out entries. All beyond are counted together.
const ROWS: usize = 32;
/// The most bytes of an entry that is not about a play.
pub(super) const MAX_ENTRY: u64 = 8 << 10;
/// How long left-out entries are counted before an entry reports them.
pub(super) const REPORT_AFTER: Duration = Duration::from_secs(60);
/// Bytes for queued plays that end after their reserve is empty, with the longest receipts and all items of one sequence.
const IN_FLIGHT: u64 = 6 << 20;

/// The most bytes that a running daemon writes in a day.
pub const BYTES_PER_DAY: u64 = PLAYS.per_day()
    + IN_FLIGHT
    + ESTOPS.per_day()
    + EDGES.per_day()
    + DAEMON.per_day()
    + ALL_USERS.per_day()
    + MAX_ENTRY * (DAY_S / REPORT_AFTER.as_secs() + 1);

/// The current state of a reserve.
#[derive(Debug)]
struct Reserve {
    rate: &'static Rate,
    /// Below zero if more was taken than there was.
    bytes: f64,
    at: HostInstant,
}

impl Reserve {
    const fn new(rate: &'static Rate, now: HostInstant) -> Self {
        Self { rate, bytes: rate.burst as f64, at: now }
    }

    fn refill(&mut self, now: HostInstant) {
        let new = self.rate.per_s as f64 * now.since(self.at).as_secs_f64();
        (self.bytes, self.at) = ((self.bytes + new).min(self.rate.burst as f64), now);
    }

    fn has(&self, bytes: u64) -> bool {
        self.bytes >= bytes as f64
    }

    fn take(&mut self, bytes: u64) {
        self.bytes -= bytes as f64;
    }
}

/// See the module.
#[derive(Debug)]
pub(super) struct Budget {
    plays: Reserve,
    estops: Reserve,
    edges: Reserve,
    daemon: Reserve,
    all_users: Reserve,
    /// By user; the highest number stands for the users that share a reserve.
    users: HashMap<u32, Reserve>,
    left_out: BTreeMap<(Option<u32>, &'static str), u64>,
}

impl Budget {
    pub(super) fn new(now: HostInstant) -> Self {
        Self {
            plays: Reserve::new(&PLAYS, now),
            estops: Reserve::new(&ESTOPS, now),
            edges: Reserve::new(&EDGES, now),
            daemon: Reserve::new(&DAEMON, now),
            all_users: Reserve::new(&ALL_USERS, now),
            users: HashMap::new(),
            left_out: BTreeMap::new(),
        }
    }

    /// Whether an entry of `bytes` bytes is to be written; if not, it is counted.
    pub(super) fn takes(&mut self, entry: &Entry, bytes: u64, now: HostInstant) -> bool {
        let (kind, uid, name) = entry.kind();
        let taken = match kind {
            Kind::Play => {
                self.plays.refill(now);
                self.plays.take(bytes);
                return true;
            }
            _ if bytes > MAX_ENTRY => false,
            Kind::EStop => take(&mut [&mut self.estops], bytes, now),
            Kind::Edge => take(&mut [&mut self.edges], bytes, now),
            Kind::Daemon => take(&mut [&mut self.daemon], bytes, now),
            Kind::Command => {
                let user = uid.unwrap_or(u32::MAX);
                self.users.retain(|&uid, reserve| {
                    reserve.refill(now);
                    uid == user || !reserve.has(USER.burst)
                });
                let own = self.users.len() < USERS || self.users.contains_key(&user);
                let user = if own { user } else { u32::MAX };
                let reserve = self.users.entry(user).or_insert_with(|| Reserve::new(&USER, now));
                take(&mut [reserve, &mut self.all_users], bytes, now)
            }
        };
        if !taken {
            let key = (uid, name);
            let is_new = !self.left_out.contains_key(&key);
            let row = if is_new && self.left_out.len() >= ROWS - 1 { (None, "other") } else { key };
            *self.left_out.entry(row).or_default() += 1;
        }
        taken
    }

    /// Takes the bytes of a pattern's text from the reserve for plays.
    pub(super) fn take_text(&mut self, bytes: u64, now: HostInstant) {
        self.plays.refill(now);
        self.plays.take(bytes);
    }

    /// Whether the reserve for plays has room.
    pub(super) fn takes_plays(&mut self, now: HostInstant) -> bool {
        self.plays.refill(now);
        self.plays.has(1)
    }

    #[cfg(test)]
    pub(super) fn use_up_plays(&mut self) {
        self.plays.bytes = -1e9;
    }

    pub(super) fn has_left_out(&self) -> bool {
        !self.left_out.is_empty()
    }

    /// The entry about the left-out entries.
    pub(super) fn report(&self) -> Entry {
        let row = |(&(uid, what), &entries): (&(Option<u32>, &'static str), &u64)| LeftOut {
            uid,
            user: None,
            what,
            entries,
        };
        let of: Vec<_> = self.left_out.iter().map(row).collect();
        Note::LeftOut { entries: of.iter().map(|row| row.entries).sum(), of }.into()
    }

    /// Notes that the entry about the left-out entries is queued.
    pub(super) fn reported(&mut self) {
        self.left_out.clear();
    }
}

/// Takes bytes from all of these reserves, or from none.
fn take(reserves: &mut [&mut Reserve], bytes: u64, now: HostInstant) -> bool {
    for reserve in reserves.iter_mut() {
        reserve.refill(now);
    }
    let has = reserves.iter().all(|reserve| reserve.has(bytes));
    if has {
        reserves.iter_mut().for_each(|reserve| reserve.take(bytes));
    }
    has
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session_record::{CommandEntry, Peer};
    use meissner_api::{BurstCounts, Event, MAX_ITEMS, MAX_ITEMS_LISTED, OnsetRecord, Receipt, Terms};
    use serde_json::{Value, json};

    fn command(name: &'static str, uid: u32, asked: Value) -> CommandEntry {
        let mut entry = CommandEntry::new(name, Peer::local(4_194_304, uid));
        entry.set_arguments(asked);
        entry.answer = "ok".to_owned();
        entry
    }

    fn refused_play(uid: u32, name: &str) -> Entry {
        let mut entry = command(
            "play",
            uid,
            json!({"pattern": name, "late": "drop", "replace": false, "open_loop": false}),
        );
        entry.answer = "not-found".to_owned();
        entry.set_detail(&format!("no pattern is called `{name}`; `meissner list` shows all"));
        Note::Command(entry).into()
    }

    fn at(seconds: f64) -> HostInstant {
        HostInstant::from_ns(1_000_000_000) + Duration::from_secs_f64(seconds)
    }

    fn counted(entry: Entry) -> (Entry, u64) {
        let bytes = entry.bytes();
        (entry, bytes)
    }

    /// The entries and bytes that a day under load writes.
    #[derive(Debug, Default)]
    struct Day {
        asked: u64,
        taken: u64,
        bytes: u64,
        left_out: u64,
    }

    impl Day {
        fn add(&mut self, budget: &mut Budget, (entry, bytes): &(Entry, u64), now: HostInstant) -> bool {
            let takes = budget.takes(entry, *bytes, now);
            self.asked += 1;
            if takes {
                (self.taken, self.bytes) = (self.taken + 1, self.bytes + bytes);
            }
            takes
        }

        fn report(&mut self, budget: &mut Budget) {
            if budget.has_left_out() {
                let report = budget.report();
                let Entry::Note(Note::LeftOut { entries, of }) = &report else { panic!("{report:?}") };
                assert_eq!(of.iter().map(|row| row.entries).sum::<u64>(), *entries);
                self.left_out += entries;
                self.bytes += report.bytes();
                assert!(report.bytes() <= MAX_ENTRY);
                budget.reported();
            }
        }
    }

    fn play(id: u64, receipt: Receipt) -> [Entry; 4] {
        let mut accepted =
            command("play", 1000, json!({"pattern": receipt.name, "seconds": 1.0, "late": "drop"}));
        accepted.play = Some(id);
        let onset = OnsetRecord {
            requested_tick: 1 << 33,
            actual_tick: 1 << 33,
            monotonic_ns: 1 << 45,
            uncertainty_ns: 9600,
            latency_ms: 4.25,
        };
        let events = [
            Event::Queued { id, name: receipt.name.clone(), ordered_ms: Some(1000.0) },
            Event::Began { id, onset },
            Event::Ended { receipt: Box::new(receipt) },
        ];
        let [queued, began, ended] =
            events.map(|event| Entry::of(&event, Some(Peer::local(7, 1000))).unwrap());
        [Note::Command(accepted).into(), queued, began, ended]
    }

    /// A day in which five users each send `load` four times a second; a sixth plays each second, stops after each play, and stops in an
    /// emergency each minute.
    fn day(load: impl Fn(u32) -> Entry) -> Day {
        let mut budget = Budget::new(at(0.0));
        let mut day = Day::default();
        let mut receipt = Receipt::new("edge-45", &"0".repeat(64), 1, &Terms::default());
        receipt.counts.bursts = Some(BurstCounts { planned: 1200, played: 1200, ..BurstCounts::default() });
        let loads = [1, 2, 3, 4, 5].map(|uid| counted(load(uid)));
        let play = play(3, receipt).map(counted);
        let estop = counted(Note::Command(command("estop", 6, Value::Null)).into());
        for second in 0..DAY_S {
            let now = at(second as f64);
            assert!(budget.takes_plays(now));
            assert!(play.iter().all(|entry| day.add(&mut budget, entry, now)));
            for load in loads.iter().cycle().take(4 * loads.len()) {
                day.add(&mut budget, load, now);
            }
            if second % 60 == 0 {
                assert!(day.add(&mut budget, &estop, now));
                day.report(&mut budget);
            }
        }
        day.report(&mut budget);
        assert_eq!(day.asked, day.taken + day.left_out, "{day:?}");
        assert!(day.bytes <= BYTES_PER_DAY && day.left_out > DAY_S, "{day:?}");
        day
    }

    #[test]
    fn a_day_of_refused_plays_and_a_day_of_stops_are_bounded_and_lose_no_play() {
        const { assert!(BYTES_PER_DAY < 800_000_000) };
        let long = "x".repeat(15_000);
        let plays = 4 * DAY_S;
        let stops = day(|uid| Note::Command(command("stop", uid, Value::Null)).into());
        let refused = day(|uid| refused_play(uid, &long));
        for day in [&stops, &refused] {
            assert!(day.taken > plays + DAY_S / 60);
        }
        println!("stops: {stops:?}\nrefused plays: {refused:?}");
    }

    #[test]
    fn the_longest_entries_are_bounded() {
        for letter in ["x", "\u{1}", "\"", "\u{10ffff}", "\u{202e}"] {
            let entry = refused_play(1, &letter.repeat(16 << 10));
            assert!(entry.bytes() <= MAX_ENTRY, "{letter:?}: {}", entry.bytes());
        }
        let pulses = Note::Command(command("calibrate", 1, json!({"pulses": vec![200; 8000]}))).into();
        assert!(Entry::bytes(&pulses) <= MAX_ENTRY);
        let receipt = crate::receipts::tests::longest();
        let bytes: u64 = play(1, receipt).iter().map(Entry::bytes).sum();
        let item = crate::receipts::tests::longest_item();
        let items = Event::Items {
            id: u64::MAX,
            session: Some("x".repeat(100)),
            items: vec![item; MAX_ITEMS_LISTED],
        };
        let items = Entry::of(&items, None).unwrap();
        // The items are no larger than a receipt, which bounds the events that wait for listeners.
        assert!(matches!(items.kind().0, Kind::Play) && items.bytes() < 32 << 10, "{}", items.bytes());
        let items = items.bytes() * (MAX_ITEMS / MAX_ITEMS_LISTED) as u64;
        // The running play with its items, 32 that wait, and one that begins.
        assert!(34 * bytes + items < IN_FLIGHT, "{bytes}, {items}");
    }

    #[test]
    fn plays_are_refused_while_their_reserve_is_empty_and_never_left_out() {
        let mut budget = Budget::new(at(0.0));
        let entries = play(1, Receipt::new("edge-45", &"0".repeat(64), 1, &Terms::default())).map(counted);
        let mut plays = 0;
        while budget.takes_plays(at(0.0)) {
            assert!(entries.iter().all(|(entry, bytes)| budget.takes(entry, *bytes, at(0.0))));
            plays += 1;
        }
        assert!(plays > 50_000 && !budget.has_left_out(), "{plays}");
        assert!(!budget.takes_plays(at(0.0)) && budget.takes_plays(at(2.0)));
    }

    #[test]
    fn a_flood_costs_other_users_and_e_stops_nothing() {
        let mut budget = Budget::new(at(0.0));
        let stop = |uid| Note::Command(command("stop", uid, Value::Null)).into();
        let (flood, bytes) = counted(stop(1));
        let taken = (0..100_000).filter(|_| budget.takes(&flood, bytes, at(0.0))).count();
        assert!((20_000..40_000).contains(&taken), "{taken}");
        let others = [
            stop(2),
            Note::Command(command("estop", 1, Value::Null)).into(),
            Entry::from(Note::DaemonEnded { problem: None }),
        ];
        assert!(others.iter().all(|entry| budget.takes(entry, entry.bytes(), at(0.0))));
        // More users and commands than there are reserves and rows.
        for uid in 0..1000 {
            let (stop, bytes) = counted(stop(uid));
            for _ in 0..100 {
                budget.takes(&stop, bytes, at(0.0));
            }
        }
        assert!(budget.users.len() <= USERS + 1 && budget.left_out.len() <= ROWS);
        assert!(budget.report().bytes() <= MAX_ENTRY, "{}", budget.report().bytes());
    }
}
