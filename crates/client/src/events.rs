//! The daemon's events, on a separate connection: [`Events`].

use crate::connection::{MAX_ANSWER, hung_up};
use crate::endpoint::Place;
use crate::error::ClientError;
use http_body_util::BodyExt;
use hyper::body::Incoming;
use meissner_api::Event;
use std::time::Duration;
use tokio::runtime::Runtime;

/// A stream of events.
#[derive(Debug)]
pub struct Events {
    place: Place,
    runtime: Runtime,
    body: Incoming,
    rest: Vec<u8>,
}

impl Events {
    pub(crate) const fn new(place: Place, runtime: Runtime, body: Incoming) -> Self {
        Self { place, runtime, body, rest: Vec::new() }
    }

    /// Waits for the next event; `None` when the daemon ends the stream.
    ///
    /// # Errors
    /// [`ClientError::Timeout`] after `timeout` without an event, [`ClientError::HungUp`] if the connection broke,
    /// [`ClientError::BadAnswer`] if something else than an event came.
    pub fn next(&mut self, timeout: Option<Duration>) -> Result<Option<Event>, ClientError> {
        loop {
            while let Some(end) = self.rest.windows(2).position(|pair| pair == b"\n\n") {
                let block: Vec<u8> = self.rest.drain(..end + 2).collect();
                let lines = block.split(|&byte| byte == b'\n');
                let data = lines.filter_map(|line| line.strip_prefix(b"data:")).collect::<Vec<_>>().concat();
                // A block without data is a comment that keeps the connection alive.
                if !data.is_empty() {
                    let event = serde_json::from_slice(&data);
                    return event.map(Some).map_err(|error| self.bad_answer(error.to_string()));
                }
            }
            if self.rest.len() > MAX_ANSWER {
                return Err(self.bad_answer("an event without end".to_owned()));
            }
            let frame = async {
                let frame = self.body.frame();
                match timeout {
                    Some(timeout) => tokio::time::timeout(timeout, frame).await,
                    None => Ok(frame.await),
                }
            };
            match self.runtime.block_on(frame) {
                Err(_) => {
                    let timeout = timeout.unwrap_or_default();
                    return Err(ClientError::Timeout { place: self.place.clone(), timeout });
                }
                Ok(None) => return Ok(None),
                Ok(Some(Err(source))) => return Err(hung_up(&self.place, Some(source))),
                Ok(Some(Ok(frame))) => self.rest.extend(frame.data_ref().into_iter().flatten()),
            }
        }
    }

    fn bad_answer(&self, what: String) -> ClientError {
        ClientError::BadAnswer { place: self.place.clone(), what }
    }
}
