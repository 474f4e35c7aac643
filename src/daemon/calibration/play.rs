//! Plays of a calibration: begins a plan's play, open loop, whose measured bursts are fitted at its end.

use crate::daemon::calibration::stored::{CalibrationRun, no_file};
use crate::daemon::core::engine::Engine;
use crate::daemon::core::runtime::PLAYS;
use crate::daemon::core::state::State;
use crate::daemon::plays::begin;
use crate::daemon::plays::begin::Compiled;
use crate::daemon::sessions::caller::Asker;
use crate::receipts::refusal;
use crate::store::Stored;
use meissner_api::{Code, Item, Order, PlayAccepted, Problem, Terms};
use meissner_array::strokes::Surplus;
use meissner_stream::calibrate::Plan;
use meissner_stream::queues::CommandError;
use std::future::ready;

/// Begins a plan's play and waits until the streamer accepts it. With `laser` nothing is measured here.
pub(in crate::daemon) async fn calibrate(
    engine: &Engine,
    by: &Asker,
    plan: Plan,
    laser: bool,
    session: Option<&str>,
) -> Result<PlayAccepted, Problem> {
    if !laser && engine.lock().calibration.file.is_none() {
        return Err(no_file());
    }
    let stored = Stored::made(plan.pattern());
    let item = Item::of(stored.pattern.name());
    let order = Order::new(item, Terms { open_loop: true, ..Terms::default() });
    let (settings, reach) = {
        let state = engine.lock();
        (state.settings, state.reach(true))
    };
    if settings.lower_stop.is_some() {
        let detail =
            "down bursts end at the lower stop, so their gain cannot be measured: calibrate without the stop";
        return Err(Problem::new(Code::LowerStop, detail));
    }
    let basis = (settings, Surplus::None, reach);
    let compiled =
        Compiled::of_order(&order, basis, by.peer(), &PLAYS, |_, _| ready(Ok((stored.clone(), ())))).await?;
    // The plan is made anew for each request; the session record needs no text of it.
    let compiled = Compiled { texts: Vec::new(), ..compiled };
    let check = |state: &mut State| {
        state.forget_unanswered();
        state.check_not_calibrating()?;
        state.session_of_play(session)?;
        let device = state.plays.receipts.device().ok_or_else(|| refusal(CommandError::NoDevice))?;
        if !laser && !device.telemetry {
            let detail = "the device has no telemetry: calibrate with a laser, `meissner calibrate --plan`";
            return Err(Problem::new(Code::NoTelemetry, detail));
        }
        if !state.plays.receipts.is_idle() {
            return Err(refusal(CommandError::Playing));
        }
        Ok(())
    };
    let sent = |state: &mut State, id| {
        if !laser {
            state.calibration.running = Some(CalibrationRun::new(id, by.caller.clone(), plan));
        }
    };
    begin::begin(engine, by, compiled, check, sent).await
}
