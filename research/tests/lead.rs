//! The lead under recorded stalls, and traces that are refused.

use meissner_research::{LEADS_MS, LeadRow, LeadTradeoff, MAX_TRACE_BYTES, STALLS, Trace, lead_tradeoff};
use meissner_stream::queues::End;
use std::fs::{self, File};
use std::process::Command;

fn tried(trace: &str, leads_ms: &[f64]) -> LeadTradeoff {
    lead_tradeoff(&Trace::read(trace, "trace").unwrap(), leads_ms)
}

fn late(found: &LeadTradeoff) -> Vec<u64> {
    found.rows.iter().map(|row| row.late_bursts).collect()
}

/// One stall in the middle of a play.
const STALL: &str = "# of 25 ms\nseconds 1\n500000 25000\n";

#[test]
fn a_lead_longer_than_the_stall_keeps_every_burst_and_a_shorter_one_loses_some() {
    let found = tried(STALL, &[10.0, 100.0]);
    let [short, long] = &found.rows[..] else { panic!("{found:?}") };
    // 24 motors make 2 880 bursts a second; this many fall into the time that the lead does not cover.
    let uncovered = 2880.0 * 0.015;
    assert!((0.5 * uncovered..2.0 * uncovered).contains(&(short.late_bursts as f64)), "{short:?}");
    assert!(short.late_share > 0.0 && long.late_share == 0.0 && long.late_bursts == 0);
    for row in [short, long] {
        let LeadRow { late_share, late_bursts, planned_bursts, end, .. } = *row;
        assert_eq!((late_share * planned_bursts as f64).round() as u64, late_bursts);
        assert!((2700..=2880).contains(&planned_bursts) && end == End::Done, "{row:?}");
        assert!(row.bytes_per_burst_open > 1.0 && row.bytes_per_burst_open < row.bytes_per_burst_loop);
    }
    assert!(found.recommendation.contains("Take a lead of 100 ms"), "{}", found.recommendation);
    assert_eq!((found.trace.seconds, found.trace.late_by_5_ms, found.trace.longest_us), (1, 1, 25_000));
}

#[test]
fn without_stalls_nothing_is_late_and_plays_begin_within_four_milliseconds() {
    let found = tried("seconds 2", &LEADS_MS);
    for (row, lead_ms) in found.rows.iter().zip(LEADS_MS) {
        assert_eq!((row.lead_ms, row.late_bursts, row.onset_late_bursts), (lead_ms, 0, 0));
        assert_eq!((row.orders, row.onsets), (7, 7));
        let (median, longest) = (row.onset_ms_p50.unwrap(), row.onset_ms_max.unwrap());
        assert!((2.5..4.0).contains(&median) && (median..4.0).contains(&longest), "{row:?}");
    }
    assert!(
        found.recommendation.starts_with("Take a lead of 5 ms: from 5 ms on"),
        "{}",
        found.recommendation
    );
}

#[test]
fn a_command_during_a_stall_waits_for_its_end() {
    // The third order comes at 502.742 ms.
    let found = tried("seconds 1\n500000 25000\n", &[50.0]);
    let longest = found.rows[0].onset_ms_max.unwrap();
    assert!((25.0..29.0).contains(&longest), "{longest}");
    assert!(found.rows[0].onset_ms_p50.unwrap() < 4.0);
}

#[test]
fn under_the_shipped_trace_shorter_leads_lose_more() {
    let whole = Trace::read(STALLS, "stalls.txt").unwrap();
    let summary = whole.summary();
    assert!(summary.seconds >= 60 && summary.late_by_5_ms > 5, "{summary:?}");
    // The part around the longest stall is enough for a test.
    let stalls: Vec<(u64, u64)> = STALLS
        .lines()
        .filter(|line| line.starts_with(|c: char| c.is_ascii_digit()))
        .map(|line| line.split_once(' ').unwrap())
        .map(|(due, late)| (due.parse().unwrap(), late.parse().unwrap()))
        .collect();
    let worst = stalls.iter().max_by_key(|(_, late)| *late).unwrap().0;
    let from = worst.saturating_sub(5_000_000);
    let part = stalls.iter().filter(|(due, _)| (from + 1..=worst).contains(due));
    let part: String = part.map(|(due, late)| format!("{} {late}\n", due - from)).collect();
    let found = tried(&format!("seconds 6\n{part}"), &[5.0, 10.0, 20.0]);
    let late = late(&found);
    assert!(late[0] > late[1] && late[1] >= late[2], "{late:?}");
    let shares: Vec<_> = found.rows.iter().map(|row| row.late_share).collect();
    assert!(shares.is_sorted_by(|a, b| a >= b), "{shares:?}");
}

#[test]
fn a_stall_longer_than_the_host_watchdog_timeout_ends_the_play_and_its_lead_is_not_recommended() {
    let found = tried("seconds 2\n500000 400000\n", &[100.0, 500.0]);
    assert_eq!((found.rows[0].end, found.rows[1].end), (End::Stopped, End::Done));
    assert!(found.rows[0].onsets < found.rows[0].orders);
    assert!(
        found.recommendation.starts_with("Take a lead of 500 ms, the longest"),
        "{}",
        found.recommendation
    );
    let found = tried("seconds 1\n500000 400000\n", &[100.0]);
    assert!(found.recommendation.starts_with("None of these leads is enough"), "{}", found.recommendation);
}

#[test]
fn an_invalid_trace_is_refused_in_one_line() {
    for (text, says) in [
        ("", "trace.txt: has no duration: record one with"),
        ("seconds 0", "begin with `seconds N`, 1 to 3600"),
        ("seconds 1e3", "has no duration"),
        ("1000 2000", "has no duration"),
        (
            "# why\nseconds 9\n\n5000 300 1",
            "trace.txt:4: `5000 300 1` is no late wake-up: write when it was due",
        ),
        ("seconds 9\n5000 0", "trace.txt:2: `5000 0` is no late wake-up"),
        ("seconds 9\n5000 -3", "is no late wake-up"),
        ("seconds 9\n5000 10000001", "how late it came, 1 to 10000000 us"),
        (
            "seconds 9\n9000001 300",
            "trace.txt:2: was due 9000001 us after the start: must be at most 9000000",
        ),
        ("seconds 9\n5000 3000\n8000 300", "trace.txt:3: was due at 8000 us: must be after 8000"),
        ("seconds 9\n18446744073709551616 3000", "is no late wake-up"),
    ] {
        let line = Trace::read(text, "trace.txt").unwrap_err().to_string();
        assert!(line.contains(says) && !line.contains('\n'), "{text:?}: {line}");
    }
}

#[test]
fn a_file_that_is_no_text_is_refused_in_one_line() {
    let file = std::env::temp_dir().join(format!("trace-{}.txt", std::process::id()));
    let complaint = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meissner-research"));
        let output = command.args(["lead", "--trace"]).arg(&file).output().unwrap();
        let line = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && line.lines().count() == 1, "{line}");
        line
    };
    fs::write(&file, b"seconds 9\n\xe9").unwrap();
    assert!(complaint().contains(".txt: not UTF-8 text"));
    File::create(&file).unwrap().set_len(MAX_TRACE_BYTES + 1).unwrap();
    assert!(complaint().contains("bytes are too many: a trace file has at most"));
    fs::remove_file(&file).unwrap();
    assert!(complaint().contains(".txt: cannot be read; name a trace file"));
}
