//! Tests of the exposure account: what counts, what is left, and what survives a restart.

use super::*;
use jiff::civil::date;
use meissner_array::pattern::{Drive, Pattern};

/// A play of one pin that vibrates all the time, for so long or without end.
fn play(end_s: Option<f64>) -> Vibration {
    let drive =
        Drive { motor: 9, frequency_hz: 60.0, amplitude_um: 80.0, phase: 0.0, start_s: None, stop_s: None };
    let pattern = Pattern::new("test", None, vec![drive], toml::Table::new()).unwrap();
    Vibration::of(&pattern, end_s)
}

fn at(seconds: f64) -> Now {
    Now { at: HostInstant::from_ns((seconds * 1e9) as u64), date: date(2026, 11, 22) }
}

fn account() -> Account {
    let limits =
        ParticipantLimits { max_continuous_s: 10.0, pause_s: 5.0, max_day_s: 30.0, ..Default::default() };
    Account::new(limits)
}

/// Plays it from `from` on, with a report ten times a second; returns when a limit was passed.
fn run(
    account: &mut Account,
    id: u64,
    vibration: Vibration,
    from: f64,
    seconds: f64,
) -> Option<(f64, Limit)> {
    account.add(id, vibration);
    let tenths = (seconds * 10.0).round() as u32;
    let passed = (0..=tenths).find_map(|tenth| {
        let played = f64::from(tenth) / 10.0;
        account.played(id, played, at(from + played)).map(|limit| (played, limit))
    });
    let played = passed.map_or(seconds, |(played, _)| played);
    account.ended(id, played, at(from + played));
    passed
}

#[test]
fn a_play_without_end_passes_the_limit_within_a_report() {
    let mut account = account();
    let (played, limit) = run(&mut account, 1, play(None), 100.0, 60.0).unwrap();
    assert_eq!(limit, Limit::Continuous);
    assert!((10.0..=10.11).contains(&played), "{played}");
    let refused = account.check(at(112.0), &play(None), false, false).unwrap_err();
    assert_eq!(refused.limit, Limit::Continuous);
    let says = "`participant.max_continuous_s` allows 10 s of vibration without a pause: 0.0 s are left; play again after a pause of 5 s";
    assert!(refused.text().starts_with(says), "{}", refused.text());
    assert_eq!(account.check(at(116.0), &play(None), false, false), Ok(()), "after a pause");
}

#[test]
fn a_finite_play_is_refused_as_a_whole_and_never_cut() {
    let mut account = account();
    assert_eq!(account.check(at(0.0), &play(Some(10.0)), false, false), Ok(()));
    let refused = account.check(at(0.0), &play(Some(10.5)), false, false).unwrap_err();
    assert!(
        refused.text().contains("the play vibrates for 10.5 s; play for less time"),
        "{}",
        refused.text()
    );
    assert_eq!(run(&mut account, 1, play(Some(10.0)), 0.0, 10.0), None, "exactly the limit");
    assert!(account.check(at(11.0), &play(Some(0.5)), false, false).is_err());
    // A rest shorter than a pause goes on with the same sum; one as long begins a new one.
    assert_eq!(run(&mut account, 2, play(Some(6.0)), 16.0, 6.0), None);
    let refused = account.check(at(24.0), &play(Some(6.0)), false, false).unwrap_err();
    assert_eq!((refused.used_s, refused.play_s), (6.0, Some(6.0)));
}

#[test]
fn plays_that_wait_have_their_time_kept() {
    let mut account = account();
    account.add(1, play(Some(6.0)));
    assert!(account.check(at(0.0), &play(Some(6.0)), false, false).is_err(), "behind it, without a pause");
    assert_eq!(account.check(at(0.0), &play(Some(6.0)), true, false), Ok(()), "in its place");
    assert_eq!(account.check(at(0.0), &play(Some(6.0)), false, true), Ok(()), "at a tick of its own");
    account.forget(1);
    assert_eq!(account.check(at(0.0), &play(Some(6.0)), false, false), Ok(()));
}

#[test]
fn the_day_s_sum_survives_a_restart_and_ends_with_the_day() {
    let mut account = account();
    for (id, from) in [(1, 0.0), (2, 20.0), (3, 40.0)] {
        assert_eq!(run(&mut account, id, play(Some(9.0)), from, 9.0), None);
    }
    let limits = *account.limits();
    let mut again = Account::new(limits);
    again.restore(account.text().unwrap().as_bytes()).unwrap();
    let refused = again.check(at(60.0), &play(Some(4.0)), false, false).unwrap_err();
    assert_eq!((refused.limit, refused.used_s.round()), (Limit::Day, 27.0));
    assert!(
        refused.text().contains("3.0 s are left") && refused.text().contains("tomorrow"),
        "{}",
        refused.text()
    );
    assert_eq!(again.check(at(60.0), &play(Some(3.0)), false, false), Ok(()));
    let tomorrow = Now { date: date(2026, 11, 23), ..at(60.0) };
    assert_eq!(again.check(tomorrow, &play(Some(4.0)), false, false), Ok(()));
    let status = again.status(at(60.0));
    assert_eq!((status.day_used_s.round(), status.day_left_s.round()), (27.0, 3.0));
    assert_eq!(again.status(tomorrow).day_used_s, 0.0);
    assert!(account.restore(b"{").is_err() && account.day_s(date(2026, 11, 22)) > 0.0, "a torn file");
}

/// Beyond the bound of names, the day's limit holds for the sum that further participants share.
#[test]
fn the_day_has_a_limit_for_the_thousand_and_first_participant_too() {
    let mut account = account();
    for person in 0..=PEOPLE {
        account.start_session(&format!("P{person}"));
        run(&mut account, 1, play(Some(1.0)), 100.0 * person as f64, 1.0);
        account.end_session();
    }
    account.start_session("late");
    let from = 1e6;
    let passed =
        (0..4).find_map(|block| run(&mut account, 1, play(None), from + 100.0 * f64::from(block), 9.0));
    assert_eq!(passed.map(|(_, limit)| limit), Some(Limit::Day));
    assert_eq!(
        account.check(at(from + 1000.0), &play(Some(1.0)), false, false).unwrap_err().limit,
        Limit::Day
    );
}
