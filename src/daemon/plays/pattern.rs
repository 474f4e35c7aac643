//! Plays of one pattern: compiles the pattern of a request, and begins the play.

use crate::daemon::engine::Engine;
use crate::daemon::plays::begin::Compiled;
use crate::daemon::plays::terms::{Terms, trigger};
use crate::daemon::state::NewPlay;
use crate::daemon::state::limits::check_limits;
use crate::daemon::system::runtime::PLAYS;
use crate::exposure::Vibration;
use crate::receipts::{Order, counts, fit};
use crate::session_record::Peer;
use crate::store::{MappedFrom, Stored};
use meissner_api::{Code, PlayAccepted, PlayRequest, Problem, Receipt};
use meissner_array::strokes::{StrokeOptions, Strokes, Surplus};
use meissner_stream::queues::Item;
use meissner_stream::{Bandwidth, Settings};
use std::sync::Arc;

impl Compiled {
    /// Compiles the pattern of a request.
    pub(super) async fn of_pattern(
        request: &PlayRequest,
        terms: &Terms,
        stored: Stored,
        (settings, surplus): (Settings, Surplus),
        client: Peer,
    ) -> Result<Self, Problem> {
        let (stored, mapped) = stored.on(settings.array, request.map)?;
        let scale = request.scale.unwrap_or(1.0);
        let options = StrokeOptions {
            surplus,
            fit: fit(request.fit),
            scale,
            ..StrokeOptions::lasting(request.seconds)
        };
        let bad = |error| Problem::new(Code::BadRequest, format!("`seconds`: {error}"));
        let strokes = Strokes::new(&stored.pattern, &options).map_err(bad)?;
        let order = Order::of(&stored.pattern, &options).map_err(bad)?;
        let name = stored.pattern.name();
        // Refuse an empty play: it would begin at the same tick as the next one, and their results could not be told apart.
        if let Some(why) = order.empty() {
            return Err(Problem::new(Code::Empty, format!("`{name}`: no stroke would be played: {why}")));
        }
        let receipt = terms.receipt(name, &stored.sha256, request.seconds);
        let mut receipt = Receipt { scale: Some(scale), ..receipt };
        let amplitudes = stored.pattern.drives().iter().map(|drive| drive.amplitude_um * scale);
        let largest = (amplitudes.fold(0.0, f64::max), request.pattern.clone());
        // Count on another thread: a long pattern has a hundred thousand strokes, and other commands must not wait.
        let (pattern, counted) = (Arc::clone(&stored.pattern), options.clone());
        let (fits, bandwidth, vibration, counts, strokes) = PLAYS
            .computing(move || {
                let end_s = strokes.end().map(|end| strokes.array().rate().ticks_to_seconds(end));
                let vibration = Vibration::of(&pattern, end_s);
                let bandwidth = Bandwidth::of(&strokes, &settings);
                let fits = check_limits(&strokes, &settings);
                (fits, bandwidth, vibration, counts(&pattern, &counted), strokes)
            })
            .await?;
        fits?;
        order.enter(&mut receipt, request.fit, counts);
        if let Some(MappedFrom { array, warnings }) = mapped {
            receipt.mapped_from = Some(array);
            receipt.warnings.splice(0..0, warnings);
        }
        let Stored { pattern, sha256, text, .. } = stored;
        Ok(Self {
            strokes: strokes.into(),
            items: vec![Item::new(trigger(request.trigger, settings.array.rate()))],
            live: None,
            bandwidth,
            settings,
            vibration,
            endless: request.endless,
            largest,
            new: NewPlay { receipt, items: None, predicted: Some((pattern, options)), client },
            texts: vec![(sha256, text)],
        })
    }
}

impl Engine {
    /// Begins a play of a pattern and waits until the streamer accepts it.
    pub(in crate::daemon) async fn play(
        &self,
        request: &PlayRequest,
        stored: Stored,
        client: Peer,
    ) -> Result<PlayAccepted, Problem> {
        let basis = self.compiles_for(request.boot)?;
        let terms = Terms::from(request);
        let compiled = Compiled::of_pattern(request, &terms, stored, basis, client).await?;
        let session = request.session.as_deref();
        self.begin(&terms, compiled, |state| state.check_before_play(session), |_, _| {}).await
    }
}
