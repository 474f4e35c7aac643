//! The confusion matrix of a set of patterns: a drawing and its numbers.
//!
//! Rows are the patterns that are played, columns those that are named. A cell's colour and its number say how often.
//!
//! Invariant: every cell shows its number, so no reader depends on the colours.

use crate::figures::color::{color, ink};
use crate::figures::table::{csv, number};
use crate::svg::{Anchor, Drawing, Paint};
use meissner_design::Confusion;

const INK: &str = "#222222";
/// Width and height of a cell, px.
const CELL: (f64, f64) = (56.0, 30.0);
/// Width of a character of a label, px: more than any has at this size.
const CHARACTER: f64 = 8.0;
const TEXT: u32 = 13;

/// Draws a confusion matrix as SVG.
#[must_use]
pub fn plot_confusion(found: &Confusion) -> String {
    let longest = found.names.iter().map(|name| name.chars().count()).max().unwrap_or(0);
    let label = CHARACTER * longest as f64 + 16.0;
    let (left, top, n) = (label + 30.0, label + 50.0, found.names.len() as f64);
    let mut drawing = Drawing::new(left + CELL.0 * n + 20.0, top + CELL.1 * n + 20.0);
    drawing.words((left + CELL.0 * n / 2.0, 22.0), TEXT, Anchor::Middle, INK, "named, %");
    drawing.turned((18.0, top + CELL.1 * n / 2.0), TEXT, Anchor::Middle, INK, "played");
    for (row, name) in found.names.iter().enumerate() {
        let (across, down) = (left + CELL.0 * (row as f64 + 0.5), top + CELL.1 * (row as f64 + 0.5));
        drawing.words((left - label + 4.0, down + 4.0), TEXT, Anchor::Start, INK, name);
        drawing.turned((across + 4.0, top - 8.0), TEXT, Anchor::Start, INK, name);
        for (column, &percent) in found.percent[row].iter().enumerate() {
            let corner = (left + CELL.0 * column as f64, top + CELL.1 * row as f64);
            let share = percent / 100.0;
            drawing.rectangle(corner, CELL, Paint { fill: &color(share), stroke: "#ffffff" });
            let middle = (corner.0 + CELL.0 / 2.0, corner.1 + CELL.1 / 2.0 + 4.5);
            drawing.words(middle, TEXT, Anchor::Middle, ink(share), &format!("{percent:.0}"));
        }
    }
    drawing.finish()
}

/// The numbers of a confusion matrix as CSV, a row for each pair.
#[must_use]
pub fn confusion_csv(found: &Confusion) -> String {
    let pairs = found.names.iter().enumerate().flat_map(|(row, played)| {
        found.names.iter().enumerate().map(move |(column, named)| {
            format!(
                "{played},{named},{},{}",
                number(found.percent[row][column]),
                number(found.d_prime[row][column])
            )
        })
    });
    csv("played,named,percent,d_prime", pairs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pair_has_a_cell_and_a_row() {
        let found = Confusion {
            names: vec!["dot".to_owned(), "edge-45".to_owned()],
            percent: vec![vec![90.0, 10.0], vec![25.5, 74.5]],
            d_prime: vec![vec![0.0, 2.5], vec![2.5, 0.0]],
            correct_percent: 82.25,
            correct_percent_se: None,
            total_correct_percent: 60.0,
            chance_percent: 50.0,
        };
        let svg = plot_confusion(&found);
        assert_eq!((svg.matches("<rect x=").count(), svg.matches(">edge-45<").count()), (4, 2));
        assert!(svg.contains(">90<") && svg.contains(">26<"), "{svg}");
        assert_eq!(
            confusion_csv(&found),
            "played,named,percent,d_prime\ndot,dot,90,0\ndot,edge-45,10,2.5\nedge-45,dot,25.5,2.5\nedge-45,edge-45,74.5,0\n"
        );
    }
}
