//! The process that searches.

use super::convert::verdict;
use super::{Job, MAX_LINE, MEMORY, NICE, Report, Task, design};
use crate::store::{Stored, target_json};
use meissner_api::{SearchProgress, SearchRequest, SearchResponse, SearchResult, SearchVerdicts};
use meissner_array::spec::{Array, ArraySpec};
use meissner_design::{ByModel, Ended, Made, Models, Progress, Rule, Target, make, response};
use meissner_skin::ModelName;
use rayon::ThreadPoolBuilder;
use rustix::process::{Resource, Rlimit, setpriority_process, setrlimit};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::ops::ControlFlow;
use std::process::{self, ExitCode};
use std::time::{Duration, Instant};
use std::{fs, thread};

/// How often it reports.
const REPORT_EVERY: Duration = Duration::from_millis(200);

/// Carries out the job on stdin.
#[must_use]
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
    let read = |target: &str| Target::read(target, "target").map_err(|error| error.to_string());
    let done = known.and_then(|array| match &job.task {
        Task::Search { request, target } => Ok(Report::Done(Box::new(search(&read(target)?, request)?))),
        Task::Compare { compare, target } => {
            let tell = |contrast| say(&Report::Contrast(contrast)).is_ok();
            compare.carry_out(&read(target)?, tell).map(Report::Contrast)
        }
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

/// Searches; an error is one line.
fn search(target: &Target, request: &SearchRequest) -> Result<SearchResult, String> {
    let request = design(request);
    let begun = Instant::now();
    let mut next = begun;
    let made = make(target, target.name(), &request, &mut |Progress { frame, frames, spent, score }| {
        let now = Instant::now();
        if now >= next {
            next = now + REPORT_EVERY;
            let (seconds, evaluations) = (begun.elapsed().as_secs_f64(), spent.evaluations);
            let value = Some(score.value).filter(|value| value.is_finite());
            let progress = SearchProgress { seconds, frame: frame + 1, frames, evaluations, value };
            // The daemon has ended, so no one reads the reports.
            if say(&Report::Progress(progress)).is_err() {
                return ControlFlow::Break(());
            }
        }
        ControlFlow::Continue(())
    });
    result(target, request.models, &made.map_err(|error| error.to_string())?)
}

fn result(target: &Target, models: Models, made: &Made) -> Result<SearchResult, String> {
    let rules = Rule::ALL.map(|rule| rule.drives(target));
    let model = models.first();
    let maps = response(target, &[made.pattern.drives(), &rules[0], &rules[1]], model);
    let maps = maps.map_err(|error| error.to_string())?;
    let [found, naive_reach, naive_pitch] =
        <[Vec<f64>; 3]>::try_from(maps.rates_hz).expect("as many maps as patterns");
    let response = SearchResponse {
        model: model.name().to_owned(),
        places_mm: maps.places.iter().map(|at| [at.x_mm, at.y_mm]).collect(),
        on: maps.on,
        found,
        naive_reach,
        naive_pitch,
    };
    let value = |rule| made.baselines.iter().find(|of| of.rule == rule).map_or(0.0, |of| of.value);
    let stored = Stored::made(made.pattern.clone());
    let text = String::from_utf8_lossy(&stored.text).into_owned();
    Ok(SearchResult {
        ended: if made.ended() == Ended::Converged { "converged" } else { "limit" }.to_owned(),
        pattern: text,
        sha256: stored.sha256,
        value: made.value,
        value_naive_reach: value(Rule::Reach),
        value_naive_pitch: value(Rule::Pitch),
        pulses_per_s: made.pulses_per_s,
        models: made.models.iter().map(verdicts).collect(),
        definition: target_json(target),
        outline: target.shape().outline(),
        response,
        warnings: target.warnings(),
    })
}

fn verdicts(of: &ByModel) -> SearchVerdicts {
    let rule = |rule| of.baselines.iter().find(|of| of.rule == rule).map(|of| verdict(&of.verdict));
    let rule = |of| rule(of).expect("both rules are judged");
    SearchVerdicts {
        model: ModelName::name(of.model).to_owned(),
        found: verdict(&of.verdict),
        naive_reach: rule(Rule::Reach),
        naive_pitch: rule(Rule::Pitch),
    }
}
