//! Computes the content of a sweep's page: marginals, fronts, and the best choice of each case.
//!
//! A case is a task of a lab: a target with an amplitude, under a model. A choice is a way to solve it: a pattern, or a method of
//! searching for one. The other axes are conditions: the worst case of a figure is the lowest decile over them, or a column of the
//! row.
//!
//! Invariant: equal choices rank by their cells' numbers.

use super::{Merged, Row};
use crate::axis::{Axis, Command, Value};
use crate::command::{Figures, columns, figures, pattern_name};
use crate::directory::Directory;
use crate::plan::{Cell, Plan};
use meissner_report::{Choice, Front, Marginal, Ordinate, Spread, SweepPage, sweep_page};
use std::collections::HashMap;

/// A numeric axis with more values is shown in this many bins.
const MOST_ORDINATES: usize = 40;
const BINS: usize = 20;
/// The most fronts and cases of a page.
const MOST_FRONTS: usize = 24;
const MOST_CASES: usize = 2000;
/// The most figures, and columns of each.
const FIGURES: usize = 2;
const LINES: usize = 3;

/// The figures of a row that the page needs; NaN: the row has none.
#[derive(Clone, Copy, Debug)]
struct Point {
    cell: u32,
    /// By figure, then by line.
    figures: [[f32; LINES]; FIGURES],
    worst: [f32; LINES],
    /// The value by which choices rank.
    rank: f32,
}

/// The cells of a choice, in a case.
#[derive(Clone, Debug)]
struct Chosen {
    name: String,
    points: Vec<Point>,
}

impl Chosen {
    fn rank(&self) -> f32 {
        self.points.iter().map(|point| point.rank).sum::<f32>() / self.points.len() as f32
    }
}

/// The choices of a case.
#[derive(Clone, Debug)]
struct Case {
    name: String,
    choices: Vec<Chosen>,
}

/// The points of each value of an axis.
type ByValue = Vec<ByValueEntry>;
type ByValueEntry = (Value, Vec<Point>);

/// See the module.
#[derive(Debug)]
pub(super) struct Summary<'a> {
    plan: &'a Plan,
    shown: Figures,
    points: Vec<Point>,
}

/// The file of a cell's pattern.
pub(super) fn file(plan: &Plan, number: u64) -> String {
    format!("best/{}.toml", pattern_name(plan.target(&plan.cell(number)).name(), number))
}

impl<'a> Summary<'a> {
    pub(super) const fn new(plan: &'a Plan) -> Self {
        Self { plan, shown: figures(plan.command()), points: Vec::new() }
    }

    pub(super) fn take(&mut self, row: &Row<'_>) {
        let columns = columns(self.plan.command());
        let number = |name: &str| {
            let place = columns.iter().position(|column| column.name == name);
            match place.and_then(|place| row.results.get(place)?.as_ref()) {
                Some(Value::Number(number)) => *number as f32,
                _ => f32::NAN,
            }
        };
        let lines = |names: &[&str]| -> [f32; LINES] {
            std::array::from_fn(|line| names.get(line).map_or(f32::NAN, |name| number(name)))
        };
        let figures = std::array::from_fn(|at| {
            self.shown.figures.get(at).map_or([f32::NAN; LINES], |figure| lines(figure.columns))
        });
        if figures[0][0].is_finite() {
            let cell = u32::try_from(row.cell.number).expect("a plan has a million cells at most");
            let worst = lines(self.shown.worst.unwrap_or_default());
            self.points.push(Point { cell, figures, worst, rank: number(self.shown.rank) });
        }
    }

    /// The axes that decide which case a cell belongs to. Values of different objectives cannot be ranked together, so each
    /// objective's best patterns are a separate case.
    const fn case_axes(&self, by_objective: bool) -> &'static [Axis] {
        match self.plan.command() {
            Command::Optimise if by_objective => {
                &[Axis::Target, Axis::AmplitudeUm, Axis::Model, Axis::Objective]
            }
            Command::Optimise => &[Axis::Target, Axis::AmplitudeUm, Axis::Model],
            Command::Simulate => &[Axis::Target, Axis::Model],
            Command::Discriminate => &[Axis::Model],
        }
    }

    /// The axes of the choice: those that vary and are not conditions.
    fn choice_axes(&self, case_axes: &[Axis]) -> Vec<Axis> {
        let command = self.plan.command();
        let varied = self.plan.varied().into_iter().map(|(axis, _)| axis);
        let mut axes: Vec<Axis> =
            varied.filter(|axis| !axis.is_condition(command) && !case_axes.contains(axis)).collect();
        // Give a choice a name even in a plan with one pattern.
        if axes.is_empty() {
            axes.push(if command == Command::Optimise { Axis::Seed } else { Axis::Pattern });
        }
        axes
    }

    fn cases(&self, by_objective: bool) -> Vec<Case> {
        let case_axes = self.case_axes(by_objective);
        let (choice_axes, mut cases) = (self.choice_axes(case_axes), Vec::<Case>::new());
        let mut places: HashMap<(String, String), (usize, usize)> = HashMap::new();
        let mut case_places: HashMap<String, usize> = HashMap::new();
        for &point in &self.points {
            let cell = self.plan.cell(u64::from(point.cell));
            let (case_name, choice_name) = (self.named(&cell, case_axes), self.named(&cell, &choice_axes));
            let (case, choice) =
                *places.entry((case_name.clone(), choice_name.clone())).or_insert_with(|| {
                    let case = *case_places.entry(case_name.clone()).or_insert_with(|| {
                        cases.push(Case { name: case_name, choices: Vec::new() });
                        cases.len() - 1
                    });
                    cases[case].choices.push(Chosen { name: choice_name, points: Vec::with_capacity(1) });
                    (case, cases[case].choices.len() - 1)
                });
            cases[case].choices[choice].points.push(point);
        }
        cases
    }

    /// The values of some axes, in words.
    fn named(&self, cell: &Cell, axes: &[Axis]) -> String {
        let word = |&axis: &Axis| match self.plan.shown(cell, axis) {
            Value::Text(word) => word,
            value if axis == Axis::AmplitudeUm => format!("{value} um"),
            value => format!("{} {value}", axis.name().replace('_', " ")),
        };
        axes.iter().map(word).collect::<Vec<_>>().join(", ")
    }

    /// The best choice of each case. Each search counts as a separate choice, because it has its own pattern.
    fn best(&self) -> Vec<(String, Chosen)> {
        let searches = self.plan.command() == Command::Optimise;
        let of_case = |case: Case| {
            let best = if searches {
                let all = case.choices.iter().flat_map(|of| of.points.iter().map(move |point| (of, point)));
                let (of, point) =
                    all.reduce(|best, other| if other.1.rank > best.1.rank { other } else { best })?;
                Chosen { name: of.name.clone(), points: vec![*point] }
            } else {
                let all = case.choices.into_iter();
                all.reduce(|best, other| if other.rank() > best.rank() { other } else { best })?
            };
            Some((case.name, best))
        };
        self.cases(true).into_iter().take(MOST_CASES).filter_map(of_case).collect()
    }

    /// The cells whose patterns are kept as files: the best searches.
    pub(super) fn best_cells(&self) -> Vec<u64> {
        if self.plan.command() != Command::Optimise {
            return Vec::new();
        }
        let mut cells: Vec<u64> = self.best().iter().map(|(_, of)| u64::from(of.points[0].cell)).collect();
        cells.sort_unstable();
        cells
    }

    pub(super) fn page(&self, directory: &Directory, merged: &Merged, models: &[String]) -> String {
        let command = self.plan.command();
        let (figures, worst) = match command {
            Command::Optimise | Command::Simulate => (
                "Contrast: mean rate of ON less that of OFF afferents, impulses/s. AUC: the chance that an ON afferent fires faster than \
                 an OFF one. The rules naive-reach and naive-pitch let all pins near the shape vibrate at 60 Hz, and need no search.",
                if command == Command::Optimise {
                    "Contrast, impulses/s. At worst: the lowest on twenty held-out fingers, with gains of 90 and 110 %, and 1 mm off."
                } else {
                    "Contrast, impulses/s. At worst: the lowest decile over fingers, gains, offsets and noise."
                },
            ),
            Command::Discriminate => (
                "How well an ideal observer of each afferent's count tells the patterns apart; the baseline knows the number of all \
                 spikes alone.",
                "d'. At worst: the lowest decile over fingers and noise.",
            ),
        };
        let mut fronts: Vec<Front> = self
            .cases(false)
            .iter()
            .filter(|case| case.choices.len() > 1)
            .map(|case| Front { of: case.name.clone(), choices: self.choices(&case.choices) })
            .collect();
        let varied: Vec<String> =
            self.plan.varied().iter().map(|(axis, count)| format!("{} ({count})", axis.name())).collect();
        let (program, Merged { cells, done, failed, missing, .. }) = (self.plan.program(), merged);
        let mut facts = vec![
            ("command", command.name().to_owned()),
            ("axes", varied.join(", ")),
            ("cells", format!("{done} done, {failed} failed, {missing} missing, of {cells}")),
            ("models", models.join(", ")),
            ("plan", directory.plan_sha256().to_owned()),
            ("program", format!("meissner {}, models of version {}", program.version, program.model)),
        ];
        if fronts.len() > MOST_FRONTS {
            facts.push(("drawn", format!("the first {MOST_FRONTS} of {} cases", fronts.len())));
            fronts.truncate(MOST_FRONTS);
        }
        let best = self.best().into_iter().filter_map(|(case, chosen)| {
            let cell = u64::from(chosen.points[0].cell);
            let choice = self.choices(&[chosen]).pop()?;
            let file = (command == Command::Optimise).then(|| file(self.plan, cell));
            Some((case, Choice { file, ..choice }))
        });
        sweep_page(&SweepPage {
            title: "meissner: sweep".to_owned(),
            facts: facts.into_iter().map(|(name, fact)| (name.to_owned(), fact)).collect(),
            lines: self.shown.lines.iter().map(|&line| line.to_owned()).collect(),
            figures: figures.to_owned(),
            worst: worst.to_owned(),
            marginals: self.marginals(),
            fronts,
            best: best.collect(),
        })
    }

    /// Choices for a front: mean and worst case of the first figure. All searches of a choice count equally.
    fn choices(&self, choices: &[Chosen]) -> Vec<Choice> {
        let choice = |chosen: &Chosen| {
            let of = |line: usize| -> Option<[f64; 2]> {
                let spread = spread(&chosen.points, |point| point.figures[0][line])?;
                let low = match self.shown.worst {
                    Some(_) => self::spread(&chosen.points, |point| point.worst[line])?.mean,
                    None => spread.low,
                };
                Some([spread.mean, low])
            };
            let baselines = (1..self.shown.lines.len()).map(of).collect();
            Some(Choice { name: chosen.name.clone(), file: None, own: of(0)?, baselines })
        };
        choices.iter().filter_map(choice).collect()
    }

    /// A panel for each figure, each axis that varies, and each model.
    fn marginals(&self) -> Vec<Marginal> {
        let varied: Vec<Axis> = self.plan.varied().into_iter().map(|(axis, _)| axis).collect();
        let by_model = varied.len() > 1 && varied.contains(&Axis::Model);
        let mut found = Vec::new();
        for &axis in varied.iter().filter(|axis| !by_model || **axis != Axis::Model) {
            for (of, values) in self.by_model_and_value(axis, by_model) {
                for (at, figure) in self.shown.figures.iter().enumerate() {
                    let ordinates = ordinates(&values, at, self.shown.lines.len());
                    let axis = axis.name().replace('_', " ");
                    let (figure, from, of) = (figure.name.to_owned(), figure.chance, of.clone());
                    found.push(Marginal { figure, from, axis, of, ordinates });
                }
            }
        }
        found
    }

    /// The points of each value of an axis, by model: models in the order of their first cells, values in that of the plan.
    fn by_model_and_value(&self, axis: Axis, by_model: bool) -> Vec<(String, ByValue)> {
        let mut models: Vec<(String, ByValue)> = Vec::new();
        let mut places: HashMap<(String, String), (usize, usize)> = HashMap::new();
        for &point in &self.points {
            let cell = self.plan.cell(u64::from(point.cell));
            let value = cell.value(axis);
            let model = if by_model { cell.text(Axis::Model).to_owned() } else { String::new() };
            let (model, place) = *places.entry((model.clone(), value.to_string())).or_insert_with(|| {
                let at = models.iter().position(|(name, _)| *name == model).unwrap_or_else(|| {
                    models.push((model, Vec::new()));
                    models.len() - 1
                });
                models[at].1.push((value.clone(), Vec::new()));
                (at, models[at].1.len() - 1)
            });
            models[model].1[place].1.push(point);
        }
        models
    }
}

/// The spread over the points that have the figure.
fn spread(points: &[Point], figure: impl Fn(&Point) -> f32) -> Option<Spread> {
    Spread::of(
        points.iter().map(|point| f64::from(figure(point))).filter(|figure| figure.is_finite()).collect(),
    )
}

/// A number of an axis, to four decimals.
fn short(number: f64) -> String {
    ((number * 1e4).round() / 1e4).to_string()
}

/// The content of a figure's panel at each value, or in each bin of a numeric axis.
fn ordinates(values: &ByValue, figure: usize, lines: usize) -> Vec<Ordinate> {
    let number = |value: &Value| match value {
        Value::Number(number) => Some(*number),
        Value::Whole(number) => Some(*number as f64),
        _ => None,
    };
    let ordinate = |label: String, at: Option<f64>, points: &[Point]| {
        let lines = (0..lines).map(|line| spread(points, |point| point.figures[figure][line])).collect();
        Ordinate { label, at, lines }
    };
    let numbers: Option<Vec<(f64, &ByValueEntry)>> =
        values.iter().map(|entry| Some((number(&entry.0)?, entry))).collect();
    let Some(mut numbers) = numbers else {
        return values.iter().map(|(value, points)| ordinate(value.to_string(), None, points)).collect();
    };
    numbers.sort_by(|a, b| a.0.total_cmp(&b.0));
    if numbers.len() <= MOST_ORDINATES {
        let shown =
            |(at, (value, points)): &(f64, &ByValueEntry)| ordinate(value.to_string(), Some(*at), points);
        return numbers.iter().map(shown).collect();
    }
    let (low, high) = (numbers[0].0, numbers[numbers.len() - 1].0);
    let width = (high - low) / BINS as f64;
    let mut bins = vec![Vec::new(); BINS];
    for (at, (_, points)) in numbers {
        bins[(((at - low) / width) as usize).min(BINS - 1)].extend(points.iter().copied());
    }
    let middle = |bin: usize| low + (bin as f64 + 0.5) * width;
    let filled = bins.iter().enumerate().filter(|(_, points)| !points.is_empty());
    filled.map(|(bin, points)| ordinate(short(middle(bin)), Some(middle(bin)), points)).collect()
}
