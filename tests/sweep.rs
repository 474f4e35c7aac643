//! Sweeps: plans, runs that are cut, parts, merges, and what is refused.

use crate::harness::{PROGRAM, TIMEOUT, complaint, document, meissner, printed, wait_until};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};
use tempfile::{TempDir, tempdir};

/// 24 searches of a fraction of a second.
const SEARCHES: &str = r#"
command = "optimise"

[grid]
target = ["dot", "edge-45"]
model = "membrane"
objective = ["contrast", "off-rms-twice"]
evaluations = 20
seed = { from = 0, to = 5 }
"#;
/// 40 simulations of a few milliseconds.
const SIMULATIONS: &str = r#"
command = "simulate"

[grid]
pattern = ["dot", "edge-*5"]
scale = { from = 0.5, to = 1, steps = 2 }

[random]
samples = 5
seed = 7
finger = { from = 1000, to = 2000 }
gain = { from = 0.9, to = 1.1 }
"#;

fn with(plan: &str) -> TempDir {
    let dir = tempdir().unwrap();
    fs::write(dir.path().join("plan.toml"), plan).unwrap();
    dir
}

/// Runs `meissner sweep` in a directory.
fn sweep(dir: &TempDir, arguments: &[&str]) -> assert_cmd::Command {
    let mut command = meissner();
    command.current_dir(dir.path()).arg("sweep").args(arguments);
    for variable in ["ID", "COUNT", "MIN", "MAX"] {
        command.env_remove(format!("SLURM_ARRAY_TASK_{variable}"));
    }
    command
}

fn merged(dir: &TempDir, out: &str) -> [Vec<u8>; 4] {
    printed(&mut sweep(dir, &["--merge", out]));
    ["results.csv", "results.parquet", "results.json", "page.html"]
        .map(|name| fs::read(dir.path().join(out).join(name)).unwrap())
}

/// The files of runs.
fn runs(dir: &TempDir, out: &str) -> Vec<std::path::PathBuf> {
    let entries = fs::read_dir(dir.path().join(out).join("rows"));
    let mut files: Vec<_> = entries.into_iter().flatten().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

/// Whole lines of cells, in all files of runs.
fn rows(dir: &TempDir, out: &str) -> usize {
    let lines = |file: &Path| {
        let text = fs::read_to_string(file).unwrap();
        text.split_inclusive('\n')
            .filter(|line| line.starts_with("{\"cell\"") && line.ends_with('\n'))
            .count()
    };
    runs(dir, out).iter().map(|file| lines(file)).sum()
}

#[test]
fn parts_kills_and_threads_leave_the_same_bytes() {
    let dir = with(SEARCHES);
    printed(&mut sweep(&dir, &["plan.toml", "--out", "whole", "--threads", "1"]));
    let whole = merged(&dir, "whole");
    assert_eq!(String::from_utf8_lossy(&whole[0]).lines().count(), 25);
    // A run is killed in the middle of its cells, and leaves a part of a line.
    let start = |part: &str| {
        let mut command = Command::new(PROGRAM);
        command.current_dir(dir.path()).args([
            "sweep",
            "plan.toml",
            "--out",
            "parts",
            "--threads",
            "1",
            "--shard",
            part,
        ]);
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    };
    let mut killed = start("1/2");
    wait_until(|| rows(&dir, "parts") >= 2);
    killed.kill().unwrap();
    killed.wait().unwrap();
    let before = rows(&dir, "parts");
    assert!((2..12).contains(&before), "{before}");
    let torn = &runs(&dir, "parts")[0];
    OpenOptions::new().append(true).open(torn).unwrap().write_all(b"{\"cell\":23,\"row\":[1.").unwrap();
    let status = document(&mut sweep(&dir, &["--status", "parts", "--json"]));
    assert_eq!((&status["done"], &status["damaged"]), (&before.into(), &0.into()), "{status}");
    // The same command computes what is missing of its part; another part runs at the same time.
    let mut other = start("2/2");
    let again = document(&mut sweep(&dir, &["plan.toml", "--out", "parts", "--shard", "1/2", "--json"]));
    assert!(other.wait().unwrap().success());
    assert_eq!(
        (&again["cells"], &again["before"], &again["computed"]),
        (&12.into(), &before.into(), &(12 - before).into()),
        "{again}"
    );
    assert_eq!(rows(&dir, "parts"), 24, "no cell was computed twice");
    assert_eq!(merged(&dir, "parts"), whole);
    // Once more there is nothing to do, and no further file.
    let files = runs(&dir, "parts").len();
    let nothing = document(&mut sweep(&dir, &["plan.toml", "--out", "parts", "--json"]));
    assert_eq!((&nothing["before"], &nothing["computed"]), (&24.into(), &0.into()));
    assert_eq!(runs(&dir, "parts").len(), files);
    // Cells that two runs have computed count once.
    let file = &runs(&dir, "whole")[0];
    fs::copy(file, file.with_file_name("copy.jsonl")).unwrap();
    assert_eq!(merged(&dir, "whole"), whole);
}

#[test]
fn a_signal_keeps_every_finished_cell() {
    for (signal, name, code) in [(Signal::INT, "SIGINT", 130), (Signal::TERM, "SIGTERM", 143)] {
        let dir = with(SEARCHES);
        let mut command = Command::new(PROGRAM);
        command.current_dir(dir.path()).args(["sweep", "plan.toml", "--out", "d", "--threads", "1"]);
        let child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        wait_until(|| rows(&dir, "d") >= 1);
        kill_process(Pid::from_child(&child), signal).unwrap();
        let ended = child.wait_with_output().unwrap();
        assert_eq!(ended.status.code(), Some(code));
        let said = String::from_utf8(ended.stderr).unwrap();
        assert!(said.contains("stopped; d has every finished cell"), "{said}");
        let status = document(&mut sweep(&dir, &["--status", "d", "--json"]));
        let run = &status["runs"][0];
        assert_eq!(
            (&run["state"], &run["last"]),
            (&"stopped".into(), &format!("stopped by {name}").into()),
            "{status}"
        );
        assert_eq!(status["done"], rows(&dir, "d"));
    }
}

#[test]
fn a_merge_has_typed_tables_a_page_and_the_best_patterns() {
    let dir = with(SEARCHES);
    printed(&mut sweep(&dir, &["plan.toml", "--out", "d"]));
    let said = document(&mut sweep(&dir, &["--merge", "d", "--json"]));
    assert_eq!((&said["done"], &said["missing"]), (&24.into(), &0.into()), "{said}");
    let out = dir.path().join("d");
    let mut table = csv::Reader::from_path(out.join("results.csv")).unwrap();
    let head: Vec<String> = table.headers().unwrap().iter().map(str::to_owned).collect();
    let place = |name: &str| head.iter().position(|column| column == name).unwrap();
    let (target, objective, value) = (place("target"), place("objective"), place("value"));
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    let about: Value = serde_json::from_slice(&fs::read(out.join("results.json")).unwrap()).unwrap();
    let columns: Vec<&str> =
        about["columns"].as_array().unwrap().iter().map(|column| column["name"].as_str().unwrap()).collect();
    assert_eq!(columns, head);
    // The best search of each target and objective has a file, which is a pattern that `optimise` makes, too.
    let number = |row: &csv::StringRecord| row[value].parse::<f64>().unwrap();
    let page = fs::read_to_string(out.join("page.html")).unwrap();
    for case in
        ["dot", "edge-45"].iter().flat_map(|target| ["contrast", "off-rms-twice"].map(|of| (*target, of)))
    {
        let own: Vec<_> = rows.iter().filter(|row| (&row[target], &row[objective]) == case).collect();
        assert_eq!(own.len(), 6);
        let best = own
            .iter()
            .copied()
            .reduce(|best, row| if number(row) > number(best) { row } else { best })
            .unwrap();
        let name = format!("best/{}-{}.toml", case.0, &best[0]);
        let text = fs::read_to_string(out.join(&name)).unwrap();
        assert!(page.contains(&name), "{name}");
        assert_eq!(printed(&mut sweep(&dir, &["--pattern", &best[0], "--out", "d"])), text);
        let seed = &best[place("seed")];
        let file = dir.path().join(format!("{}-{}.toml", case.0, &best[0]));
        let asked = [
            "optimise",
            case.0,
            "--model",
            "membrane",
            "--objective",
            case.1,
            "--budget",
            "20",
            "--seed",
            seed,
        ];
        printed(meissner().args(asked).arg("-o").arg(&file));
        assert_eq!(fs::read_to_string(file).unwrap(), text, "as the command makes it");
    }
    assert_eq!(fs::read_dir(out.join("best")).unwrap().count(), 4);
    // Both rules of thumb stand beside the patterns.
    assert!(page.contains("naive-reach on average") && page.contains("naive-pitch at worst"), "{page}");
}

#[test]
fn samples_are_the_same_for_every_combination_and_values_have_a_star() {
    let dir = with(SIMULATIONS);
    let dry = document(&mut sweep(&dir, &["plan.toml", "--dry-run", "--json"]));
    // The library has edge-45 and edge-135.
    assert_eq!(dry["cells"], 30, "{dry}");
    assert!(dry["measured"].as_u64().unwrap() >= 1 && dry["rows_bytes"].as_f64().unwrap() > 0.0, "{dry}");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "a dry run writes nothing");
    printed(&mut sweep(&dir, &["plan.toml", "--out", "d"]));
    merged(&dir, "d");
    let mut table = csv::Reader::from_path(dir.path().join("d/results.csv")).unwrap();
    let head = table.headers().unwrap().clone();
    let place = |name: &str| head.iter().position(|column| column == name).unwrap();
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    let samples: Vec<_> =
        rows.iter().map(|row| (row[place("finger")].to_owned(), row[place("gain")].to_owned())).collect();
    assert_eq!(rows.len(), 30);
    for (number, sample) in samples.iter().enumerate() {
        assert_eq!(*sample, samples[number % 5]);
        let gain: f64 = sample.1.parse().unwrap();
        assert!((0.9..1.1).contains(&gain), "{gain}");
    }
    assert_eq!(samples[..5].iter().collect::<std::collections::BTreeSet<_>>().len(), 5);
    // A row names a pattern's own target, and has the results of both rules in the same conditions.
    assert_eq!((&rows[0][place("pattern")], &rows[0][place("target")]), ("dot", "dot"));
    assert!(rows.iter().all(|row| !row[place("naive_reach_contrast_hz")].is_empty()));
}

#[test]
fn patterns_are_told_apart_on_each_finger() {
    let plan = "command = \"discriminate\"\n[[points]]\npattern = \"dot\"\nother = \"edge-0\"\n[[points]]\npattern = \"dot\"\n\
                other = \"dot\"\n[grid]\nmodel = \"membrane\"\nfinger = [0, 1]\ntrials = 8\ninterval_s = 0.2\n";
    let dir = with(plan);
    printed(&mut sweep(&dir, &["plan.toml", "--out", "d"]));
    merged(&dir, "d");
    let mut table = csv::Reader::from_path(dir.path().join("d/results.csv")).unwrap();
    let place = table.headers().unwrap().iter().position(|column| column == "d_prime_counts").unwrap();
    let d_primes: Vec<f64> = table.records().map(|row| row.unwrap()[place].parse().unwrap()).collect();
    assert!(
        d_primes[0].min(d_primes[1]) > 5.0 && d_primes[2].abs().max(d_primes[3].abs()) < 5.0,
        "{d_primes:?}"
    );
}

#[test]
fn plans_that_cannot_run_are_refused_in_one_line() {
    for (plan, wanted) in [
        (
            "command = \"optimise\"\n[grid]\ntarget = \"dot\"\ncolour = [1]\n",
            "plan.toml:4: `grid.colour` is no axis of command = \"optimise\": did you mean `",
        ),
        (
            "command = \"optimise\"\n[grid]\ntarget = \"dot\"\ngain = 0.9\n",
            "plan.toml:4: `grid.gain` is no axis of command = \"optimise\"",
        ),
        (
            "command = \"optimise\"\n[grid]\nseed = [1]\n",
            "`target` is missing: command = \"optimise\" needs it",
        ),
        (
            "command = \"optimise\"\n[grid]\ntarget = []\n",
            "`grid.target` has no value, so the sweep has no cell",
        ),
        ("command = \"optimise\"\n[grid]\ntarget = [\"dot\", \"dot\"]\n", "`grid.target` is `dot` twice"),
        ("command = \"optimise\"\n[grid]\ntarget = \"dto\"\n", "no target is called so: did you mean `dot`?"),
        ("command = \"optimise\"\n[grid]\ntarget = \"no.toml\"\n", "names the target `no.toml`"),
        (
            "command = \"simulate\"\n[grid]\npattern = \"pin-60\"\n",
            "it does not say for which target it was made: add the axis `target`",
        ),
        (
            "command = \"simulate\"\n[grid]\npattern = \"dot\"\ngain = \"high\"\n",
            "`grid.gain` is `high`: must be a number, 0 to 2",
        ),
        (
            "command = \"simulate\"\n[grid]\npattern = \"dot\"\ngain = nan\n",
            "`grid.gain` is `nan`: must be a number, 0 to 2",
        ),
        ("command = \"simulate\"\n[grid]\npattern = \"dot\"\ngain = { from = 0, to = 1 }\n", "add steps = N"),
        (
            "command = \"simulate\"\n[grid]\npattern = \"dot\"\nfinger = { from = 0, to = 999999999 }\n",
            "has 1000000000 values: must be at most",
        ),
        (
            "command = \"simulate\"\n[grid]\npattern = \"dot\"\nfinger = { from = 1, to = 1000 }\nseed = { from = 1, to = 1000 }\n\
             gain = { from = 0, to = 1, steps = 1000 }\n",
            "plan.toml: 1000000000 cells are too many: a plan has at most 1000000",
        ),
        ("command = \"simulate\"\n[grid]\npattern = \"dot\"\n[random]\nsamples = 3\n", "add one to [random]"),
        (
            "command = \"simulate\"\n[grid]\npattern = \"dot\"\ngain = 1\n[random]\nsamples = 3\ngain = { from = 0, to = 1 }\n",
            "is in [grid], too",
        ),
        ("command = \"paint\"\n", "unknown variant `paint`"),
        ("[grid]\ntarget = \"dot\"\n", "`command` is missing: add command = \"optimise\""),
        ("command = \"optimise\"\n[grd]\n", "unknown key `grd`: did you mean `grid`?"),
        (
            "command = \"optimise\"\nprogram = { version = \"0.0.1\", model = 9 }\n[grid]\ntarget = \"dot\"\n",
            "was made by meissner 0.0.1",
        ),
    ] {
        let dir = with(plan);
        let said = complaint(&mut sweep(&dir, &["plan.toml", "--out", "d"]));
        assert!(said.contains(wanted), "{said}\n{wanted}");
        assert!(!dir.path().join("d").exists(), "{said}");
    }
}

#[test]
fn directories_of_something_else_are_refused_and_nothing_is_lost() {
    let dir = with(SIMULATIONS);
    printed(&mut sweep(&dir, &["plan.toml", "--out", "d"]));
    // Differently written, equivalent plans are the same plan.
    let other_words = SIMULATIONS.replace("{ from = 0.5, to = 1, steps = 2 }", "[0.5, 1.0] # in words");
    fs::write(dir.path().join("plan.toml"), other_words).unwrap();
    let again = document(&mut sweep(&dir, &["plan.toml", "--out", "d", "--json"]));
    assert_eq!(again["before"], 30, "{again}");
    fs::write(dir.path().join("plan.toml"), SIMULATIONS.replace("seed = 7", "seed = 8")).unwrap();
    let kept = fs::read(&runs(&dir, "d")[0]).unwrap();
    let said = complaint(&mut sweep(&dir, &["plan.toml", "--out", "d"]));
    assert!(said.contains("d: holds the sweep of another plan (SHA-256 "), "{said}");
    assert_eq!(fs::read(&runs(&dir, "d")[0]).unwrap(), kept);
    fs::create_dir(dir.path().join("full")).unwrap();
    fs::write(dir.path().join("full/thesis.tex"), "").unwrap();
    let said = complaint(&mut sweep(&dir, &["plan.toml", "--out", "full"]));
    assert!(said.contains("full: is not empty and holds no sweep: name a new directory"), "{said}");
    for asked in ["--status", "--merge"] {
        let said = complaint(&mut sweep(&dir, &[asked, "full"]));
        assert!(said.contains("full: holds no sweep"), "{said}");
    }
    // A damaged line is reported, and its cell computed again.
    fs::write(dir.path().join("plan.toml"), SIMULATIONS).unwrap();
    let file = &runs(&dir, "d")[0];
    let text = String::from_utf8(kept).unwrap();
    let second = text.lines().nth(1).unwrap();
    fs::write(file, text.replace(second, &second.replace("\"row\":[", "\"row\":{"))).unwrap();
    let status = document(&mut sweep(&dir, &["--status", "d", "--json"]));
    assert_eq!((&status["damaged"], &status["missing"]), (&1.into(), &1.into()), "{status}");
    let again = document(&mut sweep(&dir, &["plan.toml", "--out", "d", "--json"]));
    assert_eq!(again["computed"], 1, "{again}");
}

/// A file-size limit of the process simulates a full disk: a line is written in part, then the write fails. A pipe or a device in a
/// file's place is refused in one line, without waiting for it.
#[test]
fn a_pipe_or_a_device_among_the_files_of_a_sweep_is_refused() {
    let dir = with(SIMULATIONS);
    printed(&mut sweep(&dir, &["plan.toml", "--out", "d"]));
    let run = runs(&dir, "d").remove(0);
    for place in [run, dir.path().join("d/plan.toml"), dir.path().join("plan.toml")] {
        let kept = fs::read(&place).unwrap();
        for pipe in [true, false] {
            fs::remove_file(&place).unwrap();
            if pipe {
                rustix::fs::mknodat(rustix::fs::CWD, &place, rustix::fs::FileType::Fifo, 0o600.into(), 0)
                    .unwrap();
            } else {
                std::os::unix::fs::symlink("/dev/zero", &place).unwrap();
            }
            let asked: &[&[&str]] = match place.parent() == Some(dir.path()) {
                true => &[&["plan.toml", "--out", "e"]],
                false => &[&["--merge", "d"], &["--status", "d"]],
            };
            for asked in asked {
                let said = complaint(&mut sweep(&dir, asked));
                assert!(said.contains("is not a regular file"), "{asked:?}: {said}");
            }
        }
        fs::remove_file(&place).unwrap();
        fs::write(&place, kept).unwrap();
    }
}

#[test]
fn a_full_disk_ends_a_run_and_keeps_its_cells() {
    let dir = with(SIMULATIONS);
    // `ulimit` counts 1024 bytes; SIGXFSZ is ignored, so that the write fails.
    let script = "trap '' XFSZ; ulimit -f 4; exec \"$0\" sweep plan.toml --out d --threads 1";
    let mut limited = assert_cmd::Command::new("bash");
    limited.current_dir(dir.path()).args(["-c", script, PROGRAM]).timeout(TIMEOUT);
    // The plan is larger than this limit.
    printed(&mut sweep(&dir, &["plan.toml", "--out", "d", "--shard", "30/30"]));
    let said = complaint(&mut limited);
    assert!(said.contains("d/rows/") && said.contains("cannot be written"), "{said}");
    let done = document(&mut sweep(&dir, &["--status", "d", "--json"]))["done"].as_u64().unwrap();
    assert!((2..30).contains(&done), "{done}");
    let again = document(&mut sweep(&dir, &["plan.toml", "--out", "d", "--json"]));
    assert_eq!((&again["before"], &again["failed"]), (&done.into(), &0.into()), "{again}");
    printed(&mut sweep(&dir, &["plan.toml", "--out", "whole"]));
    assert_eq!(merged(&dir, "d"), merged(&dir, "whole"));
}

#[test]
fn a_cell_that_fails_is_a_row_with_its_reason() {
    // No afferent of this target is ON for some fingers: the reach is a hundredth of a millimetre.
    let dir = with(
        "command = \"optimise\"\n[grid]\ntarget = \"small.toml\"\nmodel = \"membrane\"\nevaluations = 5\nfinger = [3, 9]\n",
    );
    let small = "name = \"small\"\nshape = \"dots\"\npoints = [[0.0, 0.0]]\nreach_mm = 0.6\n[population]\nseed = SEED\n";
    // Find a finger for which the target is valid.
    let seed = (0..200).find(|seed| {
        fs::write(dir.path().join("small.toml"), small.replace("SEED", &seed.to_string())).unwrap();
        let mut tried = sweep(&dir, &["plan.toml", "--dry-run", "--json"]);
        tried.output().unwrap().status.success()
    });
    let seed = seed.expect("some finger has an afferent there");
    let failing = (0..200)
        .find(|finger| {
            let plan = format!("command = \"optimise\"\n[grid]\ntarget = \"small.toml\"\nmodel = \"membrane\"\nevaluations = 5\nfinger = [{finger}]\n");
            fs::write(dir.path().join("plan.toml"), plan).unwrap();
            document(&mut sweep(&dir, &["plan.toml", "--dry-run", "--json"]))["failed"] == 1
        })
        .expect("some finger has none");
    let plan = format!(
        "command = \"optimise\"\n[grid]\ntarget = \"small.toml\"\nmodel = \"membrane\"\nevaluations = 5\nfinger = [{seed}, {failing}]\n"
    );
    fs::write(dir.path().join("plan.toml"), plan).unwrap();
    sweep(&dir, &["plan.toml", "--out", "d"]).assert().failure().code(1);
    let status = document(&mut sweep(&dir, &["--status", "d", "--json"]));
    assert_eq!((&status["done"], &status["failed"]), (&1.into(), &1.into()), "{status}");
    assert!(status["runs"][0]["last"].as_str().unwrap().contains("cell 1: "), "{status}");
    merged(&dir, "d");
    let table = fs::read_to_string(dir.path().join("d/results.csv")).unwrap();
    assert!(table.lines().nth(2).unwrap().contains("within reach of the shape"), "{table}");
}
