//! Request bodies, read within bounds of size and time.

use axum::body::Body;
use http_body_util::BodyExt;
use meissner_api::{Code, Problem};
use std::time::Duration;
use tokio::time::{Instant, timeout_at};

/// How long a body may take, at most.
const TIMEOUT: Duration = Duration::from_secs(10);
/// How long it may take beside the time for its bytes.
const GRACE: Duration = Duration::from_secs(2);
/// The least rate, bytes/s: what the grace leaves of [`TIMEOUT`] suffices for the longest body.
const RATE: u32 = 128 << 10;
/// Most bytes of a command's body. Commands are parsed on the runtime's only thread: they must be small.
const MAX_COMMAND: usize = 16 << 10;
/// Most bytes read of a body that is too large, so that its sender reaches the answer.
const MAX_SKIPPED: usize = 32 << 20;

/// Reads a command's body.
pub(super) async fn read_command(body: Body) -> Result<Vec<u8>, Problem> {
    read(body, MAX_COMMAND).await
}

/// How long a body may take of which so many bytes have come.
fn allowed(length: usize) -> Duration {
    let bytes = u32::try_from(length).unwrap_or(u32::MAX);
    (GRACE + Duration::from_secs(1) * bytes / RATE).min(TIMEOUT)
}

/// Reads a body of at most `max` bytes.
pub(super) async fn read(mut body: Body, max: usize) -> Result<Vec<u8>, Problem> {
    let begun = Instant::now();
    let (mut bytes, mut length) = (Vec::new(), 0);
    // A frame that is there is taken, however late the daemon comes to it.
    while let Some(frame) = timeout_at(begun + allowed(length), body.frame()).await.map_err(|_| slow())? {
        let frame =
            frame.map_err(|error| Problem::new(Code::BadRequest, format!("the body broke off: {error}")))?;
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
}

fn slow() -> Problem {
    let (grace, rate, most) = (GRACE.as_secs(), RATE >> 10, TIMEOUT.as_secs());
    let detail = format!(
        "the body did not arrive within {grace} s and 1 s for each {rate} KiB, {most} s at most: send it faster"
    );
    Problem::new(Code::Slow, detail)
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::stream;
    use std::convert::Infallible;

    /// A body that comes in pieces of so many bytes, one every 100 ms of virtual time: when it ended, s, and how.
    async fn read_pieces(piece: usize, pieces: usize) -> (f64, Result<usize, String>) {
        let begun = Instant::now();
        let sent = stream::unfold(0, move |sent| async move {
            tokio::time::sleep(Duration::from_millis(100)).await;
            (sent < pieces).then(|| (Ok::<_, Infallible>(vec![0; piece]), sent + 1))
        });
        let read = read(Body::from_stream(sent), 1 << 20).await;
        (begun.elapsed().as_secs_f64(), read.map(|bytes| bytes.len()).map_err(|problem| problem.code))
    }

    #[test]
    fn a_body_has_a_least_rate() {
        crate::daemon::runtime().unwrap().block_on(async {
            tokio::time::pause();
            // 200 KiB/s, and 1 KiB/s that ends within the grace.
            for (piece, pieces) in [(20 << 10, 50), (100, 18)] {
                assert_eq!(read_pieces(piece, pieces).await.1, Ok(piece * pieces));
            }
            // A byte at a time keeps the daemon as long as no byte at all.
            for (piece, pieces, most_s) in
                [(1, 1000, 2.1), (0, 1000, 2.1), (4 << 10, 1000, 3.2), (11 << 10, 1000, 10.1)]
            {
                let (took_s, read) = read_pieces(piece, pieces).await;
                assert_eq!(read, Err("slow-request".to_owned()), "{piece} bytes");
                assert!(took_s <= most_s, "{piece} bytes: {took_s} s");
            }
        });
    }
}
