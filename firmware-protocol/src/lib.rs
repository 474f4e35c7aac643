//! The wire protocol and the controller of a piezo pin-array display: no_std, no alloc, sans-IO.
//!
//! This page is the specification; there is no second one. Host and device are named from the host's side.
//!
//! # Time
//! The device counts pulse periods of 1/85 000 s, [`tick::Tick`]. Everything is scheduled in ticks; nothing
//! is "now". The count starts half a minute before the 32-bit wrap at every boot. A tick on the wire is its
//! low 32 bits and is read as a signed distance from the reader's now.
//!
//! # Frames
//! ```text
//!  0x00-free bytes: COBS( version=1 | postcard(HostMessage or DeviceMessage) | CRC-32, LE ) | 0x00
//! ```
//! At most 256 bytes ([`frame`]). What is too long, no COBS, fails its CRC, is not read to its last byte or
//! is cut short is counted (`bad_frames`) and otherwise as if it had never been sent. A frame of another
//! version is answered with the device's own `Hello`, whose first byte tells its version: both sides can say
//! which two versions met. Variants and fields are only appended within a version.
//!
//! # Handshake
//! The host sends `Hello { session }`, a random number, until the device answers with its `Hello`:
//! versions, boot id, motors, tick rate, pool, horizon, limits, features, clock, epoch. A new session number
//! while armed returns the pins and disarms (`NewHost`); the same number again changes nothing. Before a
//! `Hello` the device answers every frame with `NoSession`: it has restarted, the host begins anew.
//!
//! # The ordered stream
//! `Strokes` frames carry strokes packed in batches ([`batch`]), at most [`batch::MAX_BATCH`] in a frame (one with more
//! cannot be read), numbered from 0 in each epoch. The device
//! takes the frame it waits for (`next_seq`), keeps the next 8 that come before their turn, ignores repeated
//! ones, and answers each valid frame with a `Status` that acknowledges all before `next_seq`, names the early
//! ones it keeps, and tells the free stroke slots (`credits`). The host sends no more strokes than credits, no
//! frame beyond the 8, and after a time sends again what is neither acknowledged nor kept.
//! A stroke is accepted, refused or dropped whole. What a frame was not taken for is told by a `Verdict`;
//! a frame without one was taken as it was.
//!
//! The first frame of a play has `onset` set, and `base` is the play's onset. It is all or nothing: if the
//! onset or one of its strokes would be late, `OnsetRefused` says so and nothing of it was taken. When the
//! onset has passed, `Onset` reports it with the counters as they stood then. The trigger output rises with the
//! onset's tick and stays high for [`controller::TRIGGER_TICKS`].
//!
//! # Reports
//! `Verdict`, `OnsetRefused`, `Onset`, `Cut` and `Refused` must not be lost: they are numbered, and sent
//! again 10 ms later, when the host is heard, until the host's `seen` includes them. A `Status` tells how
//! many there are, so the host knows whether it has them all. 32 are kept. While 12 or fewer places are free,
//! `Strokes` are not taken and `Refused` is only counted, so that `Onset` and `Cut` find a place; when there is
//! none the newest is lost and counted.
//!
//! # Outside the stream
//! `Control` (arm, disarm, stop, e-stop, reset, move) carries the epoch it begins and is repeated until a
//! `Status` names that epoch; an epoch not newer than the present one is acknowledged and ignored. Frames of
//! strokes and amendments of another epoch are acknowledged and ignored: what was on its way when a stop was
//! sent does not come to life after it.
//!
//! `Amend` gives queued bursts new absolute counts: named by motor and up tick, within
//! [`limits::correction`] of the burst as planned, the newest `generation` wins. An amendment for a burst that
//! is rendered, unknown, cut, out of limits or without room before the next stroke is counted and ignored.
//! It is not acknowledged and not repeated.
//!
//! `Telemetry` comes while armed from devices that have the feature; a lost one is lost.
//!
//! # What the controller does
//! Lines are rendered at most [`controller::HORIZON`] ticks ahead, in blocks of [`controller::BLOCK`]. *Late* is what
//! begins before the rendered end. A shell looks for e-stops in the bytes as they come ([`urgent`]), before those
//! that came earlier have been read; where hosts can reach it on several lines, a `Hello` on another one takes over,
//! and the one before has lost its link.
//!
//! | event | what it does |
//! |---|---|
//! | power-up, panic, watchdog, CPU death | all lines off, disarmed for that cause, position unknown: `arm` is refused without `assume_rest` |
//! | `arm` | from disarmed only; first plays down what pins are owed, and reports it (`Cut`). Without arm, strokes are refused |
//! | stop, disarm, shutdown, abort, lease expired, link lost, another session | *return*: at the rendered end cut what runs and flush the queue, at once play down what is owed (cut in the up burst: the pulses played; later: the rest of the down burst), then off. Exempt from on-time limits. Then disarmed, after a stop armed |
//! | e-stop, a fault of its own | off after the tick being played; latched; what each pin is owed is kept. `reset` leads to disarmed |
//! | late stroke | never played late: dropped whole, reported |
//! | lease | while armed or returning and no valid frame for so long: return, disarm. Given at `arm`, at most 10 s |
//!
//! At a stroke's end the pin is at rest by definition: what a correction adds is not owed.
//!
//! # Limits
//! Kept whatever the host does ([`limits`]): up pulses of a stroke, the balance of its bursts, the distance of
//! corrections, the travel of moves, on-time per motor and rail, pool and ring sizes. A stroke that breaks one
//! is refused and reported; an on-time limit is checked when the stroke begins, for a move when it is asked for.
//! An amendment of a stroke that has begun is charged too, and ignored if it breaks one.

#![no_std]
#![forbid(unsafe_code)]

pub mod batch;
pub mod controller;
pub mod frame;
pub mod limits;
pub mod message;
pub mod stroke;
pub mod tick;
pub mod urgent;
