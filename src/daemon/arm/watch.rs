//! Arms the motors for a client, and watches for its silence.
//!
//! Invariant: the watch begins when the device has armed, whether or not the client still waits for the answer.

use crate::daemon::arm::state::Silence;
use crate::daemon::core::engine::{Engine, TIMEOUT, answer};
use crate::daemon::core::state::State;
use crate::daemon::sessions::caller::{Asker, Caller, DAEMON};
use meissner_api::{Code, EndCause, Problem};
use meissner_stream::queues::Command;
use std::sync::Arc;
use std::time::Duration;
use tracing::warn;

/// How often a watch checks whether it is over, and how soon the daemon disarms again if the device did not take the command.
const AGAIN: Duration = Duration::from_secs(1);

/// Arms, by this command, for this client, which may then be silent as long as `silence` says.
pub(in crate::daemon) async fn arm(
    engine: &Arc<Engine>,
    by: &Asker,
    command: Command,
    silence: Silence,
) -> Result<(), Problem> {
    let timeout = engine.seek_timeout();
    let reply = engine.send(Some(by), command)?;
    let (engine, name, caller) = (Arc::clone(engine), engine.names.client(by.peer()), by.caller.clone());
    let work = async move {
        answer(reply, timeout).await?;
        let watch = {
            let mut state = engine.lock();
            // The motors may have been disarmed again.
            state.is_armed().then(|| state.armed.hold(caller, name, silence))
        };
        if let Some(number) = watch.filter(|_| silence != Silence::Unattended) {
            tokio::spawn(async move { watch_silence(&engine, number).await });
        }
        Ok(())
    };
    // On a separate task, because the client may hang up before the device has answered.
    let broken = |_| Problem::new(Code::ShuttingDown, "the daemon is ending: start it again");
    tokio::spawn(work).await.unwrap_or_else(|error| Err(broken(error)))
}

/// Takes back what this client has armed, and ends its plays, if the motors stay armed for another one. Returns whether they do.
pub(in crate::daemon) fn give_back(state: &mut State, caller: &Caller) -> bool {
    let stays = state.is_armed() && state.armed.give_back(caller);
    if stays {
        for id in state.rights.plays_of(caller) {
            state.cancel_play(id, EndCause::Disarm);
        }
    }
    stays
}

/// Stops and disarms when the client with this watch has been silent for too long.
async fn watch_silence(engine: &Engine, number: u64) {
    loop {
        let Some(left) = engine.lock().armed.until_silent(number) else { return };
        if !left.is_zero() {
            // A newer watch may have taken its place.
            tokio::time::sleep(left.min(AGAIN)).await;
            continue;
        }
        let disarmed = {
            let mut state = engine.lock();
            if !state.armed.is_silent(number) {
                continue;
            }
            if let Some(event) = state.armed.fall_silent(number) {
                state.publish(&event);
            }
            state.send(DAEMON, Command::Disarm, None)
        };
        let disarmed = match disarmed {
            Ok(reply) => answer(reply, TIMEOUT).await,
            Err(problem) => Err(problem),
        };
        match disarmed {
            Ok(()) => warn!("the client that armed was silent for too long: the motors are disarmed"),
            Err(problem) => {
                warn!("the client that armed was silent for too long, and disarming failed: {problem}");
            }
        }
        tokio::time::sleep(AGAIN).await;
    }
}
