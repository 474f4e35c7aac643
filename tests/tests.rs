//! The integration tests, one binary, a module per theme.
#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

/// The architecture page against the tree; no circles of imports.
mod architecture;
/// The numbers of the paper's array are in its description only.
mod array_literals;
/// An array of a site's own.
mod arrays;
/// Boards: found, missing, in use, or something else; the doctor's report about them.
mod boards;
/// The README, the book and the example configuration: commands run, snippets parse, links have targets.
mod book;
/// The builds that tests run check for overflows.
mod build_checks;
/// `calibrate`: mistakes, and gains that were measured with a laser.
mod calibration;
/// Careless systems: an open umask, too little memory, floods of refusals.
mod careless;
/// The command line against a real daemon.
mod cli;
/// More clients than there are places, and clients that do not read.
mod client_limits;
/// `displacement`: samples of the pins as table and as document; patterns of files.
mod displacement;
/// `GET /v1/doctor`: the same findings as the command's.
mod doctor;
/// The data of figures: `motor --simulated` and `optimise --json` against the models.
mod figures;
/// A real daemon in its own directory, and helpers for the other tests.
mod harness;
/// `render` and `judge`: traces, what observers read, and what is left if something is not as told.
mod judge;
/// The man pages and completions are made from the program.
mod manual;
/// The daemon's memory: files that would fill it, a full queue of the longest pattern, the stated bound.
mod memory;
/// Patterns with motions, without a daemon: packed with their sample files, checked, simulated, refused where only drives are changed.
mod motions_offline;
/// The netlist of the board against the firmware.
mod netlist;
/// The API over TCP: commands, floods; without `listen` the daemon does not listen.
mod network;
/// The API reference: routes, answers and the book's copies agree with the OpenAPI document.
mod openapi;
/// `optimise`: files and documents, budgets, interruptions, mistakes.
mod optimise;
/// Kills at any moment, full disks and read-only directories; the session record.
mod power;
/// A whole session through a pseudo-terminal and the serial transport; the daemon ended and killed in mid-play.
mod pty;
/// The session record on a full disk, and the messages of commands.
mod record;
/// Objects that are rendered over the API, and previews of patterns.
mod renderings;
/// Rights of commands: signs of life, and terminals whose session is over.
mod rights;
/// Sequences: all or nothing, one receipt, scale and triggers; the command.
mod sequences;
/// The daemon as a service: notifications, watchdog, socket activation, reload, and a newer program.
mod service;
/// Sessions of the command line.
mod sessions;
/// `simulate` and `tradeoff`: documents, mistakes, the comparison of methods; the shipped scenes.
mod simulate;
/// `validate`: a verdict for every case, and the book's table.
mod validate;
