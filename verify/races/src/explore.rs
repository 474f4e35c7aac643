//! Runs models, and prints for each how many interleavings there were and what is broken.

use loom::model::Builder;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Threads that hand over, and what must hold.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Model {
    pub(crate) name: &'static str,
    /// What holds in every interleaving.
    pub(crate) holds: &'static str,
    /// How often a thread that could go on makes place for another, at most; `None`: all interleavings.
    pub(crate) switches: Option<usize>,
    /// One interleaving.
    pub(crate) run: fn(),
}

impl Model {
    pub(crate) const fn new(
        name: &'static str,
        holds: &'static str,
        switches: Option<usize>,
        run: fn(),
    ) -> Self {
        Self { name, holds, switches, run }
    }

    /// Explores; the number of interleavings, or what is broken.
    fn explore(self) -> Result<u64, String> {
        let (runs, counted) = (Arc::new(AtomicU64::new(0)), self.run);
        let of_model = Arc::clone(&runs);
        let mut builder = Builder::new();
        builder.preemption_bound = self.switches;
        let explored = catch_unwind(AssertUnwindSafe(|| {
            builder.check(move || {
                of_model.fetch_add(1, Ordering::Relaxed);
                counted();
            });
        }));
        let runs = runs.load(Ordering::Relaxed);
        explored.map(|()| runs).map_err(|panic| {
            let text = panic.downcast_ref::<String>().cloned();
            let text = text.or_else(|| panic.downcast_ref::<&str>().map(ToString::to_string));
            format!("in interleaving {runs}: {}", text.unwrap_or_default().lines().next().unwrap_or_default())
        })
    }
}

/// Explores these models, or those named by the arguments.
pub(crate) fn explore(all: &[Model]) -> ExitCode {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    if let Some(unknown) = wanted.iter().find(|name| all.iter().all(|model| model.name != **name)) {
        eprintln!("races: unknown model {unknown}");
        return ExitCode::from(2);
    }
    let (mut broken, mut total, begun) = (false, 0, Instant::now());
    println!("| model | what holds | switches | interleavings | time |\n|---|---|---|---|---|");
    for model in all.iter().filter(|model| wanted.is_empty() || wanted.iter().any(|name| name == model.name))
    {
        let (begun, Model { name, holds, switches, .. }) = (Instant::now(), *model);
        match model.explore() {
            Ok(runs) => {
                total += runs;
                let switches = switches.map_or_else(|| "all".to_owned(), |switches| switches.to_string());
                println!(
                    "| {name} | {holds} | {switches} | {runs} | {:.1} s |",
                    begun.elapsed().as_secs_f64()
                );
            }
            Err(what) => {
                broken = true;
                println!("broken: {name}: {holds}: {what}");
            }
        }
    }
    println!("{total} interleavings in {:.0} s", begun.elapsed().as_secs_f64());
    ExitCode::from(u8::from(broken))
}
