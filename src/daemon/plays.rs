//! Plays on their way to the streamer: compiled, counted, given an id and put on record, then ordered.
//!
//! What is too much or makes no sense is refused here; whether the device can take it, the streamer says.
//!
//! Invariant: a play is in the record before the streamer can speak of it, and an id that was refused names the next one.

use super::calibrate::Calibrating;
use super::engine::{Engine, answer};
use crate::receipts::refusal;
use crate::session_record::Peer;
use crate::store::Stored;
use firmware_protocol::tick::Tick;
use meissner_api::Receipt;
use meissner_api::{Code, PlayRequest, Problem};
use meissner_array::strokes::Strokes;
use meissner_stream::Bandwidth;
use meissner_stream::calibrate::Plan;
use meissner_stream::queues::{At, Command, CommandError, Play};
use meissner_stream::time::HostInstant;
use std::sync::Arc;

impl Engine {
    /// CommandQueue a play and waits for its being taken.
    pub(super) async fn play(
        &self,
        request: &PlayRequest,
        stored: &Stored,
        who: Peer,
    ) -> Result<u64, Problem> {
        self.begin(request, stored, who, None).await
    }

    pub(super) async fn begin(
        &self,
        request: &PlayRequest,
        stored: &Stored,
        who: Peer,
        plan: Option<Plan>,
    ) -> Result<u64, Problem> {
        let strokes = Strokes::new(&stored.pattern, request.seconds)
            .map_err(|error| Problem::new(Code::BadRequest, format!("`seconds`: {error}")))?;
        // Beside another at the same tick, what came of both could not be told apart.
        if strokes.end() == Some(0) {
            let detail = "`seconds`: less than a tick of 1/85000 s, nothing would be played: ask for more";
            return Err(Problem::new(Code::BadRequest, detail));
        }
        self.check_boot(request.boot)?;
        // A long pattern has a hundred thousand strokes: orders of others must not wait for their counting.
        let settings = self.lock().settings;
        let counted =
            tokio::task::spawn_blocking(move || (Bandwidth::of(&strokes, &settings), strokes)).await;
        let (bandwidth, strokes) = counted.map_err(|_| {
            Problem::new(Code::Busy, "the pattern could not be counted: try again, and see the daemon's log")
        })?;
        let at = match (request.at_tick, request.at_ms) {
            (Some(tick), _) => At::Tick(Tick(tick)),
            (None, Some(ms)) => At::After(nanoseconds(ms)),
            (None, None) => At::Next,
        };
        let PlayRequest { late, replace, open_loop, .. } = *request;
        let (id, reply) = {
            let mut inner = self.lock();
            inner.forget(HostInstant::now());
            if inner.calibrating.is_some() {
                return Err(refusal(CommandError::Playing));
            }
            let device = inner.receipts.device();
            let telemetry = device.as_ref().is_some_and(|device| device.telemetry);
            if plan.is_some() {
                device.ok_or_else(|| refusal(CommandError::NoDevice))?;
                if !telemetry {
                    let detail =
                        "the device has no telemetry: calibrate on one that measures where its pins are";
                    return Err(Problem::new(Code::NoTelemetry, detail));
                }
                if !inner.receipts.is_idle() {
                    return Err(refusal(CommandError::Playing));
                }
            }
            inner.last_play += 1;
            let id = inner.last_play;
            inner.receipts.offer(Receipt::new(id, stored.pattern.name(), &stored.sha256, request.seconds));
            inner.calibrating = plan.map(|plan| Calibrating::new(id, plan));
            inner.players.insert(id, who);
            inner.unseen.insert(id, (Arc::new(stored.pattern.clone()), telemetry));
            let play = Box::new(Play { id, strokes, at, late, replace, open_loop, bandwidth });
            let sent = inner.send(Command::Play(play), Some(id));
            if sent.is_err() {
                inner.settle(id, false);
            }
            (id, sent?)
        };
        answer(reply).await.map(|()| id)
    }

    fn check_boot(&self, asked: Option<u32>) -> Result<(), Problem> {
        let now = self.lock().receipts.device().map(|device| device.boot);
        match (asked, now) {
            (Some(asked), Some(now)) if asked != now => {
                let detail =
                    format!("`boot` is {asked}, but the device has restarted as {now}: read its tick again");
                Err(Problem::new(Code::StaleBoot, detail))
            }
            _ => Ok(()),
        }
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked: 0 to an hour")]
fn nanoseconds(ms: f64) -> u64 {
    (ms * 1e6) as u64
}
