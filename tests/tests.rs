//! The integration tests, one binary, a module per theme.
#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

/// The local API of a real daemon: commands, receipts, events, problems, the end.
mod api;
/// What people and scripts get wrong: one line with what, where, what to do; nothing moves.
mod bad_input;
/// Boards: found or not, in use, or no boards at all; the doctor's look at them.
mod boards;
/// `calibrate`: what a plan plays, gains found again on the plant, files and what is refused in them.
mod calibrate;
/// `calibrate` on a real daemon: played, fitted, stored, used by its own device alone.
mod calibration;
/// What a line carries: measured, compared with what plays need, on lines that carry it just so.
mod capacity;
/// A method chosen for an allowed error keeps to it.
mod choose;
/// The command line against a real daemon.
mod cli;
/// More clients than there are places, and clients that do not listen.
mod client_limits;
mod closed_loop;
/// The stepped methods come to the exact one as the step shrinks.
mod convergence;
/// Trials and changes of single motors against fresh simulations.
mod evaluator;
/// Scenes at the edges of what a scene may be, by every method: each has one right answer.
mod extremes;
/// What was felt of a play whose bursts travelled otherwise than designed, beside what should have been felt.
mod felt;
/// `report`: figures against the models, the page, places that cannot be written to.
mod figures;
/// Motors that move by more or less than they should.
mod gains;
/// A real daemon in a directory of its own, for the others.
mod harness;
/// `tradeoff --loop`: a corner of its grid within the limits, the same bytes on any cores, its document and plot.
mod hold;
/// The same bits whatever the threads, the order of receptors, the blocks, and what is skipped.
mod independence;
/// The order of the rooms.
mod layers;
/// `tradeoff --stream`: the lead under recorded stalls, traces that are refused, its document and plot.
mod lead;
/// The library: made again byte for byte, and worth what it says.
mod library;
/// The manual pages and completions in `deploy` are what the command line makes of itself today.
mod manual;
/// The motor model and the plant against the reference figures.
mod models;
/// `optimise`: files and documents, budgets, interruptions, mistakes.
mod optimise;
/// A second, slow simulator written from the equations alone, for the fast one to be compared with.
mod oracle;
/// Pattern files: what is refused and how it is said; the shipped library.
mod patterns;
/// The simulated shafts: scatter, end stops, telemetry, and times a month away.
mod plant;
/// What was felt of plays as they were measured: with the loop and without, cut, unmeasured.
mod played;
/// What is left when the daemon is killed at any moment, the disk is full or nothing may be written: patterns, the logbook, and a play that goes on.
mod power;
/// A whole session through a pseudo-terminal and the serial transport; the daemon ended and killed in mid-play.
mod pty;
/// Orders that cross each other, the device's word, and the end of a lease: nothing comes to life that is over.
mod races;
/// Random numbers and scenes for the simulator's tests.
mod random;
/// What the README and the example configuration say is true.
mod readme;
/// `simulate` and `tradeoff`: documents, mistakes, the comparison of methods and its plot; the shipped scenes.
mod report;
/// A streamer and a mock in virtual time whose lines are compared with compiled strokes.
mod rig;
/// Scene files: what is refused and how it is said.
mod scenes;
/// The search: the paper's frequencies, a coordinate search's price, threads, budgets, flat places, its space.
mod search;
/// As a service: notices, watchdog, a socket that is handed over, a configuration that is read again.
mod service;
/// A session and a controller over a line that loses: one verdict per stroke.
mod session;
/// Shapes and sides against slow ways to the same: samples of an outline, pairs of receptors.
mod shapes;
/// Simulated spikes against another program's and the oracle's.
mod simulate;
/// The streamer against the mock: tick for tick, over bad lines, through stalls, stops and pulled cables.
mod streaming;
/// From patterns to strokes: exact ticks, repeats and cuts, invariants on random patterns.
mod strokes;
/// Target files: what is refused and how it is said; the shipped targets.
mod targets;

/// Lets `assert_no_alloc` see every allocation of the tests.
#[cfg(debug_assertions)]
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
