//! Frames that are too short for one stroke of a slow drive.

use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_array::strokes::{DriveStrokes, StrokeOptions, reached};
use meissner_paper::{
    Budget, Fidelity, Frame, Made, Objective, Request, Rule, Setting, Target, Vibration, make, shipped,
};
use std::ops::ControlFlow::Continue;

/// An edge that crosses the array in a tenth of a second, in frames of 12.5 ms: at 60 Hz a stroke of 80 um takes 15.3 ms.
fn fast() -> Target {
    let text = r#"
name = "fast"
shape = "segment"
points = [[-5.0, 0.0], [5.0, 0.0]]
reach_mm = 1.5
[motion]
duration_s = 0.1
speed_mm_s = 80.0
direction_deg = 90.0
frames = 8
"#;
    Target::read(text, "fast.toml").unwrap()
}

fn made(setting: Setting) -> Made {
    let budget = Budget::Evaluations(vec![120]);
    let request = Request { setting, seed: 3, budget, ..Request::default() };
    make(&fast(), "fast", &request, &mut |_| Continue(())).unwrap()
}

fn has_stroke(drive: &Drive) -> bool {
    DriveStrokes::of(Array::paper(), drive).unwrap().next().is_some()
}

#[test]
fn a_pattern_for_short_frames_has_no_drive_without_a_stroke() {
    for setting in [Setting::Default, Setting::AlwaysOn] {
        let made = made(setting);
        let found = reached(&made.pattern, &StrokeOptions::default()).unwrap();
        let silent = found.iter().filter(|drive| drive.strokes == Some(0)).count();
        assert_eq!(silent, 0, "{setting:?}: of {} drives", found.len());
        assert!(!found.is_empty());
        if setting == Setting::AlwaysOn {
            assert_eq!(found.len(), 24 * 8, "every motor moves in every frame");
        }
        // The rules of thumb are judged by strokes, too.
        assert!(made.baselines.iter().any(|baseline| baseline.verdict.on_hz > 0.0));
    }
}

#[test]
fn naive_rules_move_pins_in_short_frames() {
    for rule in Rule::ALL {
        let drives = rule.drives(&fast());
        assert!(!drives.is_empty() && drives.iter().all(has_stroke), "{rule:?}");
        assert!(rule.drives(&shipped("dot").unwrap()).iter().all(|drive| drive.frequency_hz == 60.0));
    }
}

#[test]
fn a_space_in_a_frame_has_exactly_the_vibrations_with_a_stroke() {
    let target = fast();
    for frame in target.frames() {
        let Frame { start_s, stop_s, .. } = *frame;
        for setting in [Setting::Default, Setting::AlwaysOn] {
            let plain = setting.space(Array::paper());
            let space = plain.clone().in_frame(frame, 80.0);
            assert!(*space.decihertz.start() > 600 && space.decihertz.end() == plain.decihertz.end());
            for (decihertz, percent) in
                (50..=1500).step_by(7).flat_map(|hz| (0..100).step_by(9).map(move |p| (hz, p)))
            {
                let (hz, phase) = (f64::from(decihertz) / 10.0, f64::from(percent) / 100.0);
                let drive = |frequency_hz| Drive {
                    motor: 0,
                    frequency_hz,
                    amplitude_um: 80.0,
                    phase,
                    start_s,
                    stop_s,
                };
                let motion = space.motion(hz, phase);
                match motion {
                    None => {
                        assert!(
                            space.may_be_off
                                && !has_stroke(&drive(hz.max(f64::from(*space.decihertz.start()) / 10.0)))
                        );
                    }
                    Some(of) => {
                        assert!(has_stroke(&drive(of.frequency_hz())) && of.percent == percent);
                        assert!(
                            of.decihertz == decihertz || !has_stroke(&drive(hz)),
                            "{setting:?} {hz} {of:?}"
                        );
                    }
                }
            }
            assert!(space.random(1).0.iter().all(Option::is_some));
        }
    }
}

#[test]
fn a_vibration_without_a_stroke_scores_as_a_motor_that_is_off() {
    let target = fast();
    let frame = &target.frames()[3];
    let space = Setting::Default.space(Array::paper()).in_frame(frame, 80.0);
    let objective = Objective::new(&target, frame, &[0], 0, Fidelity::FULL);
    let mut point = space.random(5);
    point.0[9] = Some(Vibration { decihertz: 200, percent: 40 });
    let nearest = space.nearest(&point);
    assert!(nearest.0[9].is_none() && nearest.0[10] == point.0[10]);
    assert_eq!(objective.at(point).unwrap().score(), objective.at(nearest).unwrap().score());
}

#[test]
fn targets_at_rest_and_amplitudes_without_a_stroke_keep_their_space() {
    let still = shipped("dot").unwrap();
    for setting in [Setting::Default, Setting::AlwaysOn] {
        assert_eq!(
            setting.space(Array::paper()).in_frame(&still.frames()[0], 80.0),
            setting.space(Array::paper())
        );
        assert_eq!(
            setting.space(Array::paper()).in_frame(&fast().frames()[0], 0.05),
            setting.space(Array::paper())
        );
    }
}
