//! Compares our search with other methods at the same budget: afferents simulated, times the simulated duration.
//!
//! Before criterion's times it prints what each method has found within several budgets, on several targets. On the yardstick it
//! also prints how our search compares with a coordinate search on ten populations, how soon it comes within 1 % of its final
//! result, and where subgradient methods stop. Each pattern found is scored again, exactly, with noise that no search has used.
//!
//! Invariant: two runs print the same, except for the times.

#[path = "optimise/baselines.rs"]
mod baselines;

use baselines::{METHODS, Method};
use criterion::{Criterion, criterion_group, criterion_main};
use meissner_paper::{
    Brief, Fidelity, Found, Limit, Objective, Point, Score, Setting, Space, Spent, Target, YARDSTICK, search,
    shipped,
};
use rayon::ThreadPoolBuilder;
use rayon::prelude::*;
use std::hint::black_box;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

const TARGETS: [&str; 5] = [YARDSTICK, "disc", "two-dots", "grating-9", "braille-b"];
const BUDGETS: [f64; 3] = [4_000.0, 16_000.0, 80_000.0];
/// Each seed has its own population, start and random numbers.
const SEEDS: u64 = 3;
const POPULATIONS: u64 = 10;
/// Patterns found with noise seed 0 are scored with these noise seeds.
const NOISE_SEEDS: [u64; 4] = [101, 102, 103, 104];
const NO_LIMIT: Limit = Limit::Evaluations(u64::MAX);
const SETTINGS: [(&str, Setting); 2] = [("always on", Setting::AlwaysOn), ("default", Setting::Default)];

fn target(name: &str) -> Target {
    shipped(name).expect("it is shipped")
}

/// A search on the population of its seed.
struct Command<'j> {
    target: &'j Target,
    space: Space,
    seed: [u64; 1],
}

impl<'j> Command<'j> {
    const fn new(target: &'j Target, space: Space, seed: u64) -> Self {
        Self { target, space, seed: [seed] }
    }

    fn brief(&self) -> Brief<'_> {
        Brief {
            target: self.target,
            frame: &self.target.frames()[0],
            populations: &self.seed,
            noise_seed: 0,
            space: self.space.clone(),
            seed: self.seed[0],
        }
    }

    fn start(&self) -> Point {
        self.space.random(self.seed[0])
    }

    fn search(&self, limit: Limit, watch: &mut dyn FnMut(Spent, Score)) -> Found {
        let mut watch = |spent, score| {
            watch(spent, score);
            ControlFlow::Continue(())
        };
        search(&self.brief(), self.start(), limit, &mut watch).expect("the method can")
    }

    fn exact_hz(&self, point: Point) -> f64 {
        let Brief { target, frame, populations, .. } = self.brief();
        let of_noise = |&noise: &u64| {
            let objective = Objective::new(target, frame, populations, noise, Fidelity::FULL);
            objective.at(point).expect("the method can").score().cost_hz()
        };
        mean(&NOISE_SEEDS.each_ref().map(of_noise))
    }
}

fn mean(of: &[f64]) -> f64 {
    of.iter().sum::<f64>() / of.len() as f64
}

fn least(of: &[f64]) -> f64 {
    of.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Costs of a method on a target in a setting, by seed and budget.
fn costs(method: Method, target: &Target, setting: Setting) -> Vec<Vec<f64>> {
    let of_seed = |seed| {
        let job = Command::new(target, setting.space(target.array()), seed);
        let found = method.found(&job.brief(), job.start(), &BUDGETS);
        found.into_iter().map(|point| job.exact_hz(point)).collect()
    };
    (0..SEEDS).into_par_iter().map(of_seed).collect()
}

/// Prints the objective that our search reaches, divided by each other method's, for all targets, seeds and both settings.
fn table() {
    println!("Cost, impulses/s, by afferent-seconds: means of {SEEDS} seeds.");
    println!("{:>36} {:^26} {:^26}", "", "always on", "default");
    print!("{:<16} {:<19}", "target", "method");
    (0..2).flat_map(|_| BUDGETS).for_each(|budget| print!(" {budget:>8}"));
    println!();
    let mut ratios = [[(); 2]; METHODS.len()].map(|of| of.map(|()| BUDGETS.map(|_| Vec::new())));
    for name in TARGETS {
        let target = target(name);
        let jobs: Vec<_> =
            METHODS.iter().flat_map(|&method| SETTINGS.map(|(_, setting)| (method, setting))).collect();
        let all: Vec<_> = jobs.par_iter().map(|&(method, setting)| costs(method, &target, setting)).collect();
        for (number, method) in METHODS.iter().enumerate() {
            print!("{name:<16} {:<19}", method.name());
            for setting in 0..2 {
                let (ours, theirs) = (&all[setting], &all[2 * number + setting]);
                for budget in 0..BUDGETS.len() {
                    let costs: Vec<f64> = theirs.iter().map(|by_budget| by_budget[budget]).collect();
                    print!(" {:>8.1}", mean(&costs));
                    let ratio = |(ours, theirs): (&Vec<f64>, &Vec<f64>)| ours[budget] / theirs[budget];
                    ratios[number][setting][budget].extend(ours.iter().zip(theirs).map(ratio));
                }
            }
            println!();
        }
    }
    println!("Ours over theirs, mean and least of {} searches:", TARGETS.len() as u64 * SEEDS);
    for (method, ratios) in METHODS.iter().zip(&ratios).skip(1) {
        for ((setting, _), ratios) in SETTINGS.iter().zip(ratios) {
            print!("  {:<19} {setting:<10}", method.name());
            // Within the first budget some values are near 0, and ratios mean nothing.
            for (budget, ratios) in BUDGETS.iter().zip(ratios).skip(1) {
                print!("  {budget:>6}: {:>6.3} {:>6.3}", mean(ratios), least(ratios));
            }
            println!();
        }
    }
}

/// Our search on the yardstick, all motors on, for ten populations: at a fifth of the coordinate search's budget, and at the same
/// budget.
fn against_coordinates() {
    let target = target(YARDSTICK);
    let free = Setting::AlwaysOn.space(target.array());
    let fixed = Space { phases: false, ..free.clone() };
    for logarithmic in [false, true] {
        let grid = if logarithmic { "a logarithmic" } else { "an even" };
        println!(
            "Against three sweeps over {grid} grid on {YARDSTICK}, always on; ours over theirs, phases fixed | free:"
        );
        let of_seed = |seed| {
            let job = Command::new(&target, fixed.clone(), seed);
            let trail = Method::Coordinates { logarithmic }.trail(&job.brief(), job.start(), f64::INFINITY);
            let theirs_hz = job.exact_hz(trail.at(f64::INFINITY));
            let ratios = [0.2, 1.0].map(|share| {
                [&fixed, &free].map(|space| {
                    let job = Command::new(&target, space.clone(), seed);
                    let found = job.search(Limit::AfferentSeconds(share * trail.afferent_s), &mut |_, _| ());
                    job.exact_hz(found.point) / theirs_hz
                })
            });
            (trail.afferent_s, theirs_hz, ratios)
        };
        let all: Vec<_> = (0..POPULATIONS).into_par_iter().map(of_seed).collect();
        for (seed, (afferent_s, hz, [fifth, full])) in all.iter().enumerate() {
            print!("  population {seed}: {hz:.1}/s for {afferent_s:.0}");
            print!("; at a fifth {:.3} | {:.3}", fifth[0], fifth[1]);
            println!("; at the same {:.3} | {:.3}", full[0], full[1]);
        }
        for (share, what) in ["at a fifth", "at the same"].iter().enumerate() {
            for (space, phases) in ["fixed", "free"].iter().enumerate() {
                let ratios: Vec<f64> = all.iter().map(|(.., ratios)| ratios[share][space]).collect();
                println!("  {what}, phases {phases}: mean {:.3}, least {:.3}", mean(&ratios), least(&ratios));
            }
        }
    }
}

/// How early the yardstick's search could have been stopped, and still have been within 1 % of its final result.
fn soon() {
    println!("{YARDSTICK}, default, to convergence, and when it was first within 1 % of that:");
    let target = target(YARDSTICK);
    for seed in 0..5 {
        let job = Command::new(&target, Setting::Default.space(target.array()), seed);
        let (begun, mut times) = (Instant::now(), Vec::new());
        let found = job.search(NO_LIMIT, &mut |spent, _| times.push((spent.evaluations, begun.elapsed())));
        let took = begun.elapsed();
        let final_hz = job.exact_hz(found.point);
        // A step of an unfinished pass is not yet a result, so a search that ends at this step is scored.
        let near = found.trace.iter().map(|step| step.spent).find(|spent| {
            let step = found.trace.iter().find(|step| step.spent == *spent).expect("it is one");
            job.exact_hz(step.point) >= 0.99 * final_hz && {
                let found = job.search(Limit::Evaluations(spent.evaluations), &mut |_, _| ());
                job.exact_hz(found.point) >= 0.99 * final_hz
            }
        });
        let Spent { evaluations, afferent_s } = found.spent;
        println!(
            "  seed {seed}: {final_hz:.1}/s, {evaluations} evaluations, {afferent_s:.0} afferent-s, {took:.2?}"
        );
        if let Some(Spent { evaluations, afferent_s }) = near {
            let (_, when) = times.iter().find(|(by, _)| *by >= evaluations).expect("it was heard of");
            println!("    within 1 %: {evaluations} evaluations, {afferent_s:.0} afferent-s, {when:.2?}");
        }
    }
}

/// Where subgradient methods end: with five times the budget, and when they last found something better.
fn stuck() {
    println!("Subgradients on {YARDSTICK}, always on, phases fixed, 400 000 afferent-s:");
    let target = target(YARDSTICK);
    let space = Space { phases: false, ..Setting::AlwaysOn.space(target.array()) };
    for root in [false, true] {
        let of_seed = |seed| {
            let job = Command::new(&target, space.clone(), seed);
            let method = Method::Subgradient { root };
            let trail = method.trail(&job.brief(), job.start(), 5.0 * BUDGETS[2]);
            let &(when, _, point) = trail.best.last().expect("the start at least");
            (job.exact_hz(point), when)
        };
        let all: Vec<_> = (0..SEEDS).into_par_iter().map(of_seed).collect();
        let method = Method::Subgradient { root };
        all.iter()
            .for_each(|(hz, when)| println!("  {}: {hz:.1}/s, last better at {when:.0}", method.name()));
    }
}

fn to_convergence(criterion: &mut Criterion) {
    let begun = Instant::now();
    table();
    against_coordinates();
    soon();
    stuck();
    println!("All that took {:.0?}.", begun.elapsed());
    let target = target(YARDSTICK);
    let job = Command::new(&target, Setting::Default.space(target.array()), 0);
    let mut group = criterion.benchmark_group("to_convergence");
    group.sample_size(10).measurement_time(Duration::from_secs(10));
    for threads in [1, 2] {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be started");
        group.bench_function(format!("{threads}_threads"), |bencher| {
            pool.install(|| bencher.iter(|| black_box(&job).search(NO_LIMIT, &mut |_, _| ())));
        });
    }
    group.finish();
}

criterion_group!(benches, to_convergence);
criterion_main!(benches);
