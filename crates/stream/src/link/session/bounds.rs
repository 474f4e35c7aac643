//! The bounds of all that a device says: the one place where its messages are checked.
//!
//! Each function takes a message and returns what the session may use of it, or a [`Contradiction`]: then the session
//! ignores the message. Bounds follow from the protocol, from what the device has said ([`DeviceKnowledge`]), and from what was
//! sent, which the session passes ([`Sent`]). The table is in the specification (`firmware_protocol`, "Bounds of what a device
//! says").
//!
//! Invariant: a device that follows the specification never contradicts itself here, whatever the line loses, repeats,
//! delays or reorders; time that passes only for the device (the host is suspended) is the exception.

use crate::link::clock::ClockEstimate;
use crate::link::session::batch::Batch;
use crate::link::session::contradiction::Contradiction;
use crate::time::HostInstant;
use firmware_protocol::array::{ArrayId, Layout};
use firmware_protocol::board::{Board, Output, Outputs, SelfTestState};
use firmware_protocol::controller::{HORIZON, REORDER_WINDOW, REPORTS};
use firmware_protocol::limits::{PowerLimits, Refusal};
use firmware_protocol::message::{Cause, Counters, Cut, DeviceHello, Op, Report, State, Status};
use firmware_protocol::tick::{Tick, WireTick};
use meissner_array::spec::Array;
use meissner_array::units::TickRate;
use std::collections::VecDeque;

/// No device has run for longer: 26 thousand years. Arithmetic on ticks has room above it.
const LATEST_CLOCK: Tick = Tick(1 << 56);
/// How far a tick may lie beyond twice the clock's uncertainty, ms.
const CLOCK_SLACK_MS: u64 = 3;
/// A status that another overtook is no older than this, ms; lines delay by milliseconds.
const OVERTAKEN_MS: u64 = 1000;
/// Between two statuses at most so much counts as spent in a return, ms: the host did not see the rest.
const RETURN_SEEN_MS: u64 = 100;
/// Marks whose reports may be on their way: as many as there are reports.
const MARKS: usize = REPORTS;

/// A return takes at most a burst of each motor of a rail, one after the other. The longest is a seek. A third more is room for the
/// statuses around it, and no bound is below 2 s.
fn longest_return(layout: &Layout) -> u64 {
    let bursts = u64::from(layout.turns(&one_at_once(layout))) * u64::from(layout.max_seek());
    (2 * u64::from(layout.tick_hz())).max(bursts * 4 / 3)
}

/// One motor of a rail has pulses at once.
const fn one_at_once(layout: &Layout) -> PowerLimits {
    PowerLimits { rail_at_once: 1, chip_at_once: 1, ..layout.no_limits() }
}

/// Most pulses of a stroke, which are counted when it ends.
fn stroke_pulses(layout: &Layout) -> u64 {
    u64::from(layout.max_up_pulses()) + u64::from(layout.max_down_pulses())
}

/// What the session has asked for since the last command whose epoch a status named.
#[derive(Clone, Copy, Debug)]
struct Ordered {
    arms: bool,
    resets: bool,
    /// To seek the lower stop.
    seeks: bool,
}

impl Ordered {
    /// A command is about to be sent.
    fn command(&mut self, op: &Op) {
        self.arms |= matches!(op, Op::Arm { .. });
        self.resets |= matches!(op, Op::Reset);
        self.seeks |= match op {
            Op::Arm { lower_stop, .. } => lower_stop.is_some_and(|stop| stop.seek > 0),
            op => matches!(op, Op::Seek { .. }),
        };
    }

    /// A status names the epoch of the last command.
    fn answered(&mut self, state: State) {
        (self.arms, self.resets) = (false, false);
        // The position is known when the seek is over, unless it was cut.
        self.seeks &= state == State::Returning;
    }
}

/// What the session knows of the device besides the stream.
#[derive(Clone, Debug)]
pub(super) struct DeviceKnowledge {
    array: Array,
    pool: u16,
    horizon: u32,
    telemetry: bool,
    /// The clock when the handshake began, at the earliest, and the number of reports read before.
    opened: Tick,
    reports: u16,
    /// The newest status and its tick.
    status: Option<(Status, Tick)>,
    /// The newest epoch in a status.
    epoch: u16,
    /// The last report with counters: later ones are not below these.
    reported: Counters,
    /// The first status after the outputs have failed. Counts that were reported before it may be above it.
    failed: Option<Tick>,
    /// The device's clock was not beyond this when the last report was read.
    report_read_by: Tick,
    ordered: Ordered,
    /// Ticks of a return that the statuses show.
    returning: u64,
    /// Marks sent that may still be reported.
    marks: VecDeque<Tick>,
    /// Whether it has a trigger input; the last edge of this session: its number and tick.
    trigger_input: bool,
    edge: Option<(u32, Tick)>,
}

/// The device's clock at an instant, and by how much it may lie before or after that.
#[derive(Clone, Copy, Debug)]
pub(super) struct ClockReading {
    tick: Tick,
    slack: u64,
}

impl ClockReading {
    pub(super) fn new(clock: &ClockEstimate, rate: TickRate, at: HostInstant) -> Self {
        let slack = 2 * rate.duration_to_ticks(clock.uncertainty(at)) + rate.of_ms(CLOCK_SLACK_MS);
        Self { tick: clock.tick_at(at), slack }
    }

    /// The device's clock is not beyond this.
    pub(super) fn latest(&self) -> Tick {
        self.tick + self.slack
    }

    /// The device's clock is not before this.
    pub(super) const fn earliest(&self) -> Tick {
        Tick(self.tick.0.saturating_sub(self.slack))
    }
}

/// What the host has sent and read, by which a status is judged.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sent {
    /// The device's clock when the ping left that the status answers.
    pub(super) pinged: Option<ClockReading>,
    /// The newest epoch; the command that waits for its answer, and whether the device may know it.
    pub(super) epoch: u16,
    pub(super) command: Option<(Op, bool)>,
    /// The frames before this one are acknowledged; so many from it on were sent.
    pub(super) acked: u16,
    pub(super) frames: usize,
    /// The last report read.
    pub(super) seen: u16,
}

impl DeviceKnowledge {
    pub(super) fn new(array: Array) -> Self {
        Self {
            array,
            pool: 0,
            horizon: 0,
            telemetry: false,
            opened: Tick(0),
            reports: 0,
            status: None,
            epoch: 0,
            reported: Counters::NONE,
            failed: None,
            report_read_by: Tick(0),
            // A seek that another session began may be under way.
            ordered: Ordered { arms: false, resets: false, seeks: true },
            returning: 0,
            marks: VecDeque::with_capacity(MARKS),
            trigger_input: false,
            edge: None,
        }
    }

    fn layout(&self) -> &'static Layout {
        self.array.spec().layout()
    }

    /// The array that the device must have.
    pub(super) fn array(&self) -> ArrayId {
        *self.layout().id()
    }

    /// Its motors.
    pub(super) fn motors(&self) -> usize {
        self.array.motors()
    }

    /// Whether these outputs are all there.
    fn has(&self, outputs: Outputs) -> bool {
        outputs.lines.without(self.layout().all()).is_empty()
    }

    /// Most outstanding return pulses of all pins together.
    fn most_outstanding(&self) -> u32 {
        self.motors() as u32 * u32::from(u16::MAX)
    }

    /// A command is about to be sent.
    pub(super) fn command(&mut self, op: &Op) {
        self.ordered.command(op);
    }

    /// A frame with a mark leaves.
    pub(super) fn mark_sent(&mut self, mark: Tick) {
        if self.marks.len() == MARKS {
            self.marks.pop_front();
        }
        self.marks.push_back(mark);
    }

    /// The handshake is done; the device's clock was not before `from` when it began, and is not beyond `by`.
    pub(super) fn open(&mut self, hello: &DeviceHello, [from, by]: [Tick; 2]) {
        (self.pool, self.telemetry) = (hello.pool, hello.features & DeviceHello::TELEMETRY != 0);
        self.trigger_input = hello.features & DeviceHello::TRIGGER_INPUT != 0;
        (self.horizon, self.reports) = (hello.horizon.into(), hello.reports);
        (self.opened, self.epoch, self.report_read_by) = (from, hello.epoch, by);
    }

    /// Takes over the newest status; `current`: the epoch that the session has begun last.
    pub(super) fn status(&mut self, status: Status, tick: Tick, current: u16) {
        if self.fails(&status) {
            self.failed = Some(tick);
            self.reported = self.after_failure(&self.reported, &status.counters);
        }
        let before = self.status.replace((status, tick)).map_or(tick, |(_, before)| before);
        self.returning = match status.state {
            State::Returning => self.returning + (tick - before).min(self.array.rate().of_ms(RETURN_SEEN_MS)),
            _ => 0,
        };
        self.epoch = status.epoch;
        if status.epoch == current {
            self.ordered.answered(status.state);
        }
    }

    /// Takes over a report.
    pub(super) fn report(&mut self, report: &Report, tick: Tick, by: Tick) {
        self.report_read_by = by;
        if let Report::Edge { number, .. } = report {
            self.edge = Some((*number, tick));
        }
        if let Report::Onset { counters, .. } = report {
            let at = self.marks.iter().position(|&sent| sent == tick);
            at.and_then(|at| self.marks.remove(at));
            self.reported = match &self.status {
                Some((status, _)) if self.failed.is_some_and(|failed| tick < failed) => {
                    self.after_failure(counters, &status.counters)
                }
                _ => *counters,
            };
        }
    }

    /// Whether this status is the first one that says that the outputs have failed.
    fn fails(&self, now: &Status) -> bool {
        now.cause == Cause::Output && self.status.is_none_or(|(before, _)| before.cause != Cause::Output)
    }

    /// Whether a board report may follow the last one of this session.
    pub(super) fn read_board(&self, board: &Board, before: Option<&Board>) -> Result<(), Contradiction> {
        let within = |slack: Option<u8>| slack.is_none_or(|slack| u32::from(slack) <= self.horizon);
        let outputs_exist = self.has(board.high_at_boot.unwrap_or_default());
        // The least slack since the start is at most the slack of any window, and is measured if that slack is.
        let bounds_least = |slack: Option<u8>| {
            slack.is_none_or(|slack| board.slack_since_boot.is_some_and(|least| least <= slack))
        };
        let follows = before.is_none_or(|before| {
            before.reset == board.reset
                && before.high_at_boot == board.high_at_boot
                && before.uptime_s <= board.uptime_s
                && before.counts.iter().zip(board.counts.iter()).all(|((_, then), (_, now))| then <= now)
                && bounds_least(before.slack_since_boot)
        });
        let slack = within(board.slack) && within(board.slack_since_boot) && bounds_least(board.slack);
        if slack && outputs_exist && follows { Ok(()) } else { Err(Contradiction::Board) }
    }

    /// Whether a status that says `now` may follow what is known.
    fn may_become(&self, now: &Status) -> bool {
        let begins_epoch = now.epoch != self.epoch;
        let [arms, resets, seeks] = [self.ordered.arms, self.ordered.resets, self.ordered.seeks]
            .map(|ordered| ordered && begins_epoch);
        // At the handshake an armed device returns its pins.
        let (before, cause) = self
            .status
            .map_or((State::Returning, Cause::NewHost), |(status, _)| (status.state, status.cause));
        match (before, now.state) {
            (_, State::Faulted) | (State::Armed, _) => true,
            (State::Disarmed | State::Returning, State::Disarmed) | (State::Returning, State::Returning) => {
                true
            }
            (State::Returning, State::Armed) if seeks => true,
            (State::Returning, State::Armed) => arms || matches!(cause, Cause::Stop | Cause::Request),
            (State::Disarmed, _) => arms,
            (State::Faulted, State::Disarmed) => resets,
            (State::Faulted, _) => resets && arms,
        }
    }

    /// Widens a tick that lies between the handshake and `ahead` ticks from now.
    fn tick_within(&self, clock: ClockReading, tick: WireTick, ahead: u32) -> Result<Tick, Contradiction> {
        let tick = tick.near(clock.tick);
        let from = Tick(self.opened.0.saturating_sub(clock.slack));
        let by = clock.latest() + u64::from(ahead);
        if (from..=by).contains(&tick) { Ok(tick) } else { Err(Contradiction::Clock) }
    }

    pub(super) fn read_hello(hello: &DeviceHello) -> Result<(), Contradiction> {
        let sane = Tick(hello.tick) <= LATEST_CLOCK && hello.pool > 0 && hello.max_up_pulses > 0;
        if sane { Ok(()) } else { Err(Contradiction::Hello) }
    }

    /// Reads a status; returns its tick, widened, and whether no later status has overtaken it.
    pub(super) fn read_status(
        &self,
        status: &Status,
        clock: ClockReading,
        sent: &Sent,
    ) -> Result<(Tick, bool), Contradiction> {
        let tick = self.tick_within(clock, status.tick, 0)?;
        if sent.pinged.is_some_and(|pinged| tick < pinged.earliest()) {
            return Err(Contradiction::Clock);
        }
        let newest = self.status.map_or(Tick(0), |(_, tick)| tick);
        if tick < newest {
            let overtaken = newest - tick <= self.array.rate().of_ms(OVERTAKEN_MS);
            return if overtaken { Ok((tick, false)) } else { Err(Contradiction::Clock) };
        }
        match self.status_follows(status, tick, sent) {
            Ok(()) => Ok((tick, true)),
            // Of two statuses of one tick the later may have come first.
            Err(_) if tick == newest => Ok((tick, false)),
            Err(how) => Err(how),
        }
    }

    /// Whether a status may follow the newest one.
    fn status_follows(&self, status: &Status, tick: Tick, sent: &Sent) -> Result<(), Contradiction> {
        self.check_command(status, sent)?;
        if status.epoch == sent.epoch {
            let acked = usize::from(status.next_seq.wrapping_sub(sent.acked));
            let buffered = REORDER_WINDOW - status.out_of_order.leading_zeros() as usize;
            if acked > sent.frames || (buffered > 0 && acked + buffered >= sent.frames) {
                return Err(Contradiction::Stream);
            }
        }
        if status.credits > self.pool {
            return Err(Contradiction::Credits);
        }
        let before = self.status.map_or(self.reports, |(status, _)| status.reports);
        let unread = status.reports.wrapping_sub(sent.seen);
        let read_before = unread > u16::MAX / 2;
        if status.reports.wrapping_sub(before) > u16::MAX / 2
            || (!read_before && usize::from(unread) > REPORTS + usize::from(self.pool))
            || (read_before && tick > self.report_read_by)
        {
            return Err(Contradiction::Reports);
        }
        if !self.may_become(status) || status.outstanding > self.most_outstanding() {
            return Err(Contradiction::State);
        }
        if self.returning > longest_return(self.layout()) && status.state == State::Returning {
            return Err(Contradiction::State);
        }
        if let Some((before, _)) = &self.status
            && before.position_known != status.position_known
            && !(self.ordered.seeks
                || (self.ordered.arms && status.position_known)
                || status.cause == Cause::Output)
        {
            return Err(Contradiction::State);
        }
        self.check_counters(status, tick)
    }

    /// Whether the epoch of a status was begun, and is answered as its command may be.
    fn check_command(&self, status: &Status, sent: &Sent) -> Result<(), Contradiction> {
        let unsent = sent.command.is_some_and(|(_, under_way)| !under_way);
        let begun = sent.epoch.wrapping_sub(self.epoch).saturating_sub(unsent.into());
        let answers = status.epoch.wrapping_sub(self.epoch);
        if answers > begun {
            return Err(Contradiction::Command);
        }
        let Some((op, _)) = sent.command.filter(|_| status.epoch == sent.epoch) else { return Ok(()) };
        let fits = match (op, status.refusal) {
            (_, None) => true,
            (Op::Arm { .. }, Some(why)) => {
                matches!(why, Refusal::State | Refusal::PositionUnknown | Refusal::Pushing | Refusal::Travel)
            }
            (Op::Seek { .. }, Some(why)) => {
                matches!(why, Refusal::State | Refusal::Pushing | Refusal::Travel)
            }
            (Op::Move { .. }, Some(why)) => matches!(
                why,
                Refusal::State
                    | Refusal::Motor
                    | Refusal::Travel
                    | Refusal::MotorOnTime
                    | Refusal::RailOnTime
                    | Refusal::Pushing
            ),
            _ => false,
        };
        let obeyed = match op {
            Op::EStop => status.state == State::Faulted,
            Op::Disarm(_) => status.state != State::Armed,
            _ => true,
        };
        if fits && obeyed { Ok(()) } else { Err(Contradiction::Command) }
    }

    /// Whether a status may have these counters at `tick`.
    fn check_counters(&self, now: &Status, tick: Tick) -> Result<(), Contradiction> {
        let before = self.status.map_or(Counters::NONE, |(status, _)| status.counters);
        let fails = self.fails(now);
        let follows = |earlier: &Counters| {
            grows(&if fails { self.after_failure(earlier, &now.counters) } else { *earlier }, &now.counters)
        };
        if follows(&before) && (tick <= self.report_read_by || follows(&self.reported)) {
            self.check_pace(&now.counters, tick)
        } else {
            Err(Contradiction::Counters)
        }
    }

    /// The least that `earlier` may become when the outputs have failed: what was counted since they were last seen to work is taken
    /// back, and its moves are `now` dropped.
    fn after_failure(&self, earlier: &Counters, now: &Counters) -> Counters {
        let most = self.motors() as u64 * u64::from(HORIZON);
        let moves = now.dropped.saturating_sub(earlier.dropped).min(most);
        Counters {
            pulses: earlier.pulses.saturating_sub(most),
            played: earlier.played.saturating_sub(moves),
            amended: earlier.amended.saturating_sub(moves),
            shortened: earlier.shortened.saturating_sub(moves),
            ..*earlier
        }
    }

    /// Whether the counters at `tick` are within what all lines can have played since the newest status.
    fn check_pace(&self, now: &Counters, tick: Tick) -> Result<(), Contradiction> {
        let Some((before, at)) = &self.status else { return Ok(()) };
        // Each line plays at most a pulse per tick; a stroke counts at its end.
        let most = self.motors() as u64 * ((tick - *at) + stroke_pulses(self.layout()));
        let jumps = |count: fn(&Counters) -> u64| count(now).saturating_sub(count(&before.counters)) > most;
        let jumps = jumps(|counts| counts.pulses) || jumps(|counts| counts.played);
        if jumps { Err(Contradiction::Counters) } else { Ok(()) }
    }

    /// Reads a report; returns its tick, widened. `frame` is the frame that a verdict is about, if it was sent and has none;
    /// `stale`: the verdict is of an epoch that is over.
    pub(super) fn read_report(
        &self,
        report: &Report,
        clock: ClockReading,
        frame: Option<&Batch>,
        stale: bool,
    ) -> Result<Tick, Contradiction> {
        match *report {
            Report::Verdict { rendered, .. } | Report::OnsetRefused { rendered, .. } if stale => {
                self.tick_within(clock, rendered, self.horizon)
            }
            Report::Verdict { late, refused, kept, reason, rendered, .. } => {
                let frame = frame.ok_or(Contradiction::Report)?;
                let listed = late | refused;
                let fits = late & refused == 0
                    && (listed != 0 || !kept.is_empty())
                    && kept.without(frame.withdraws().unwrap_or_default()).is_empty()
                    && listed.checked_shr(frame.moves() as u32).unwrap_or(0) == 0
                    && reason.is_some() == (refused != 0);
                if fits {
                    self.tick_within(clock, rendered, self.horizon)
                } else {
                    Err(Contradiction::Report)
                }
            }
            Report::OnsetRefused { rendered, .. } => {
                let frame = frame.ok_or(Contradiction::Report)?;
                let rendered = self.tick_within(clock, rendered, self.horizon)?;
                let fits = frame.marks().is_some_and(|onset| onset < rendered);
                if fits { Ok(rendered) } else { Err(Contradiction::Report) }
            }
            Report::Onset { tick, counters } => {
                let tick = self.tick_within(clock, tick, 0)?;
                if !self.marks.contains(&tick) {
                    return Err(Contradiction::Report);
                }
                if !grows(&self.reported, &counters) {
                    return Err(Contradiction::Counters);
                }
                self.check_pace(&counters, tick).map(|()| tick)
            }
            Report::Cut(Cut { at, flushed, outstanding, return_ticks, .. }) => {
                let fits = flushed <= self.pool
                    && outstanding <= self.most_outstanding()
                    && return_ticks.is_none_or(|ticks| u64::from(ticks) <= longest_return(self.layout()));
                if fits { self.tick_within(clock, at, self.horizon) } else { Err(Contradiction::Report) }
            }
            Report::Refused { motor, tick, reason } => {
                let limit = matches!(
                    reason,
                    Refusal::MotorOnTime
                        | Refusal::RailOnTime
                        | Refusal::Pushing
                        | Refusal::RailAtOnce
                        | Refusal::ChipAtOnce
                        | Refusal::Dense
                );
                let fits = self.array.has(motor) && limit;
                if fits { self.tick_within(clock, tick, self.horizon) } else { Err(Contradiction::Report) }
            }
            Report::Lowered { tick, late, held } => {
                let motors = late | held;
                if !motors.is_empty() && motors.without(self.layout().all()).is_empty() {
                    self.tick_within(clock, tick, self.horizon)
                } else {
                    Err(Contradiction::Report)
                }
            }
            Report::Edge { tick, number } => {
                let tick = self.tick_within(clock, tick, 0)?;
                let fits = self.trigger_input && self.edge_follows(number, tick);
                if fits { Ok(tick) } else { Err(Contradiction::Report) }
            }
        }
    }

    /// Whether an edge with this number at this tick may follow the last one: at most one in each dead time.
    fn edge_follows(&self, number: u32, tick: Tick) -> bool {
        let Some((last, at)) = self.edge else { return true };
        let most = tick.0.saturating_sub(at.0) / u64::from(self.layout().edge_dead_time());
        (1..=most).contains(&number.wrapping_sub(last).into())
    }

    /// Whether the result of a self-test names only outputs that there are.
    pub(super) fn read_self_test(&self, state: SelfTestState) -> Result<(), Contradiction> {
        let SelfTestState::Done(result) = state else { return Ok(()) };
        let exist = result.lines.is_none_or(|lines| {
            let is_output = |output| match output {
                Output::Line(line) => usize::from(line) < self.motors(),
                Output::Trigger | Output::Enable => true,
            };
            self.has(lines.stuck_high | lines.stuck_low | lines.shorted)
                && lines.pair.is_none_or(|(a, b)| is_output(a) && is_output(b))
        });
        if exist { Ok(()) } else { Err(Contradiction::Board) }
    }

    /// The tick of a part of a telemetry sample, from the motor `first` on, widened. Its displacements are for the telemetry
    /// monitors, motor by motor.
    pub(super) fn read_telemetry(
        &self,
        clock: ClockReading,
        tick: WireTick,
        first: u8,
        y: &[i32],
    ) -> Result<Tick, Contradiction> {
        if !self.telemetry || usize::from(first) + y.len() > self.motors() {
            return Err(Contradiction::Telemetry);
        }
        self.tick_within(clock, tick, 0)
    }
}

fn fields(counters: &Counters) -> [u64; 11] {
    let Counters {
        played,
        pulses,
        dropped,
        late,
        refused,
        replaced,
        amended,
        shortened,
        amendments_ignored,
        bad_frames,
        reports_lost,
    } = *counters;
    let played = [played, pulses, dropped, late, refused, replaced, amended, shortened];
    let [a, b, c, d, e, f, g, h] = played;
    [a, b, c, d, e, f, g, h, amendments_ignored, bad_frames, reports_lost]
}

/// Whether no count of `later` is below that of `earlier`, or beyond all that a device can count.
fn grows(earlier: &Counters, later: &Counters) -> bool {
    fields(earlier)
        .into_iter()
        .zip(fields(later))
        .all(|(earlier, later)| earlier <= later && later <= 1 << 62)
}
