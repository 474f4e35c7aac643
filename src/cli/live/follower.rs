//! Converts the events of an input device to poses of a shape.
//!
//! Relative axes (a mouse) shift the shape; it stays on the array. Absolute axes (a touchpad, a tablet) put it at their place:
//! their range is the array's area. A wheel or a knob turns it. [`Follower::hear`] takes an event, [`Follower::pose`] returns the
//! resulting pose.
//!
//! Invariant: the shift is never beyond the outermost pins.

use evdev::{AbsoluteAxisCode, EventSummary, InputEvent, RelativeAxisCode};
use meissner_api::LivePose;

/// How far a notch of a wheel or knob turns the shape, degrees.
const NOTCH_DEG: f64 = 5.0;

/// The range of an absolute axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Range {
    pub(super) least: i32,
    pub(super) most: i32,
}

impl Range {
    /// Where a value lies, -1 to 1.
    fn part(self, value: i32) -> f64 {
        let [least, most, value] = [self.least, self.most, value].map(f64::from);
        if most > least { (2.0 * (value - least) / (most - least) - 1.0).clamp(-1.0, 1.0) } else { 0.0 }
    }
}

#[derive(Debug)]
pub(super) struct Follower {
    mm_per_count: f64,
    /// The largest shift across and along the finger, mm: to the outermost pins.
    most_mm: [f64; 2],
    /// The ranges of the axes X and Y, if the device has them.
    ranges: [Option<Range>; 2],
    pose: LivePose,
}

impl Follower {
    pub(super) fn new(mm_per_count: f64, most_mm: [f64; 2], ranges: [Option<Range>; 2]) -> Self {
        Self { mm_per_count, most_mm, ranges, pose: LivePose::default() }
    }

    /// Where the shape is.
    pub(super) const fn pose(&self) -> LivePose {
        self.pose
    }

    pub(super) fn hear(&mut self, event: InputEvent) {
        match event.destructure() {
            // Moving the mouse away from the person moves the shape towards the fingertip; Y decreases.
            EventSummary::RelativeAxis(_, RelativeAxisCode::REL_X, counts) => self.shift(counts, 0),
            EventSummary::RelativeAxis(_, RelativeAxisCode::REL_Y, counts) => self.shift(0, counts),
            EventSummary::RelativeAxis(_, RelativeAxisCode::REL_WHEEL, notches) => {
                self.turn(f64::from(notches));
            }
            // A knob counts up when turned clockwise.
            EventSummary::RelativeAxis(_, RelativeAxisCode::REL_DIAL, notches) => {
                self.turn(-f64::from(notches));
            }
            EventSummary::AbsoluteAxis(_, AbsoluteAxisCode::ABS_X, value) => self.place(Some(value), None),
            EventSummary::AbsoluteAxis(_, AbsoluteAxisCode::ABS_Y, value) => self.place(None, Some(value)),
            _ => {}
        }
    }

    fn shift(&mut self, x: i32, y: i32) {
        let [most_x, most_y] = self.most_mm;
        let LivePose { x_mm, y_mm, .. } = &mut self.pose;
        *x_mm = (*x_mm + f64::from(x) * self.mm_per_count).clamp(-most_x, most_x);
        *y_mm = (*y_mm - f64::from(y) * self.mm_per_count).clamp(-most_y, most_y);
    }

    /// Puts the shape where the absolute axes are.
    pub(super) fn place(&mut self, x: Option<i32>, y: Option<i32>) {
        let [x_range, y_range] = self.ranges;
        if let (Some(value), Some(range)) = (x, x_range) {
            self.pose.x_mm = range.part(value) * self.most_mm[0];
        }
        if let (Some(value), Some(range)) = (y, y_range) {
            self.pose.y_mm = -range.part(value) * self.most_mm[1];
        }
    }

    fn turn(&mut self, notches: f64) {
        // After hours of turning the angle is still a small number.
        self.pose.angle_deg = (self.pose.angle_deg + notches * NOTCH_DEG) % 360.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evdev::EventType;

    fn after(mut follower: Follower, events: &[InputEvent]) -> [f64; 3] {
        events.iter().for_each(|&event| follower.hear(event));
        let LivePose { x_mm, y_mm, angle_deg, .. } = follower.pose();
        [x_mm, y_mm, angle_deg].map(|value| (value * 1e9).round() / 1e9)
    }

    fn relative(axis: RelativeAxisCode, value: i32) -> InputEvent {
        InputEvent::new(EventType::RELATIVE.0, axis.0, value)
    }

    fn absolute(axis: AbsoluteAxisCode, value: i32) -> InputEvent {
        InputEvent::new(EventType::ABSOLUTE.0, axis.0, value)
    }

    const X: RelativeAxisCode = RelativeAxisCode::REL_X;
    const Y: RelativeAxisCode = RelativeAxisCode::REL_Y;

    #[test]
    fn a_mouse_shifts_the_shape_and_its_wheel_turns_it() {
        let mouse = || Follower::new(0.02, [4.35, 7.25], [None; 2]);
        let report = InputEvent::new(EventType::SYNCHRONIZATION.0, 0, 0);
        let button = InputEvent::new(EventType::KEY.0, 0x110, 1);
        let moved = [relative(X, 50), relative(Y, -100), report, button, relative(X, -10), report];
        assert_eq!(after(mouse(), &moved), [0.8, 2.0, 0.0], "right, and away from the person");
        let wheel = |notches| relative(RelativeAxisCode::REL_WHEEL, notches);
        assert_eq!(after(mouse(), &[wheel(1), wheel(2)]), [0.0, 0.0, 15.0]);
        assert_eq!(after(mouse(), &[relative(RelativeAxisCode::REL_DIAL, 1)]), [0.0, 0.0, -5.0], "clockwise");
        assert_eq!(after(mouse(), &[wheel(73)]), [0.0, 0.0, 5.0]);
    }

    #[test]
    fn the_shape_stays_on_the_array() {
        let mouse = Follower::new(0.02, [4.35, 7.25], [None; 2]);
        let far = [relative(X, 10_000), relative(Y, i32::MAX), relative(X, -50)];
        // The shape leaves the edge at once when the mouse turns back.
        assert_eq!(after(mouse, &far), [3.35, -7.25, 0.0]);
    }

    #[test]
    fn a_tablets_area_is_the_arrays() {
        let tablet = || {
            Follower::new(
                0.02,
                [4.35, 7.25],
                [Some(Range { least: 100, most: 300 }), Some(Range { least: 0, most: 10 })],
            )
        };
        let at = |x, y| {
            after(tablet(), &[absolute(AbsoluteAxisCode::ABS_X, x), absolute(AbsoluteAxisCode::ABS_Y, y)])
        };
        assert_eq!(at(100, 0), [-4.35, 7.25, 0.0], "the top left");
        assert_eq!(at(200, 5), [0.0, 0.0, 0.0]);
        assert_eq!(at(300, 10), [4.35, -7.25, 0.0]);
        assert_eq!(at(999, -1), [4.35, 7.25, 0.0], "beyond its own range");
        let pressure = absolute(AbsoluteAxisCode::ABS_PRESSURE, 7);
        assert_eq!(after(tablet(), &[pressure]), [0.0, 0.0, 0.0]);
        let flat = Follower::new(0.02, [4.35, 7.25], [Some(Range { least: 5, most: 5 }), None]);
        assert_eq!(after(flat, &[absolute(AbsoluteAxisCode::ABS_X, 5)]), [0.0; 3]);
    }
}
