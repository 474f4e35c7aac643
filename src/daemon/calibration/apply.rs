//! The daemon's calibration: reads the stored gains when a device connects, fits a plan that was played, and stores the result.
//!
//! The event `calibrated` reports the result.
//!
//! Invariant: only a calibration of the connected device is stored and used.

use crate::daemon::calibration::stored::{
    CalibrationRun, StoredCalibration, no_file, read, report, with_other_motors, write,
};
use crate::daemon::core::engine::Engine;
use crate::daemon::core::log_lines;
use crate::daemon::core::runtime::blocking;
use crate::daemon::core::state::State;
use crate::daemon::sessions::caller::{Asker, Caller};
use crate::daemon::sessions::right;
use crate::daemon::sessions::rights::going_on;
use crate::receipts::refusal;
use meissner_api::{Code, Event, Problem, Route};
use meissner_input::message::quote;
use meissner_stream::calibrate::Calibration;
use meissner_stream::queues::{Command, CommandError};
use std::sync::{Arc, PoisonError};
use tracing::{error, info, warn};

/// Reads the stored calibration for a device (`None`: no device is connected). Logs a new problem with it.
pub(in crate::daemon) fn load_calibration(engine: &Engine, identity: Option<&str>) {
    // Do not read while an import reads and then writes the file.
    let _one = engine.calibration_file.lock().unwrap_or_else(PoisonError::into_inner);
    let (array, file) = {
        let state = engine.lock();
        (state.settings.array, state.calibration.file.clone())
    };
    let (found, bad) = match read(array, file.as_deref(), identity) {
        Ok(stored) => (Ok(stored), false),
        Err((why, bad)) => (Err(why), bad),
    };
    let why = |found: &Result<StoredCalibration, String>| match found {
        Ok(stored) => stored.unused.clone(),
        Err(why) => Some(why.clone()),
    };
    let old = {
        let mut state = engine.lock();
        state.calibration.identity = identity.unwrap_or_default().to_owned();
        std::mem::replace(&mut state.calibration.stored, found.clone())
    };
    match why(&found) {
        why_not if why_not == why(&old) => {}
        Some(why_not) if bad || identity.is_some() && found.is_ok() => warn!("{why_not}"),
        Some(_) => {}
        None => {
            let motors = found.map_or(0, |stored| stored.calibration.motors().len());
            info!("{motors} motors are calibrated");
        }
    }
}

/// Stores a calibration that was measured elsewhere, and uses it. Returns the document of `GET /v1/calibration`.
pub(in crate::daemon) async fn import_calibration(
    engine: &Arc<Engine>,
    by: &Asker,
    new: Calibration,
) -> Result<Vec<u8>, Problem> {
    let changed = Arc::clone(engine);
    let used = right::changing(engine, by, move || {
        add_calibration(&changed, new, |state| {
            if state.plays.receipts.device().is_none() {
                return Err(refusal(CommandError::NoDevice));
            }
            if state.calibration.running.is_some() || !state.plays.receipts.is_idle() {
                return Err(refusal(CommandError::Playing));
            }
            Ok(())
        })?;
        calibration_json(&changed)
    });
    let used = used.await?;
    engine.changed.notify_one();
    used
}

/// Adds a calibration of the connected device to the stored one, in the file and in use. Only one at a time, so that each keeps
/// the motors of the one before it. Waits for the disk.
fn add_calibration(
    engine: &Engine,
    new: Calibration,
    check: impl FnOnce(&State) -> Result<(), Problem>,
) -> Result<(), Problem> {
    let _one = engine.calibration_file.lock().unwrap_or_else(PoisonError::into_inner);
    let same_device = |state: &State, new: &Calibration| {
        let (its, array) = (new.array(), state.settings.array);
        if its != array {
            let detail =
                format!("the calibration is for the array {}, and this one is {}", its.name(), array.name());
            return Err(Problem::new(Code::OtherArray, detail));
        }
        if !new.is_of_description() {
            let detail = format!(
                "the calibration is for another description of the array {}: calibrate again",
                array.name()
            );
            return Err(Problem::new(Code::OtherArray, detail));
        }
        let (found, device) = (&new.provenance().identity, &state.calibration.identity);
        if found == device {
            return Ok(());
        }
        let (found, device) = (quote(found), quote(device));
        let detail = format!(
            "`provenance.identity` is {found}, but the connected device is {device}: connect the device that was measured"
        );
        Err(Problem::new(Code::BadRequest, detail))
    };
    let (file, all) = {
        let state = engine.lock();
        check(&state)?;
        same_device(&state, &new)?;
        let file = state.calibration.file.clone().ok_or_else(no_file)?;
        (file, Arc::new(with_other_motors(new, state.calibration.stored.as_ref().ok())))
    };
    write(&file, &all).map_err(|problem| Problem::new(Code::Store, problem))?;
    let mut state = engine.lock();
    // Another device may have connected meanwhile; it then reads the file itself, after this.
    same_device(&state, &all)?;
    let reach = |state: &State| [false, true].map(|open_loop| state.reach(open_loop));
    let before = reach(&state);
    let sent = state.commands.set_gains(all.gains());
    state.calibration.gains_set = true;
    state.calibration.stored = Ok(StoredCalibration { calibration: all, unused: None });
    // How far running and waiting plays may take pins was checked with the gains from before.
    let farther =
        before.iter().flatten().zip(reach(&state).iter().flatten()).any(|(before, now)| now > before);
    if farther && !state.plays.receipts.is_idle() {
        let _ = state.commands.send_unanswered(Command::Stop);
    }
    let busy = "it is stored, but too many commands wait: the daemon uses it from the next connection on";
    sent.map_err(|_| Problem::new(Code::Busy, busy))
}

/// The document of `GET /v1/calibration`. It takes milliseconds for a long file.
pub(in crate::daemon) fn calibration_json(engine: &Engine) -> Result<Vec<u8>, Problem> {
    let (array, file, stored) = {
        let state = engine.lock();
        (state.settings.array, state.calibration.file.clone(), state.calibration.stored.clone())
    };
    Ok(serde_json::to_vec(&report(array, file.as_ref(), &stored)?).unwrap_or_default())
}

/// If this play was a calibration and is over, fits and stores it.
pub(in crate::daemon) fn finish_calibration(engine: &Arc<Engine>, id: u64) {
    let (run, receipt, device, identity) = {
        let mut state = engine.lock();
        let receipt = state.plays.receipts.receipt(id).filter(|receipt| receipt.state.is_over()).cloned();
        let Some(receipt) = receipt else { return };
        let running = state.calibration.running.as_mut().filter(|running| running.id == id);
        let Some(run) = running.map(CalibrationRun::take) else { return };
        (run, receipt, state.plays.receipts.device(), state.calibration.identity.clone())
    };
    let engine = Arc::clone(engine);
    let work = move || {
        let fitted = device.ok_or_else(|| "the device is gone: nothing was stored".to_owned());
        let fitted = fitted.and_then(|device| run.fit(&receipt, &device, &identity));
        store_calibration(&engine, id, &run.by, fitted);
    };
    tokio::spawn(async move {
        if let Err(problem) = blocking(work).await {
            error!("calibration: {}", problem.detail);
        }
    });
}

/// Stores a calibration that this client has ordered, uses it and publishes the result, or publishes why there is none.
fn store_calibration(engine: &Engine, id: u64, by: &Caller, fitted: Result<Calibration, String>) {
    let still_may =
        |state: &State| state.check_right(by, going_on(Route::Calibrate.access())).map_err(|no| no.problem);
    let motors = fitted.iter().flat_map(|new| new.motors().iter().map(|fit| fit.motor)).collect();
    let added =
        fitted.and_then(|new| add_calibration(engine, new, still_may).map_err(|problem| problem.detail));
    let mut state = engine.lock();
    state.calibration.running = None;
    let problem = added.err();
    let event = Event::Calibrated { id, motors, problem };
    state.publish(&event);
    drop(state);
    log_lines::log(engine, &event);
    engine.changed.notify_one();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::core::runtime::PLAYS;
    use crate::daemon::exposure::state::Exposure;
    use crate::daemon::live::play;
    use crate::daemon::plays::order;
    use crate::exposure::{Account, ParticipantLimits};
    use crate::store::Stored;
    use meissner_api::{Item, LiveDrive, LiveRequest, Order, Terms};
    use meissner_array::pattern::Pattern;
    use meissner_stream::Settings;
    use meissner_stream::calibrate::{Fit, MotorFit};
    use meissner_stream::queues::queues;
    use std::fs;
    use std::future::ready;
    use std::thread;

    /// Each import adds a motor; none is lost in the file or in use.
    #[test]
    fn imports_at_once_do_not_mix() {
        const MOTORS: u8 = 8;
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("calibration.toml");
        let (mut port, commands, _events) = queues().unwrap();
        let engine = Engine::new(
            commands,
            Settings::of(meissner_array::spec::Array::paper()),
            "mock".to_owned(),
            Some(file.clone()),
        );
        let array = meissner_array::spec::Array::paper();
        let of = |motor| {
            let provenance = meissner_stream::calibrate::laser_plan(array, motor, None, None)
                .unwrap()
                .provenance("mock", "1", "", "laser");
            let fit = Fit {
                slope_um_per_pulse: 0.14,
                slope_se_um_per_pulse: 0.001,
                offset_um: 0.0,
                relative_sd: 0.05,
                bursts: 70,
            };
            let fit = MotorFit { motor, up: fit, down: fit, up_points: vec![], down_points: vec![] };
            Calibration::new(array, vec![fit], provenance).unwrap()
        };
        thread::scope(|scope| {
            for motor in 0..MOTORS {
                let (engine, new) = (&engine, of(motor));
                scope.spawn(move || add_calibration(engine, new, |_| Ok(())).unwrap());
            }
        });
        let motors =
            |calibration: &Calibration| calibration.motors().iter().map(|fit| fit.motor).collect::<Vec<_>>();
        let all: Vec<u8> = (0..MOTORS).collect();
        let used = engine.lock().calibration.stored.clone().unwrap().calibration;
        assert_eq!(motors(&used), all);
        let kept = Calibration::parse(&fs::read_to_string(file).unwrap(), "file").unwrap();
        assert_eq!(motors(&kept), all);
        assert_eq!(std::iter::from_fn(|| port.pop()).count(), usize::from(MOTORS), "gains were set");
    }

    /// A low gain adds pulses, 30 % at most; in open loop a high gain takes pins farther. What was ordered before is stopped.
    #[test]
    fn a_calibration_takes_no_pin_above_the_amplitude() {
        let array = meissner_array::spec::Array::paper();
        let dir = tempfile::tempdir().unwrap();
        let (mut port, commands, _events) = queues().unwrap();
        let file = Some(dir.path().join("calibration.toml"));
        let engine = Arc::new(Engine::new(commands, Settings::of(array), "mock".to_owned(), file));
        let limits = ParticipantLimits { max_amplitude_um: 100.0, ..ParticipantLimits::NONE };
        engine.lock().exposure = Exposure::new(Account::new(limits));
        let runtime = crate::daemon::runtime().unwrap();
        let calibrate = |gain: f64| {
            let plan = meissner_stream::calibrate::laser_plan(array, 9, None, None).unwrap();
            let fit = Fit {
                slope_um_per_pulse: gain * array.motor().um_per_pulse,
                slope_se_um_per_pulse: 0.001,
                offset_um: 0.0,
                relative_sd: 0.05,
                bursts: 70,
            };
            let fit = MotorFit { motor: 9, up: fit, down: fit, up_points: vec![], down_points: vec![] };
            let new = Calibration::new(array, vec![fit], plan.provenance("mock", "1", "", "laser")).unwrap();
            add_calibration(&engine, new, |_| Ok(())).unwrap();
        };
        let play = |um: f64, open_loop| {
            let text = format!(
                "format = 1\nname = \"ramp\"\n[[ramp]]\nmotor = 9\nto_um = {um}\nrise_s = 0.02\nhold_s = 0.1\n"
            );
            let stored = Stored::made(Pattern::parse(&text, "ramp").unwrap());
            let order = Order::new(Item::of("ramp"), Terms { open_loop, ..Terms::default() });
            let find = |_, _| ready(Ok((stored.clone(), ())));
            let by = Asker { breaks: engine.lock().commands.breaks(), ..Asker::operator() };
            runtime.block_on(order::play(&engine, &by, &order, &PLAYS, find)).unwrap_err()
        };
        // Nothing answers the play that is sent.
        assert_eq!(play(100.0, false).code, "timeout");
        calibrate(0.6);
        let sent: Vec<_> = std::iter::from_fn(|| port.pop()).map(|request| request.command).collect();
        assert!(matches!(&sent[..], [Command::Play(_), Command::SetGains(_), Command::Stop]), "{sent:?}");
        for (gain, um, open_loop, reached_um) in
            [(0.6, 100.0, false, 130.0), (0.9, 95.0, false, 105.6), (1.3, 90.0, true, 117.0)]
        {
            calibrate(gain);
            let refused = play(um, open_loop);
            let says = format!(
                "`ramp` asks for {um} um, whose pulses reach {reached_um:.1} um with the calibration in use"
            );
            assert!(refused.code == "participant-limit" && refused.detail.contains(&says), "{refused:?}");
            assert_eq!(play(um, !open_loop).code, "timeout", "{gain}");
        }
        calibrate(0.6);
        let drive = LiveDrive { motor: 9, frequency_hz: 60.0, amplitude_um: 80.0, phase: 0.0 };
        let request = LiveRequest { drives: vec![drive], ..LiveRequest::default() };
        let by = Asker::operator();
        let live = play::start_live(&engine, &by, &request, None);
        let refused = runtime.block_on(live).unwrap_err();
        assert!(
            refused.detail.contains("`the live play` asks for 80 um, whose pulses reach 104.0 um"),
            "{refused:?}"
        );
    }
}
