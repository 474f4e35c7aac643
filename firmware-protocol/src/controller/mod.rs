//! The behaviour of the device as a state machine without I/O: bytes and ticks in, line states and bytes out.
//!
//! The firmware and the mock are thin shells around [`Controller`]. A shell passes incoming bytes to
//! [`Controller::receive`], calls [`Controller::poll`] as time passes, asks [`Controller::render`] for the lines at most
//! [`HORIZON`] ticks ahead, and sends what [`Controller::transmit`] writes. While [`Controller::forced_off`] is true it
//! holds all lines low. The rules are in the crate's documentation.
//!
//! Invariant: the lines follow from the queued slots alone, and a slot changes only ahead of the rendered end. So the
//! number of pulses played is known after any cut, flush or amendment.

mod allowance;
mod at_once;
mod board;
mod changes;
mod commands;
mod completion;
mod density;
mod drivers;
mod fingerprint;
mod inbox;
mod lines;
mod marks;
mod motion;
mod pool;
mod reorder;
mod reporting;
mod session;
mod stream;
mod taking;

use crate::board::{Measures, SelfTest};
use crate::frame::{self, FrameError, MAX_FRAME};
use crate::limits::{self, PowerLimits};
use crate::message::{Cause, Counters, DeviceHello, DeviceMessage, Op, State, Status};
use crate::stroke::{Lines, MOTORS};
use crate::tick::{TICK_HZ, Tick};
use allowance::Allowance;
use board::BoardRequests;
use changes::Changes;
use drivers::Drivers;
pub use drivers::{DRIVER_LEAD, DRIVER_TAIL};
use inbox::Inbox;
use marks::Marks;
pub use pool::POOL;
use pool::{Pool, Slot};
pub use reorder::REORDER_WINDOW;
use reorder::ReorderBuffer;
pub use reporting::REPORTS;
use reporting::{Due, Reporting};
use session::Session;
use taking::Taking;

/// Most ticks rendered ahead. A stroke that begins before the rendered end is late. While the drivers are off, so is one that
/// begins less than [`DRIVER_LEAD`] after it.
pub const HORIZON: u32 = 64;
/// Ticks of a block. Shells render a block, aligned to [`Tick::BOOT`], as soon as it fits the horizon, so that all shells
/// cut at the same ticks.
pub const BLOCK: u32 = HORIZON / 4;
/// Most ticks from now to a stroke's down burst.
const FARTHEST: i64 = 1 << 30;

/// What the shell tells the controller about the device, for the handshake.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// Firmware version: major, minor, patch.
    pub firmware: [u8; 3],
    /// Hash of the build.
    pub build: [u8; 4],
    /// Random at every boot.
    pub boot: u32,
    /// [`DeviceHello::SIMULATED`] and so on.
    pub features: u32,
}

/// Consecutive ticks in which no output changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// The lines in each of these ticks.
    pub lines: Lines,
    /// The trigger output, which a [`Trigger`](crate::message::Trigger) drives from a mark on.
    pub trigger: bool,
    /// Whether the drivers are enabled.
    pub drivers: bool,
    /// Number of ticks.
    pub ticks: u32,
}

/// The controller of one array.
#[derive(Clone, Debug)]
pub struct Controller {
    identity: Identity,
    inbox: Inbox,
    session: Session,
    next_seq: u16,
    /// Motors whose strokes are late until a frame withdraws again from them, because it came too late the last time.
    kept: u32,
    /// The newest amendment of this epoch that the device knows of.
    generation: Option<u16>,
    reorder: ReorderBuffer,
    taking: Taking,
    reporting: Reporting,
    board: BoardRequests,

    state: State,
    cause: Cause,
    /// The state after a return.
    then: State,
    position_known: bool,
    /// All pins are being driven down to the lower stop.
    seeks: bool,
    outstanding: [u16; MOTORS],
    /// How many of the outstanding return pulses push against the lower stop.
    outstanding_pushes: [u16; MOTORS],
    /// Net pulses of moves since the pins were last at rest.
    travel: [i16; MOTORS],
    now: Tick,

    pool: Pool,
    marks: Marks,
    drivers: Drivers,
    allowance: Allowance,
    rendered: Tick,
    lines: Lines,
    changes: Changes,
    /// No stroke ends before this tick.
    next_end: Tick,
    /// End of what was rendered before an e-stop.
    off_until: Tick,
}

const NEVER: Tick = Tick(u64::MAX);

impl Identity {
    /// All zero.
    pub const NONE: Self = Self { firmware: [0; 3], build: [0; 4], boot: 0, features: 0 };
}

impl Controller {
    /// A controller that has just started: lines off, position unknown, clock at [`Tick::BOOT`].
    #[must_use]
    pub const fn new(identity: Identity) -> Self {
        Self::starting_at(identity, Tick::BOOT)
    }

    /// Like [`Self::new`], with another start of the clock, for tests of long runs.
    #[must_use]
    pub const fn starting_at(identity: Identity, now: Tick) -> Self {
        Self {
            identity,
            inbox: Inbox::EMPTY,
            session: Session::new(now),
            next_seq: 0,
            kept: 0,
            generation: None,
            reorder: ReorderBuffer::new(),
            taking: Taking::NOTHING,
            reporting: Reporting::NOTHING,
            board: BoardRequests::none(now),
            state: State::Disarmed,
            cause: Cause::Boot,
            then: State::Disarmed,
            position_known: false,
            seeks: false,
            outstanding: [0; MOTORS],
            outstanding_pushes: [0; MOTORS],
            travel: [0; MOTORS],
            now,
            pool: Pool::new(),
            marks: Marks::NONE,
            drivers: Drivers::OFF,
            allowance: Allowance::new(now),
            rendered: now,
            lines: Lines::OFF,
            changes: Changes::none(now),
            next_end: NEVER,
            off_until: now,
        }
    }

    /// Sets the identity and the reason of the start (a panic, the watchdog), for a shell that learns them later.
    pub fn introduce(&mut self, identity: Identity, cause: Cause) {
        (self.identity, self.cause) = (identity, cause);
    }

    /// The state of the controller.
    #[must_use]
    pub fn state(&self) -> State {
        self.state
    }

    /// Why it is in that state.
    #[must_use]
    pub fn cause(&self) -> Cause {
        self.cause
    }

    /// Counts since boot.
    #[must_use]
    pub fn counters(&self) -> Counters {
        self.reporting.counters()
    }

    /// The limits that the last `arm` set.
    #[must_use]
    pub fn limits(&self) -> PowerLimits {
        self.allowance.limits()
    }

    /// The rendered end: the first tick not rendered yet.
    #[must_use]
    pub fn rendered(&self) -> Tick {
        self.rendered
    }

    /// Outstanding return pulses of a motor's pin after an e-stop or a fault.
    #[must_use]
    pub fn outstanding(&self, motor: u8) -> u16 {
        self.outstanding.get(usize::from(motor)).copied().unwrap_or(0)
    }

    /// Whether the shell must hold all lines low at `now`, whatever was rendered. The tick that was being played when this
    /// became true counts as played.
    #[must_use]
    pub fn forced_off(&self, now: Tick) -> bool {
        self.state == State::Faulted || now < self.off_until
    }

    /// The present epoch while a session is open. An e-stop takes effect if its epoch is [`newer`].
    #[must_use]
    pub fn epoch(&self) -> Option<u16> {
        self.session.is_open().then(|| self.session.epoch())
    }

    /// Carries out an e-stop that the shell has found ([`crate::urgent`]), ahead of the bytes before it. When the frame itself is
    /// received later, it counts as a repetition. The shell compared the e-stop with [`Self::epoch`] when it found it. The lines
    /// go off even if the link was lost since then, or another session opened.
    pub fn e_stop(&mut self, now: Tick, epoch: u16) {
        self.pass(now);
        // An earlier call may have passed a time slightly ahead of the lines. Nothing after `now` was played.
        self.off_from(Cause::EStop, (now + 1).min(self.rendered));
        if self.session.is_open() {
            self.control(epoch, Op::EStop);
        }
    }

    /// Opens a session for a host whose `Hello` the shell has found ([`crate::urgent`]), perhaps over several packets.
    pub fn open_session(&mut self, now: Tick, session: u32) {
        self.pass(now);
        self.open(session);
    }

    /// Takes bytes from the host, in any chunks.
    pub fn receive(&mut self, now: Tick, mut bytes: &[u8]) {
        self.pass(now);
        while self.next_frame(&mut bytes) {
            while self.take() {}
        }
    }

    /// Decodes bytes up to the end of the next frame, and removes them from `bytes`. Returns whether there was one. Then call
    /// [`Self::advance`] until it returns `false`. So a shell that has lines to render has to do only a piece at a time.
    pub fn read(&mut self, now: Tick, bytes: &mut &[u8]) -> bool {
        self.pass(now);
        while self.take() {}
        self.next_frame(bytes)
    }

    /// Decodes the next frame of `bytes`, if they end one.
    fn next_frame(&mut self, bytes: &mut &[u8]) -> bool {
        match self.inbox.decode(bytes) {
            None => return false,
            Some(Ok(())) => {}
            Some(Err(FrameError::Version(_))) => self.reporting.send_hello(),
            Some(Err(_)) => self.reporting.count().bad_frames += 1,
        }
        true
    }

    /// Lets time pass: books what was played before `now` and checks the host timeout. Then takes one buffered frame if it
    /// is next in order, and returns whether it did. Call it at least once per block.
    pub fn poll(&mut self, now: Tick) -> bool {
        self.pass(now);
        while self.take() {}
        let followed = self.follow();
        while self.take() {}
        followed
    }

    /// Like [`Self::poll`], but does only a piece of what is left to do with the frame read last or with the buffered ones.
    /// Returns whether it did one.
    pub fn advance(&mut self, now: Tick) -> bool {
        self.pass(now);
        self.take() || self.follow()
    }

    fn pass(&mut self, now: Tick) {
        self.now = self.now.max(now);
        self.settle();
        let listening = self.state == State::Armed || self.state == State::Returning;
        if listening && self.session.is_silent(self.now) {
            self.disarm(Cause::HostTimeout);
        }
    }

    /// Returns, disarms and forgets the session, because the cable was unplugged or the port closed.
    pub fn link_lost(&mut self, now: Tick) {
        self.pass(now);
        self.disarm(Cause::LinkLost);
        self.session.close();
        self.reporting.forget_answers();
        self.board.forget_requests();
        self.inbox.reset();
    }

    /// Turns all lines off at once and latches, because of the device's own fault.
    pub fn fault(&mut self, now: Tick, cause: Cause) {
        self.pass(now);
        self.off(cause);
    }

    /// Turns all lines off and latches, because they have stopped following what is rendered. `followed` is the first tick
    /// that may not have been on the pins: from it on, strokes that have not ended count as not played. The position is
    /// unknown then.
    pub fn output_failed(&mut self, followed: Tick) {
        self.off_from(Cause::Output, followed.min(self.now + 1).min(self.rendered));
        self.position_known = false;
    }

    /// Displacements of all pins in 0.01 µm, sampled at `tick`. Sent while armed; replaces a sample that is not sent yet.
    pub fn telemetry(&mut self, tick: Tick, y: [i32; MOTORS]) {
        if self.session.is_open() && matches!(self.state, State::Armed | State::Returning) {
            self.reporting.send_telemetry(tick, y);
        }
    }

    /// Takes the slack of a block that was rendered while the lines are enabled: the ticks until its first word is fetched.
    pub fn rendered_with(&mut self, slack: u32) {
        self.board.rendered_with(slack);
    }

    /// Whether a board report is about to be sent: then [`Self::measured`] is worth its time.
    #[must_use]
    pub fn wants_measures(&self) -> bool {
        self.board.wants_measures()
    }

    /// Takes what the shell has measured.
    pub fn measured(&mut self, measures: Measures) {
        self.board.measured(measures);
    }

    /// Whether the shell is to carry out a self-test. When this becomes false, it sets the lines low first and then goes on.
    #[must_use]
    pub fn is_testing(&self) -> bool {
        self.board.is_testing()
    }

    /// Takes the result of the self-test.
    pub fn tested(&mut self, result: SelfTest) {
        self.board.tested(result);
    }

    /// Writes the next frame to send into `out` and returns its length, or 0 if there is none.
    pub fn transmit(&mut self, now: Tick, out: &mut [u8; MAX_FRAME]) -> usize {
        self.now = self.now.max(now);
        if self.reporting.is_status_due() {
            // Strokes may have ended since the last pass: the status has this tick, so it counts them.
            self.settle();
        }
        let message = match self.reporting.next(self.now, self.session.is_open(), &mut self.board) {
            None => return 0,
            Some(Due::Hello) => DeviceMessage::Hello(self.hello()),
            Some(Due::Status) => DeviceMessage::Status(self.status()),
            Some(Due::Message(message)) => message,
        };
        // Every message fits a frame: see `messages_fit` in the tests.
        frame::encode(&message, out).unwrap_or(0)
    }

    fn hello(&self) -> DeviceHello {
        DeviceHello {
            session: self.session.id().unwrap_or(0),
            firmware: self.identity.firmware,
            build: self.identity.build,
            boot: self.identity.boot,
            motors: MOTORS as u8,
            tick_hz: TICK_HZ,
            pool: POOL as u16,
            horizon: (HORIZON + DRIVER_LEAD) as u8,
            max_up_pulses: limits::MAX_UP_PULSES,
            limits: PowerLimits::NONE,
            features: self.identity.features,
            tick: self.now.0,
            epoch: self.session.epoch(),
            reports: self.reporting.reports().read(),
            last_cut: self.reporting.last_cut(),
        }
    }

    fn status(&mut self) -> Status {
        Status {
            token: self.session.take_token(),
            tick: self.now.wire(),
            epoch: self.session.epoch(),
            refusal: self.session.refusal(),
            next_seq: self.next_seq,
            out_of_order: self.reorder.mask(self.next_seq),
            credits: self.credits(),
            reports: self.reporting.reports().made(),
            state: self.state,
            cause: self.cause,
            position_known: self.position_known,
            outstanding: self.outstanding_total(),
            counters: self.reporting.counters(),
        }
    }

    /// Stroke slots that the host may fill. Each refused stroke takes one until the host has seen its report: so there
    /// is always a place for the next report.
    fn credits(&self) -> u16 {
        self.pool.free().saturating_sub(self.reporting.reports().refused())
    }

    fn outstanding_total(&self) -> u32 {
        self.outstanding.iter().map(|&outstanding| u32::from(outstanding)).sum()
    }

    fn queue(&mut self, slot: Slot) -> bool {
        let motor = usize::from(slot.stroke.motor);
        let idle = self.pool.current(motor).is_none();
        let queued = self.pool.push(slot);
        if idle && queued {
            // The line may not have been brought to the rendered end since its last stroke ended.
            self.change_by(motor, slot.stroke.up);
        }
        self.next_end = self.next_end.min(slot.stroke.end());
        queued
    }
}

/// Whether epoch or generation `a` comes after `b`. These numbers wrap.
#[must_use]
pub fn newer(a: u16, b: u16) -> bool {
    (1..0x8000).contains(&a.wrapping_sub(b))
}
