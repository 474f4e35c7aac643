//! Removes old files. A clock reading alone never makes a file old.
//!
//! The record counts the days on which it is written, and keeps the count of each file's last day in [`LIST`], beside the files.
//! [`Removal::written`] defines when a file is old: both the count and the calendar must say so. A new date adds one to the count,
//! but only if the daemon has run for [`MIN_APART`] since it last added one. So a clock that jumps adds at most one, and a repeated
//! date adds nothing.
//!
//! Invariants: the last `logbook_days` days of writing stay; a file that is not in the list counts as written today; only files
//! named after a day are removed, at most [`MOST`] at a time.

use super::{days, numbers};
use jiff::Span;
use jiff::civil::{Date, date};
use meissner_stream::time::HostInstant;
use rustix::fs::OFlags;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::Duration;

/// The list: a line for each file, with its date and the count of days on its last day of writing.
pub(super) const LIST: &str = "days";
/// The most bytes of a list: a century.
const MAX_LIST: u64 = 1 << 20;
/// Files of earlier dates were written with a clock that was never set. Their age is unknown, so they stay.
const FIRST: Date = date(2026, 1, 1);
/// Files removed on one day, at most.
const MOST: usize = 3;
/// The daemon must run this long between two days that count: less than a day, because labs do not begin at the same minute.
const MIN_APART: Duration = Duration::from_secs(20 * 3600);

/// Each file's day, and the count of days on its last day of writing.
type Files = BTreeMap<Date, u64>;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Removal {
    /// When this process last counted a day.
    counted: Option<HostInstant>,
    /// The highest number in the files that were removed from the directory.
    pub(super) removed: u64,
}

impl Removal {
    /// Notes that the file of `today` has a new line, and removes old files if a new day begins with it.
    ///
    /// A file is old if the record was written on more than `keep` days since the file's last line, and if its date is more than
    /// `keep` days before today and before the newest other date. The files of `held` days stay, because the running session has
    /// lines there.
    ///
    /// # Errors
    /// If the list cannot be written (then nothing is removed), or a file cannot be removed.
    pub(super) fn written(
        &mut self,
        dir: &Path,
        today: Date,
        now: HostInstant,
        keep: u32,
        held: &BTreeSet<Date>,
    ) -> io::Result<()> {
        let mut present = Vec::new();
        for entry in fs::read_dir(dir)? {
            present.extend(entry?.file_name().to_str().and_then(days::day));
        }
        let (files, is_new_day) = self.count(&read(dir)?, &present, today, now);
        write(dir, &files)?;
        if !is_new_day {
            return Ok(());
        }
        self.counted = Some(now);
        // Go on after a file that cannot be removed.
        let old = old(&files, today, keep).into_iter().filter(|day| !held.contains(day));
        let remove = |day| {
            let path = dir.join(days::name(day));
            let last = numbers::last(&path).ok().flatten();
            fs::remove_file(&path)?;
            self.removed = self.removed.max(last.unwrap_or(0));
            Ok(())
        };
        old.map(remove).fold(Ok(()), Result::and)
    }

    /// The list with today's line, and whether today is a new day of writing.
    fn count(&self, listed: &Files, present: &[Date], today: Date, now: HostInstant) -> (Files, bool) {
        let count = listed.values().max().copied().unwrap_or(0);
        let waited = self.counted.is_none_or(|counted| now.since(counted) >= MIN_APART);
        let is_new_day = waited && !listed.contains_key(&today);
        let count = count.saturating_add(is_new_day.into());
        let mut files: Files =
            present.iter().map(|&day| (day, listed.get(&day).copied().unwrap_or(count))).collect();
        files.insert(today, count);
        (files, is_new_day)
    }
}

/// The files to remove now: the oldest of the old ones.
fn old(files: &Files, today: Date, keep: u32) -> Vec<Date> {
    let count = files.get(&today).copied().unwrap_or(0);
    let newest = files.keys().copied().filter(|&day| day != today).max().unwrap_or(today);
    // Beyond the calendar's range everything stays.
    let oldest = newest.min(today).checked_sub(Span::new().days(keep)).unwrap_or(FIRST);
    let is_old =
        |day: Date, last: u64| (FIRST..oldest).contains(&day) && count.saturating_sub(last) > keep.into();
    let mut old: Vec<_> = files.iter().filter(|&(&day, &last)| is_old(day, last)).collect();
    old.sort_by_key(|&(day, last)| (last, day));
    old.into_iter().take(MOST).map(|(&day, _)| day).collect()
}

/// Reads the list, at most [`MAX_LIST`] bytes; a line that cannot be read is ignored.
fn read(dir: &Path) -> io::Result<Files> {
    let mut text = Vec::new();
    match File::open(dir.join(LIST)) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Files::new()),
        list => list?.take(MAX_LIST).read_to_end(&mut text)?,
    };
    let line = |line: &str| {
        let (day, count) = line.split_once(' ')?;
        Some((day.parse().ok()?, count.parse().ok()?))
    };
    Ok(String::from_utf8_lossy(&text).lines().filter_map(line).collect())
}

/// Replaces the list atomically, and makes it durable.
fn write(dir: &Path, files: &Files) -> io::Result<()> {
    let text: String = files.iter().map(|(day, count)| format!("{day} {count}\n")).collect();
    replace(dir, &dir.join(LIST), text.as_bytes())
}

/// Replaces a file of the directory atomically, and makes it durable.
pub(super) fn replace(dir: &Path, path: &Path, bytes: &[u8]) -> io::Result<()> {
    let next = path.with_extension("new");
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(true).mode(0o640);
    let mut file = options.custom_flags(OFlags::NOFOLLOW.bits().cast_signed()).open(&next)?;
    file.write_all(bytes)?;
    file.sync_data()?;
    fs::rename(next, path)?;
    File::open(dir)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;
    use jiff::ToSpan;
    use proptest::prelude::*;

    /// A record in memory, and the daemon that writes it. Time is counted in hours.
    #[derive(Default)]
    struct Lab {
        files: BTreeSet<Date>,
        list: Files,
        removal: Removal,
        /// The true time.
        hour: u64,
        /// The hour of each file's last line.
        lines: BTreeMap<Date, u64>,
        /// The hours of the daemon's starts.
        starts: Vec<u64>,
    }

    impl Lab {
        fn restart(&mut self) {
            self.removal = Removal::default();
            self.starts.push(self.hour);
        }

        /// Does the same as [`Removal::written`] on a disk.
        fn write(&mut self, clock: Date, keep: u32) {
            self.files.insert(clock);
            self.lines.insert(clock, self.hour);
            let now = HostInstant::from_ns(self.hour * 3_600_000_000_000);
            let present: Vec<_> = self.files.iter().copied().collect();
            let is_new_day;
            (self.list, is_new_day) = self.removal.count(&self.list, &present, clock, now);
            if is_new_day {
                self.removal.counted = Some(now);
                for day in old(&self.list, clock, keep) {
                    self.files.remove(&day);
                }
            }
        }

        /// Writes once a day, from a date on.
        fn days(&mut self, from: Date, number: i32, keep: u32) {
            for day in 0..number {
                // Beyond the calendar's end the clock stands.
                self.write(from.saturating_add(day.days()), keep);
                self.hour += 24;
            }
        }
    }

    fn dates(from: Date, number: i32) -> BTreeSet<Date> {
        (0..number).map(|day| from + day.days()).collect()
    }

    #[test]
    fn the_last_days_stay_and_older_ones_go() {
        let mut lab = Lab::default();
        lab.days(date(2026, 2, 1), 40, 10);
        // Today, yesterday, and the ten days before.
        assert_eq!(lab.files, dates(date(2026, 3, 1), 12));
        // With fewer days to keep, files are removed in steps.
        lab.days(date(2026, 3, 13), 1, 2);
        assert_eq!(lab.files.len(), 13 - MOST);
        lab.days(date(2026, 3, 14), 10, 2);
        assert_eq!(lab.files, dates(date(2026, 3, 20), 4));
        // The calendar's days without an entry do not count.
        let mut lab = Lab::default();
        (0..40).for_each(|week| lab.days(date(2026, 2, 1) + (7 * week).days(), 1, 10));
        assert_eq!(lab.files.len(), 11);
    }

    /// 301 daily files, and clocks that went wrong: with one command before midnight and one after, at each start, and for good.
    #[test]
    fn a_wrong_clock_removes_none_of_301_files() {
        let first = date(2026, 1, 26);
        let clocks = [
            date(2028, 3, 4),
            date(2099, 1, 1),
            date(9999, 12, 31),
            date(2026, 1, 2),
            date(1970, 1, 1),
            date(-9999, 1, 1),
        ];
        for clock in clocks {
            let mut lab = Lab::default();
            lab.days(first, 301, 400);
            for _ in 0..3 {
                lab.restart();
                lab.days(clock, 1, 400);
                lab.write(clock.saturating_add(1.days()), 400);
            }
            lab.days(clock, 50, 400);
            lab.days(first + 310.days(), 2, 400);
            assert!(lab.files.is_superset(&dates(first, 301)), "{clock}");
        }
    }

    /// The clock stands at one date after each start, for months: the last entries are in that file, however old its date is.
    #[test]
    fn the_file_of_a_dead_clock_battery_is_not_old() {
        let mut lab = Lab::default();
        let stuck = date(2026, 1, 2);
        lab.days(stuck, 300, 100);
        for _ in 0..200 {
            lab.restart();
            lab.days(stuck, 1, 100);
        }
        lab.restart();
        lab.days(date(2027, 6, 1), 90, 100);
        assert!(lab.files.contains(&stuck));
        lab.days(date(2027, 8, 30), 100, 100);
        assert!(!lab.files.contains(&stuck));
    }

    #[test]
    fn a_lost_list_and_a_restored_file_delay_the_removal() {
        let mut lab = Lab::default();
        lab.days(date(2026, 2, 1), 20, 10);
        lab.list.clear();
        lab.files.insert(date(2026, 1, 20));
        let before = lab.files.clone();
        lab.days(date(2026, 2, 21), 11, 10);
        assert!(lab.files.is_superset(&before));
        lab.days(date(2026, 3, 4), 1, 10);
        assert!(!lab.files.contains(&date(2026, 1, 20)));
    }

    #[test]
    fn only_files_of_days_are_removed_and_what_cannot_be_removed_keeps_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let name = |day| dir.path().join(days::name(day));
        let others =
            ["2026-02-01.jsonl~", "x2026-02-01.jsonl", "2026-2-1.jsonl", "2026-13-01.jsonl", "notes.jsonl"];
        for other in others {
            fs::write(dir.path().join(other), "").unwrap();
        }
        fs::write(name(date(1970, 1, 1)), "").unwrap();
        fs::create_dir(name(date(2026, 2, 2))).unwrap();
        let mut removal = Removal::default();
        let mut write = |day: i32| {
            let today = date(2026, 3, 1) + day.days();
            fs::write(name(today), "").unwrap();
            let now = HostInstant::from_ns(day.unsigned_abs() as u64 * 86_400_000_000_000);
            removal.written(dir.path(), today, now, 2, &BTreeSet::new()).is_ok()
        };
        let is_good: Vec<_> = (0..6).map(&mut write).collect();
        assert_eq!(
            is_good,
            [true, true, true, false, false, false],
            "the directory cannot be removed as a file"
        );
        assert!(others.iter().all(|other| dir.path().join(other).exists()));
        assert!(name(date(1970, 1, 1)).exists());
        let left = (0..6).map(|day| name(date(2026, 3, 1) + day.days()).exists()).collect::<Vec<_>>();
        assert_eq!(left, [false, false, true, true, true, true]);
        // Unreadable lines count as missing.
        fs::write(
            dir.path().join(LIST),
            b"\xff\n2026-03-03\n2026-03-04 x\n2026-03-06 18446744073709551615\n",
        )
        .unwrap();
        assert!(write(6) && name(date(2026, 3, 3)).exists());
        // If the list cannot be written, nothing is removed.
        fs::create_dir(dir.path().join("days.new")).unwrap();
        assert!(!write(50) && name(date(2026, 3, 3)).exists());
    }

    #[derive(Clone, Debug)]
    enum Op {
        /// Commands once a day, with the clock as it stands.
        Days(i32),
        /// The clock jumps to another day; a command before midnight and one after.
        Jump(i32),
        /// The clock goes wild within an hour.
        Flap(Vec<i32>),
        Restart,
    }

    fn op() -> impl Strategy<Value = Op> {
        let offset = -800..800_i32;
        prop_oneof![
            4 => (1..30_i32).prop_map(Op::Days),
            2 => offset.clone().prop_map(Op::Jump),
            1 => prop::collection::vec(offset, 1..40).prop_map(Op::Flap),
            1 => Just(Op::Restart),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        /// For any clock, the record was written on more than `keep` days since a removed file's last line. True time bounds the
        /// number of days: one in each [`MIN_APART`], and one at each start.
        #[test]
        fn jumping_clocks_remove_no_young_file(ops in prop::collection::vec(op(), 1..40), keep in 1..60_u32) {
            let mut lab = Lab::default();
            let mut offset = 0;
            for op in ops {
                let (hours, clocks) = match op {
                    Op::Days(number) => {
                        offset += number;
                        (24, (offset - number..offset).collect())
                    }
                    Op::Jump(to) => {
                        offset = to;
                        (0, vec![offset, offset + 1])
                    }
                    Op::Flap(clocks) => (0, clocks),
                    Op::Restart => {
                        lab.restart();
                        continue;
                    }
                };
                for clock in clocks {
                    lab.write(date(2027, 1, 1) + clock.days(), keep);
                    lab.hour += hours;
                    let (hour, left) = (lab.hour, &lab.files);
                    for (day, last) in lab.lines.extract_if(.., |day, _| !left.contains(day)) {
                        let starts = lab.starts.iter().filter(|&&start| start >= last).count() as u64;
                        prop_assert!((hour - last) / 20 + starts + 1 > keep.into(), "{day} {last} {hour} {starts}");
                    }
                }
            }
        }
    }
}
