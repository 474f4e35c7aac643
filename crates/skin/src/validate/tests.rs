//! Tests verdicts against their numbers, and numbers against the book and another program.

use super::*;
use std::sync::LazyLock;

static FOUND: LazyLock<Validation> = LazyLock::new(validate);

fn case(start: &str) -> &'static Case {
    FOUND.cases.iter().find(|case| case.name.starts_with(start)).unwrap_or_else(|| panic!("no case {start}"))
}

#[test]
fn a_verdict_is_the_comparison_with_the_tolerance() {
    use ValidationVerdict::{Agrees, High, Low, None as Nothing};
    let about = Published::About(6.0, 2.0);
    assert_eq!([2.9, 3.0, 12.0, 12.1].map(|value| about.verdict(Some(value))), [Low, Agrees, Agrees, High]);
    assert_eq!((about.verdict(None), about.verdict(Some(f64::NAN))), (Nothing, Nothing));
    assert_eq!([0.9, 1.0].map(|value| Published::AtLeast(1.0).verdict(Some(value))), [Low, Agrees]);
    assert_eq!([1.0, 1.1].map(|value| Published::AtMost(1.0).verdict(Some(value))), [Agrees, High]);
}

#[test]
fn the_second_model_has_the_reference_s_spikes_and_the_first_none_of_its_classes() {
    assert_eq!(case("share of").afferents.value, Some(1.0));
    for case in FOUND.cases.iter().filter(|case| case.name.starts_with("PC") || case.name.starts_with("SA1"))
    {
        assert_eq!(case.membrane.verdict, ValidationVerdict::NotModelled, "{}", case.name);
        assert_ne!(case.afferents.verdict, ValidationVerdict::NotModelled, "{}", case.name);
    }
}

/// Checks the book's statements about the models with independent numbers: the library's cross-check.
#[test]
fn the_first_model_fires_several_times_per_cycle_and_the_second_once_at_most() {
    let display = case("RA: impulses per cycle");
    let [membrane, afferents] = [display.membrane, display.afferents].map(|of| of.value.unwrap());
    assert!((3.0..6.0).contains(&membrane) && (0.3..=1.0).contains(&afferents), "{membrane} {afferents}");
    // Saal's model of a PC afferent: below a micrometre at its best frequency.
    let lowest = case("PC: lowest threshold").afferents.value.unwrap();
    assert!((0.01..1.0).contains(&lowest), "{lowest}");
    let [agree, of] = FOUND.agreements(ModelName::Afferents);
    assert!(agree > 0 && agree < of && of == FOUND.cases.len() - 1, "{agree} of {of}: not its own spikes");
    let fitted = FOUND.cases.iter().filter(|case| case.made_from == Some(ModelName::Membrane));
    assert!(fitted.clone().count() == 2 && fitted.clone().all(|case| case.name.starts_with("RA: area")));
}
