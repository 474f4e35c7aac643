//! The behaviour of the device as a state machine without I/O: bytes and ticks in, line states and bytes out.
//!
//! The firmware and the mock are thin shells around [`Controller`]. A shell passes incoming bytes to
//! [`Controller::receive`], calls [`Controller::poll`] as time passes, asks [`Controller::render`] for the lines at most
//! [`HORIZON`] ticks ahead, and sends what [`Controller::transmit`] writes. While [`Controller::forced_off`] is true it
//! holds all lines low. The rules are in the crate's documentation.
//!
//! The controller passes time, bytes and messages to its parts. Each owns its fields; calls go from the upper parts to the lower:
//!
//! | part | what it does |
//! |---|---|
//! | `inbox` | decodes the bytes of the host into the next frame |
//! | `commands` | hands each message to the part that handles it |
//! | `session` | keeps the session, its epoch, and whether the host is heard |
//! | `stream` | takes frames of moves in order, and amendments |
//! | `motion` | has the state, and drives pins outside of plays: returns, moves, seeks |
//! | `player` | queues moves, renders the lines from them, books what was played |
//! | `reporting` | has the counts, the reports and the answers that are to be sent |
//! | `edges` | numbers the edges of the trigger input |
//! | `board` | answers requests for the board report and for a self-test |
//!
//! Invariant: only the player changes lines, only the motion changes the state, and time never goes backward.

mod board;
mod commands;
mod edges;
mod inbox;
mod motion;
mod player;
mod reporting;
mod session;
mod stream;

use crate::array::Layout;
use crate::board::{Measures, SelfTest};
use crate::frame::{self, FrameError, MAX_FRAME};
use crate::limits::PowerLimits;
use crate::message::{Cause, Counters, DeviceHello, DeviceMessage, Op, State, Status};
use crate::stroke::Lines;
use crate::tick::Tick;
use board::BoardRequests;
use edges::Edges;
use inbox::Inbox;
use motion::Motion;
use player::Player;
pub use player::{DRIVER_TAIL, POOL};
pub use reporting::REPORTS;
use reporting::{Due, Pending, Reporting};
use session::Session;
pub use stream::REORDER_WINDOW;
use stream::{Parts, Stream};

pub use crate::tick::{BLOCK, HORIZON};
/// Most ticks from now to a move.
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
    stream: Stream,
    motion: Motion,
    player: Player,
    reporting: Reporting,
    board: BoardRequests,
    edges: Edges,
    now: Tick,
}

impl Identity {
    /// All zero.
    pub const NONE: Self = Self { firmware: [0; 3], build: [0; 4], boot: 0, features: 0 };
}

impl Controller {
    /// A controller of an array with this layout that has just started: lines off, position unknown, clock at [`Tick::BOOT`].
    pub const fn new(identity: Identity, layout: Layout) -> Self {
        Self::starting_at(identity, layout, Tick::BOOT)
    }

    /// Like [`Self::new`], with another start of the clock, for tests of long runs.
    pub const fn starting_at(identity: Identity, layout: Layout, now: Tick) -> Self {
        Self {
            identity,
            inbox: Inbox::EMPTY,
            session: Session::new(&layout, now),
            stream: Stream::NOTHING,
            motion: Motion::new(now),
            player: Player::new(layout, now),
            reporting: Reporting::new(&layout),
            board: BoardRequests::none(&layout, now),
            edges: Edges::none(&layout, now),
            now,
        }
    }

    /// Sets the identity and the reason of the start (a panic, the watchdog), for a shell that learns them later.
    pub fn introduce(&mut self, identity: Identity, cause: Cause) {
        self.identity = identity;
        self.motion.set_cause(cause);
    }

    /// The state of the controller.
    pub fn state(&self) -> State {
        self.motion.state()
    }

    /// Why it is in that state.
    pub fn cause(&self) -> Cause {
        self.motion.cause()
    }

    /// Counts since boot, up to the rendered end. A status has those up to its tick.
    pub fn counters(&self) -> Counters {
        self.reporting.counters()
    }

    /// The layout of its array.
    pub fn layout(&self) -> &Layout {
        self.player.layout()
    }

    /// The limits that the last `arm` set.
    pub fn limits(&self) -> PowerLimits {
        self.player.limits()
    }

    /// The rendered end: the first tick not rendered yet.
    pub fn rendered(&self) -> Tick {
        self.player.rendered()
    }

    /// Outstanding return pulses of a motor's pin after an e-stop or a fault.
    pub fn outstanding(&self, motor: u8) -> u16 {
        self.player.height(motor.into())
    }

    /// The first tick at which a burst that is queued now may begin: the rendered end, or later if the drivers must start up
    /// first.
    pub fn ready(&self) -> Tick {
        self.player.ready()
    }

    /// Renders the outputs from the rendered end on, for `max` ticks or until one changes.
    pub fn render(&mut self, max: u32) -> Run {
        self.player.render(max, &mut self.reporting)
    }

    /// Whether the shell must hold all lines low at `now`, whatever was rendered. The tick that was being played when this
    /// became true counts as played.
    pub fn forced_off(&self, now: Tick) -> bool {
        self.motion.forced_off(now)
    }

    /// The present epoch while a session is open. An e-stop takes effect if its epoch is [`newer`].
    pub fn epoch(&self) -> Option<u16> {
        self.session.is_open().then(|| self.session.epoch())
    }

    /// Carries out an e-stop that the shell has found ([`crate::urgent`]), ahead of the bytes before it. When the frame itself is
    /// received later, it counts as a repetition. The shell compared the e-stop with [`Self::epoch`] when it found it. The lines
    /// go off even if the link was lost since then, or another session opened.
    pub fn e_stop(&mut self, now: Tick, epoch: u16) {
        self.pass(now);
        // An earlier call may have passed a time slightly ahead of the lines. Nothing after `now` was played.
        self.off_from(Cause::EStop, (now + 1).min(self.player.rendered()));
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
            Some(Err(FrameError::Version(_))) => self.reporting.pending.hello = true,
            Some(Err(_)) => self.reporting.count().bad_frames += 1,
        }
        true
    }

    /// Whether each pin that is above its goal comes down or waits to, each pin below it goes up, and each move that waits will begin:
    /// for tests.
    pub fn is_consistent(&self) -> bool {
        self.player.is_consistent()
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
        if self.motion.is_active() && self.session.is_silent(self.now) {
            self.disarm(Cause::HostTimeout);
        }
    }

    /// Returns, disarms and forgets the session, because the cable was unplugged or the port closed.
    pub fn link_lost(&mut self, now: Tick) {
        self.pass(now);
        self.disarm(Cause::LinkLost);
        self.session.id = None;
        self.reporting.pending = Pending::NONE;
        self.board.forget_requests();
        self.inbox.reset();
    }

    /// Turns all lines off at once and latches, because of the device's own fault.
    pub fn fault(&mut self, now: Tick, cause: Cause) {
        self.pass(now);
        self.off(cause);
    }

    /// Turns all lines off and latches, because they have stopped following what is rendered. `followed` is the first tick
    /// that may not have been on the pins: moves that begin from it on count as not played. The position is
    /// unknown then.
    pub fn output_failed(&mut self, followed: Tick) {
        self.off_from(Cause::Output, followed.min(self.now + 1).min(self.player.rendered()));
        self.motion.lose_position();
    }

    /// Takes a rising edge of the trigger input in this tick, which is not after now. It is reported unless it comes within the dead
    /// time or the places for reports are short.
    pub fn edge(&mut self, tick: Tick) {
        if let Some(report) = self.edges.count(tick)
            && self.session.is_open()
            && self.reporting.reports().has_room()
        {
            self.reporting.report(report);
        }
    }

    /// Displacements of all pins in 0.01 µm, sampled at `tick`. Sent while armed. It replaces a sample of which nothing is sent
    /// yet, and is left out while another one is sent in parts.
    pub fn telemetry(&mut self, tick: Tick, y: &[i32]) {
        if self.session.is_open() && self.motion.is_active() {
            self.reporting.send_telemetry(tick, y.get(..self.layout().motors()).unwrap_or(y));
        }
    }

    /// Takes the slack of a block that was rendered while the lines are enabled: the ticks until its first word is fetched.
    pub fn rendered_with(&mut self, slack: u32) {
        self.board.rendered_with(slack);
    }

    /// Whether a board report is about to be sent: then [`Self::measured`] is worth its time.
    pub fn wants_measures(&self) -> bool {
        self.board.wants_measures()
    }

    /// Takes what the shell has measured.
    pub fn measured(&mut self, measures: Measures) {
        self.board.measured(measures);
    }

    /// Whether the shell is to carry out a self-test. When this becomes false, it sets the lines low first and then goes on.
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
        if self.reporting.pending.status {
            // Moves may have ended since the last pass: the status has this tick, so it counts them.
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

    #[inline(never)]
    fn hello(&self) -> DeviceHello {
        let layout = self.layout();
        DeviceHello {
            session: self.session.id.unwrap_or(0),
            firmware: self.identity.firmware,
            build: self.identity.build,
            boot: self.identity.boot,
            array: *layout.id(),
            pool: POOL as u16,
            horizon: layout.horizon(),
            max_up_pulses: layout.max_up_pulses(),
            limits: layout.no_limits(),
            features: self.identity.features,
            tick: self.now.0,
            epoch: self.session.epoch(),
            reports: self.reporting.reports().read(),
            last_cut: self.reporting.last_cut,
        }
    }

    fn status(&mut self) -> Status {
        let pins = self.motion.pins();
        Status {
            token: core::mem::take(&mut self.session.token),
            tick: self.now.wire(),
            epoch: self.session.epoch(),
            refusal: self.session.refusal,
            next_seq: self.stream.next_seq(),
            out_of_order: self.stream.out_of_order(),
            credits: self.player.credits(&self.reporting),
            reports: self.reporting.reports().made(),
            state: self.motion.state(),
            cause: self.motion.cause(),
            position_known: pins.position_known(),
            outstanding: if self.motion.is_active() { 0 } else { self.player.heights_total() },
            counters: self.player.played(self.reporting.counters(), self.now),
        }
    }

    /// Takes a piece of the frame that was decoded last. Returns `false` if nothing is left of it.
    fn take(&mut self) -> bool {
        if let Some((body, len)) = self.inbox.take() {
            match frame::read(Ok(&body[..len])) {
                Ok(message) => self.handle(message),
                Err(_) => self.reporting.count().bad_frames += 1,
            }
            return true;
        }
        let (stream, mut parts) = self.stream();
        stream.take(&mut parts)
    }

    /// Prepares one buffered frame if it is next in order.
    fn follow(&mut self) -> bool {
        let (stream, mut parts) = self.stream();
        stream.follow(&mut parts)
    }

    /// The stream, and the parts that it works on.
    fn stream(&mut self) -> (&mut Stream, Parts<'_>) {
        let Self { stream, session, motion, player, reporting, now, .. } = self;
        (stream, Parts { now: *now, armed: motion.is_armed(), player, reporting, session })
    }

    fn disarm(&mut self, cause: Cause) {
        self.motion.disarm(cause, self.now, &mut self.player, &mut self.reporting);
    }

    /// Turns all lines off after the tick being played, for an e-stop or a fault.
    fn off(&mut self, cause: Cause) {
        self.off_from(cause, (self.now + 1).min(self.player.rendered()));
    }

    /// Turns all lines off; nothing from `at` on was played.
    fn off_from(&mut self, cause: Cause, at: Tick) {
        if self.motion.off_from(cause, at, &mut self.player, &mut self.reporting) {
            self.board.off(cause);
        }
    }

    /// Books what was played before now.
    fn settle(&mut self) {
        self.motion.settle(self.now, &mut self.player, &mut self.reporting);
    }
}

/// Whether epoch or generation `a` comes after `b`. These numbers wrap.
pub fn newer(a: u16, b: u16) -> bool {
    (1..0x8000).contains(&a.wrapping_sub(b))
}
