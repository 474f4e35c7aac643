//! One play that meets the faults of one case.
//!
//! It follows the runner in virtual time (`crates/stream/tests/faults.rs`), with shorter waits: the emulator is slow. A fault that
//! does not end by itself lasts until the play has ended, and a second at least. Then everything is mended, the host has to find
//! the device again, and the next play has to be whole.

use crate::bench::{CpuEvent, Which};
use crate::faults::verdict::Verdict;
use crate::rig::{Rig, RigError, RigOptions};
use crate::scenario::pattern;
use crate::time::{MS, TICK};
use firmware_protocol::message::State;
use meissner_array::strokes::{Step, Stroke, StrokeOptions, Strokes};
use meissner_fault_cases::{Kind, ONSET, Observed, Order, PLAY, Seen, What, bytes};
use meissner_stream::faulty::Line;
use meissner_stream::queues::{At, Command, Outcome, Play, StreamEvent};
use meissner_test_support::paper::RATE;
use std::time::Duration;

/// Most ms from the start of a board, or the end of a fault, until the host has greeted it.
const GREETING_MS: u64 = 10_000;
/// A device that the streamer gave up is opened again after so long, as the daemon does.
const REOPENED: u64 = 250 * MS;
/// A fault lasts for so long at least: longer than the host watchdog waits.
const FAULT: u64 = 1_000 * MS;
/// From the end of the play and of the faults until the lines are judged: longer than the host watchdog waits and pins return.
const SETTLED: u64 = 600 * MS;
/// How long a play may take to end.
const LATE: u64 = 3_000 * MS;
/// The ids of the two plays.
const FIRST: u64 = 1;
const NEXT: u64 = 2;

struct Player {
    rig: Rig,
    value: f64,
    /// When the last fault began: the first time, if it happens several times.
    fault: u64,
    /// When the daemon opens the device again.
    reopen_at: Option<u64>,
    restarts: u32,
    estopped: bool,
    /// What the device has counted before it restarted.
    observed: Observed,
}

/// Plays it and judges it.
///
/// # Errors
/// What was not as the case expects, in one line.
pub fn play(which: &Which, kind: &Kind<'_>, pattern: &str, seed: u64) -> Result<Seen, String> {
    let mut player = Player::armed(which, kind.value, seed)?;
    let verdict = player.play(kind, pattern)?;
    let (boots, notices) = player.rig.finish();
    verdict.judge(kind.case, &boots, &notices)
}

fn text(error: RigError) -> String {
    error.to_string()
}

fn cycles(time: Duration) -> u64 {
    RATE.duration_to_ticks(time) * TICK
}

fn strokes(name: &str, seconds: f64) -> Result<Strokes, String> {
    let pattern = pattern(name).map_err(|error| error.to_string())?;
    Strokes::new(&pattern, &StrokeOptions::lasting(Some(seconds))).map_err(|error| error.to_string())
}

fn outcome(notices: &[StreamEvent], play: u64) -> Option<&Outcome> {
    notices.iter().find_map(|notice| match notice {
        StreamEvent::PlayEnded { id, outcome } if *id == play => Some(outcome),
        _ => None,
    })
}

impl Player {
    fn armed(which: &Which, value: f64, seed: u64) -> Result<Self, String> {
        let rig = Rig::new(which, RigOptions { seed, ..RigOptions::default() }).map_err(text)?;
        let (restarts, observed) = (0, Observed::default());
        let mut player = Self { rig, value, fault: 0, reopen_at: None, restarts, estopped: false, observed };
        player.rig.run_to_greeting(GREETING_MS).map_err(text)?;
        player.run(100 * MS)?;
        player.arm(true)?;
        Ok(player)
    }

    fn arm(&mut self, assume_rest: bool) -> Result<(), String> {
        let ticket = self.rig.order(Command::Arm { assume_rest });
        self.run(150 * MS)?;
        let answer = self.rig.notices.iter().find_map(|notice| match notice {
            StreamEvent::Answer { ticket: of, result } if *of == ticket => Some(result),
            _ => None,
        });
        if answer == Some(&Ok(())) { Ok(()) } else { Err(format!("it does not arm: {answer:?}")) }
    }

    fn run(&mut self, cycles: u64) -> Result<(), String> {
        self.run_to(self.rig.now() + cycles)
    }

    /// Runs as the daemon does: a device that the streamer gives up is closed, and opened again later.
    fn run_to(&mut self, until: u64) -> Result<(), String> {
        while self.rig.now() < until {
            self.rig.run_to((self.rig.now() + 10 * MS).min(until)).map_err(text)?;
            let given_up = self.rig.streamer.take_disconnect_reason().is_some();
            if given_up && self.rig.is_open() {
                self.rig.close(true).map_err(text)?;
                let _ = self.rig.streamer.take_disconnect_reason();
                self.reopen_at = Some(self.rig.now() + REOPENED);
            }
            if self.reopen_at.is_some_and(|at| at <= self.rig.now()) {
                self.reopen_at = None;
                self.rig.close(false).map_err(text)?;
            }
        }
        Ok(())
    }

    /// Begins a fault, and ends it if it is one of the host or of the cable.
    fn begin(&mut self, what: &What, is_first: bool) -> Result<(), String> {
        let value = self.value;
        if is_first {
            self.fault = self.rig.now();
        }
        match what {
            What::Line(fault) => {
                let (to_device, to_host) = fault.lines(value);
                self.rig.set_lines(to_device, to_host);
            }
            What::Stall(ms) => {
                let until = self.rig.now() + cycles(ms.ms(value));
                self.rig.stall(until);
                self.run_to(until)?;
            }
            What::Suspend(ms) => {
                let time = cycles(ms.ms(value));
                self.rig.suspend(time);
                self.run(time)?;
            }
            What::Die(ms) => {
                self.rig.replace_host(RigOptions::default().settings).map_err(text)?;
                self.run(cycles(ms.ms(value)))?;
                self.rig.close(false).map_err(text)?;
            }
            What::Unplug(ms) => {
                self.rig.plug(false).map_err(text)?;
                self.run(cycles(ms.ms(value)))?;
                self.rig.plug(true).map_err(text)?;
            }
            What::Restart => self.restart(CpuEvent::Run)?,
            // The board's own watchdog ends it.
            What::Hang(_) => self.restart(CpuEvent::Die)?,
            What::ClockPpm(ppm) => self.rig.set_clock_error(ppm.of(value), 0.0),
            What::ClockDrift(ppm_per_s) => self.rig.set_clock_error(0.0, ppm_per_s.of(value)),
            What::Nonsense(count) => self.rig.inject(&bytes::nonsense(count.of(value) as u32)),
            What::OlderVersion => self.rig.inject(&bytes::older_frame()),
            What::Lie(lie) => {
                let lie = *lie;
                self.rig.lie(move |message| lie.tell(message));
            }
            What::Telemetry(_) => return Err("the board has no sensor".to_owned()),
            What::Order(order) => {
                self.estopped |= matches!(order, Order::Estop);
                self.rig.order(order.command());
            }
        }
        Ok(())
    }

    fn restart(&mut self, event: CpuEvent) -> Result<(), String> {
        self.restarts += 1;
        self.observed.unread_by_device = self.unread_by_device();
        self.rig.fail(event).map_err(text)
    }

    /// Everything is as it should be again.
    fn mend(&mut self) {
        self.rig.set_lines(Line::default(), Line::default());
        self.rig.set_clock_error(0.0, 0.0);
        self.rig.stop_lying();
    }

    fn play(&mut self, kind: &Kind<'_>, pattern: &str) -> Result<Verdict, String> {
        let strokes = strokes(pattern, PLAY.as_secs_f64())?;
        let ordered_at = self.rig.now();
        let ordered = self.rig.grid().tick(ordered_at).0;
        let onset = ordered + ONSET;
        let play = Play { at: At::Tick(onset), open_loop: true, ..Play::new(FIRST, strokes.clone()) };
        self.rig.order(Command::Play(Box::new(play)));
        let mut compiled = strokes;
        compiled.begin(onset);
        let compiled: Vec<Step> = compiled.collect::<Result<_, _>>().map_err(|error| error.to_string())?;
        let compiled: Vec<Stroke> = compiled.iter().filter_map(Step::stroke).collect();
        for fault in &kind.case.fault {
            for (time, begins) in kind.begins(fault, ordered, &compiled).enumerate() {
                // The grid of a board that has restarted since then is another one.
                let at = if self.restarts == 0 {
                    self.rig.grid().cycle(ordered + RATE.duration_to_ticks(begins))
                } else {
                    ordered_at + cycles(begins)
                };
                self.run_to(at)?;
                self.begin(&fault.what, time == 0)?;
                if let Some(lasts) = fault.lasts_ms {
                    self.run(cycles(lasts.ms(self.value)))?;
                    self.mend();
                }
            }
        }
        self.end()?;
        let low_since = self.rig.low_since().unwrap_or(0);
        let is_latched = self.state()? == State::Faulted;
        let rested_at = self.rig.now();
        let observed = self.observed();
        self.recover(pattern)?;
        Ok(Verdict {
            fault: self.fault,
            low_since,
            rested_at,
            is_latched,
            observed,
            restarts: self.restarts,
            plays: [FIRST, NEXT],
        })
    }

    /// The play ends, the faults end, and the host finds the device again.
    fn end(&mut self) -> Result<(), String> {
        let begun = self.rig.now();
        let limit = begun + cycles(PLAY) + LATE;
        while self.rig.now() < self.fault.max(begun) + FAULT || outcome(&self.rig.notices, FIRST).is_none() {
            if self.rig.now() >= limit {
                return Err("the play did not end".to_owned());
            }
            self.run(10 * MS)?;
        }
        self.mend();
        let limit = self.rig.now() + GREETING_MS * MS;
        while !self.is_connected() {
            if self.rig.now() >= limit {
                return Err("the host does not find the device again".to_owned());
            }
            self.run(10 * MS)?;
        }
        self.run(SETTLED)
    }

    /// A person resets, arms and plays again.
    fn recover(&mut self, pattern: &str) -> Result<(), String> {
        if self.estopped || self.state()? == State::Faulted {
            self.rig.order(Command::Reset { estops_seen: u64::MAX, keep: true });
            self.run(50 * MS)?;
        }
        if self.state()? != State::Armed {
            // Only a board that has started again does not know where its pins are.
            self.arm(self.restarts > 0)?;
        }
        let play = Play { open_loop: true, ..Play::new(NEXT, strokes(pattern, 0.3)?) };
        self.rig.order(Command::Play(Box::new(play)));
        self.rig.run_to_end(NEXT, 2_000).map_err(text)?;
        self.run(50 * MS)
    }

    fn is_connected(&self) -> bool {
        self.rig.is_open()
            && self.rig.tap().status().is_some()
            && self.rig.streamer.tick_at(self.rig.host_time()).is_some()
    }

    /// As the device says.
    fn state(&self) -> Result<State, String> {
        self.rig.tap().status().map(|status| status.state).ok_or_else(|| "the device is silent".to_owned())
    }

    fn unread_by_device(&self) -> u64 {
        let now = self.rig.tap().status().map_or(0, |status| status.counters.bad_frames);
        self.observed.unread_by_device + now
    }

    /// What host and device have counted so far.
    fn observed(&self) -> Observed {
        Observed {
            unread_by_device: self.unread_by_device(),
            harmed: self.rig.harmed_frames(),
            ..Observed::told(&self.rig.notices)
        }
    }
}
