//! Contact against closed solutions, and how it converges as grains become finer.

use meissner_skin::afferents::{ELASTICITY, POISSON};
use meissner_touch::{Contact, Grains, solve};

const MODULUS: f64 = ELASTICITY / (1.0 - POISSON * POISSON);

/// Grains of a round object of this radius, whose height is given by the distance from its middle.
fn round(pitch_mm: f64, radius_mm: f64, height_mm: impl Fn(f64) -> f64) -> Grains {
    let count = (radius_mm / pitch_mm).ceil() as usize;
    let first = -(count as f64 - 0.5) * pitch_mm;
    let distance = |[column, row]: [usize; 2]| {
        let [x, y] = [column, row].map(|index| first + index as f64 * pitch_mm);
        (x * x + y * y).sqrt()
    };
    let cells: Vec<_> =
        (0..2 * count).flat_map(|row| (0..2 * count).map(move |column| [column, row])).collect();
    let cells: Vec<_> = cells.into_iter().filter(|&cell| distance(cell) < radius_mm).collect();
    let heights = cells.iter().map(|&cell| height_mm(distance(cell))).collect();
    Grains::new(pitch_mm, pitch_mm / 2.0, [first; 2], cells, heights)
}

/// A flat round punch of radius R has the load 2REδ/(1 − ν²) (Sneddon 1946).
#[test]
fn the_load_of_a_flat_punch_converges_to_the_books() {
    let (radius_mm, depth_mm) = (3.0, 0.5);
    let exact = 2.0 * radius_mm * MODULUS * depth_mm;
    for (pitch_mm, within) in [(0.4, 0.02), (0.2, 0.01), (0.1, 0.001)] {
        let grains = round(pitch_mm, radius_mm, |_| 0.0);
        let load: f64 = solve(&grains, depth_mm, None).unwrap().iter().sum();
        assert!((load / exact - 1.0).abs() < within, "{pitch_mm}: {}", load / exact);
    }
}

/// A sphere has the load 4/3·E/(1 − ν²)·√R·δ^1.5 and a contact of radius √(Rδ) (Hertz). The error of the load halves with the pitch.
#[test]
fn the_load_of_a_sphere_converges_to_hertzs_with_the_pitch() {
    let (radius_mm, depth_mm) = (8.0_f64, 0.5_f64);
    let exact = 4.0 / 3.0 * MODULUS * radius_mm.sqrt() * depth_mm.powf(1.5);
    let mut last: Option<f64> = None;
    for pitch_mm in [0.4, 0.2, 0.1] {
        let grains = round(pitch_mm, 3.0, |from_middle| -from_middle * from_middle / (2.0 * radius_mm));
        let loads = solve(&grains, depth_mm, None).unwrap();
        assert!(loads.iter().all(|&load| load >= 0.0));
        let touching = loads.iter().filter(|&&load| load > 0.0).count() as f64;
        let contact_mm = (touching / std::f64::consts::PI).sqrt() * pitch_mm;
        assert!((contact_mm / (radius_mm * depth_mm).sqrt() - 1.0).abs() < 0.01, "{pitch_mm}: {contact_mm}");
        let error = loads.iter().sum::<f64>() / exact - 1.0;
        assert!(error > 0.0 && last.is_none_or(|last| error < 0.55 * last), "{pitch_mm}: {error}");
        last = Some(error);
    }
}

/// Between two of the solved depths, loads are interpolated. The sum is close; a grain at the rim, where contact begins, has the largest
/// error.
#[test]
fn interpolated_loads_are_close_to_solved_ones() {
    let (most_mm, radius_mm) = (1.0, 8.0);
    let grains = round(0.2, 3.5, |from_middle| -from_middle * from_middle / (2.0 * radius_mm));
    let contact = Contact::new(grains.clone(), most_mm).unwrap();
    let (total, largest) = contact
        .loads_n(most_mm)
        .into_iter()
        .fold((0.0, 0.0_f64), |(sum, most), load| (sum + load, most.max(load)));
    for depth_mm in [0.02, 0.06, 0.13, 0.29, 0.47, 0.63, 0.81, 0.95, 1.0] {
        let exact = solve(&grains, depth_mm, None).unwrap();
        let found = contact.loads_n(depth_mm);
        let sums = [&exact, &found].map(|loads| loads.iter().sum::<f64>());
        let worst = exact.iter().zip(&found).map(|(exact, found)| (exact - found).abs()).fold(0.0, f64::max);
        let errors = [(sums[1] - sums[0]).abs() / total, worst / largest];
        assert!(errors[0] < 0.002 && errors[1] < 0.1, "{depth_mm}: {errors:?}");
    }
}
