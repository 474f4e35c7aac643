//! Ends a command's play when a signal ends the command: Ctrl-C, SIGTERM, or SIGHUP of a closed terminal.
//!
//! It stops the display as `meissner stop` does. A killed command cannot do so; then its silence disarms the motors.
//!
//! Invariant: the command sends no order after its stop.

use super::arguments::ClientOptions;
use super::gate::Gate;
use super::output::tell;
use crate::daemon;
use anyhow::Result;
use meissner_client::{Client, ClientError};
use serde_json::{Value, json};
use std::process;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use tokio::signal::unix::{SignalKind, signal};

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Ending {
    gate: Arc<Gate>,
    over: Arc<AtomicBool>,
}

impl Ending {
    /// Stops the display at a signal from now on, and ends this process with 128 and the signal's number.
    pub(super) fn listen(options: &ClientOptions) -> Result<Self> {
        let ending = Self::default();
        let (gate, over) = (Arc::clone(&ending.gate), Arc::clone(&ending.over));
        let mut client = options.client()?;
        on_signals(move |number| {
            let said = if over.load(Ordering::Relaxed) {
                "the play is over: see `meissner receipt`".to_owned()
            } else {
                match gate.stop(|| stop(&mut client)) {
                    Ok(_) => "stopped: see `meissner receipt`".to_owned(),
                    Err(error) => format!("not stopped: {error}"),
                }
            };
            tell(&said);
            process::exit(128 + number);
        })?;
        Ok(ending)
    }

    /// Sends an order with `send`. If the display is being stopped, it waits until the process ends.
    pub(super) fn order<T>(&self, send: impl FnOnce() -> Result<T, ClientError>) -> Result<T, ClientError> {
        self.gate.order(send).unwrap_or_else(|| Gate::wait_for_end())
    }

    /// Notes that the play is over: a signal no longer stops the display, and a play that a signal has cut is not reported.
    pub(super) fn set_over(&self) {
        self.gate.wait_if_stopping();
        self.over.store(true, Ordering::Relaxed);
    }
}

/// Stops the display.
fn stop(client: &mut Client) -> Result<Value, ClientError> {
    client.post("/v1/stop", &json!({}))
}

/// Calls `work` at every Ctrl-C from now on, on a separate thread.
pub(super) fn on_interrupt(mut work: impl FnMut() + Send + 'static) -> Result<()> {
    on([SignalKind::interrupt()], move |_| work())
}

/// Calls `work` with the number of each signal that tells a command to end from now on, on a separate thread.
pub(super) fn on_signals(work: impl FnMut(i32) + Send + 'static) -> Result<()> {
    on([SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()], work)
}

fn on<const N: usize>(kinds: [SignalKind; N], mut work: impl FnMut(i32) + Send + 'static) -> Result<()> {
    let runtime = daemon::runtime()?;
    let (sender, mut signals) = tokio::sync::mpsc::channel(N);
    for kind in kinds {
        let mut source = runtime.block_on(async { signal(kind) })?;
        let sender = sender.clone();
        runtime.spawn(async move {
            while source.recv().await.is_some() && sender.send(kind.as_raw_value()).await.is_ok() {}
        });
    }
    thread::Builder::new().name("interrupt".into()).spawn(move || {
        while let Some(number) = runtime.block_on(signals.recv()) {
            work(number);
        }
    })?;
    Ok(())
}
