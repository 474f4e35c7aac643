//! Meissner drives a tactile display of piezo pins: it plays patterns on the motors, tick by tick, and predicts the response of
//! the skin's afferents. This crate is the program: the daemon and the commands. The other crates implement the parts, from file to
//! motor.
//!
//! # The data path
//!
//! 1. **Object** (`library/objects/*.toml`, a shape on the skin) → [`meissner_paper`]: `search` and `make` find the pattern for it with the
//!    skin model; its `judge` scores the result. Command: `cli/optimise.rs`.
//! 2. **Pattern** (`library/patterns/*.toml`: which pins vibrate, at which frequency, amplitude and phase, when) →
//!    [`meissner_array::pattern`] reads and checks it. [`store`] holds the shipped patterns and a site's own.
//! 3. **Request** → `meissner play NAME` ([`cli`]) goes through [`meissner_client`] to the [`daemon`]: the routes are rows in `crates/api/src/route.rs`,
//!    [`meissner_api`] the JSON types, errors and events of both sides. Located errors of all input come from [`meissner_input`].
//! 4. **Play** → `daemon/plays` compiles the pattern to strokes ([`meissner_array::strokes`]), evaluates the bandwidth it needs,
//!    opens its receipt and sends it to the streamer.
//! 5. **Stroke**: one excursion of one pin, an up burst and the down burst that undoes it, at exact ticks.
//!    [`firmware_protocol::stroke`] defines it once for streamer, controller and simulators.
//! 6. **Streamer** ([`meissner_stream`], a real-time thread) → chooses the onset, keeps the controller fed `lead_ms` ahead, and
//!    corrects each burst from telemetry shortly before it begins (`control`). It accounts for every burst.
//! 7. **Link** ([`meissner_stream::link`]) → a reliable, ordered stream of frames with credits; it estimates the device's clock and
//!    measures the line's capacity. The wire format is specified in [`firmware_protocol`].
//! 8. **Device** ([`meissner_stream::device`]) → a board's serial port, its USB interface, or the mock.
//!    `daemon/core/connector.rs` opens it.
//! 9. **Controller** ([`firmware_protocol::controller`], the same code on boards and in the mock) → plays the ticks, guards the
//!    limits, returns the pins when it is stopped or no longer hears its host. `firmware/` runs it on a board.
//! 10. **Motors** → real ones, or [`meissner_array::simulated`], after the model of [`meissner_array::motor`].
//!
//! # The way back
//!
//! Streamer events enter the daemon in `daemon/core/event_loop.rs`. [`receipts`] turns them into receipts, totals and the API's
//! events: at its end, each burst of a play was played, late, dropped or refused. There are two records: the [`log`](mod@log) for operators
//! (its lines are in `daemon/core/log_lines.rs`), and the [`record`] for experiments, a file of JSON lines per session. Neither can
//! delay an emergency stop. [`meissner_stream::calibrate`] fits each motor's gain from the bursts of a calibration pattern;
//! `daemon/calibration/play.rs` plays it, `daemon/calibration/apply.rs` stores and applies it.
//!
//! # The skin model
//!
//! [`meissner_skin`] simulates the afferents' spikes for a scene, exactly or by steps: `cli/simulate` simulates scenes and patterns,
//! `cli/tradeoff` compares methods. The daemon runs it for renderings and previews in a process of their own ([`render_process`]).
//!
//! # Modules
//!
//! `docs/dev/architecture.md` says which file to open for which change.
//! The modules of this crate: `clock`, [`log`](mod@log), `file`, [`mod@array`], [`exposure`], [`record`],
//! [`receipts`], [`store`], `rendering`, [`render_process`], [`config`], `doctor`, [`daemon`], [`cli`]. Tests run streamer, link,
//! controller and simulated motors in virtual time ([`meissner_stream::Simulation`]): the same code without a clock.
//!
//! # Example
//!
//! ```
//! use meissner::store::Store;
//! use meissner_array::strokes::{StrokeOptions, Strokes};
//!
//! let edge = Store::new(None, false)?.get("edge-45")?;
//! let first = Strokes::new(&edge.pattern, &StrokeOptions::lasting(1.0))?.next().expect("an edge moves pins")?;
//! assert_eq!((first.moves(), first.level()), (2, 0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod array;
pub mod cli;
mod clock;
pub mod config;
pub mod daemon;
mod doctor;
pub mod exposure;
mod file;
pub mod log;
pub mod receipts;
pub mod record;
pub mod render_process;
mod rendering;
pub mod store;
