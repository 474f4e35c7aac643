//! Previews of patterns: what pins and afferents do.
//!
//! Bounds: an answer takes [`TIMEOUT`] beside the time in which other previews are computed; a waiting client takes a place among those that wait.

use crate::daemon::core::runtime::{OTHERS, computing};
use crate::daemon::jobs::preview::begin;
use crate::daemon::net::answer::{Answer, PathPart, json_response, path};
use crate::daemon::net::app::Call;
use crate::daemon::patterns::find;
use crate::render_process::{Job, Preview};
use axum::http::Uri;
use axum::response::Response;
use meissner_api::{Code, MAX_PREVIEW_FROM_S, MAX_PREVIEW_S, Problem};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::timeout;

/// How long a preview may be computed. It takes less than a second, but a busy machine gives its process little time.
const TIMEOUT: Duration = Duration::from_secs(30);
/// The largest file of a pattern, bytes: it fits on a line to the process.
const MAX_PATTERN: usize = 4 << 20;
/// The shortest preview, and the one without `seconds`, s.
const LEAST_S: f64 = 0.001;
const SECONDS: f64 = 1.0;

pub(in crate::daemon) async fn show(Call { app, by }: Call, name: PathPart, uri: Uri) -> Answer<Response> {
    let (name, (from_s, seconds)) = (path(name)?, piece(uri.query().unwrap_or_default())?);
    let _waits = app.waiting_place(by.peer())?;
    let job = {
        let (stored, _place) = find(Arc::clone(&app.store), &app.engine, &OTHERS, &name, None).await?;
        if stored.text.len() > MAX_PATTERN {
            let detail = format!(
                "the pattern's file has more than {MAX_PATTERN} bytes: `meissner simulate` and `meissner displacement` take it"
            );
            return Err(Problem::new(Code::TooLarge, detail).into());
        }
        let job = move || {
            let pattern = String::from_utf8_lossy(&stored.text).into_owned();
            let preview = Preview { pattern, sha256: stored.sha256, from_s, seconds };
            Job::preview(preview, stored.pattern.array())
        };
        computing(job).await?
    };
    let (mut running, _place) = begin(job).await?;
    let late = |_| {
        let seconds = TIMEOUT.as_secs();
        let detail =
            format!("the preview takes longer than {seconds} s: take an earlier piece, or a shorter one");
        Problem::new(Code::Timeout, detail)
    };
    let result = timeout(TIMEOUT, running.result()).await.map_err(late)?;
    Ok(json_response(result.map_err(|detail| Problem::new(Code::Store, detail))?))
}

/// The piece that a query asks for: its beginning and length, s.
fn piece(query: &str) -> Result<(f64, f64), Problem> {
    let (mut from_s, mut seconds) = (0.0, SECONDS);
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        let number = |name: &str| pair.strip_prefix(name).and_then(|number| number.parse::<f64>().ok());
        let within = |number: &f64, least: f64, most: f64| (least..=most).contains(number);
        if let Some(number) = number("from_s=").filter(|number| within(number, 0.0, MAX_PREVIEW_FROM_S)) {
            from_s = number;
        } else if let Some(number) =
            number("seconds=").filter(|number| within(number, LEAST_S, MAX_PREVIEW_S))
        {
            seconds = number;
        } else {
            let pair: String = pair.chars().take(100).collect();
            let detail = format!(
                "the query `{pair}`: must be `from_s=` and 0 to {MAX_PREVIEW_FROM_S}, or `seconds=` and {LEAST_S} to {MAX_PREVIEW_S}"
            );
            return Err(Problem::new(Code::BadRequest, detail));
        }
    }
    Ok((from_s, seconds))
}
