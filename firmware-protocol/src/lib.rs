//! The wire protocol of a piezo pin-array display, and the controller that runs on its device.
//!
//! This page is the specification of the protocol; there is no other. The crate is `no_std`, does not allocate and does
//! no I/O: the firmware, the mock and the host's link all use it. Modules, in the order of the data path:
//!
//! | module | what it holds |
//! |---|---|
//! | [`tick`], [`moves`], [`stroke`] | the unit of time, what motors are asked to do, and what lines do in a tick |
//! | [`mod@array`] | which array it is: motors, carrier, rails, driver chips, limits |
//! | [`batch`] | moves and amendments, packed |
//! | [`board`] | what a device says of itself: the board report, the self-test |
//! | [`message`], [`frame`] | messages, and their bytes on the line |
//! | [`urgent`] | finds an e-stop in incoming bytes before they are read in order |
//! | [`controller`] | the device's behaviour: bytes and ticks in, line states and bytes out |
//! | [`limits`] | what the controller refuses, whatever the host asks |
//!
//! ```
//! use firmware_protocol::array::{ArrayId, Layout, Name};
//! use firmware_protocol::controller::{Controller, Identity};
//! use firmware_protocol::frame::{self, Decoder, MAX_FRAME};
//! use firmware_protocol::message::{DeviceMessage, HostMessage};
//! use firmware_protocol::tick::Tick;
//!
//! let rails = [0, 0, 0, 1, 1, 1];
//! let chips = [0, 0, 1, 2, 2, 3];
//! let id = ArrayId { name: Name::new("two-by-three").expect("a name"), motors: 6, tick_hz: 70_000, duty_up: 250, duty_down: 750, hash: 7 };
//! let layout = Layout::new(id, &rails, &chips, 3_000, 17_000)?;
//! let mut device = Controller::new(Identity::NONE, layout);
//! let mut bytes = [0; MAX_FRAME];
//! let len = frame::encode(&HostMessage::Hello { session: 7 }, &mut bytes)?;
//! device.receive(Tick::BOOT, &bytes[..len]);
//! let len = device.transmit(Tick::BOOT, &mut bytes);
//! let mut decoder = Decoder::new();
//! let body = decoder.next(&mut &bytes[..len]).expect("a whole frame");
//! let DeviceMessage::Hello(hello) = frame::read(body)? else { panic!("a hello") };
//! assert_eq!((hello.session, hello.array), (7, id));
//! # Ok::<(), Box<dyn core::error::Error>>(())
//! ```
//!
//! # Time
//! The device counts ticks ([`tick::Tick`]). A tick is the period of one pulse: 1/85 000 s at the carrier of the paper's array. All
//! actions are scheduled in ticks. The count starts 2 550 000 ticks before the 32-bit wrap at every boot. The wire carries the low 32 bits of a tick; the reader
//! takes them as a signed distance from its own present tick.
//!
//! # Frames
//! ```text
//! version u8 | message (postcard) | CRC-32 of both, little-endian     the message: HostMessage or DeviceMessage
//! COBS of that                    | 0x00                              on the line: at most 256 bytes
//! ```
//! A *bad frame* is too long, is not COBS, fails its CRC, or its body is not exactly one message of its version: it has an
//! unknown variant, or bytes are missing or left over. Each side counts the bad frames that it receives (the device in
//! `bad_frames`, the host by kind) and otherwise ignores them. The device also counts a `Moves` frame whose batch cannot be read.
//!
//! # Moves
//! A *level* is a height of a pin above rest, in pulses. A move ([`moves::Move`]) gives a motor's pin a level from a tick on. One rule
//! holds for all motion:
//!
//! Each motor has a *goal*: the level that its pin should have now. A move sets the goal in its tick. From then on the motor pulses once a
//! tick towards the goal, until the pin is there or the motor's next move begins; a move before which the pin had not come to its goal
//! is counted as *shortened*. **A pin goes up only by a move that begins in time and that no limit refuses. It comes down whenever it is
//! above its goal**, as soon as the drivers are ready and the limits on motors at once allow it; nothing refuses the way down.
//!
//! A stroke is two moves, a ramp is many, a hold is none. Levels are absolute: a move that is lost changes nothing for those after it. A move
//! to the present goal, without a surplus, changes nothing: the pin is there or goes on. If the move before was refused, the goal is not its
//! level, and a move to that level takes the pin there.
//!
//! A refused move leaves the goal of the move before it, or the height if the pin is lower: so the pin stays, or comes down.
//! The *height* of a pin counts pulses; at the end of a burst it is the goal, whatever correction the burst had.
//!
//! # The array
//! The device is built for one array. The array has 1 to 64 motors ([`array::MAX_MOTORS`]), each with its rail (the motors that share a
//! supply) and its driver chip, in any grouping; the motors of a chip are on one rail. It has a carrier of 20 000 to 200 000 Hz, and limits of its pulses
//! ([`array::Layout`]). Times and limits in this page that depend on the array are methods of the layout. The handshake names the array
//! ([`array::ArrayId`]): name, motors, carrier, duties, and a hash of the description that both were made from. The host ends
//! the session if one of them is not that of its own array, and names the key and both values.
//!
//! A set of motors is a varint of at most 64 bits: bit m is motor m ([`array::MotorSet`]). The device ignores bits of motors that it
//! does not have. A set of outputs is the set of their lines, then a byte for the trigger and one for the driver enable, 0 or 1.
//!
//! # Versions
//! The messages of a version never change. A new, removed or moved field or variant needs a new [`frame::PROTOCOL`]:
//! postcard cannot skip what it does not know, and an older host that cannot read a `Status` or a report would wait for it
//! for ever. Within a version only unused bits of `features` may get a meaning.
//! Version 7 is not released yet: its messages may still change.
//! The device answers a frame of another version with its own `Hello`, whose first byte is its version. The host ends the
//! session when it reads a frame of another version, and tells the user to update the firmware or the program.
//!
//! # Handshake
//! The host repeats `Hello { session }`, a random number, until the device answers with its own `Hello`: firmware, boot
//! id, array, pool, horizon, limits, features, clock and epoch. A new session number begins a new epoch and
//! disarms the device (`NewHost`). The same number again changes nothing. Before a `Hello` the device answers every
//! frame with `NoSession`: it has restarted, and the host begins again.
//!
//! # The ordered stream
//! A `Moves` frame carries at most [`batch::MAX_BATCH`] packed moves. Frames are numbered from 0 in each epoch (`seq`).
//! The device takes frames in order. It buffers the next 8 that arrive out of order and ignores repeated ones. It
//! answers each valid frame with a `Status`, except `Board` and `SelfTest`, which have an answer of their own. In a `Status`
//! `next_seq` acknowledges all frames before it, `out_of_order` names those that are buffered, and `credits` is the number of
//! moves that the device can still queue. A move to level 0 without a surplus takes no slot, and counts as played at once, if its pin is at
//! rest by then whatever is refused before: if the goal is 0 and nothing of its motor waits, or the last that waits is a move to level 0 that
//! belongs to no stroke. The host sends no more moves than it has credits and no frame beyond those 8. It
//! sends again what is neither acknowledged nor buffered (selective repeat).
//! The device accepts, refuses or drops a move as a whole, and the two moves of a stroke together. A `Verdict` lists the moves of a frame
//! that were not accepted; a frame without a verdict was accepted as sent.
//!
//! A move is *late* if it begins before the rendered end, or before the drivers are ready. It counts as late, and a late move up is dropped. A late move down
//! lowers the goal at once, to the height of the pin at most, unless it belongs to a stroke, or a move of the motor that begins at its tick or
//! later has begun already: that one is newer.
//!
//! The first frame of a play has a `mark`, and its `base` is the onset. It is all or nothing: if the onset is late, or it has more than
//! [`batch::MAX_FIRST_BATCH`] moves, the device takes none of it and reports `OnsetRefused`. Its mark says for how long pins may be held. The first frame of a later item of a play has a mark, too. If that one
//! is late, the device refuses the mark alone and judges the moves one by one. When a mark has passed, the device reports
//! `Onset` with the counters of that moment. At most 8 marks wait.
//!
//! A mark may have a `trigger`, which the trigger output gives from the mark's tick on, exact to the tick:
//! ```text
//! code 0:      one pulse of `width` ticks
//! code 1..255: ten cells of `width` ticks: high | bit 0 | bit 1 | … | bit 7 | low      (1 is high; idle is low)
//! ```
//! A code is a serial frame (one start bit, eight data bits, one stop bit) with inverted levels; its rate is the carrier divided by
//! `width`, in baud. A
//! later mark with a trigger ends the one before.
//!
//! # Trigger input
//! A device with that feature reports each rising edge of its trigger input (`Edge`), in any state: the tick, and a number that counts edges
//! since boot. Edges within [`array::Layout::edge_dead_time`] after one that counts do not count; a board may miss edges for some ticks more. An edge moves no pin and ends no play: what follows
//! from it, the host orders. Edges while no session is open, and edges for whose report there is no room, are numbered and not reported.
//!
//! # Replacing moves
//! A frame with a `withdraw` replaces queued moves, each motor's as a whole or not at all. For each motor named there, the device returns
//! to the pool all moves that begin at `base` or later. It does so in the moment in which it queues the first move of that motor in the
//! same frame; for a motor without a move in the frame, after the frame's moves. These moves count as *replaced*: every move sent is
//! played, late, dropped, refused or replaced. The device never touches a move that has begun. The second move of a stroke stays if its first does. So the host names a `base` far enough
//! ahead, and sends what follows the last move before it. Without a new move the pin keeps the level of that one.
//!
//! The device *keeps* a motor's queue if a move from `base` on has begun; of a stroke its first move counts. It also keeps the queue if the first move that would take its
//! place is late, breaks a limit or comes too shortly after one before. Then a `Verdict` names the motor, and the device takes no moves
//! of it, in this and later frames, until a frame withdraws again from it, a play begins, or a command begins an epoch. The device
//! plays the old moves instead; the moves not taken count as replaced. The host needs credits for the new moves before the old ones
//! are withdrawn. The first frame of a play withdraws nothing.
//!
//! The frame that withdraws a move may overtake an amendment of that move, and the new move may begin at the same tick. So `withdraw` has
//! the `generation` of the last amendment that concerns old moves. A move takes only amendments newer than all that the device knew of
//! when it queued the move.
//!
//! # Reports
//! `Verdict`, `OnsetRefused`, `Onset`, `Cut`, `Refused`, `Lowered` and `Edge` must reach the host. The device numbers them and repeats them
//! every 10 ms while it hears the host, until the host's `seen` includes their number. At most 32 are sent and not seen.
//! `Status` gives the number of reports made, so the host knows whether one is missing. A host that has read all of them
//! knows what became of every move that began before the tick of that status.
//!
//! `Refused` is never lost: the device has a place for each move that can be queued, and a refused move takes a credit
//! until the host has seen its report. The device stores 32 of the other reports. It keeps the last 12 of these places for
//! `Onset` and `Cut`: when only they are free, it takes no `Moves`. `Lowered` waits while no more than 14 are free, and names all that was lowered
//! meanwhile, from the first tick on. An `Edge` is left out then. When no place is free, it loses the newest report and
//! counts it.
//!
//! # Outside the stream
//! `Control` (arm, disarm, stop, e-stop, reset, move) names the epoch that it begins. The host repeats it until a `Status`
//! names that epoch. The device acknowledges and ignores a control whose epoch is not newer than the present one, and
//! moves and amendments of any other epoch. So nothing that was on the line when the host sent a stop is played after it.
//!
//! `Amend` sets new absolute pulse counts for queued moves, each named by motor and tick. A count must lie within
//! [`limits::correction`] of the planned one, which is the distance from the level of the move before and not 0; the newest `generation` wins. The
//! device counts and ignores an amendment if its move has begun, is unknown or cut, if the count is out of limits, or if the burst would
//! run into the next move. Amendments are neither acknowledged nor repeated. An amendment does nothing if the pin is not where the plan had
//! it when the move begins.
//!
//! `Telemetry` comes while the device is armed, if it has that feature. It is not repeated. A message has at most 32 displacements, from
//! the motor `first` on. A sample of more motors takes several messages with the same tick, in order; the host uses a sample of which it has
//! all. The device replaces a sample of which it has sent nothing by a newer one, and sends one that it has begun to its end.
//!
//! `Board` asks for the device's counters: why it started, its stalls, recoveries and faults, and the least time it had left to
//! render. That time is taken over *windows*. A request with a new number ends a window and begins the next; the answer, also to
//! a repetition, has the window that ended. So windows follow each other without a gap, whatever the line loses. A host asks about
//! once a second, when it offers a play and when a play is over. The answer is one short frame.
//!
//! `SelfTest` with a new number begins a self-test, if the device is disarmed. The device drives each line and the trigger high
//! and low for some microseconds, one by one, and never the driver enable. It reads all of them back, tests free memory and
//! measures its clock and its speed. Any `Control`, an e-stop, a fault, a lost link or another session ends the test: the device
//! first turns all lines low, then acts on the event. The device answers with what it measured; the host judges.
//!
//! # Bounds of what a device says
//! A frame with a right CRC may still be untrue: a fault of the firmware, its memory or its clock. The host checks every
//! message against these bounds in one place, before it uses anything of it.
//!
//! | field | bound | beyond it |
//! |---|---|---|
//! | `Hello`: `array` | that of the host | the link closes: another array |
//! | `Hello`: `tick`; `pool`, `max_up_pulses` | at most 2^56; at least 1 | contradiction `hello` |
//! | `Hello`: `session`; `epoch`, `reports` | the host's own; any | ignored; later statuses contradict a false number |
//! | `Hello`: others | any: for people, or not used | |
//! | ticks of statuses, reports, telemetry | from the first `Hello` to now (reports of cuts, verdicts: plus `horizon`), by the host's estimate of the clock ± (twice its uncertainty + 3 ms) | contradiction `clock` |
//! | `Status`: `tick` | not before the ping it answers; at most 1 s before the newest status | contradiction `clock`; a little older: ignored, a later one overtook it |
//! | `Status`: `token` | one of the last 64 pings | measures nothing |
//! | `Status`: `epoch`, `refusal` | from the last one named to the last one sent; what the command can be refused for; faulted after an e-stop, not armed after a disarm | contradiction `command` |
//! | `Status`: `next_seq`, `out_of_order` | not before the last one; frames that were sent | contradiction `stream` |
//! | `Status`: `credits` | at most `pool` | contradiction `credits` |
//! | `Status`: `reports` | does not shrink; at most `pool` + 32 beyond the last one read, not before it | contradiction `reports` |
//! | `Status`: `state`, `cause`, `position_known` | arms and leaves faults only after a command; returns for at most 2 s, or longer where motors of a rail with long seeks take turns; learns positions after `arm` or a seek, and forgets them in a seek or with the cause `Output` only; a seek may be under way at the handshake | contradiction `state` |
//! | `Status`: `outstanding` | at most 65 535 for each motor | contradiction `state` |
//! | counters of statuses and onsets | do not shrink, but with the cause `Output` by what is played in `HORIZON` ticks, and no more moves than `dropped` grows; at most 2^62; `played` and `pulses` grow by at most a pulse per tick and line, and what is rendered ahead | contradiction `counters` |
//! | `Report`: `number` | the next one | ignored: the device repeats what is missing |
//! | `Verdict`, `OnsetRefused` | a frame sent and not judged; moves of that frame, each late or refused; motors it withdraws from; a frame with a mark whose base is before `rendered` | contradiction `report` |
//! | `Onset`: `tick` | a mark sent and not reported | contradiction `report` |
//! | `Cut`: `flushed`, `outstanding`, `return_ticks` | at most `pool`; as in `Status`; as long as a return may take | contradiction `report` |
//! | `Refused`: `motor`, `reason` | one of the array; a limit on on-time, on motors at once or on density | contradiction `report` |
//! | `Lowered`: `late`, `held` | of the array; not both empty | contradiction `report` |
//! | `Edge` | only with that feature; a number and a tick after those of the last one, by no more edges than dead times have passed | contradiction `report` |
//! | `Board`: `window` | the newest request | ignored: an answer to one before |
//! | `Board`: `slack`, `slack_since_boot` | at most `horizon`; the second does not grow, and is not above the first | contradiction `board` |
//! | `Board`: counters; `reset`, `high_at_boot` | do not shrink in a session; do not change in it; outputs there are | contradiction `board` |
//! | `SelfTest`: `run`; masks and pairs of outputs | the one asked for; outputs there are | ignored; contradiction `board` |
//! | `Telemetry` | only with that feature, of motors of the array; any displacement: the monitor of each motor judges it | contradiction `telemetry` |
//! | answer to a `Control`, a report announced, the report of an onset | within 3 s; 3 s; 5 s after the play's end | the link closes |
//!
//! The host ignores a *contradiction* as a whole, counts it by kind, and asks for another status at once. So a single false
//! message does nothing. If the host has believed a false message, the truth contradicts it later, and the host notices. After
//! five contradictions within a second the host does not trust the device. It repeats an e-stop for 100 ms, each in an epoch a
//! third of their range from the last, so that one of them is newer, whatever the device's epoch is. Then it closes the link and
//! opens a new session, which forgets all that it has learned. There it resets its own e-stop: the device comes back disarmed.
//!
//! The controller in turn takes any message of a host: [`limits`] bound what it does, and frames bound what it stores.
//!
//! # What the controller does
//! It renders lines at most [`controller::HORIZON`] ticks ahead, in blocks of [`controller::BLOCK`].
//!
//! It enables the drivers around bursts only, because an enabled driver without pulses has DC on its piezo. They are on from
//! [`array::Layout::driver_lead`] before the first pulse of any line to [`controller::DRIVER_TAIL`] after the last, and off in each
//! pause of all lines that is longer than both. They are *ready* once they have been on for the lead. So while they are off, a
//! move is late unless it begins a lead after the rendered end, and pins come down by as much later. `horizon` in the handshake is the sum of
//! the render horizon and the lead.
//!
//! The drivers may be on without a pulse. This happens when a limit refuses a move at its beginning, or when the pin is already where the
//! move takes it; and when a move is withdrawn, or flushed by a cut, less than a lead before it begins.
//!
//! A firmware looks for e-stops in the bytes as they arrive ([`urgent`]), before it reads the bytes that came earlier, and in
//! SETUP packets of USB ([`urgent::e_stop_request`]). An e-stop that was new when it was found latches, even if the link is lost
//! or another session opened before the controller carries it out. Any program that may open the USB device can stop the lines by
//! a request. Without a session a request needs no new epoch: it latches, too, and the next host resets it.
//! Where hosts can connect over several lines, a `Hello` on another line takes over, and the first line counts as lost.
//!
//! *Outstanding return pulses* are the heights of pins that stay up after an e-stop or a fault. A *return* flushes the queues and sets all
//! goals to 0; then the lines are off. A burst up that runs ends at the rendered end, a burst down goes on. `Cut` says after how many
//! ticks the pins are down at the latest.
//!
//! | event | what the controller does |
//! |---|---|
//! | power-up, panic, watchdog reset, core fault | turns all lines off; disarmed with that cause, position unknown: it refuses `arm` without `assume_rest` |
//! | `arm` | only from disarmed: brings pins down first and reports it (`Cut`), or seeks the lower stop. It refuses moves unless armed |
//! | seek | with a lower stop, in `arm` or while armed and idle: drives all pins down by as many pulses as asked and reports them (`Cut`); then their position is known and no return pulses are outstanding. It refuses a seek that may not reach the stop |
//! | stop | returns, stays armed; what the play's mark said of holds counts no more |
//! | disarm, shutdown, abort, host silent, link lost, another session | returns, then disarms |
//! | e-stop, own fault | turns lines off after the tick being played; latches; pins stay where they are. `reset` leads to disarmed |
//! | outputs do not follow (PIO, DMA) | as its own fault, with the cause `Output`: counts nothing from the last block on that was seen to be played, and the position is unknown. Only a restart ends it |
//! | late move | drops it and reports it; one down, of no stroke and with no newer one begun, lowers the goal at once, and the device reports that, too (`Lowered`, `late`) |
//! | a pin above rest without a pulse for longer than the play says whose mark was reached last (`Mark::hold`), at least [`array::Layout::least_hold`] and at most [`array::Layout::longest_hold`] | sets the goal to 0 and reports it (`Lowered`, `held`) |
//! | no valid frame for `host_timeout` ticks while armed or returning | as if the host had asked for disarm, with the cause `HostTimeout`. `arm` sets the time; the maximum is 10 s |
//!
//! # Lower stop
//! A *lower stop* is a plate below which no pin can go: a motor that pushes against it slips. `arm` says whether the array has
//! one ([`message::LowerStop`]). With a stop, a move to level 0 may have a *surplus*: pulses after the pin is at rest, so that
//! scatter and asymmetry cannot add up. Without one, the controller refuses such a move (`Pushing`). With a stop, no correction makes a
//! way down longer than planned.
//!
//! A seek must reach the stop, because the controller takes all pins to be there afterwards. A pin is above rest by the net
//! pulses of its shifts (`Op::Move`) and its height. The controller refuses (`Travel`) a seek shorter than
//! [`array::Layout::least_seek`] of the highest pin: half as many pulses again, at most [`array::Layout::whole_travel`]. Where the
//! position is unknown, a seek takes at least the whole travel. In a seek each pin counts as so many pulses above rest and comes down, in
//! turns: a stop, a silent host or a lost link do not cut it short, and on-time limits do not refuse it, but it counts. An e-stop cuts it,
//! and then the position is unknown.
//!
//! A shift down takes a pin to the stop and no further: its travel ends at 0, and the pulses left push.
//!
//! To bound wear and heat, no motor may push more than `pulses_per_s` pulses in a sliding second against the stop, and never more
//! than [`array::Layout::max_pushes_per_s`]: surplus, seeks and shifts together, and corrections. A way up that an amendment makes shorter
//! leaves pulses of the way down that push; a longer one makes no room for others. A surplus that would break the limit is left out, and a
//! correction of a way up leaves no more to push than may be; the move is not left out.
//!
//! # Limits
//! The controller enforces [`limits`] whatever the host asks. They bound levels, surplus, the size of corrections, the travel of shifts,
//! the on-time per motor and per rail, the motors at once per rail and per driver chip, pushing, and the sizes of pool and queues. Of any
//! three moves of a motor in a row, the last begins at least 1 ms after the first, so that the chip has time to render them. The
//! controller refuses and reports a move that breaks a limit. It checks density, on-time and motors at once when a move up begins, and
//! for a shift when it is asked for.
//!
//! On-time counts the pulses of a sliding second, and for each pin above rest the pulses of its way down: so a way down never breaks the
//! limit.
//!
//! # Motors at once
//! Motors share rails and driver chips, as the layout says. `arm` may limit how many motors of each have pulses in the
//! same tick ([`limits::PowerLimits`]). A move up is refused as it begins (`RailAtOnce`, `ChipAtOnce`), with the second move of its stroke, if as many others of the group have
//! pulses as may, or if a pin of the group waits to come down. A pin that is to come down waits until there is room. In one tick the motor
//! with the lower number comes first. So a return takes at most [`array::Layout::turns`] times its longest burst.

#![no_std]
#![forbid(unsafe_code)]

pub mod array;
pub mod batch;
pub mod board;
pub mod controller;
pub mod frame;
pub mod limits;
pub mod message;
pub mod moves;
pub mod stroke;
pub mod tick;
pub mod urgent;
