//! From patterns to strokes: exact ticks, repeats and cuts, and invariants on random patterns.

use firmware_protocol::tick::Tick;
use meissner_array::motion::TRIED_S;
use meissner_array::motor::SquareWave;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::per_motor::PerMotor;
use meissner_array::reflected_walk::Spread;
use meissner_array::spec::Array;
use meissner_array::strokes::Stroke;
use meissner_array::strokes::{
    AutoSurplus, Fit, Sequence, Start, StrokeOptions, Strokes, StrokesError, Surplus, reached,
};
use meissner_test_support::paper::UM_PER_PULSE;
use meissner_test_support::patterns::{self, drive};
use proptest::prelude::*;

fn pattern(duration_s: Option<f64>, drives: Vec<Drive>) -> Pattern {
    patterns::pattern("test", duration_s, drives)
}

fn all(pattern: &Pattern, seconds: Option<f64>) -> Vec<Stroke> {
    with(pattern, &StrokeOptions::lasting(seconds))
}

fn with(pattern: &Pattern, options: &StrokeOptions) -> Vec<Stroke> {
    Strokes::new(pattern, options).unwrap().map(|step| step.unwrap().stroke().unwrap()).collect()
}

/// The strokes of a pattern by the rule of the model, drive by drive and sorted at the end: what `Strokes` must return.
fn by_the_rule(pattern: &Pattern, options: &StrokeOptions) -> Vec<Stroke> {
    let ticks = |seconds: f64| (seconds * 85_000.0 + 0.5).floor() as u64;
    let end = ticks(options.seconds.unwrap());
    let Surplus::Fixed(surplus_um) = options.surplus else { panic!("{options:?}") };
    let asked = (surplus_um / (0.95 / 7.0) - 1e-9).ceil() as u64;
    let surplus = |pulses: u64| if asked == 0 { 0 } else { asked.min((pulses * 3 / 10).max(1)) };
    let mut strokes = Vec::new();
    for repeat in 0.. {
        let begin = |repeat: i32| {
            pattern.duration_s().map(|d| (f64::from(repeat) * d * 85_000.0 + 0.5).floor() as u64)
        };
        let start = begin(repeat).unwrap_or(0);
        if start >= end || (repeat > 0 && pattern.duration_s().is_none()) {
            break;
        }
        // A play that covers its end goes beyond the last repeat.
        let covers = options.fit == Fit::Cover && begin(repeat + 1).is_none_or(|next| next >= end);
        for drive in pattern.drives() {
            let mut wanted = (drive.amplitude_um * options.scale / (0.95 / 7.0) + 0.5).floor() as u64;
            let period = 85_000.0 / drive.frequency_hz + 1e-9;
            if asked > 0 {
                wanted = wanted.min((period / 2.0).floor() as u64);
                while (2 * wanted + surplus(wanted)) as f64 > period {
                    wanted -= 1;
                }
            }
            let edge = |h: i32| {
                let tick = ((f64::from(h) / 2.0 + drive.phase) * 85_000.0) / drive.frequency_hz + 0.5;
                start + tick.floor() as u64 + drive.start_s.map_or(0, ticks)
            };
            for h in (0..).step_by(2) {
                let (up, down) = (edge(h), edge(h + 1));
                let pulses = wanted.min(down - up).min(edge(h + 2) - down);
                let back = pulses + surplus(pulses);
                let down = if asked == 0 { down } else { down.min(edge(h + 2) - back) };
                let stop = drive.stop_s.map_or(u64::MAX, |stop| start + ticks(stop));
                let repeat_end = begin(repeat + 1).unwrap_or(u64::MAX).min(end);
                if up >= end || down + back > if covers { stop } else { stop.min(repeat_end) } {
                    break;
                }
                if pulses > 0 {
                    let (motor, up, down) = (drive.motor, Tick(up), Tick(down));
                    strokes.push(Stroke {
                        motor,
                        up,
                        up_pulses: pulses as u16,
                        down,
                        down_pulses: back as u16,
                    });
                }
            }
        }
    }
    strokes.sort_by_key(|stroke| (stroke.up, stroke.motor));
    strokes
}

/// Successive drives of a motor, with gaps, in at most 0.4 s.
fn drives_of(motor: u8) -> impl Strategy<Value = Vec<Drive>> {
    let drive = (0.1..300.0f64, 0.0..400.0f64, 0.0..1.0f64, 0.0..0.03f64, 0.001..0.1f64);
    (prop::collection::vec(drive, 0..4), any::<bool>()).prop_map(move |(settings, open)| {
        let mut at = 0.0;
        let count = settings.len();
        let drives = settings.into_iter().enumerate().map(|(i, (hz, amplitude_um, phase, gap, length))| {
            let start = at + gap;
            at = start + length;
            Drive {
                motor,
                // Mostly high frequencies, of which several periods fit.
                frequency_hz: (300.0 - hz).max(0.1),
                amplitude_um,
                phase,
                start_s: Some(start),
                stop_s: (!open || i + 1 < count).then_some(at),
            }
        });
        drives.collect()
    })
}

fn any_pattern() -> impl Strategy<Value = Pattern> {
    let drives = (0..24).map(drives_of).collect::<Vec<_>>();
    (drives, prop::option::of(0.4..0.7f64))
        .prop_map(|(drives, duration_s)| pattern(duration_s, drives.concat()))
}

fn any_options() -> impl Strategy<Value = StrokeOptions> {
    let surplus = prop_oneof![Just(0.0), 0.0..130.0f64];
    let fit = prop_oneof![Just(Fit::Whole), Just(Fit::Cover)];
    (0.0..2.0f64, prop_oneof![Just(1.0), 0.0..1.0f64], fit, surplus).prop_map(
        |(seconds, scale, fit, surplus)| StrokeOptions {
            seconds: Some(seconds),
            scale,
            fit,
            surplus: Surplus::Fixed(surplus),
            error_um: None,
            tried_s: TRIED_S,
        },
    )
}

/// The strokes of three seconds are those of the rule.
fn assert_rule(pattern: &Pattern, fit: Fit, surplus_um: f64) {
    let options = StrokeOptions { fit, surplus: Surplus::Fixed(surplus_um), ..StrokeOptions::lasting(3.0) };
    assert_eq!(with(pattern, &options), by_the_rule(pattern, &options), "{options:?}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_pattern_plays_by_the_rule_and_within_the_limits(pattern in any_pattern(), options in any_options()) {
        let mut compiled = Strokes::new(&pattern, &options).unwrap();
        let strokes: Vec<Stroke> = compiled.by_ref().map(|step| step.unwrap().stroke().unwrap()).collect();
        prop_assert_eq!(&strokes, &by_the_rule(&pattern, &options));
        let mut busy = [Tick(0); 24];
        for stroke in &strokes {
            prop_assert!(stroke.check(Array::paper().layout()).is_ok());
            let busy = &mut busy[usize::from(stroke.motor)];
            prop_assert!(stroke.up >= *busy);
            *busy = stroke.end();
        }
        prop_assert!(strokes.windows(2).all(|pair| (pair[0].up, pair[0].motor) < (pair[1].up, pair[1].motor)));
        // The requested end, or that of the last stroke.
        let asked = (options.seconds.unwrap() * 85_000.0 + 0.5).floor() as u64;
        prop_assert_eq!(compiled.end(), busy.iter().map(|end| end.0).max().max(Some(asked)));
        // The figures of the drives are those of the strokes.
        let reached = reached(&pattern, &options).unwrap();
        for motor in 0..24 {
            let drives = pattern.drives().iter().zip(&reached).filter(|(drive, _)| drive.motor == motor);
            let count: u64 = drives.clone().map(|(_, reached)| reached.strokes.unwrap()).sum();
            prop_assert_eq!(count, strokes.iter().filter(|stroke| stroke.motor == motor).count() as u64);
            let over = drives.filter_map(|(_, reached)| reached.over).max();
            let last = strokes.iter().filter(|stroke| stroke.motor == motor).map(|stroke| stroke.end().0).max();
            prop_assert_eq!(over, last);
        }
    }

    #[test]
    fn an_edge_is_the_nearest_tick_a_month_in(n in 103..307_200_i128, p in 0..4096_i128, h in 0..1_600_000_000_i128) {
        // Frequencies of n/1024 and phases of p/4096 are exact in f64; so is the tick wanted, as a fraction.
        let wave = SquareWave::new(Array::paper(), n as f64 / 1024.0, 1.0, p as f64 / 4096.0).unwrap();
        let tick = i128::from(wave.edge(h as u64));
        let (numerator, denominator) = ((h * 2048 + p) * 85_000 * 1024, 4096 * n);
        prop_assert!((tick * denominator - numerator).abs() * 1000 <= 501 * denominator);
    }
}

#[test]
fn a_stroke_that_a_repeat_is_too_short_for_is_left_out() {
    // Each repeat has the length of one saturated period: whether it fits depends on the rounding of the repeat's ends.
    for hz in [299.0, 150.5, 201.3, 290.1, 233.0, 77.7] {
        for ticks in [-1.0, -0.6, -0.3, 0.0, 0.3] {
            let period = pattern(
                Some(1.0 / hz + ticks / 85_000.0),
                vec![drive(0, hz, 400.0), drive(1, hz / 2.0, 9.0)],
            );
            assert_rule(&period, Fit::Whole, 0.0);
            assert_rule(&period, Fit::Cover, 0.0);
            assert_rule(&period, Fit::Cover, 3.0);
        }
    }
}

#[test]
fn a_rare_repeat_that_is_long_enough_is_found_at_once() {
    // The saturated period has 425 ticks. Repeats have 424, and one in ten thousand million has 425.
    let duration_s = (424.0 + 1e-10) / 85_000.0;
    let begin = |repeat: u64| (repeat as f64 * duration_s * 85_000.0 + 0.5).floor() as u64;
    let mut strokes =
        Strokes::new(&pattern(Some(duration_s), vec![drive(0, 200.0, 80.0)]), &StrokeOptions::lasting(1e8))
            .unwrap();
    let ups: Vec<_> = strokes.by_ref().map(|step| step.unwrap().begin().0).collect();
    assert_eq!(ups.len(), 2);
    for up in ups {
        let repeat = up / 424;
        assert_eq!((begin(repeat - 1), begin(repeat), begin(repeat + 1)), (up - 424, up, up + 425));
    }
}

#[test]
fn the_strokes_of_years_are_counted_at_once() {
    let steady = pattern(Some(0.5), vec![drive(0, 60.0, 80.0)]);
    let strokes = |seconds| reached(&steady, &StrokeOptions::lasting(seconds)).unwrap()[0].strokes;
    assert_eq!(strokes(Some(1e8)), Some(60 * 100_000_000));
    let endless = pattern(None, vec![drive(0, 60.0, 80.0)]);
    assert_eq!(reached(&endless, &StrokeOptions::default()).unwrap()[0].strokes, None);
}

#[test]
fn an_automatic_surplus_suits_each_motor_and_amplitude() {
    let mut spread = PerMotor::all(Array::paper(), Spread { scatter: 0.1, asymmetry: 0.0 });
    spread[9].asymmetry = 0.06;
    let surplus = Surplus::Auto(Box::new(AutoSurplus { spread, rest_error_um: 4.0 }));
    let two = pattern(None, vec![drive(3, 60.0, 80.0), drive(9, 60.0, 80.0), drive(5, 60.0, 20.0)]);
    let options = StrokeOptions { surplus: surplus.clone(), ..StrokeOptions::lasting(1.0) };
    let reached = reached(&two, &options).unwrap();
    for (drive, reached) in two.drives().iter().zip(&reached) {
        let um = surplus
            .um(drive.motor, f64::from((drive.amplitude_um / UM_PER_PULSE).round() as u32) * UM_PER_PULSE);
        assert!(
            reached.surplus_um >= um - 1e-9 && reached.surplus_um < um + UM_PER_PULSE,
            "{um} {reached:?}"
        );
        let stroke = with(&two, &options).into_iter().find(|stroke| stroke.motor == drive.motor).unwrap();
        assert_eq!(f64::from(stroke.down_pulses - stroke.up_pulses) * UM_PER_PULSE, reached.surplus_um);
    }
    // The asymmetric motor needs 4.8 um more, its climb per stroke; a small amplitude scatters within the bound.
    let [even, climbing, small] = reached[..] else { panic!() };
    assert!((3.0..7.0).contains(&(climbing.surplus_um - even.surplus_um)), "{reached:?}");
    assert!(small.surplus_um < 2.0, "{reached:?}");
}

#[test]
fn a_surplus_that_does_not_fit_lowers_the_amplitude_and_that_is_said() {
    let fast = pattern(None, vec![drive(0, 72.0, 80.0)]);
    let at = |surplus_um| {
        let options = StrokeOptions { surplus: Surplus::Fixed(surplus_um), ..StrokeOptions::lasting(1.0) };
        reached(&fast, &options).unwrap()[0]
    };
    // A period of 1180 ticks holds two bursts of 589 pulses and two pulses more.
    assert_eq!((at(0.0).amplitude_um, at(0.0).surplus_um), (589.0 * UM_PER_PULSE, 0.0));
    assert_eq!((at(0.2).amplitude_um, at(0.2).surplus_um), (589.0 * UM_PER_PULSE, 2.0 * UM_PER_PULSE));
    assert_eq!(at(13.5).surplus_um, 100.0 * UM_PER_PULSE);
    assert_eq!(at(13.5).amplitude_um, 540.0 * UM_PER_PULSE);
    // The surplus never exceeds the controller's limit of 30 %.
    assert_eq!((at(400.0).amplitude_um, at(400.0).surplus_um), (513.0 * UM_PER_PULSE, 153.0 * UM_PER_PULSE));
}

#[test]
fn a_pattern_without_strokes_ends() {
    let silent = drive(0, 60.0, 0.05);
    assert_eq!(all(&pattern(None, vec![silent]), None), []);
    assert_eq!(all(&pattern(Some(0.01), vec![silent]), Some(1e8)), []);
    // Too short for one stroke, repeated for three years.
    assert_eq!(all(&pattern(Some(0.01), vec![drive(0, 10.0, 80.0)]), Some(1e8)), []);
    assert_eq!(all(&pattern(None, vec![]), None), []);
    let ends = |pattern: &Pattern| Strokes::new(pattern, &StrokeOptions::default()).unwrap().end();
    assert_eq!(ends(&pattern(None, vec![])), Some(0));
    assert_eq!(ends(&pattern(None, vec![drive(0, 60.0, 80.0)])), None);
    let stops = Drive { stop_s: Some(0.5), ..drive(0, 60.0, 80.0) };
    assert_eq!(ends(&pattern(None, vec![stops])), Some(42_500));
    assert_eq!(all(&pattern(None, vec![stops]), None).len(), 30);
    assert_eq!(ends(&pattern(None, vec![stops, drive(1, 60.0, 80.0)])), None);
}

#[test]
fn an_option_out_of_range_is_refused() {
    let refused = |options| Strokes::new(&pattern(None, vec![]), &options).unwrap_err();
    for number in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(refused(StrokeOptions::lasting(number)), StrokesError::Seconds { .. }));
        let scale = StrokeOptions { scale: number, ..StrokeOptions::default() };
        assert!(matches!(refused(scale), StrokesError::Scale { .. }));
        let surplus = |surplus| StrokeOptions { surplus, ..StrokeOptions::default() };
        assert!(matches!(refused(surplus(Surplus::Fixed(number))), StrokesError::Surplus { .. }));
        let spread = PerMotor::all(Array::paper(), Spread { scatter: 0.1, asymmetry: 0.0 });
        let auto = Surplus::Auto(Box::new(AutoSurplus { spread, rest_error_um: number }));
        assert!(matches!(refused(surplus(auto)), StrokesError::RestError { .. }));
    }
}

/// Also while items of a sequence begin and end beside one another, in a copy.
#[test]
fn nothing_is_allocated_while_overlapping_items_play() {
    let mut sequence = Sequence::new(Array::paper());
    let of = |motor: u8| pattern(None, vec![drive(motor, 60.0, 20.0)]);
    let compiled: Vec<_> =
        (0..24).map(|motor| sequence.compile(&of(motor), &StrokeOptions::default()).unwrap()).collect();
    for item in 0..240 {
        sequence.add(compiled[item % 24], Some(0.11), Start::At(5.0 * item as f64)).unwrap();
    }
    let mut strokes = sequence.strokes().unwrap().clone();
    let count = assert_no_alloc::assert_no_alloc(|| {
        strokes.begin(Tick::BOOT);
        strokes.by_ref().filter(Result::is_ok).count()
    });
    assert_eq!(count, 240 * 6);
}
