//! Years of days: month and year ends, a leap day, and both changes of daylight saving time, with removal of old files.

use super::{location, lost, stamp};
use crate::session_record::writer::{Disk, Writer};
use jiff::civil::{Date, date};
use jiff::tz::TimeZone;
use jiff::{Timestamp, ToSpan};
use std::collections::BTreeMap;
use std::fs;

/// Days that stay.
const KEEP: u32 = 60;
/// A disk without syncing, because durability is not tested here.
const UNSYNCED: Disk = Disk { sync: |_| Ok(()), ..Disk::REAL };

/// The local dates in a file's lines.
fn dates(text: &str) -> Vec<Date> {
    let date = |line: &str| {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        line["time"].as_str().unwrap()[..10].parse().unwrap()
    };
    text.lines().map(date).collect()
}

/// Writes a line every three hours for 800 days: two year ends, 29 February 2028 and four changes of the clock.
fn write_years(zone: &str) {
    let dir = tempfile::tempdir().unwrap();
    let record = location(dir.path(), KEEP).dir;
    let zone = TimeZone::posix(zone).unwrap();
    let mut writer = Writer::new(location(dir.path(), KEEP)).on(UNSYNCED, zone.clone());
    let begun: Timestamp = "2027-12-20T12:00:00Z".parse().unwrap();
    // The expected number of lines of each date, counted independently of the record.
    let mut written = BTreeMap::<Date, usize>::new();
    let mut offsets = Vec::new();
    for hours in (0..800 * 24_i64).step_by(3) {
        let now = begun + hours.hours();
        writer.write_next(stamp(&now.to_string(), 3_600_000_000_000 * hours.unsigned_abs()), lost(1));
        let local = now.to_zoned(zone.clone());
        *written.entry(local.date()).or_default() += 1;
        offsets.push(local.offset());
    }
    writer.finish();
    offsets.dedup();
    assert_eq!(offsets.len(), 5, "the clock changes four times");
    assert!(written.contains_key(&date(2028, 2, 29)) && written.len() > 800 - 2);
    // Exactly the last days remain, each with all its lines and no other day's.
    let mut kept = BTreeMap::new();
    for file in fs::read_dir(&record).unwrap() {
        let file = file.unwrap();
        let name = file.file_name().into_string().unwrap();
        let Some(day) = name.strip_suffix(".jsonl") else { continue };
        let day: Date = day.parse().unwrap();
        let dates = dates(&fs::read_to_string(file.path()).unwrap());
        assert!(dates.iter().all(|&date| date == day), "{name}: {dates:?}");
        kept.insert(day, dates.len());
    }
    // Today, the newest other date, and those up to `KEEP` days before that one.
    let last: BTreeMap<Date, usize> = written.into_iter().rev().take(KEEP as usize + 2).collect();
    assert_eq!(kept, last);
}

#[test]
fn every_line_of_years_is_in_the_file_of_its_local_date() {
    // Zones like Zurich; Havana, where the clock changes at midnight; and Lord Howe Island, where it changes by half an hour, in
    // the other half of the year.
    let zones =
        ["CET-1CEST,M3.5.0,M10.5.0/3", "CST5CDT,M3.2.0/0,M11.1.0/1", "<+1030>-10:30<+11>-11,M10.1.0,M4.1.0"];
    // A day's file is synced to the disk: side by side they wait less.
    std::thread::scope(|scope| {
        for zone in zones {
            scope.spawn(move || write_years(zone));
        }
    });
}

/// The daemon runs only on work days, with a holiday of a month. Days of writing count, so no file is removed early.
#[test]
fn a_lab_that_closes_keeps_its_days_of_writing() {
    let dir = tempfile::tempdir().unwrap();
    let record = location(dir.path(), KEEP).dir;
    let begun: Timestamp = "2027-12-20T08:00:00Z".parse().unwrap();
    let mut days = Vec::new();
    for day in 0..400_i64 {
        let now = begun + (24 * day).hours();
        let date = now.to_zoned(TimeZone::UTC).date();
        let holiday = date >= Date::constant(2028, 7, 15) && date < Date::constant(2028, 8, 15);
        if holiday || date.weekday().to_monday_zero_offset() > 4 {
            continue;
        }
        // Each day is another process.
        let mut writer = Writer::new(location(dir.path(), KEEP)).on(UNSYNCED, TimeZone::UTC);
        writer.write_next(stamp(&now.to_string(), 1), lost(1));
        writer.finish();
        days.push(date);
        let kept = fs::read_dir(&record)
            .unwrap()
            .filter(|file| file.as_ref().unwrap().file_name().to_string_lossy().ends_with(".jsonl"));
        let kept = kept.count();
        assert!(kept >= days.len().min(KEEP as usize), "{date}: {kept} files of {} days", days.len());
        assert!(kept <= KEEP as usize + 1, "{date}: {kept} files");
    }
}
