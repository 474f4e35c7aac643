//! Live plays: their drives as their clients have set them, and the channels to their clients.
//!
//! Bounds: one entry for each accepted play that is not over. Invariant: a play accepts one connection, by a key that cannot be
//! guessed.

use crate::daemon::core::commands::Commands;
use crate::daemon::exposure::limits::too_many;
use crate::daemon::sessions::state::random_hex;
use meissner_api::{Code, EndCause, LIVE_GLIDE_MS, LiveAnswer, LiveApplied, LiveDrive, LiveMessage, Problem};
use meissner_array::motor::SquareWave;
use meissner_array::pattern::Drive;
use meissner_array::per_motor::PerMotor;
use meissner_array::power::Group;
use meissner_array::spec::Array;
use meissner_array::strokes::{DriveStrokes, LiveMotion, StrokeOptions};
use meissner_render::Poses;
use meissner_stream::Settings;
use meissner_stream::queues::{Applied, Command, LiveResult, LiveUpdate, StreamEvent};
use meissner_stream::time::HostInstant;
use std::collections::HashMap;
use std::sync::Arc;
use tokio::sync::mpsc;

/// The most pending updates of the streamer, whose event queue must never fill.
const UNDER_WAY: usize = 32;
/// The most answers that wait for a client; a client that does not read loses further ones.
const ANSWERS: usize = 4 * UNDER_WAY;

/// A live play that is not over.
#[derive(Debug)]
pub(in crate::daemon) struct LivePlay {
    key: String,
    array: Array,
    drives: PerMotor<LiveDrive>,
    /// The motors whose pins follow levels, µm, in place of their drives.
    levels: PerMotor<Option<f64>>,
    /// Whether messages may have levels.
    takes_levels: bool,
    /// Nothing corrects its strokes.
    pub(in crate::daemon) open_loop: bool,
    /// Scale and surplus of its strokes.
    options: StrokeOptions,
    most_hz: f64,
    seq: Option<u64>,
    under_way: usize,
    /// The heights of pins for poses of its object.
    heights: Option<Arc<Poses>>,
    answers: Option<mpsc::Sender<LiveAnswer>>,
}

/// See the module.
#[derive(Debug, Default)]
pub(in crate::daemon) struct LivePlays {
    plays: HashMap<u64, LivePlay>,
}

impl LivePlay {
    /// A play of these drives; the other motors are silent.
    ///
    /// # Errors
    /// If a drive is too fast, or the system gives no random numbers.
    pub(in crate::daemon) fn new(
        array: Array,
        drives: &[LiveDrive],
        options: StrokeOptions,
        most_hz: f64,
    ) -> Result<Self, Problem> {
        let no_numbers =
            || Problem::new(Code::Store, "the system gives no random numbers for the key: try again");
        let key = random_hex::<16>().ok_or_else(no_numbers)?;
        let silent =
            |motor| LiveDrive { motor, frequency_hz: most_hz.min(60.0), amplitude_um: 0.0, phase: 0.0 };
        let silent = PerMotor::from_fn(array, silent);
        let mut new = Self {
            key,
            array,
            drives: silent,
            levels: PerMotor::all(array, None),
            takes_levels: false,
            open_loop: false,
            options,
            most_hz,
            seq: None,
            under_way: 0,
            heights: None,
            answers: None,
        };
        new.set(drives)?;
        Ok(new)
    }

    /// The same play with an object, whose poses become levels.
    pub(in crate::daemon) fn with_heights(self, heights: Option<Arc<Poses>>) -> Self {
        Self { takes_levels: self.takes_levels || heights.is_some(), heights, ..self }
    }

    /// The same play, whose messages may have levels.
    pub(in crate::daemon) fn with_levels(self, takes_levels: bool) -> Self {
        Self { takes_levels, ..self }
    }

    /// The same play, which nothing corrects.
    pub(in crate::daemon) fn with_open_loop(self, open_loop: bool) -> Self {
        Self { open_loop, ..self }
    }

    pub(in crate::daemon) fn key(&self) -> &str {
        &self.key
    }

    fn set(&mut self, drives: &[LiveDrive]) -> Result<(), Problem> {
        if let Some(fast) = drives.iter().find(|drive| drive.frequency_hz > self.most_hz) {
            let (motor, hz, most_hz) = (fast.motor, fast.frequency_hz, self.most_hz);
            let detail = format!(
                "motor {motor} at {hz} Hz: the play was started for at most {most_hz} Hz: start it with a higher `max_frequency_hz`"
            );
            return Err(Problem::new(Code::BadRequest, detail));
        }
        let travel_um = self.array.motor().travel_um;
        let wrong = |LiveDrive { motor, amplitude_um, .. }: &LiveDrive| {
            if !self.array.has(*motor) {
                return Some(format!("motor {motor}: the array has motors {}", self.array.motor_range()));
            }
            (*amplitude_um > travel_um)
                .then(|| format!("motor {motor} with {amplitude_um} um: must be 0 to {travel_um} um"))
        };
        if let Some(detail) = drives.iter().find_map(wrong) {
            return Err(Problem::new(Code::BadRequest, detail));
        }
        for drive in drives {
            let motor = usize::from(drive.motor);
            (self.drives[motor], self.levels[motor]) = (*drive, None);
        }
        Ok(())
    }

    /// Takes over the levels of a message.
    fn set_levels(&mut self, message: &LiveMessage) -> Result<(), Problem> {
        let travel_um = self.array.motor().travel_um;
        for (&motor, &um) in &message.um {
            let detail = if !self.takes_levels {
                "the play was started without `levels`: start it with `levels`, so that the line is checked for them"
                    .to_owned()
            } else if !self.array.has(motor) {
                format!("motor {motor}: the array has motors {}", self.array.motor_range())
            } else if um > travel_um {
                format!("motor {motor} at {um} um: must be 0 to {travel_um} um")
            } else {
                let motor = usize::from(motor);
                (self.levels[motor], self.drives[motor].amplitude_um) = (Some(um), 0.0);
                continue;
            };
            return Err(Problem::new(Code::BadRequest, detail));
        }
        Ok(())
    }

    /// Takes over a message.
    fn take(&mut self, message: &LiveMessage) -> Result<(), Problem> {
        self.options.scale = message.scale.unwrap_or(self.options.scale);
        self.seq = Some(message.seq);
        self.set(message.drives.as_deref().unwrap_or_default())?;
        self.set_levels(message)
    }

    /// What an update tells the streamer: the levels of the message, and all drives.
    fn motions(&self, message: &LiveMessage) -> Result<PerMotor<Option<LiveMotion>>, Problem> {
        let (array, rate) = (self.array, self.array.rate());
        let glide_ms = message.glide_ms.unwrap_or(LIVE_GLIDE_MS);
        let mut motions = self.waves()?.map(|wave| Some(LiveMotion::Wave(wave)));
        for (motor, (motion, level)) in (0..).zip(motions.iter_mut().zip(&*self.levels)) {
            let Some(um) = level else { continue };
            let pulses = array.motor().pulses(um * self.options.scale).round();
            let pulses = (pulses as u16).min(array.motor().most_pulses);
            let glide_ticks = rate.ms_in_ticks(glide_ms) as u32;
            // A pin that the device has brought down stays there until a message names it again.
            let is_new = message.um.contains_key(&motor) || self.options.scale == 0.0;
            *motion = is_new.then_some(LiveMotion::Level { array, pulses, glide_ticks });
        }
        Ok(motions)
    }

    /// Answers its client. A client that does not read its answers loses them.
    fn answer(&self, answer: LiveAnswer) {
        if let Some(answers) = &self.answers {
            let _ = answers.try_send(answer);
        }
    }

    /// The largest amplitude that is ordered, and how far pins may go for it, µm, each so many times as far as ordered.
    pub(in crate::daemon) fn largest_um(&self, reach: &[f64]) -> [f64; 2] {
        let ordered = self.drives.iter().zip(&*self.levels);
        let ordered = ordered.map(|(drive, level)| drive.amplitude_um.max(level.unwrap_or(0.0)));
        let both = ordered.zip(reach).map(|(um, reach)| [um, um * reach]);
        let most = both.fold([0.0, 0.0], |most: [f64; 2], um| [most[0].max(um[0]), most[1].max(um[1])]);
        most.map(|um| um * self.options.scale)
    }

    /// Refuses drives that move more motors than may have pulses at once. Phases are ignored, because they shift with each change.
    pub(in crate::daemon) fn check_at_once(&self, settings: &Settings) -> Result<(), Problem> {
        let limits = settings.limits;
        let moves = |motor: &&u8| {
            let motor = usize::from(**motor);
            self.levels[motor].is_some() || self.drives[motor].amplitude_um * self.options.scale > 0.0
        };
        let rails = (0..).take(self.array.rails().count()).map(Group::Rail);
        let chips = (0..).take(self.array.chips().count()).map(Group::Chip);
        for group in rails.chain(chips) {
            let most = match group {
                Group::Rail(_) => limits.rail_at_once,
                Group::Chip(_) => limits.chip_at_once,
            };
            let found = group.motors(&self.array).iter().filter(moves).count();
            if found > usize::from(most) {
                return Err(too_many(group, &format!("{found} moving motors in a live play"), settings));
            }
        }
        Ok(())
    }

    /// The waves of all motors.
    ///
    /// # Errors
    /// If a drive is out of the motor's range, which a checked one is not.
    pub(in crate::daemon) fn waves(&self) -> Result<PerMotor<SquareWave>, Problem> {
        let wave = |&LiveDrive { motor, frequency_hz, amplitude_um, phase }: &LiveDrive| {
            let drive = Drive { motor, frequency_hz, amplitude_um, phase, start_s: None, stop_s: None };
            let strokes = DriveStrokes::with(self.array, &drive, &self.options);
            strokes
                .map(|strokes| *strokes.wave())
                .map_err(|error| Problem::new(Code::BadRequest, error.to_string()))
        };
        let mut waves = PerMotor::all(self.array, wave(&self.drives[0])?);
        for (own, drive) in waves.iter_mut().zip(&*self.drives) {
            *own = wave(drive)?;
        }
        Ok(waves)
    }
}

impl LivePlays {
    pub(in crate::daemon) fn add(&mut self, id: u64, play: LivePlay) {
        self.plays.insert(id, play);
    }

    /// The heights of pins for poses of a play's object.
    pub(in crate::daemon) fn heights(&self, id: u64) -> Option<Arc<Poses>> {
        self.plays.get(&id)?.heights.clone()
    }

    pub(in crate::daemon) fn forget(&mut self, id: u64) {
        self.plays.remove(&id);
    }

    /// Opens the connection of the play with this key, once. Returns the play and where its answers arrive.
    pub(in crate::daemon) fn connect(
        &mut self,
        key: &str,
    ) -> Result<(u64, mpsc::Receiver<LiveAnswer>), Problem> {
        let unknown = || {
            let detail = "no live play has this key, or it is over: start one with POST /v1/live, and open the connection within 2 s";
            Problem::new(Code::NotFound, detail)
        };
        let found = self.plays.iter_mut().find(|(_, play)| play.key == key);
        let (&id, play) = found.ok_or_else(unknown)?;
        if play.answers.is_some() {
            return Err(Problem::new(Code::BadRequest, "the live play has its connection: it takes one"));
        }
        let (answers, receiver) = mpsc::channel(ANSWERS);
        play.answers = Some(answers);
        Ok((id, receiver))
    }

    /// Carries out a message of a play's client, whose answer comes later: changes the play, if `check` accepts it then, and sends the change
    /// to the streamer.
    ///
    /// # Errors
    /// Why the message changes nothing.
    pub(in crate::daemon) fn change(
        &mut self,
        id: u64,
        message: &LiveMessage,
        received_at: HostInstant,
        settings: &Settings,
        check: impl FnOnce(&LivePlay) -> Result<(), Problem>,
        commands: &mut Commands,
    ) -> Result<(), Problem> {
        let play = self.plays.get_mut(&id).ok_or_else(over)?;
        if let Some(last) = play.seq.filter(|last| message.seq <= *last) {
            let detail =
                format!("`seq` is {}: must be above that of the message before, {last}", message.seq);
            return Err(Problem::new(Code::BadRequest, detail));
        }
        if message.pose.is_some() {
            let detail = "`pose` is that of an object: this live play was started with drives";
            return Err(Problem::new(Code::BadRequest, detail));
        }
        let changes = message.drives.is_some() || message.scale.is_some() || !message.um.is_empty();
        let busy = || Problem::new(Code::Busy, "too many updates are under way: wait for their answers");
        let before = (play.drives, play.levels, play.options.scale, play.seq);
        let change = |play: &mut LivePlay| {
            play.take(message)?;
            play.check_at_once(settings)?;
            let motions = play.motions(message)?;
            check(play)?;
            let mut update = LiveUpdate::new(settings.array, id, message.seq, received_at);
            if changes {
                update.motions = motions;
            }
            if play.under_way >= UNDER_WAY {
                return Err(busy());
            }
            commands.send_unanswered(Command::UpdateLive(Box::new(update))).map_err(|_| busy())
        };
        let sent = change(play);
        match &sent {
            Ok(()) => play.under_way += 1,
            Err(_) => (play.drives, play.levels, play.options.scale, play.seq) = before,
        }
        sent
    }

    /// Passes on the result of an update, or the end of a play.
    pub(in crate::daemon) fn follow(&mut self, event: &StreamEvent) {
        match event {
            StreamEvent::LiveUpdated(update) => {
                let Some(play) = self.plays.get_mut(&update.id) else { return };
                play.under_way = play.under_way.saturating_sub(1);
                play.answer(answer(update));
            }
            StreamEvent::PlayEnded { id, outcome } => {
                let Some(play) = self.plays.remove(id) else { return };
                let ended = outcome.cause.clone().or_else(|| Some(EndCause::Other("done".into())));
                play.answer(LiveAnswer { ended, ..LiveAnswer::default() });
            }
            _ => {}
        }
    }
}

fn over() -> Problem {
    Problem::new(Code::NotFound, "the live play is over: the message changed nothing")
}

fn answer(update: &LiveUpdate) -> LiveAnswer {
    let seq = Some(update.number);
    match update.result {
        LiveResult::Applied(Applied { received, replaced, motors, repeats, refused }) => {
            let ticks = motors.iter().map(|tick| tick.map(|tick| tick.0)).collect();
            let (received_tick, from_tick) = (received.0, replaced.0);
            let applied = LiveApplied { received_tick, from_tick, ticks, repeats, refused };
            LiveAnswer { seq, applied: Some(applied), ..LiveAnswer::default() }
        }
        LiveResult::Merged { into } => LiveAnswer { seq, merged_into: Some(into), ..LiveAnswer::default() },
        LiveResult::Waiting | LiveResult::Over => LiveAnswer::refused(
            seq,
            Problem::new(Code::NotFound, "the live play is over: the update changed nothing"),
        ),
    }
}
