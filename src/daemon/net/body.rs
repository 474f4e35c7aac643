//! Request bodies, read within bounds of size and time.

use axum::body::Body;
use http_body_util::BodyExt;
use meissner_api::{Code, MAX_BODY, Problem};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::sync::{Semaphore, SemaphorePermit};
use tokio::time::{Instant, timeout};

/// How long a body may take, at most.
const TIMEOUT: Duration = Duration::from_secs(10);
/// How long it may take beside the time for its bytes.
const GRACE: Duration = Duration::from_secs(2);
/// The lowest accepted rate, bytes/s: the longest body takes [`TIMEOUT`] minus the grace.
const RATE: u32 = 128 << 10;
/// How long to wait for the body of a request that is refused.
const DISCARDED: Duration = Duration::from_millis(100);
/// How often the daemon checks whether a body is late.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// The places for large bodies that are orders.
pub(in crate::daemon) static ORDERS: Files = Files::new(4);
/// The places for large bodies of readers: no order waits for them.
pub(in crate::daemon) static READS: Files = Files::new(1);
/// How long they wait.
const FILES_TIMEOUT: Duration = Duration::from_secs(10);
/// How long a body that is not complete keeps its place while others wait for one.
const HELD: Duration = Duration::from_millis(1500);
/// A body up to this size needs no place, bytes.
const SMALL: usize = 64 << 10;
/// Most bytes of a command's body. Commands are parsed on the runtime's only thread: they must be small.
pub(in crate::daemon) const MAX_COMMAND: usize = 16 << 10;
/// Most bytes read of a body that is too large, so that its sender gets to reading the answer.
const MAX_SKIPPED: usize = 96 << 20;

/// Reads a command's body.
pub(in crate::daemon) async fn read_command(body: Body) -> Result<Vec<u8>, Problem> {
    read(body, MAX_COMMAND).await
}

/// Reads the body of a request that is refused, for a moment: its client then finds the answer, and not a closed connection.
pub(in crate::daemon) async fn discard(body: Body) {
    let _ = timeout(DISCARDED, read_command(body)).await;
}

/// How long a body may take of which `length` bytes have come.
fn allowed(length: usize) -> Duration {
    let bytes = u32::try_from(length).unwrap_or(u32::MAX);
    (GRACE + Duration::from_secs(1) * bytes / RATE).min(TIMEOUT)
}

/// Reads a body of at most `max` bytes.
pub(in crate::daemon) async fn read(body: Body, max: usize) -> Result<Vec<u8>, Problem> {
    collect(body, max, usize::MAX, &ORDERS, &mut Places::default()).await
}

/// Reads a body as large as a file. A large one takes a place `among` these until the returned places are dropped.
pub(in crate::daemon) async fn read_file(
    body: Body,
    max: usize,
    among: &'static Files,
) -> Result<(Vec<u8>, Places), Problem> {
    let mut places = Places::default();
    let bytes = collect(body, max, SMALL, among, &mut places).await?;
    Ok((bytes, places))
}

/// Places for large bodies that arrive or are processed.
#[derive(Debug)]
pub(in crate::daemon) struct Files {
    /// Each holds a file, and further ones wait.
    places: Semaphore,
    /// For a body that is larger than any without packed samples: one at a time.
    packed: Semaphore,
    /// Bodies that wait.
    waiting: AtomicUsize,
}

impl Files {
    const fn new(places: usize) -> Self {
        let [places, packed] = [Semaphore::const_new(places), Semaphore::const_new(1)];
        Self { places, packed, waiting: AtomicUsize::new(0) }
    }

    async fn place_among(&self, places: &'static Semaphore) -> Result<Place, Problem> {
        let busy = || Problem::new(Code::Busy, "too many files are in work: try again in a moment");
        let _waits = Waits::new(&self.waiting);
        let place = timeout(FILES_TIMEOUT, places.acquire()).await;
        place.ok().and_then(Result::ok).ok_or_else(busy)
    }
}

/// A place of a large body.
pub(in crate::daemon) type Place = SemaphorePermit<'static>;

/// The places of a body.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Places {
    file: Option<Place>,
    packed: Option<Place>,
}

/// Counts a body that waits, until it is dropped, for example when the client hangs up.
struct Waits<'a>(&'a AtomicUsize);

impl<'a> Waits<'a> {
    fn new(waiting: &'a AtomicUsize) -> Self {
        waiting.fetch_add(1, Ordering::Relaxed);
        Self(waiting)
    }
}

impl Drop for Waits<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Waits for a place among those of [`ORDERS`].
pub(in crate::daemon) async fn file_place() -> Result<Place, Problem> {
    ORDERS.place_among(&ORDERS.places).await
}

/// Reads a body; takes a place when it has more than `small` bytes.
async fn collect(
    mut body: Body,
    max: usize,
    small: usize,
    among: &'static Files,
    places: &mut Places,
) -> Result<Vec<u8>, Problem> {
    let (mut begun, mut held) = (Instant::now(), None);
    let (mut bytes, mut length) = (Vec::new(), 0);
    loop {
        // A frame that has arrived is taken, even if the daemon reads it late.
        let frame = timeout(LOOK_EVERY, body.frame()).await;
        let Ok(frame) = frame else {
            let is_wanted = among.waiting.load(Ordering::Relaxed) > 0;
            let held_too_long = held.is_some_and(|since: Instant| is_wanted && since.elapsed() >= HELD);
            if held_too_long || begun.elapsed() >= allowed(length) {
                return Err(slow());
            }
            continue;
        };
        let Some(frame) = frame else { break };
        let frame =
            frame.map_err(|error| Problem::new(Code::BadRequest, format!("the body broke off: {error}")))?;
        let data = frame.into_data().unwrap_or_default();
        length += data.len();
        if length <= max {
            bytes.extend_from_slice(&data);
        } else if length > MAX_SKIPPED {
            break;
        }
        if begun.elapsed() >= allowed(length) {
            return Err(slow());
        }
        let needs = [
            (length > small && places.file.is_none(), &among.places, &mut places.file),
            (length > MAX_BODY.max(small) && places.packed.is_none(), &among.packed, &mut places.packed),
        ];
        for (_, all, place) in needs.into_iter().filter(|(needed, ..)| *needed) {
            let asked = Instant::now();
            *place = Some(among.place_among(all).await?);
            // The client does not count as slow while the daemon was busy.
            begun += asked.elapsed();
            held = Some(Instant::now());
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

    /// Reads a body that comes in pieces of `piece` bytes, one every 100 ms of virtual time: when it ended, s, and the result.
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
            // Sending single bytes keeps the daemon waiting no longer than sending nothing.
            for (piece, pieces, most_s) in
                [(1, 1000, 2.3), (0, 1000, 2.3), (4 << 10, 1000, 3.4), (11 << 10, 1000, 10.3)]
            {
                let (took_s, read) = read_pieces(piece, pieces).await;
                assert_eq!(read, Err("slow-request".to_owned()), "{piece} bytes");
                assert!(took_s <= most_s, "{piece} bytes: {took_s} s");
            }
        });
    }
}
