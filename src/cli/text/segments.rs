//! The segments of a pattern: times in which the same drives run.
//!
//! A segment ends when a drive starts or stops. Neighbouring segments with equal drives are merged. Drives of amplitude 0
//! are left out. Times in the same tick are equal.
//!
//! Invariant: segments follow each other without a gap, from 0 to the end of the pattern. No motor occurs twice in one.

use meissner_array::pattern::Drive;
use meissner_array::units::TickRate;

/// A time in which the same drives run.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Segment {
    /// When it begins, s.
    pub(super) start_s: f64,
    /// When it ends, s; none if it does not end.
    pub(super) stop_s: Option<f64>,
    /// The drives that run.
    pub(super) drives: Vec<Drive>,
}

/// The segments of some drives, at least one, by the ticks of their array. Without a duration the pattern ends when its last drive
/// stops.
pub(super) fn segments(rate: TickRate, drives: &[Drive], duration_s: Option<f64>) -> Vec<Segment> {
    let tick = |seconds: f64| rate.seconds_to_ticks(seconds);
    let drives: Vec<Drive> = drives.iter().filter(|drive| drive.amplitude_um > 0.0).copied().collect();
    let ends = |drive: &Drive| drive.stop_s.unwrap_or(f64::INFINITY);
    let end = duration_s.unwrap_or_else(|| drives.iter().map(ends).fold(0.0, f64::max));
    let end = if drives.is_empty() { duration_s.unwrap_or(f64::INFINITY) } else { end };
    let mut bounds: Vec<f64> = drives.iter().flat_map(|drive| [drive.start(), ends(drive)]).collect();
    bounds.extend([0.0, end]);
    bounds.retain(|&at| at <= end);
    bounds.sort_by(f64::total_cmp);
    bounds.dedup_by_key(|at| tick(*at));

    let mut found: Vec<Segment> = Vec::new();
    for pair in bounds.windows(2) {
        let [from, to] = [pair[0], pair[1]].map(tick);
        let runs = |drive: &&Drive| tick(drive.start()) <= from && tick(ends(drive)) >= to;
        let running: Vec<Drive> = drives.iter().filter(runs).copied().collect();
        let stop_s = Some(pair[1]).filter(|stop| stop.is_finite());
        match found.last_mut() {
            Some(last) if last.drives == running => last.stop_s = stop_s,
            _ => found.push(Segment { start_s: pair[0], stop_s, drives: running }),
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::spec::{self, Array};

    fn of_paper(drives: &[Drive], duration_s: Option<f64>) -> Vec<Segment> {
        segments(Array::paper().rate(), drives, duration_s)
    }

    fn drive(motor: u8, start_s: Option<f64>, stop_s: Option<f64>) -> Drive {
        Drive { motor, frequency_hz: 60.0, amplitude_um: 80.0, phase: 0.0, start_s, stop_s }
    }

    fn motors(segment: &Segment) -> Vec<u8> {
        segment.drives.iter().map(|drive| drive.motor).collect()
    }

    #[test]
    fn steady_drives_are_one_segment() {
        for duration_s in [None, Some(5.0)] {
            let found = of_paper(&[drive(3, None, None), drive(4, Some(0.0), duration_s)], duration_s);
            assert_eq!((found.len(), found[0].start_s, found[0].stop_s), (1, 0.0, duration_s));
            assert_eq!(motors(&found[0]), [3, 4]);
        }
        let off = Drive { amplitude_um: 0.0, ..drive(3, Some(1.0), None) };
        for nothing in [&[][..], &[off]] {
            assert_eq!(of_paper(nothing, None), [Segment { start_s: 0.0, stop_s: None, drives: vec![] }]);
        }
    }

    #[test]
    fn starts_and_stops_end_a_segment_and_gaps_are_segments() {
        let drives = [drive(0, None, Some(1.0)), drive(1, Some(0.5), Some(1.0)), drive(2, Some(2.0), None)];
        let found = of_paper(&drives, Some(3.0));
        let times: Vec<_> = found.iter().map(|segment| (segment.start_s, segment.stop_s.unwrap())).collect();
        assert_eq!(times, [(0.0, 0.5), (0.5, 1.0), (1.0, 2.0), (2.0, 3.0)]);
        let found: Vec<_> = found.iter().map(motors).collect();
        assert_eq!(found, [vec![0], vec![0, 1], vec![], vec![2]]);
    }

    #[test]
    fn without_a_duration_the_last_stop_ends_the_pattern() {
        let found = of_paper(&[drive(0, None, Some(1.0)), drive(1, Some(1.0), Some(2.5))], None);
        assert_eq!(found.last().unwrap().stop_s, Some(2.5));
        assert_eq!(found.len(), 2);
        let found = of_paper(&[drive(0, None, Some(1.0)), drive(1, None, None)], None);
        assert_eq!((found.len(), found[1].stop_s), (2, None));
        // 0.1 + 0.2 is a little more than 0.3.
        let found = of_paper(&[drive(0, None, Some(0.1 + 0.2)), drive(1, Some(0.3), Some(0.5))], None);
        assert_eq!(found.iter().map(motors).collect::<Vec<_>>(), [[0], [1]]);
    }

    #[test]
    fn times_in_one_tick_of_an_array_are_equal() {
        for array in spec::names().into_iter().map(|name| Array::named(name).unwrap()) {
            let tick_s = array.rate().ticks_to_seconds(1);
            for (ticks, expected) in [(0.4, 2), (1.0, 3)] {
                let drives = [drive(0, None, Some(1.0)), drive(1, Some(1.0 + ticks * tick_s), None)];
                let found = segments(array.rate(), &drives, Some(2.0));
                assert_eq!(found.len(), expected, "{array:?}: {found:?}");
            }
        }
    }
}
