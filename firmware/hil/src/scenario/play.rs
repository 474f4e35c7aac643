//! Plays a scenario on a bench.

use crate::bench::Which;
use crate::bench::answer::unhex;
use crate::judge::Judged;
use crate::rig::{Rig, RigOptions};
use crate::scenario::{Act, Check, Scenario, ScenarioError, Step, outcome, pattern};
use crate::tap::Event;
use firmware_protocol::batch::{Amendment, BATCH_BYTES, Packer};
use firmware_protocol::frame::{MAX_FRAME, encode};
use firmware_protocol::message::HostMessage;
use firmware_protocol::tick::Tick;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_stream::end_cause;
use meissner_stream::queues::{At, Command, Play, StreamEvent};
use meissner_test_support::paper::RATE;

/// Most ms from a boot to the handshake.
const GREETING_MS: u64 = 3_000;

/// The result of a scenario on one bench.
#[derive(Debug)]
pub struct Ran {
    /// The judged boots.
    pub boots: Vec<Judged>,
    /// Per boot, the tick at which its core failed.
    pub deaths: Vec<Option<Tick>>,
    /// All faults, in words.
    pub wrong: Vec<String>,
}

struct Runner<'a> {
    scenario: &'a Scenario,
    rig: Rig,
    /// Number of play commands, and the ids of those that must not be refused.
    ordered: u64,
    plays: Vec<u64>,
    /// Tickets of commands, whether they must be refused, and their steps.
    tickets: Vec<(u64, bool, usize)>,
    generation: u16,
    boots: usize,
    wrong: Vec<String>,
}

/// Plays the scenario.
///
/// # Errors
/// If the bench fails, or the scenario names something that is missing.
pub fn run(scenario: &Scenario, which: &Which) -> Result<Ran, ScenarioError> {
    let options =
        RigOptions { function: scenario.function, faults: scenario.faults, seed: 1, ..RigOptions::default() };
    let rig = Rig::new(which, options)?;
    let mut runner = Runner {
        scenario,
        rig,
        ordered: 0,
        plays: Vec::new(),
        tickets: Vec::new(),
        generation: 0,
        boots: 1,
        wrong: Vec::new(),
    };
    runner.rig.run_to_greeting(GREETING_MS)?;
    for (number, step) in scenario.steps.iter().enumerate() {
        runner.step(number, step)?;
    }
    let end = runner.rig.grid().cycle(tick(scenario.end_ms));
    runner.rig.run_to(end)?;
    runner.finish()
}

/// A time of the device's clock.
fn tick(ms: f64) -> Tick {
    Tick::BOOT + RATE.seconds_to_ticks(ms / 1000.0)
}

impl Runner<'_> {
    fn step(&mut self, number: usize, step: &Step) -> Result<(), ScenarioError> {
        let at = self.rig.grid().cycle(tick(step.at_ms) + step.ticks) + step.cycles;
        self.rig.run_to(at)?;
        if let Some(ticks) = step.low_within_ticks {
            self.rig.low_from(ticks);
        }
        let job = match &step.act {
            Act::Arm { assume_rest } => Command::Arm { assume_rest: *assume_rest },
            Act::Play { pattern: name, seconds, onset_ms } => {
                self.ordered += 1;
                if !step.refused {
                    self.plays.push(self.ordered);
                }
                let strokes = Strokes::new(&pattern(name)?, &StrokeOptions::lasting(*seconds))?;
                let (id, at) = (self.ordered, At::Tick(tick(*onset_ms)));
                Command::Play(Box::new(Play { at, open_loop: true, ..Play::new(id, strokes) }))
            }
            Act::Stop => Command::Stop,
            Act::Estop => Command::EStop,
            Act::Reset => Command::Reset { estops_seen: u64::MAX, keep: true },
            Act::Disarm => Command::Disarm,
            other => return self.happen(number, other),
        };
        let ticket = self.rig.order(job);
        self.tickets.push((ticket, step.refused, number));
        Ok(())
    }

    fn happen(&mut self, number: usize, act: &Act) -> Result<(), ScenarioError> {
        let rig = &mut self.rig;
        let bytes = |hex: &String| unhex(hex).ok_or_else(|| ScenarioError::Hex(hex.clone()));
        match act {
            Act::Amend { motor, stroke, up, down } => self.amend(*motor, *stroke, *up, *down)?,
            Act::Stall(ms) => rig.stall(rig.now() + (ms * crate::time::MS as f64) as u64),
            Act::Kill => rig.kill(true),
            Act::Revive => rig.kill(false),
            Act::TakeOver(function) => rig.take_over(*function)?,
            Act::Unplug => rig.plug(false)?,
            Act::Plug => rig.plug(true)?,
            Act::Close => rig.close(true)?,
            Act::Open => rig.close(false)?,
            Act::HalfFrame => {
                let mut frame = [0; MAX_FRAME];
                let len = encode(&HostMessage::Ping { token: 0, seen: 0 }, &mut frame).unwrap_or(0);
                rig.raw(&frame[..len / 2]);
            }
            Act::Raw(hex) => rig.raw(&bytes(hex)?),
            Act::Stray(hex) => rig.stray(&bytes(hex)?)?,
            Act::Faults(faults) => rig.set_faults(*faults),
            Act::Cpu(event) => {
                let boot = rig.tap().hello().map(|hello| hello.boot);
                rig.fail(*event)?;
                // The old boot's handshake is valid until the reset.
                let end = rig.now() + GREETING_MS * crate::time::MS;
                while rig.tap().hello().is_some() && rig.now() < end {
                    rig.run_to(rig.now() + crate::time::MS)?;
                }
                rig.run_to_greeting(GREETING_MS)?;
                self.boots += 1;
                if rig.tap().hello().map(|hello| hello.boot) == boot {
                    self.wrong.push(format!("step {number}: after the reset the boot id is the same"));
                }
            }
            Act::Check(check) => self.check(number, check),
            Act::Arm { .. } | Act::Play { .. } | Act::Stop | Act::Estop | Act::Reset | Act::Disarm => {}
        }
        Ok(())
    }

    fn amend(
        &mut self,
        motor: u8,
        n: usize,
        up: Option<u16>,
        down: Option<u16>,
    ) -> Result<(), ScenarioError> {
        let sent = self.rig.tap().events.iter().filter_map(|(_, event)| match event {
            Event::Batch(batch) => Some(&batch.moves),
            _ => None,
        });
        let of_motor = sent.flatten().filter(|one| one.of.motor == motor);
        let ups = of_motor.clone().filter(|one| !one.joined).map(|one| one.of.tick);
        let downs = of_motor.filter(|one| one.joined).map(|one| one.of.tick);
        let (at_up, at_down) = ups.zip(downs).nth(n).ok_or(ScenarioError::NoStroke(motor, n))?;
        let mut packer = Packer::<BATCH_BYTES>::new(at_up);
        for (tick, pulses) in [(at_up, up), (at_down, down)] {
            if let Some(pulses) = pulses {
                // Two items always fit.
                let _ = packer.amendment(&Amendment { motor, tick, pulses });
            }
        }
        self.generation += 1;
        let (epoch, generation) = (self.rig.tap().epoch(), self.generation);
        let base = packer.base().wire();
        self.rig.message(&HostMessage::Amend { epoch, generation, base, items: packer.bytes() });
        Ok(())
    }

    fn check(&mut self, number: usize, check: &Check) {
        let status = self.rig.tap().status();
        let mut wrong = |what: &str, wanted: String, found: String| {
            if wanted != found {
                self.wrong.push(format!("step {number}: {what} is {found} and should be {wanted}"));
            }
        };
        let state =
            status.map_or("unheard".to_owned(), |status| format!("{:?}", status.state).to_lowercase());
        let cause = status.map_or("none".to_owned(), |status| end_cause(status.cause).to_string());
        if let Some(wanted) = &check.state {
            wrong("state", wanted.clone(), state);
        }
        let on_chip = matches!(self.rig.bench, crate::bench::Bench::Chip(_));
        if let Some(wanted) = check.chip_cause.as_ref().filter(|_| on_chip).or(check.cause.as_ref()) {
            wrong("cause", wanted.clone(), cause);
        }
        if let Some(wanted) = check.position_known {
            let found = status.is_some_and(|status| status.position_known);
            wrong("position_known", wanted.to_string(), found.to_string());
        }
        if let Some(wanted) = check.outstanding {
            wrong(
                "outstanding",
                wanted.to_string(),
                status.is_some_and(|status| status.outstanding > 0).to_string(),
            );
        }
        if let Some(wanted) = check.connected {
            wrong("connected", wanted.to_string(), self.rig.bench.configured().to_string());
        }
        if let Some(wanted) = check.boots {
            wrong("boots", wanted.to_string(), self.boots.to_string());
        }
    }

    fn finish(self) -> Result<Ran, ScenarioError> {
        let Self { scenario, rig, plays, tickets, mut wrong, .. } = self;
        let bad_frames = rig.tap().status().is_some_and(|status| status.counters.bad_frames > 0);
        if bad_frames != scenario.bad_frames {
            wrong.push(format!(
                "frames that could not be read: {bad_frames}, expected {}",
                scenario.bad_frames
            ));
        }
        let (boots, notices) = rig.finish();
        let judged: Vec<_> = boots.iter().map(crate::judge::Boot::judge).collect();
        for (number, (boot, judged)) in boots.iter().zip(&judged).enumerate() {
            wrong.extend(judged.findings.iter().map(|finding| format!("boot {number}: {finding}")));
            if boot.tap.unreadable > 0 && scenario.faults == crate::rig::Faults::default() {
                wrong.push(format!("boot {number}: {} frames that cannot be read", boot.tap.unreadable));
            }
        }
        wrong.extend(notices.iter().filter_map(|notice| match notice {
            StreamEvent::Contradiction(how) => Some(format!("the host doubts a true device: {}", how.name())),
            _ => None,
        }));
        for (ticket, refused, number) in tickets {
            let mut answers = notices.iter().filter_map(|notice| match notice {
                StreamEvent::Answer { ticket: t, result } if *t == ticket => Some(result),
                _ => None,
            });
            match answers.next() {
                Some(result) if result.is_err() == refused => {}
                answer => wrong.push(format!("step {number}: the host answers {answer:?}")),
            }
        }
        let deaths =
            boots.iter().zip(&judged).map(|(boot, judged)| boot.death.map(|cycle| judged.grid.tick(cycle).0));
        let deaths = deaths.collect();
        outcome::check(scenario, &plays, notices, &judged, &mut wrong);
        Ok(Ran { boots: judged, deaths, wrong })
    }
}
