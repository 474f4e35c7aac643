//! The page of a sweep: small multiples of marginals, Pareto fronts, and tables, in one HTML file without scripts.
//!
//! A [`Marginal`] shows how a figure depends on one axis, over all values of the others; its panel draws the mean and the lowest
//! decile of the pattern and of the baseline. A [`Front`] draws the mean of each choice against its worst case.
//!
//! Invariant: the same numbers make the same bytes, and every drawing shows the baseline.

use crate::figures::page::STYLE;
use crate::figures::table::{number, table};
use crate::svg::{Anchor, Drawing, Paint, escape};

/// Colours of the pattern and of up to two baselines, which red-green blind people can tell apart; of text and of axes.
const COLORS: [&str; 3] = ["#0072b2", "#d55e00", "#009e73"];
const INK: &str = "#222222";
const GRID: &str = "#e4e4e4";
/// The area of a panel's axes, and the space around it, px.
const AREA: (f64, f64) = (300.0, 170.0);
const LEFT: f64 = 52.0;
const TOP: f64 = 26.0;
const RIGHT: f64 = 14.0;
const TEXT: u32 = 12;
/// Width of a character, px: more than most have at this size.
const CHARACTER: f64 = 6.6;
/// The most labels below a panel.
const MOST_LABELS: usize = 24;
/// The most choices that a front's drawing shows besides those on the front, and the most rows of its table.
const MOST_DOTS: usize = 500;
const MOST_ROWS: usize = 100;
/// The most characters of a label.
const MOST_CHARACTERS: usize = 14;

/// Mean and lowest decile of some numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The mean.
    pub mean: f64,
    /// The lowest decile: a tenth of the numbers is lower.
    pub low: f64,
}

impl Spread {
    /// The spread of some numbers; none if there are none.
    #[must_use]
    pub fn of(mut numbers: Vec<f64>) -> Option<Self> {
        let mean = numbers.iter().sum::<f64>() / numbers.len() as f64;
        let at = numbers.len() / 10;
        let low = *numbers.get(at)?;
        let low = if numbers.len() > 1 { *numbers.select_nth_unstable_by(at, f64::total_cmp).1 } else { low };
        Some(Self { mean, low })
    }
}

/// The figures of a panel at one value of its axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Ordinate {
    /// The value.
    pub label: String,
    /// Its position on the axis, if the axis is numeric.
    pub at: Option<f64>,
    /// The spread for the pattern, then those for the baselines.
    pub lines: Vec<Option<Spread>>,
}

/// How a figure depends on an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Marginal {
    /// The figure, with its unit.
    pub figure: String,
    /// The lower end of the figure's axis, unless there are lower figures: zero, or the chance level.
    pub from: f64,
    /// The axis.
    pub axis: String,
    /// The cells shown, as in `model afferents`; empty: all.
    pub of: String,
    /// The values of the axis, in its order.
    pub ordinates: Vec<Ordinate>,
}

/// A choice that a front compares.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// Its name.
    pub name: String,
    /// The file of its pattern, in the directory.
    pub file: Option<String>,
    /// The figure's mean, and its worst case.
    pub own: [f64; 2],
    /// Those of the baselines.
    pub baselines: Vec<Option<[f64; 2]>>,
}

/// Compares choices by their mean and their worst case.
#[derive(Clone, Debug, PartialEq)]
pub struct Front {
    /// The cells shown; empty: all.
    pub of: String,
    /// All choices.
    pub choices: Vec<Choice>,
}

/// The page of a sweep.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepPage {
    /// The title: what was swept.
    pub title: String,
    /// Facts about the sweep, each with a name.
    pub facts: Vec<(String, String)>,
    /// The names of the lines: the pattern, then the baselines; three at most.
    pub lines: Vec<String>,
    /// The figures, in words.
    pub figures: String,
    /// The figure of fronts, and what "at worst" means.
    pub worst: String,
    /// One panel each.
    pub marginals: Vec<Marginal>,
    /// One drawing and table each.
    pub fronts: Vec<Front>,
    /// The best choice of each case, with its file.
    pub best: Vec<(String, Choice)>,
}

/// The page as HTML.
#[must_use]
pub fn sweep_page(page: &SweepPage) -> String {
    let title = escape(&page.title);
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n<title>{title}</title>\n<style>\n{STYLE}\
         .multiples {{ display: flex; flex-wrap: wrap; gap: 0.5rem; width: max-content; max-width: 94vw; }}\n</style>\n</head>\n<body>\n<h1>{title}</h1>\n\
         <p>Computed from the models; nothing here was measured on hardware.</p>\n"
    );
    let facts = page.facts.iter().map(|(name, fact)| vec![name.clone(), fact.clone()]);
    html += &table(&["", ""], facts);
    let (figures, worst) = (escape(&page.figures), escape(&page.worst));
    let legend: Vec<String> = COLORS
        .iter()
        .zip(&page.lines)
        .map(|(color, line)| format!("<span style=\"color:{color}\">&#9632;</span> {}", escape(line)))
        .collect();
    let legend = legend.join(", ");
    if !page.marginals.is_empty() {
        html += &format!(
            "<h2>Marginals</h2>\n<p>{figures} {legend}. A panel shows one axis; the other axes are as in the plan, and all cells count \
             alike. Lines and dots: means. Dashed: down to the lowest decile of the cells.</p>\n<div class=\"multiples\">\n"
        );
        html.extend(page.marginals.iter().map(panel));
        html.push_str("</div>\n");
    }
    let baselines: Vec<&str> = page.lines.iter().skip(1).map(String::as_str).collect();
    if !page.fronts.is_empty() {
        html += &format!(
            "<h2>On average and at worst</h2>\n<p>{worst} {legend}. Filled: the Pareto front, which no other choice beats in both. Open: \
             the other choices, and the baselines in the same cells.</p>\n"
        );
        for front in &page.fronts {
            html += &front_html(front, &baselines);
        }
    }
    if !page.best.is_empty() {
        html.push_str("<h2>Best of each case</h2>\n");
        let rows = page.best.iter().map(|(case, choice)| {
            let mut row = vec![case.clone()];
            row.extend(cells(choice, baselines.len()));
            row.push(choice.file.clone().unwrap_or_default());
            row
        });
        let mut head = vec!["case", "choice"];
        let names = figure_names(&baselines);
        head.extend(names.iter().map(String::as_str));
        head.push("file");
        html += &table(&head, rows);
    }
    html + "</body>\n</html>\n"
}

/// Heads of the columns of [`cells`].
fn figure_names(baselines: &[&str]) -> Vec<String> {
    let of = |what: &str| {
        let own = format!("pattern {what}");
        [own].into_iter().chain(baselines.iter().map(|name| format!("{name} {what}"))).collect::<Vec<_>>()
    };
    [of("on average"), of("at worst")].concat()
}

/// A choice as a table row: its name, then the means of the pattern and the baselines, then their worst cases.
fn cells(choice: &Choice, baselines: usize) -> Vec<String> {
    let of = |at: usize| {
        let baselines = (0..baselines).map(move |line| choice.baselines.get(line).copied().flatten());
        let figures = [Some(choice.own)].into_iter().chain(baselines);
        figures.map(move |of| of.map_or_else(|| "-".to_owned(), |of| number(of[at])))
    };
    [choice.name.clone()].into_iter().chain(of(0)).chain(of(1)).collect()
}

/// The axes of a panel, which map values to pixels.
struct Panel {
    drawing: Drawing,
    y: [f64; 2],
    x: [f64; 2],
    /// The space below the axes, px.
    below: f64,
}

impl Panel {
    /// A panel whose y axis begins at `from`, with space for labels of this many characters.
    fn new(title: &str, x: [f64; 2], from: f64, ys: impl Iterator<Item = f64>, characters: usize) -> Self {
        let below = 16.0 + CHARACTER * characters.min(MOST_CHARACTERS + 1) as f64;
        let mut drawing = Drawing::new(LEFT + AREA.0 + RIGHT, TOP + AREA.1 + below);
        let (low, high) = ys.fold((from, from), |(low, high), y| (low.min(y), high.max(y)));
        let span = if high > low { high - low } else { 1.0 };
        let step = step(span / 4.0);
        let y = [(low / step).floor() * step, (high / step).ceil().max((low / step).floor() + 1.0) * step];
        drawing.words((LEFT, TOP - 10.0), TEXT, Anchor::Start, INK, title);
        let marks = ((y[1] - y[0]) / step).round();
        let mut panel = Self { drawing, y, x, below };
        for mark in 0..=marks as u32 {
            let value = y[0] + f64::from(mark) * step;
            let at = panel.down(value);
            panel.drawing.line(&[(LEFT, at), (LEFT + AREA.0, at)], 1.0, GRID);
            panel.drawing.words((4.0, at + 4.0), TEXT, Anchor::Start, INK, &number(value));
        }
        panel
    }

    fn across(&self, x: f64) -> f64 {
        let span = self.x[1] - self.x[0];
        LEFT + AREA.0 * if span > 0.0 { (x - self.x[0]) / span } else { 0.5 }
    }

    fn down(&self, y: f64) -> f64 {
        TOP + AREA.1 * (1.0 - (y - self.y[0]) / (self.y[1] - self.y[0]))
    }

    fn label(&mut self, x: f64, text: &str) {
        let mut short: String = text.chars().take(MOST_CHARACTERS).collect();
        if short.len() < text.len() {
            short.push('…');
        }
        let at = (self.across(x) + 4.0, TOP + AREA.1 + self.below - 6.0);
        self.drawing.turned(at, TEXT, Anchor::Start, INK, &short);
    }

    fn dot(&mut self, x: f64, y: f64, color: &str, filled: bool) {
        let at = (self.across(x), self.down(y));
        self.drawing.circle(at, 3.0, Paint { fill: if filled { color } else { "none" }, stroke: color });
    }
}

/// The step of marks: 1, 2 or 5 of a decade, at least this.
fn step(least: f64) -> f64 {
    let decade = 10_f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .map(|step| step * decade)
        .into_iter()
        .find(|step| *step >= least * 0.999)
        .unwrap_or(decade)
}

fn panel(marginal: &Marginal) -> String {
    let Marginal { figure, from, axis, of, ordinates } = marginal;
    let places: Vec<f64> =
        ordinates.iter().enumerate().map(|(number, of)| of.at.unwrap_or(number as f64)).collect();
    let (first, last) =
        places.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &x| (a.min(x), b.max(x)));
    let spreads = ordinates.iter().flat_map(|of| of.lines.iter().copied()).flatten();
    let title =
        if of.is_empty() { format!("{figure}, by {axis}") } else { format!("{figure}, by {axis}: {of}") };
    let longest = ordinates.iter().map(|of| of.label.chars().count()).max().unwrap_or_default();
    let ys = spreads.flat_map(|of| [of.mean, of.low]);
    let mut panel = Panel::new(&title, [first, last], *from, ys, longest);
    let every = ordinates.len().div_ceil(MOST_LABELS).max(1);
    for (ordinate, &x) in ordinates.iter().zip(&places).step_by(every) {
        panel.label(x, &ordinate.label);
    }
    // Draw the pattern last, so that no baseline covers it.
    for (line, color) in COLORS.into_iter().enumerate().rev() {
        let spreads: Vec<(f64, Spread)> = ordinates
            .iter()
            .zip(&places)
            .filter_map(|(ordinate, &x)| Some((x, ordinate.lines.get(line).copied().flatten()?)))
            .collect();
        // Names have no order, so do not connect them by lines.
        let is_line = ordinates.iter().all(|ordinate| ordinate.at.is_some());
        let mean: Vec<(f64, f64)> =
            spreads.iter().map(|(x, of)| (panel.across(*x), panel.down(of.mean))).collect();
        let low: Vec<(f64, f64)> =
            spreads.iter().map(|(x, of)| (panel.across(*x), panel.down(of.low))).collect();
        if is_line {
            panel.drawing.line(&mean, 2.0, color);
            dashed(&mut panel.drawing, &low, color);
        } else {
            for (mean, low) in mean.iter().zip(&low) {
                dashed(&mut panel.drawing, &[*mean, *low], color);
            }
        }
        for (x, of) in spreads {
            panel.dot(x, of.mean, color, line == 0);
        }
    }
    panel.drawing.finish()
}

/// A line of dashes.
fn dashed(drawing: &mut Drawing, points: &[(f64, f64)], color: &str) {
    for pair in points.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let length = (to.0 - from.0).hypot(to.1 - from.1);
        let dashes = (length / 7.0).ceil().max(1.0) as u32;
        let at = |part: f64| (from.0 + (to.0 - from.0) * part, from.1 + (to.1 - from.1) * part);
        for dash in 0..dashes {
            let of = |step: f64| (f64::from(dash) + step) / f64::from(dashes);
            drawing.line(&[at(of(0.0)), at(of(0.55))], 1.5, color);
        }
    }
}

/// The Pareto front: choices for which no other one is at least as good in both figures and better in one.
fn on_front(choices: &[Choice]) -> Vec<bool> {
    let mut order: Vec<usize> = (0..choices.len()).collect();
    let own = |number: &usize| choices[*number].own;
    order.sort_by(|a, b| own(b)[0].total_cmp(&own(a)[0]).then(own(b)[1].total_cmp(&own(a)[1])));
    let (mut found, mut highest) = (vec![false; choices.len()], f64::NEG_INFINITY);
    // Go through groups of equal mean, from the best mean down. The first of each group has the best worst case.
    for alike in order.chunk_by(|a, b| own(a)[0] == own(b)[0]) {
        let best = own(&alike[0])[1];
        for &number in alike {
            found[number] = best > highest && own(&number)[1] == best;
        }
        highest = highest.max(best);
    }
    found
}

fn front_html(front: &Front, baselines: &[&str]) -> String {
    let Front { of, choices } = front;
    let points = || {
        choices
            .iter()
            .flat_map(|choice| [Some(choice.own)].into_iter().chain(choice.baselines.iter().copied()))
            .flatten()
    };
    let (low, high) = points().fold((0.0_f64, 0.0_f64), |(a, b), [x, _]| (a.min(x), b.max(x)));
    let ys = points().map(|[_, y]| y);
    let mut panel = Panel::new("at worst (up), on average (right)", [low, high], 0.0, ys, 6);
    let step = step((high - low).max(f64::MIN_POSITIVE) / 5.0);
    let first = (low / step).ceil();
    for mark in 0..=((high / step).floor() - first).max(0.0) as u32 {
        let value = (first + f64::from(mark)) * step;
        panel.label(value, &number(value));
    }
    let on_front = on_front(choices);
    let every = choices.len().div_ceil(MOST_DOTS).max(1);
    let drawn =
        choices.iter().zip(&on_front).enumerate().filter(|(number, (_, on))| **on || number % every == 0);
    for (_, (choice, &on)) in drawn {
        for (&baseline, color) in choice.baselines.iter().zip(&COLORS[1..]) {
            if let Some([x, y]) = baseline {
                panel.dot(x, y, color, false);
            }
        }
        panel.dot(choice.own[0], choice.own[1], COLORS[0], on);
    }
    let mut best: Vec<&Choice> =
        choices.iter().zip(&on_front).filter(|(_, on)| **on).map(|(choice, _)| choice).collect();
    best.sort_by(|a, b| b.own[0].total_cmp(&a.own[0]));
    let rows = best.into_iter().take(MOST_ROWS).map(|choice| cells(choice, baselines.len()));
    let heading = if of.is_empty() { String::new() } else { format!("<h3>{}</h3>\n", escape(of)) };
    let names = figure_names(baselines);
    let head: Vec<&str> = ["on the front"].into_iter().chain(names.iter().map(String::as_str)).collect();
    let table = table(&head, rows);
    format!(
        "{heading}{}<details open>\n<summary>Pareto front</summary>\n{table}</details>\n",
        panel.drawing.finish()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choice(own: [f64; 2]) -> Choice {
        Choice { name: format!("{own:?}"), file: None, own, baselines: vec![Some([1.0, 1.0])] }
    }

    #[test]
    fn a_spread_has_the_lowest_decile() {
        let numbers: Vec<f64> = (1..=20).rev().map(f64::from).collect();
        assert_eq!(Spread::of(numbers), Some(Spread { mean: 10.5, low: 3.0 }));
        assert_eq!(Spread::of(vec![4.0]), Some(Spread { mean: 4.0, low: 4.0 }));
        assert_eq!(Spread::of(Vec::new()), None);
    }

    #[test]
    fn the_front_has_what_nothing_beats() {
        let all = [[3.0, 1.0], [2.0, 2.0], [1.0, 3.0], [1.0, 1.0], [2.0, 2.0]].map(choice);
        assert_eq!(on_front(&all), [true, true, true, false, true]);
        let alike = [[3.0, 1.0], [3.0, 0.5], [2.0, 1.0]].map(choice);
        assert_eq!(on_front(&alike), [true, false, false]);
    }

    #[test]
    fn a_page_shows_figures_baselines_and_files() {
        let spread = |mean| Some(Spread { mean, low: mean - 1.0 });
        let ordinate = |number: u8| Ordinate {
            label: number.to_string(),
            at: Some(f64::from(number)),
            lines: vec![spread(5.0), spread(3.0)],
        };
        let best = Choice { file: Some("best/<dot>.toml".to_owned()), ..choice([3.0, 1.0]) };
        let page = SweepPage {
            title: "sweep".to_owned(),
            facts: vec![("cells".to_owned(), "4".to_owned())],
            lines: vec!["pattern".to_owned(), "rule <of> thumb".to_owned()],
            figures: "Contrast, impulses/s.".to_owned(),
            worst: "At worst: the lowest decile.".to_owned(),
            marginals: vec![Marginal {
                figure: "contrast".to_owned(),
                from: 0.0,
                axis: "gain".to_owned(),
                of: String::new(),
                ordinates: [1, 2].map(ordinate).to_vec(),
            }],
            fronts: vec![Front { of: "dot".to_owned(), choices: vec![best.clone(), choice([1.0, 0.5])] }],
            best: vec![("dot".to_owned(), best)],
        };
        let html = sweep_page(&page);
        assert_eq!(html.matches("<svg ").count(), 2, "{html}");
        assert_eq!(
            html.matches(&format!("fill=\"{}\"", COLORS[0])).count(),
            3,
            "two ordinates, one on the front"
        );
        assert_eq!(html.matches(&format!("fill=\"none\" stroke=\"{}\"/>", COLORS[1])).count(), 4);
        assert!(html.contains("best/&lt;dot&gt;.toml") && html.ends_with("</html>\n"), "{html}");
        assert!(html.contains("<th>rule &lt;of&gt; thumb at worst</th>"), "{html}");
    }

    #[test]
    fn panels_without_numbers_are_drawn() {
        let empty = Ordinate { label: "x".repeat(40), at: None, lines: vec![None] };
        let [figure, axis, of] = ["contrast", "target", ""].map(str::to_owned);
        let svg = panel(&Marginal { figure, axis, of, ordinates: vec![empty], from: 0.0 });
        assert!(svg.contains("xxxxxxxxxxxxxx…") && !svg.contains("NaN"), "{svg}");
    }
}
