use meissner_paper::{Partition, shipped};
use meissner_skin::membrane::{self, Position};
use meissner_touch::Shape;
use proptest::prelude::*;

fn point() -> impl Strategy<Value = [f64; 2]> {
    [-9.0..9.0, -12.0..12.0]
}

fn shape() -> impl Strategy<Value = Shape> {
    prop_oneof![
        prop::collection::vec(point(), 2..6).prop_map(Shape::Polyline),
        prop::collection::vec(point(), 1..6).prop_map(Shape::Dots),
        (point(), 0.0..6.0).prop_map(|(center_mm, radius_mm)| Shape::Disc { center_mm, radius_mm }),
        (1.0..12.0, -360.0..360.0, -20.0..20.0).prop_map(|(period_mm, angle_deg, offset_mm)| {
            Shape::Grating { period_mm, angle_deg, offset_mm }
        }),
    ]
}

/// Places on the shape, close together.
fn samples(shape: &Shape) -> Vec<[f64; 2]> {
    const PIECES: u32 = 2000;
    let parts = || (0..=PIECES).map(|piece| f64::from(piece) / f64::from(PIECES));
    let between =
        |a: [f64; 2], b: [f64; 2]| parts().map(move |t| [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]);
    match shape {
        Shape::Polyline(points) => points.windows(2).flat_map(|ends| between(ends[0], ends[1])).collect(),
        Shape::Dots(dots) => dots.clone(),
        Shape::Disc { center_mm: [x, y], radius_mm } => parts()
            .map(|t| (t * std::f64::consts::TAU).sin_cos())
            .map(|(sin, cos)| [x + radius_mm * cos, y + radius_mm * sin])
            .collect(),
        Shape::Grating { period_mm, angle_deg, offset_mm } => {
            let (sin, cos) = angle_deg.to_radians().sin_cos();
            let at = |along: f64, up: f64| [along * cos - up * sin, along * sin + up * cos];
            let line = |number: i32| offset_mm + f64::from(number) * period_mm;
            (-50..=50).flat_map(|number| between(at(-20.0, line(number)), at(20.0, line(number)))).collect()
        }
    }
}

proptest! {
    #[test]
    fn distances_are_those_of_the_nearest_sample(shape in shape(), [x, y] in point()) {
        let near = samples(&shape).iter().map(|at| (at[0] - x).hypot(at[1] - y)).fold(f64::INFINITY, f64::min);
        let inside = matches!(&shape, Shape::Disc { center_mm, radius_mm }
            if (center_mm[0] - x).hypot(center_mm[1] - y) <= *radius_mm);
        let found = shape.distance_mm(Position { x_mm: x, y_mm: y });
        let expected = if inside { 0.0 } else { near };
        // Samples are up to 0.02 mm apart.
        prop_assert!((found - expected).abs() < 0.011, "{found} {expected}");
    }

    #[test]
    fn a_place_that_moves_with_the_shape_keeps_its_distance(
        shape in shape(), [x, y] in point(), by in point(), turned_deg in -400.0..400.0
    ) {
        let (sin, cos) = f64::to_radians(turned_deg).sin_cos();
        let moved = Position { x_mm: x * cos - y * sin + by[0], y_mm: x * sin + y * cos + by[1] };
        let (before, after) =
            (shape.distance_mm(Position { x_mm: x, y_mm: y }), shape.moved(by, turned_deg).distance_mm(moved));
        prop_assert!((before - after).abs() < 1e-9, "{before} {after}");
    }

    #[test]
    fn the_outline_lies_on_the_shape(shape in shape()) {
        for [x_mm, y_mm] in shape.outline().concat() {
            let found = shape.distance_mm(Position { x_mm, y_mm });
            prop_assert!(found < 1e-9, "{found} at {x_mm} {y_mm}");
        }
    }

    #[test]
    fn the_auc_is_a_count_of_pairs(rates in prop::collection::vec(0_u8..9, 306), seed in 0..9_u64) {
        let rates: Vec<f64> = rates.into_iter().map(f64::from).collect();
        let edge = shipped("edge-45").unwrap();
        let partition = Partition::of(&edge.frames()[0].shape, 1.5, &membrane::population(seed));
        let of = |on: bool| {
            let rates = partition.on().iter().zip(&rates).filter(move |(is_on, _)| **is_on == on);
            rates.map(|(_, &rate)| rate).collect::<Vec<f64>>()
        };
        let (on, off) = (of(true), of(false));
        let wins = |a: f64, b: f64| if a > b { 1.0 } else if a == b { 0.5 } else { 0.0 };
        let sum: f64 = on.iter().map(|&a| off.iter().map(|&b| wins(a, b)).sum::<f64>()).sum();
        let expected = sum / (on.len() * off.len()) as f64;
        prop_assert!((partition.auc(&rates).unwrap() - expected).abs() < 1e-12);
        let mean = |rates: &[f64]| rates.iter().sum::<f64>() / rates.len() as f64;
        prop_assert!((partition.cost_hz(&rates).unwrap() - (mean(&on) - mean(&off))).abs() < 1e-12);
    }
}
