//! Tests of the exposure account: the counted vibration, the remaining time, and restarts.

mod random;

use super::*;
use jiff::civil::date;
use meissner_stream::{Hold, Settings};

/// A play of one pin that vibrates all the time, until `end_s` or without end.
fn play(end_s: Option<f64>) -> Vibration {
    Vibration::new([(0.0, end_s.unwrap_or(f64::INFINITY))], end_s)
}

fn at(seconds: f64) -> Now {
    let (today, wall) = (date(2026, 11, 22), Timestamp::from_second(1_795_300_000).unwrap());
    let wall = wall + SignedDuration::from_secs_f64(seconds);
    Now { at: HostInstant::from_ns((seconds * 1e9) as u64), wall, date: today, passed: today }
}

/// Whether a play would fit.
fn check(account: &mut Account, now: Now, play: &Vibration, onset: Onset) -> Result<(), Exceeded> {
    account.hold(now, play.clone(), onset, false).map(|held| {
        account.forget(held);
    })
}

fn check_next(account: &mut Account, now: Now, play: &Vibration) -> Result<(), Exceeded> {
    check(account, now, play, Onset::Next)
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
    let held = HELD + 1000 + id;
    let onset = Onset::Next;
    let live = Live { id: held, vibration, onset, counted_to_s: 0.0, gap_s: 0.0, cut: None, replaces: false };
    account.live.push(live);
    account.begin(held, id, at(from));
    let tenths = (seconds * 10.0).round() as u32;
    let passed = (0..=tenths).find_map(|tenth| {
        let played = f64::from(tenth) / 10.0;
        account.played(id, played, at(from + played)).map(|limit| (played, limit))
    });
    let played = passed.map_or(seconds, |(played, _)| played);
    account.ended(id, Some(played), at(from + played));
    passed
}

#[test]
fn a_play_without_end_is_stopped_before_it_passes_the_limit() {
    let mut account = account();
    let (played, limit) = run(&mut account, 1, play(None), 100.0, 60.0).unwrap();
    assert_eq!(limit, Limit::Continuous);
    assert!((9.5..=9.7).contains(&played), "{played}");
    let refused = check_next(&mut account, at(112.0), &play(None)).unwrap_err();
    assert_eq!(refused.limit, Limit::Continuous);
    let says = "limit for participants: `participant.max_continuous_s` allows 10 s of vibration without a pause: 0.4 s are left; play again after a pause of 5 s";
    assert!(refused.text().starts_with(says), "{}", refused.text());
    assert_eq!(check_next(&mut account, at(116.0), &play(None)), Ok(()), "after a pause");
}

#[test]
fn a_finite_play_is_refused_as_a_whole_and_never_cut() {
    let mut account = account();
    assert_eq!(check_next(&mut account, at(0.0), &play(Some(10.0))), Ok(()));
    let refused = check_next(&mut account, at(0.0), &play(Some(10.5))).unwrap_err();
    assert!(
        refused.text().contains("the play vibrates for 10.5 s; play for less time"),
        "{}",
        refused.text()
    );
    assert_eq!(run(&mut account, 1, play(Some(10.0)), 0.0, 10.0), None, "exactly the limit");
    assert!(check_next(&mut account, at(11.0), &play(Some(0.5))).is_err());
    // After a rest shorter than a pause the sum goes on; after a pause a new one begins.
    assert_eq!(run(&mut account, 2, play(Some(6.0)), 16.0, 6.0), None);
    let refused = check_next(&mut account, at(24.0), &play(Some(6.0))).unwrap_err();
    assert_eq!((refused.used_s, refused.play_s), (6.0, Some(6.0)));
}

#[test]
fn plays_that_wait_have_their_time_kept() {
    let mut account = account();
    let six = play(Some(6.0));
    let first = account.hold(at(0.0), six.clone(), Onset::Next, false).unwrap();
    assert!(check_next(&mut account, at(0.0), &six).is_err(), "behind it, without a pause");
    let instead = account.hold(at(0.0), six.clone(), Onset::Next, true).unwrap();
    account.forget(instead);
    // For a play at a fixed time, it matters whether a pause fits before it.
    for (after_s, fits) in [(0.015, false), (7.0, false), (10.9, false), (11.2, true), (3600.0, true)] {
        assert_eq!(check(&mut account, at(0.0), &six, Onset::At(after_s)).is_ok(), fits, "{after_s}");
    }
    account.forget(first);
    assert_eq!(check_next(&mut account, at(0.0), &six), Ok(()));
}

/// A loop that once evaded the limit: plays a little shorter than the limit, each at a fixed time a moment later.
#[test]
fn what_has_vibrated_counts_for_a_play_at_a_time_of_its_own() {
    let mut account = account();
    assert_eq!(run(&mut account, 1, play(Some(9.0)), 0.0, 9.0), None);
    for (now_s, onset_s, fits) in [
        (9.0, 9.015, false),
        (9.0, 13.9, false),
        (9.0, 14.1, true),
        (13.0, 13.015, false),
        (14.0, 14.015, true),
    ] {
        let found = check(&mut account, at(now_s), &play(Some(9.0)), Onset::At(onset_s));
        assert_eq!(found.is_ok(), fits, "{now_s} {onset_s}");
    }
    let sequence = Vibration::new([(0.0, 4.0), (20.0, 24.0)], Some(24.0));
    assert!(check(&mut account, at(9.0), &sequence, Onset::At(9.015)).is_err());
    let gap = Vibration::new([(0.0, 0.4), (20.0, 29.0)], Some(29.0));
    assert_eq!(check(&mut account, at(9.0), &gap, Onset::At(9.015)), Ok(()), "its own pause");
    assert_eq!(account.status(at(9.0)).continuous_used_s.round(), 9.0);
}

/// The return of the play before took its stretch beyond the limit.
#[test]
fn a_play_that_begins_with_a_gap_is_not_stopped_for_what_was_before_a_pause() {
    let mut account = account();
    assert_eq!(run(&mut account, 1, play(Some(10.0)), 100.0, 10.0), None);
    account.moved(at(110.0).at, 0.1, at(110.1));
    let later = Vibration::new([(1.0, 2.0)], Some(2.0));
    assert_eq!(check_next(&mut account, at(120.0), &later), Ok(()));
    assert_eq!(run(&mut account, 2, later, 120.0, 2.0), None);
}

/// After a kill the reserved time counts as used, and the stretch without a pause goes on; changing the clock gives no pause.
#[test]
fn a_kill_leaves_no_smaller_sum() {
    let mut account = account();
    let killed = |account: &Account, from: f64, after: Now| {
        let mut again = Account::new(*account.limits());
        again.restore(account.text(at(from)).unwrap().as_bytes(), after).unwrap();
        again
    };
    account.hold(at(0.0), play(Some(8.0)), Onset::Next, false).unwrap();
    let mut again = killed(&account, 0.0, at(2.0));
    assert_eq!((again.status(at(2.0)).day_used_s, again.status(at(2.0)).continuous_used_s), (8.5, 8.5));
    assert!(check_next(&mut again, at(2.0), &play(Some(4.0))).is_err());
    assert_eq!(check_next(&mut again, at(7.6), &play(Some(4.0))), Ok(()), "after a pause");
    // By the wall clock an hour has passed, by the other clock two seconds.
    let hour = Now { wall: at(3600.0).wall, ..at(10.0) };
    assert!(check_next(&mut killed(&account, 0.0, hour), hour, &play(Some(4.0))).is_err());
    // The machine has restarted, so only the wall clock counts.
    let again = |wall_s: f64| Now { wall: at(wall_s).wall, ..at(0.5) };
    account.forget(HELD + 1);
    run(&mut account, 1, play(Some(8.0)), 100.0, 8.0);
    for (wall_s, fits) in [(50.0, false), (110.0, false), (120.0, true)] {
        let mut after = killed(&account, 108.0, again(wall_s));
        assert_eq!(check_next(&mut after, again(wall_s), &play(Some(4.0))).is_ok(), fits, "{wall_s}");
    }
    // For a play without end ten seconds are reserved, and half a second after it.
    account.hold(at(200.0), play(None), Onset::Next, false).unwrap();
    let used_s = killed(&account, 200.0, at(200.0)).status(at(200.0)).day_used_s;
    assert!((used_s - 18.5).abs() < 1e-6, "{used_s}");
}

/// Pins that an emergency stop leaves up vibrate until half a second later, which the file says ahead, and come down some time.
#[test]
fn no_restart_makes_a_pause_of_pins_that_were_left_up() {
    let mut account = account();
    run(&mut account, 1, play(Some(8.0)), 100.0, 8.0);
    account.left_up(at(108.0).at, 0.03, at(108.0));
    let fits = |account: &Account, saved_s: f64, after: Now| {
        let mut again = Account::new(*account.limits());
        again.restore(account.text(at(saved_s)).unwrap().as_bytes(), after).unwrap();
        [5.0, 5.6].map(|rests_s| {
            let now = after.at(at(seconds(after.at) + rests_s).at);
            check_next(&mut again, now, &play(Some(4.0))).is_ok()
        })
    };
    // The last text on the disk is from before they came down.
    assert_eq!(fits(&account, 108.0, at(200.0)), [false, true]);
    assert!(account.come_down(at(108.1)) && !account.come_down(at(108.1)), "once");
    // The wall clock was set forward by an hour.
    let hour = Now { wall: at(3708.2).wall, ..at(108.2) };
    assert_eq!(fits(&account, 108.1, hour), [false, true]);
}

/// Its pins may come down at once, or none of them stands.
#[test]
fn a_replaced_play_makes_no_pause() {
    let mut account = account();
    run(&mut account, 1, play(Some(8.0)), 0.0, 8.0);
    let [from, until] = [10, 11].map(|seconds| seconds * 85_000);
    let hold = Hold { longest: 0, counted_until: None, vibrates: vec![(from, until)], highest: 400 };
    let settings = Settings::of(meissner_array::spec::Array::paper());
    let later = Vibration::of(&hold, Some(until), &settings);
    let held = account.hold(at(8.0), later, Onset::Next, false).unwrap();
    account.begin(held, 2, at(8.0));
    account.began(2, at(8.0).at);
    for (now_s, fits) in [(12.9, false), (13.0, true)] {
        let instead = account.hold(at(now_s), play(Some(4.0)), Onset::Next, true);
        assert_eq!(instead.map(|held| account.forget(held)).is_ok(), fits, "{now_s}");
    }
}

/// The clock is set forward by a day and back: neither of the two days starts again from 0.
#[test]
fn a_clock_that_is_set_gives_no_new_day() {
    let mut account = account();
    let on = |day: i8, passed: i8, seconds: f64| {
        let [date, passed] = [day, passed].map(|day| date(2026, 11, day));
        Now { date, passed, ..at(seconds) }
    };
    for (id, from) in [(1, 0.0), (2, 20.0), (3, 40.0)] {
        run(&mut account, id, play(Some(9.0)), from, 9.0);
    }
    let used = |account: &Account, now: Now| account.status(now).day_used_s.round();
    assert_eq!(used(&account, on(23, 22, 60.0)), 27.0, "a day passes more slowly");
    // After a restart of the daemon, only the date is known.
    let mut again = Account::new(*account.limits());
    again.restore(account.text(at(60.0)).unwrap().as_bytes(), on(23, 23, 61.0)).unwrap();
    assert_eq!(used(&again, on(23, 23, 61.0)), 0.0);
    for day in 23..29 {
        let held = again.hold(on(day, day, 100.0), play(Some(1.0)), Onset::Next, false).unwrap();
        again.begin(held, 9, on(day, day, 100.0));
        again.began(9, on(day, day, 100.0).at);
        again.ended(9, None, on(day, day, 101.0));
    }
    assert!(again.dates.len() <= DATES);
    assert_eq!(used(&again, on(28, 28, 200.0)), 1.0);
    assert_eq!(used(&again, on(22, 22, 200.0)), 27.0, "back again");
    assert!(again.problem(on(22, 22, 200.0)).unwrap().contains("later than today"));
}

#[test]
fn a_file_that_cannot_be_true_is_never_taken_for_nothing() {
    let day = |sums: &str| format!("{{\"date\":\"2026-11-22\",\"days\":[{sums}]}}");
    for text in [
        String::new(),
        "{".to_owned(),
        "null".to_owned(),
        "{\"date\":\"someday\",\"days\":[]}".to_owned(),
        day("{\"participant\":null,\"vibration_s\":-3}"),
        day("{\"participant\":null,\"vibration_s\":1e300}"),
        day("{\"participant\":null,\"vibration_s\":NaN}"),
        day("{\"participant\":null,\"vibration_s\":null}"),
        day("{\"participant\":\"P1\"}"),
    ] {
        let mut account = account();
        let why = account.restore(text.as_bytes(), at(0.0)).unwrap_err().to_string();
        assert!(why.starts_with("`exposure.json`: ") && why.contains("correct or remove it"), "{why}");
        assert_eq!(check_next(&mut account, at(0.0), &play(Some(0.1))).unwrap_err().limit, Limit::Day);
        assert_eq!(account.text(at(0.0)), None, "the file stays as it is");
        account.restore(day("").as_bytes(), at(0.0)).unwrap();
        assert_eq!(check_next(&mut account, at(0.0), &play(Some(0.1))), Ok(()));
    }
}

#[test]
fn spaces_and_case_make_no_other_person() {
    let mut account = account();
    let sums = "{\"date\":\"2026-11-22\",\"days\":[{\"participant\":\"P1 \",\"vibration_s\":3},\
                {\"participant\":\"P1\",\"vibration_s\":4},{\"participant\":\"P2\",\"vibration_s\":1}]}";
    account.restore(sums.as_bytes(), at(0.0)).unwrap();
    for (name, used_s) in [("P1", 7.0), (" p1", 7.0), ("\u{ff30}\u{ff11}", 7.0), ("P2", 1.0), ("P 1", 0.0)] {
        account.start_session(name);
        assert_eq!(account.status(at(0.0)).day_used_s, used_s, "{name:?}");
    }
}

#[test]
fn the_day_s_sum_survives_a_restart_and_ends_with_the_day() {
    let mut account = account();
    for (id, from) in [(1, 0.0), (2, 20.0), (3, 40.0)] {
        assert_eq!(run(&mut account, id, play(Some(9.0)), from, 9.0), None);
    }
    let limits = *account.limits();
    let mut again = Account::new(limits);
    again.restore(account.text(at(60.0)).unwrap().as_bytes(), at(60.0)).unwrap();
    let refused = check_next(&mut again, at(60.0), &play(Some(4.0))).unwrap_err();
    assert_eq!((refused.limit, refused.used_s.round()), (Limit::Day, 27.0));
    assert!(
        refused.text().contains("3.0 s are left") && refused.text().contains("tomorrow"),
        "{}",
        refused.text()
    );
    assert_eq!(check_next(&mut again, at(60.0), &play(Some(3.0))), Ok(()));
    let tomorrow = Now { date: date(2026, 11, 23), passed: date(2026, 11, 23), ..at(60.0) };
    assert_eq!(check_next(&mut again, tomorrow, &play(Some(4.0))), Ok(()));
    let status = again.status(at(60.0));
    assert_eq!((status.day_used_s.round(), status.day_left_s.round()), (27.0, 3.0));
    assert_eq!(again.status(tomorrow).day_used_s, 0.0);
}

/// Beyond the bound of names, the day's limit applies to the sum that further participants share.
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
    assert_eq!(check_next(&mut account, at(from + 1000.0), &play(Some(1.0))).unwrap_err().limit, Limit::Day);
}
