use crate::harness::{offline, printed};

/// As docs/models.md says.
#[test]
fn validate_counts_the_cases_in_which_each_model_agrees() {
    let text = printed(offline().arg("validate"));
    let says =
        "membrane agrees in 1 of 12 cases that it was not made from; afferents agrees in 4 of 18 cases";
    assert!(text.contains(says), "{text}");
}
