//! Reads the file of the access tokens again when another daemon has changed it.
//!
//! A request that shows an access token waits until the file was checked, for [`PATIENCE`] at most. So if one daemon revokes a
//! token, the others refuse it at its next use. For running plays and open streams, a thread checks the file every second while
//! there are tokens, and reports changes to the daemon.
//!
//! Invariant: only this thread waits for the disk. If the disk hangs, the last known tokens stay valid.

use crate::daemon::network::tokens::TokenStore;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use std::io;
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::Duration;
use tokio::sync::oneshot;

/// How often the thread checks the file by itself.
const EVERY: Duration = Duration::from_secs(1);
/// How long a request waits for a disk.
const PATIENCE: Duration = Duration::from_secs(1);
/// The most requests that wait; further ones use the last known tokens.
const WAITING: usize = 256;

/// The channel to the thread, once it runs; the thread ends when this is dropped.
#[derive(Debug, Default)]
pub(super) struct Refresher(OnceLock<Sender<oneshot::Sender<()>>>);

impl Refresher {
    /// Starts the thread, if these tokens have a file. It calls `changed` after it has read other tokens than before.
    pub(super) fn watch(
        &self,
        tokens: &Arc<TokenStore>,
        changed: impl Fn() + Send + 'static,
    ) -> io::Result<()> {
        if !tokens.has_file() {
            return Ok(());
        }
        let (sender, requests) = bounded(WAITING);
        let tokens = Arc::clone(tokens);
        thread::Builder::new().name("tokens".into()).spawn(move || work(&tokens, &requests, changed))?;
        // It is started once.
        let _ = self.0.set(sender);
        Ok(())
    }

    /// Waits until the tokens are those of the file as it is now.
    pub(super) async fn refresh(&self) {
        let Some(sender) = self.0.get() else { return };
        let (done, is_done) = oneshot::channel();
        if sender.try_send(done).is_ok() {
            // An error means that the thread has ended, with the daemon.
            let _ = tokio::time::timeout(PATIENCE, is_done).await;
        }
    }
}

fn work(tokens: &TokenStore, requests: &Receiver<oneshot::Sender<()>>, changed: impl Fn()) {
    loop {
        let first = if tokens.list().is_empty() {
            // Without tokens no right can end, so only wait for requests.
            requests.recv().map(Some).map_err(|_| ())
        } else {
            match requests.recv_timeout(EVERY) {
                Ok(first) => Ok(Some(first)),
                Err(RecvTimeoutError::Timeout) => Ok(None),
                Err(RecvTimeoutError::Disconnected) => Err(()),
            }
        };
        let Ok(first) = first else { return };
        // Answer all requests that came before this check.
        let waiting: Vec<_> = first.into_iter().chain(requests.try_iter()).collect();
        if tokens.refresh() {
            changed();
        }
        for done in waiting {
            // The client may be gone.
            let _ = done.send(());
        }
    }
}
