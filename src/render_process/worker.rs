//! What the process does.

use super::{Job, MAX_LINE, MEMORY, NICE, Report, Task};
use meissner_array::spec::{Array, ArraySpec};
use rayon::ThreadPoolBuilder;
use rustix::process::{Resource, Rlimit, setpriority_process, setrlimit};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::process::{self, ExitCode};
use std::{fs, thread};

/// Carries out the job on stdin.
pub fn work() -> ExitCode {
    lower();
    let mut stdin = BufReader::new(io::stdin());
    let mut line = Vec::new();
    let read = (&mut stdin).take(MAX_LINE).read_until(b'\n', &mut line);
    let Some(job) = read.ok().and_then(|_| serde_json::from_slice::<Job>(&line).ok()) else {
        // There is no daemon at the other end, or it has ended.
        return ExitCode::FAILURE;
    };
    // The daemon sends nothing more, so any input means the end.
    let watch = thread::Builder::new().name("stdin".into()).spawn(move || {
        let _ = io::copy(&mut stdin, &mut io::sink());
        process::exit(1);
    });
    let report = match watch {
        Ok(_) => carry_out(&job),
        Err(error) => Report::Failed(format!("the system gives no thread: {error}")),
    };
    if say(&report).is_ok() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Carries out a job; returns its last report.
fn carry_out(job: &Job) -> Report {
    // The daemon's array may be a site's own.
    let known = ArraySpec::parse(&job.array, "array").map_err(|error| error.to_string());
    let known = known.and_then(|spec| Array::known(spec).map_err(|problem| problem.to_string()));
    let done = known.and_then(|array| match &job.task {
        Task::Render(render) => {
            // If the daemon has ended, so does this process.
            let tell = |text| drop(say(&Report::Found(text)));
            Ok(Report::Rendered(Box::new(render.carry_out(array, tell)?)))
        }
        Task::Preview(preview) => Ok(Report::Previewed(Box::new(preview.carry_out()?))),
    });
    done.unwrap_or_else(Report::Failed)
}

/// Lowers this process's use of the machine. Each step is optional, because the service's unit may forbid some.
fn lower() {
    // Do not use `nice`: it would add to the niceness of the thread that started this process.
    let _ = setpriority_process(None, NICE);
    // When memory runs out, the system kills this process first.
    let _ = fs::write("/proc/self/oom_score_adj", "1000");
    let _ = setrlimit(Resource::Data, Rlimit { current: Some(MEMORY), maximum: Some(MEMORY) });
    // This process may have inherited the daemon's descriptors; close them, so that no port stays open.
    let open = fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
    let numbers: Vec<i32> = open.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect();
    for number in numbers.into_iter().filter(|number| *number > 2) {
        let _ = nix::unistd::close(number);
    }
    // Leave one processor to the daemon. After an error there is one thread for each processor, at the same priority.
    let processors = thread::available_parallelism().map_or(1, usize::from);
    let _ = ThreadPoolBuilder::new().num_threads((processors - 1).max(1)).build_global();
}

fn say(report: &Report) -> io::Result<()> {
    let mut line = serde_json::to_vec(report)?;
    line.push(b'\n');
    let mut out = io::stdout().lock();
    out.write_all(&line)?;
    out.flush()
}
