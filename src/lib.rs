//! What happens to a pattern, from file to motor.
//!
//! A [`pattern`] is a TOML file: which pins of the [`array`](mod@array) vibrate, at which frequency, amplitude and phase, and
//! when. The [`store`] keeps the shipped ones and a site's own. A person says `meissner play edge-45`: the [`cli`]
//! hands it over by [`client`] to the [`daemon`], which may run as a service: systemd starts it by its socket, hears how it stands and
//! that its streamer lives. Requests, the status and errors are defined in [`api`].
//!
//! The daemon compiles the pattern to [`strokes`]: excursions of one pin, an up burst and the down burst that
//! undoes it, each at an exact tick of 1/85 000 s. A stroke is defined once, in `firmware_protocol`, for everybody
//! who makes, sends, plays or simulates one.
//!
//! The [`stream`] is the heart. Its thread takes the play through a bounded ring, chooses an onset a few
//! milliseconds ahead, and keeps the controller fed 100 ms ahead of now through the [`link`], which makes a
//! reliable, ordered stream out of frames that may get lost, and estimates the device's clock ([`link::Clock`], in
//! [`units`] that cannot be mixed up). Telemetry, from a device that has it, comes back the same way; from it the streamer corrects each burst
//! shortly before it begins, within `firmware_protocol::limits`, so that shafts keep their rest position.
//!
//! A [`device`] is whatever a controller can be reached through: a board's serial port or its own USB interface, or
//! the mock. The controller is the same code in all, `firmware_protocol::controller`: it plays ticks, guards the limits,
//! and returns the pins when it is told to stop or no longer hears its host. On a board it runs in `firmware/`, which is
//! built and tested on its own, in an emulator that the real streamer plays to (`firmware/hil`). On the mock its lines
//! go to the [`plant`], 24 shafts after the [`motor`] model with the scatter that was measured on real ones ([`draw`]
//! makes it repeatable).
//!
//! When a device is connected, the link measures what the line carries, and a play that needs more is refused (counted
//! by [`stream::Need`]). The doctor looks at a device closer, without a daemon (measured by [`checkup`], judged by its
//! command), and at what on this machine could be in the way.
//!
//! By how much each pin's travel is off the model is measured: [`calibrate`] plays bursts of several lengths, an ordinary
//! pattern, and makes of the travels a gain for each motor and direction, kept in a file. The daemon has them measured, and the
//! streamer goes by them as long as the same device is connected.
//!
//! What happened comes out as notices; [`receipts`] makes of them the receipts and events that clients see. In the
//! end every burst of every play was played, late, dropped or refused, and the receipt says which, and what the skin felt of it.
//! The [`session_record`] keeps receipts, events and who asked for what, a file per day, for years. Lines for whoever runs the machine are
//! worded in `daemon/notebook.rs` and go where [`log`](mod@log) says: to the terminal or to journald. Neither can hold up an
//! emergency stop.
//!
//! What the [`skin`] makes of a pattern is computed offline: [`simulate`] takes a scene of drives and receptors to
//! spikes, exactly or by a step, and [`report`] says what each way of doing so costs and by how much it errs, and draws
//! what motors and skin make of a pattern. It also tries the streamer's lead on stalls that were recorded on a real machine.
//! What one is to feel is a target, a shape on the skin; [`optimise`] finds the pattern that tells it best from its surroundings.
//! It says, too, what was left of that when motors did not do quite what they were told ([`optimise::felt()`]).
//!
//! Tests run streamer, link, controller and plant in virtual time ([`stream::Simulation`]): same code, no clock.
//! Rooms are listed lowest first in `tests/layers.rs`; a room uses only what stands before it. [`config`] is read
//! at the daemon's start, and again when it is told to; what it takes while it runs stands in `daemon/reload.rs`.

pub mod cli;
pub mod config;
pub mod daemon;
pub mod log;
pub mod receipts;
pub mod session_record;
pub mod store;
