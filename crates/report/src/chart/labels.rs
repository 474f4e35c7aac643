//! Places the labels of points so that no label covers another one, a marker or a line.
//!
//! Invariant: a label without a free place is left out.

/// Width of a character and height of a line of labels, px, at [`super::LABEL`] px.
const CHARACTER: (i32, i32) = (7, 13);
/// Half the side of the square that a marker takes, px.
const MARKER: i32 = 6;
/// Half the side of the squares that a line takes, and their distance, px.
const LINE: i32 = 2;
const EVERY: i32 = 4;
/// Distances of a label from its point, px.
const DISTANCES: [i32; 2] = [4, 16];

/// A rectangle: left, top, right, bottom, px.
pub(super) type Place = [i32; 4];

fn overlap(a: &Place, b: &Place) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}

/// The place of each label, in the order of `labelled`, which has its point and text. `markers` are all points, `lines` all lines,
/// `area` is where labels may lie.
pub(super) fn place(
    labelled: &[((i32, i32), &str)],
    markers: &[(i32, i32)],
    lines: &[Vec<(i32, i32)>],
    area: Place,
) -> Vec<Option<Place>> {
    let square = |(x, y): (i32, i32), half: i32| [x - half, y - half, x + half, y + half];
    let mut taken: Vec<Place> = markers.iter().map(|&at| square(at, MARKER)).collect();
    for ends in lines.iter().flat_map(|line| line.windows(2)) {
        let [from, to] = [ends[0], ends[1]];
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let pieces = (dx.abs().max(dy.abs()) / EVERY).max(1);
        taken
            .extend((0..=pieces).map(|n| square((from.0 + dx * n / pieces, from.1 + dy * n / pieces), LINE)));
    }
    let mut free = |&((x, y), text): &((i32, i32), &str)| {
        let width = CHARACTER.0 * i32::try_from(text.chars().count()).unwrap_or(i32::MAX / 16);
        let height = CHARACTER.1;
        let candidates = DISTANCES.into_iter().flat_map(|far| {
            let [left, right] = [x - MARKER - far - width, x + MARKER + far];
            let [above, below] = [y - MARKER - far - height, y + MARKER + far];
            let (middle, level) = (x - width / 2, y - height / 2);
            [
                (right, level),
                (middle, above),
                (middle, below),
                (left, level),
                (right, above),
                (left, above),
                (right, below),
                (left, below),
            ]
        });
        let places = candidates.map(|(left, top)| [left, top, left + width, top + height]);
        let inside =
            |at: &Place| at[0] >= area[0] && at[1] >= area[1] && at[2] <= area[2] && at[3] <= area[3];
        let found = places.into_iter().find(|at| inside(at) && !taken.iter().any(|other| overlap(at, other)));
        taken.extend(found);
        found
    };
    labelled.iter().map(&mut free).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_never_overlap() {
        let area = [0, 0, 200, 200];
        // Sixteen points close together, and one at the edge.
        let mut points: Vec<(i32, i32)> = (0..16).map(|n| (80 + 9 * (n % 4), 90 + 9 * (n / 4))).collect();
        points.push((198, 198));
        let labelled: Vec<_> = points.iter().map(|&at| (at, "100 µs")).collect();
        let places = place(&labelled, &points, &[], area);
        let found: Vec<Place> = places.iter().flatten().copied().collect();
        for (index, one) in found.iter().enumerate() {
            assert!(found[index + 1..].iter().all(|other| !overlap(one, other)));
            assert!(
                points.iter().all(|&(x, y)| !(one[0]..one[2]).contains(&x) || !(one[1]..one[3]).contains(&y))
            );
            assert!(one[0] >= 0 && one[2] <= 200 && one[3] <= 200);
        }
        assert!(places[16].is_some_and(|at| at[2] < 198));
        assert!((2..16).contains(&found.len()), "not all find a place: {}", found.len());
        let alone = place(&[((100, 100), "1 µs")], &[(100, 100)], &[], area);
        assert_eq!(alone, [Some([110, 94, 138, 107])]);
        let crossed = place(&[((100, 100), "1 µs")], &[(100, 100)], &[vec![(100, 100), (190, 100)]], area);
        assert_eq!(crossed, [Some([86, 77, 114, 90])], "above the point, not on its line");
    }
}
