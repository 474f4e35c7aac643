//! Code that the tests of several crates share. No program uses it.
//!
//! - [`arrays`]: arrays of other motors than the paper's.
//! - [`documents`]: tables of mistakes that readers refuse.
//! - [`patterns`]: drives and patterns in few words; [`random`]: random drives and scenes.
//! - [`statistics`]: mean, standard deviation, root mean square.
//! - [`oracle`]: a second simulator, slow, written from the equations alone; [`both`] makes a scene for both.
//! - [`rig`]: a streamer and a mock in virtual time; its lines are compared with compiled strokes.

#![expect(missing_docs, missing_debug_implementations, reason = "only tests use it")]
#![expect(clippy::unwrap_used, clippy::missing_panics_doc, reason = "a test that panics has failed")]

pub mod arrays;
pub mod both;
pub mod documents;
pub mod oracle;
pub mod paper;
pub mod patterns;
pub mod random;
pub mod rig;
pub mod statistics;

/// The long form of a test where `MEISSNER_LONG` is set (`verify/run tests`), else the short one.
pub fn at_length<T>(short: T, long: T) -> T {
    if std::env::var_os("MEISSNER_LONG").is_some() { long } else { short }
}

/// Of a receipt: `planned = played + late + dropped + refused + replaced`, and something was planned.
#[track_caller]
pub fn assert_accounts(receipt: &serde_json::Value) {
    let bursts = &receipt["counts"]["bursts"];
    let of = |fate: &str| bursts[fate].as_u64().unwrap();
    assert_eq!(
        of("planned"),
        of("played") + of("late") + of("dropped") + of("refused") + of("replaced"),
        "{receipt}"
    );
    assert!(of("planned") > 0, "{receipt}");
}
