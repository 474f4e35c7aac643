//! Cases of `tests/faults`: some on the chip, all on the mock as a check of the runner, and that a case can fail.
//!
//! `cargo run -p meissner-hil --example faults` plays all of them on the chip.

use meissner_fault_cases::{Case, Ends, Evidence, Kind, PATTERNS, Seen, cases, jobs, run};
use meissner_hil::bench::Which;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::faults::{not_possible, play};

/// The case of a name, which may end with the label of a kind: `estop, down`.
fn case(name: &str) -> Case {
    let file = name.split(", ").next().unwrap_or(name);
    cases().into_iter().find(|case| case.name == file).unwrap()
}

/// The kind of that label, or the first one.
fn kind<'a>(case: &'a Case, name: &str) -> Kind<'a> {
    let label = name.split_once(", ").map(|(_, label)| label);
    case.kinds().find(|kind| label.is_none_or(|label| kind.label() == label)).unwrap()
}

/// The last one: values rise.
fn worst(case: &Case) -> Kind<'_> {
    case.kinds().last().unwrap()
}

/// Plays a kind on the chip.
fn on_the_chip(name: &str, pattern: &str) {
    let case = case(name);
    let seen = play(&Which::Chip(ChipOptions::new(1)), &kind(&case, name), pattern, 1);
    println!("{name}: {:?}", seen.unwrap_or_else(|problem| panic!("{name}: {problem}")));
}

macro_rules! on_the_chip {
    ($($test:ident: $name:literal, $pattern:literal;)*) => {
        mod on_chip {
            $(#[test] fn $test() { super::on_the_chip($name, $pattern) })*
        }
    };
}

on_the_chip! {
    an_e_stop: "estop, down", "edge-45";
    a_host_that_hangs: "host-hangs", "wave";
    a_cable_that_is_pulled: "unplugged, hold", "wave";
    a_restart: "device-restarts", "pin-60";
    a_line_that_loses: "line-loses", "edge-45";
    a_lie: "device-lies-about-credits", "pin-60";
}

#[test]
fn every_kind_on_the_mock() {
    let cases = cases();
    let kinds: Vec<Kind<'_>> =
        cases.iter().flat_map(Case::kinds).filter(|kind| not_possible(kind).is_none()).collect();
    assert!(kinds.len() >= 60, "{} kinds", kinds.len());
    let on_the_mock = |kind: &Kind<'_>, pattern: &str, seed| play(&Which::Mock(seed), kind, pattern, seed);
    let problems = run(&kinds, &PATTERNS[..1], jobs(), on_the_mock, |_| ());
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

/// Plays a kind on the mock: as its case expects, and then with a changed case, which must fail with `why`.
fn is_told(name: &str, why: &str, change: fn(&mut Case)) {
    let mut case = case(name);
    let seen =
        |case: &Case| -> Result<Seen, String> { play(&Which::Mock(1), &kind(case, name), "pin-60", 1) };
    seen(&case).unwrap_or_else(|problem| panic!("{name}: {problem}"));
    change(&mut case);
    let problem = seen(&case).unwrap_err();
    assert!(problem.contains(why), "{name}: {problem}");
}

#[test]
fn what_is_not_as_expected_is_told() {
    is_told("stop, hold", "the play was cut", |case| case.expect.play = Ends::Done);
    is_told("host-hangs", "lines were high", |case| case.expect.safe_ms = Some(100.0));
    is_told("estop, up", "lines were high", |case| case.expect.safe_ms = Some(-2.0));
    is_told("stop, hold", "did not reach", |case| case.expect.latched = true);
    is_told("host-stalls-beyond-the-lead", "of the bursts were lost", |case| case.expect.lost_percent = 0.0);
    let evidence = [
        ("line-loses", Evidence::Resent),
        ("line-damages", Evidence::Unread),
        ("line-damages", Evidence::UnreadByDevice),
        ("clock-runs-wrong", Evidence::Rate),
        ("device-lies-about-credits", Evidence::Contradictions),
        ("line-delays", Evidence::Line),
    ];
    for (name, shows) in evidence {
        let mut case = case(name);
        case.expect.shows = Some(shows);
        let seen = |case: &Case| play(&Which::Mock(1), &worst(case), "pin-60", 1);
        seen(&case).unwrap_or_else(|problem| panic!("{name}: {problem}"));
        // Without its fault nothing shows it.
        case.fault.clear();
        let problem = seen(&case).unwrap_err();
        assert!(problem.contains("nothing shows") || problem.contains("the play was"), "{name}: {problem}");
    }
}

/// A case that expects a cut fails if the play ends otherwise, whatever the fault.
#[test]
fn no_case_is_met_by_a_play_without_its_fault() {
    for mut case in cases().into_iter().filter(|case| case.expect.play == Ends::Cut) {
        if case.kinds().all(|kind| not_possible(&kind).is_some()) {
            continue;
        }
        case.fault.clear();
        let problem = play(&Which::Mock(1), &kind(&case, &case.name), "pin-60", 1).unwrap_err();
        assert!(problem.contains("the play was done"), "{}: {problem}", case.name);
    }
}
