//! A cell of `discriminate`: two patterns on a finger, told apart by counts, by times, and by the number of all spikes.

use super::{Column, Figure, Figures, Outcome, model, number, scaled, some};
use crate::axis::{Axis, Value};
use crate::plan::{Cell, Plan};
use meissner_array::pattern::Pattern;
use meissner_design::{ClassReadings, Plan as Comparison, discriminate};
use meissner_skin::SkinModel;
use meissner_skin::afferents::Class;
use meissner_skin::membrane::{AfferentModel, POPULATION_NOISE_SD, Rectify};

pub(super) const COLUMNS: &[Column] = &[
    number("d_prime_counts", "d' of the ideal observer of all afferents' counts"),
    number("d_prime_times", "d' of an observer of spike times in bins, a lower bound"),
    number("d_prime_total", "d' by the number of all spikes alone, the baseline"),
    number("d_prime_counts_se", "standard error of d' by counts, from the trials"),
    number("correct_counts_percent", "correct answers of two intervals by counts, at the efficiency"),
    number("correct_times_percent", "the same by times"),
    number("correct_total_percent", "the same by the number of all spikes"),
    number("d_prime_counts_sa1", "d' by counts of SA1 afferents alone; none in the model membrane"),
    number("d_prime_counts_ra", "d' by counts of RA afferents alone"),
    number("d_prime_counts_pc", "d' by counts of PC afferents alone; none in the model membrane"),
];

pub(super) const FIGURES: Figures = Figures {
    lines: &["by each count", "by all spikes"],
    figures: &[
        Figure { name: "d'", columns: &["d_prime_counts", "d_prime_total"], chance: 0.0 },
        Figure {
            name: "correct, %",
            columns: &["correct_counts_percent", "correct_total_percent"],
            chance: 50.0,
        },
    ],
    worst: None,
    rank: "d_prime_counts",
};

pub(super) fn compute(plan: &Plan, cell: &Cell) -> Result<Outcome, String> {
    let scale = cell.number(Axis::Scale);
    let pattern = |axis: Axis| -> Result<Pattern, String> {
        let pattern = plan.documents().pattern(cell.text(axis));
        let drives = scaled(pattern.drives(), scale);
        let provenance = toml::Table::new();
        let scaled = Pattern::new(pattern.array(), pattern.name(), pattern.duration_s(), drives, provenance);
        scaled.map_err(|error| error.to_string())
    };
    let (one, other) = (pattern(Axis::Pattern)?, pattern(Axis::Other)?);
    let membrane = AfferentModel::default_for(Rectify::default(), POPULATION_NOISE_SD);
    let comparison = Comparison {
        model: SkinModel::of(model(cell), membrane),
        trials: cell.whole(Axis::Trials) as usize,
        fingers: vec![cell.whole(Axis::Finger)],
        seconds: cell.number(Axis::IntervalS),
        resolution_ms: cell.number(Axis::ResolutionMs),
        seed: cell.whole(Axis::Seed),
        efficiency: cell.number(Axis::Efficiency),
    };
    comparison.check(2)?;
    let classes = discriminate([&one, &other], &comparison, &|_| ()).map_err(|error| error.to_string())?;
    let all = classes.last().expect("a model has classes");
    let of_class = |class: Class| -> Option<Value> {
        let of: &ClassReadings = classes.iter().find(|of| of.class == Some(class))?;
        some(of.counts.d_prime)
    };
    let row = vec![
        some(all.counts.d_prime),
        some(all.times.d_prime),
        some(all.total.d_prime),
        some(all.counts.d_prime_se),
        some(all.counts.correct_percent),
        some(all.times.correct_percent),
        some(all.total.correct_percent),
        of_class(Class::Sa1),
        of_class(Class::Ra),
        of_class(Class::Pc),
    ];
    Ok(Outcome { row, pattern: None })
}
