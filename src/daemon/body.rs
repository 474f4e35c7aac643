//! Request bodies, read within bounds of size and time.

use axum::body::Body;
use http_body_util::BodyExt;
use meissner_api::{Code, Problem};
use std::time::Duration;

/// How long a body may take.
const TIMEOUT: Duration = Duration::from_secs(10);
/// Most bytes of a command's body. Commands are parsed on the runtime's only thread: they must be small.
const MAX_COMMAND: usize = 16 << 10;
/// Most bytes read of a body that is too large, so that its sender reaches the answer.
const MAX_SKIPPED: usize = 32 << 20;

/// Reads a command's body.
pub(super) async fn read_command(body: Body) -> Result<Vec<u8>, Problem> {
    read(body, MAX_COMMAND).await
}

/// Reads a body of at most `max` bytes.
pub(super) async fn read(mut body: Body, max: usize) -> Result<Vec<u8>, Problem> {
    let collect = async {
        let (mut bytes, mut length) = (Vec::new(), 0);
        while let Some(frame) = body.frame().await {
            let frame = frame
                .map_err(|error| Problem::new(Code::BadRequest, format!("the body broke off: {error}")))?;
            let data = frame.into_data().unwrap_or_default();
            length += data.len();
            if length <= max {
                bytes.extend_from_slice(&data);
            } else if length > MAX_SKIPPED {
                break;
            }
        }
        if length > max {
            let detail = format!("the body is larger than {max} bytes: send less");
            return Err(Problem::new(Code::TooLarge, detail));
        }
        Ok(bytes)
    };
    let slow = |_| Err(Problem::new(Code::Slow, "the body did not arrive within 10 s: send it faster"));
    tokio::time::timeout(TIMEOUT, collect).await.unwrap_or_else(slow)
}
