//! The overhead of a sweep beyond its cells, and the time of a merge.
//!
//! Overhead: the time of a run on one thread minus the time of its cells alone, per cell. Merge: rows of CELLS cells (10 000), each
//! with a pattern of the usual size, in the files of TASKS tasks (100).
//!
//! `cargo bench -p meissner-benches --bench sweep`, `CELLS=1000000 cargo bench -p meissner-benches --bench sweep`

use meissner_sweep::{Directory, Document, Plan, Run, Shard, Sources, compute, merge};
use serde_json::json;
use std::env;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::sync::Arc;
use std::time::Instant;

/// Shipped targets; patterns are not needed.
struct Shipped;

impl Sources for Shipped {
    fn names(&self, _: Document) -> Vec<String> {
        Vec::new()
    }

    fn text(&self, _: Document, name: &str) -> Result<String, String> {
        let target = meissner_design::shipped(name).ok_or("no such target")?;
        toml::to_string(&target.definition()).map_err(|error| error.to_string())
    }
}

fn plan(text: &str) -> Plan {
    Plan::read(text, "plan.toml", &Shipped).expect("a plan")
}

/// The most memory that this process has used, MB.
fn peak_mb() -> f64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kb = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    kb.unwrap_or(f64::NAN) / 1024.0
}

fn number(name: &str, default: u64) -> u64 {
    env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

fn overhead(dir: &std::path::Path) {
    // A search of one evaluation: the cheapest cell with a pattern.
    let text = "command = \"optimise\"\n[grid]\ntarget = \"dot\"\nmodel = \"membrane\"\nevaluations = 1\nseed = { from = 0, to = 99 }\n";
    let plan = Arc::new(plan(text));
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let begun = Instant::now();
    one.install(|| (0..plan.cells()).for_each(|cell| drop(compute(&plan, &plan.cell(cell)).expect("a row"))));
    let alone_s = begun.elapsed().as_secs_f64();
    let begun = Instant::now();
    let directory = Directory::of_plan(dir, &plan).expect("a directory");
    let run = Run::begin(&directory, Arc::clone(&plan), Shard::WHOLE, None).expect("a run");
    run.work(1, &|_| ()).expect("all cells");
    let run_s = begun.elapsed().as_secs_f64();
    let cells = plan.cells() as f64;
    println!(
        "a cell: {:.2} ms alone, {:.2} ms in a run with its start and end; overhead {:.2} ms",
        alone_s / cells * 1e3,
        run_s / cells * 1e3,
        (run_s - alone_s) / cells * 1e3
    );
}

fn merging(dir: &std::path::Path, cells: u64, tasks: u64) {
    // 5 amplitudes, 2 models, and seeds.
    let text = format!(
        "command = \"optimise\"\n[grid]\ntarget = \"dot\"\namplitude_um = {{ from = 40, to = 80, steps = 5 }}\nmodel = [\"membrane\", \
         \"both\"]\nseed = {{ from = 0, to = {} }}\n",
        cells / 10 - 1
    );
    let plan = plan(&text);
    let outcome = compute(&plan, &plan.cell(0)).expect("a row");
    let directory = Directory::of_plan(dir, &plan).expect("a directory");
    let row: Vec<_> = outcome.row.iter().map(|value| json!(value)).collect();
    let pattern = outcome.pattern.expect("a pattern");
    let mut bytes = 0;
    for task in 1..=tasks {
        let file =
            File::create(dir.join("rows").join(format!("{task}-of-{tasks}-bench.jsonl"))).expect("a file");
        let mut file = BufWriter::new(file);
        for cell in (0..plan.cells()).filter(|&cell| (Shard { number: task, of: tasks }).has(cell)) {
            let mut row = row.clone();
            row[0] = json!(meissner_array::random::uniform([1, 2, 3, cell])[0]);
            let line = json!({"cell": cell, "row": row, "pattern": pattern}).to_string();
            bytes += line.len() + 1;
            file.write_all(line.as_bytes()).and_then(|()| file.write_all(b"\n")).expect("a line");
        }
    }
    let before_mb = peak_mb();
    let begun = Instant::now();
    let merged = merge(&directory, &plan).expect("a merge");
    let merged_s = begun.elapsed().as_secs_f64();
    assert_eq!(merged.done, plan.cells());
    println!(
        "a merge of {} cells in {tasks} files, {:.1} MB: {merged_s:.2} s, at most {:.0} MB of memory (before it {before_mb:.0})",
        merged.done,
        bytes as f64 / 1e6,
        peak_mb()
    );
    // A restarted task reads its own files alone.
    let begun = Instant::now();
    let shard = Shard { number: 1, of: tasks };
    let run = Run::begin(&directory, Arc::new(plan), shard, None).expect("a run");
    assert_eq!(run.missing(), 0);
    println!("a task that is started again finds its cells in {:.3} s", begun.elapsed().as_secs_f64());
}

fn main() {
    let dir = tempfile::tempdir().expect("a directory");
    overhead(&dir.path().join("overhead"));
    merging(&dir.path().join("merge"), number("CELLS", 10_000), number("TASKS", 100));
}
