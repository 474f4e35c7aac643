//! Runs the doctor's checks ([`crate::doctor`]) inside the daemon.
//!
//! They read files and wait for systemd, so they run on a blocking thread.
//!
//! Invariant: only one check runs at a time, even if its client has hung up. Requests that come meanwhile share the next one, so a
//! request waits for at most two checks, and at most for [`TIMEOUT`].

use crate::daemon::core::runtime::blocking;
use meissner_api::{Code, DoctorReport, Problem};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::Mutex;

/// Shortest time from one check to the next, so that a client that asks without a pause does not keep a processor busy with
/// `systemctl`.
const PERIOD: Duration = Duration::from_millis(250);

/// How long a request waits for its report. Two checks wait for systemd for at most 3 s each, so a longer wait means that something
/// else hangs.
const TIMEOUT: Duration = Duration::from_secs(10);

/// The last report, and when its check began. The holder of the lock runs the check.
type Last = Arc<Mutex<Option<(Instant, DoctorReport)>>>;

/// See the module.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Doctor(Last);

impl Doctor {
    /// A report of checks that begin after this call.
    pub(in crate::daemon) async fn report(
        &self,
        checks: impl FnOnce() -> DoctorReport + Send + 'static,
    ) -> Result<DoctorReport, Problem> {
        let late =
            |_| Problem::new(Code::Timeout, "the checks hang: run `meissner doctor` on the daemon's machine");
        tokio::time::timeout(TIMEOUT, self.checked(checks)).await.map_err(late)?
    }

    async fn checked(
        &self,
        checks: impl FnOnce() -> DoctorReport + Send + 'static,
    ) -> Result<DoctorReport, Problem> {
        let asked = Instant::now();
        let mut last = Arc::clone(&self.0).lock_owned().await;
        if let Some((begun, report)) = &*last {
            if *begun >= asked {
                return Ok(report.clone());
            }
            tokio::time::sleep(PERIOD.saturating_sub(begun.elapsed())).await;
        }
        // The lock moves into the work, which goes on even if its client hangs up.
        blocking(move || {
            let begun = Instant::now();
            let report = checks();
            *last = Some((begun, report.clone()));
            report
        })
        .await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::runtime;
    use futures_util::future::{join_all, select};
    use std::future::ready;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::{Barrier, Mutex};

    /// Twenty clients ask while the first client's check runs, and the first hangs up. One more check answers them all.
    #[test]
    fn one_check_runs_at_a_time_and_answers_all_who_waited() {
        runtime().unwrap().block_on(async {
            let (doctor, gate) = (Doctor::default(), Arc::new(Barrier::new(2)));
            let (begun, alone) = (Arc::new(AtomicUsize::new(0)), Arc::new(Mutex::new(())));
            let first = doctor.report({
                let (gate, alone) = (Arc::clone(&gate), Arc::clone(&alone));
                move || {
                    let _alone = alone.try_lock().expect("no other check runs");
                    // The gate is passed once when the check has begun, and once to let it go on.
                    gate.wait();
                    gate.wait();
                    DoctorReport::from(vec![])
                }
            });
            // Poll it once, so that its work begins, then drop it.
            drop(select(Box::pin(first), ready(())).await);
            gate.wait();
            let ask = || {
                let (begun, alone) = (Arc::clone(&begun), Arc::clone(&alone));
                doctor.report(move || {
                    let _alone = alone.try_lock().expect("no other check runs");
                    begun.fetch_add(1, Ordering::SeqCst);
                    DoctorReport::from(vec![])
                })
            };
            let asked = join_all((0..20).map(|_| ask()));
            let freed = async { drop(blocking(move || gate.wait()).await) };
            let (answers, ()) = tokio::join!(asked, freed);
            assert!(answers.iter().all(Result::is_ok));
            assert_eq!(begun.load(Ordering::SeqCst), 1);
            let last = Instant::now();
            ask().await.unwrap();
            assert_eq!(begun.load(Ordering::SeqCst), 2, "a report is not older than its request");
            ask().await.unwrap();
            assert!(last.elapsed() >= PERIOD, "a client that asks without a pause waits between two checks");
        });
    }
}
