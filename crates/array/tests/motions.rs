//! Patterns with motions: motions beside drives, in files, packed, mapped and compiled.

use meissner_array::motion::{Envelope, Noise, RampHold, Shape, Tone};
use meissner_array::pattern::{MAX_AT_ONCE, MAX_FILE_BYTES, MAX_PATTERN_SAMPLES, Motion, Pattern, Wave};
use meissner_array::spec::Array;
use meissner_array::strokes::ordered_end;
use meissner_test_support::documents::{assert_changes_refused, in_one_line};
use std::sync::Arc;

const GOOD: &str = r#"format = 1
name = "good"
duration_s = 5

[[drive]]
motor = 9
frequency_hz = 60.0
amplitude_um = 80.0
start_s = 3.0

[[wave]]
motor = 9
rate_hz = 100.0
um = [0.0, 10, 20.5, 0]
start_s = 2.0

[[wave]]
motor = 4
rate_hz = 1000
samples = "AADAPwAAIEE="

[[ramp]]
motor = 9
to_um = 200.0
rise_s = 0.05
hold_s = 1.0
fall_s = 0.1
shape = "cosine"

[[tone]]
motor = 9
start_s = 0.1
duration_s = 0.5
frequency_hz = 40.0
end_hz = 80.0
amplitude_um = 20.0
about_um = 0.0
envelope = "hann"

[[noise]]
motor = 3
duration_s = 0.5
low_hz = 5.0
high_hz = 50.0
rms_um = 3.0
seed = 7
envelope = { attack_s = 0.1, release_s = 0.05 }
"#;

fn parse(text: &str) -> Pattern {
    Pattern::parse(text, "p.toml").unwrap()
}

fn refused(text: &str) -> String {
    in_one_line(Pattern::parse(text, "p.toml")).unwrap_err()
}

/// A pattern with these tables.
fn with(tables: &str) -> String {
    format!("format = 1\nname = \"p\"\n{tables}")
}

#[test]
fn motions_are_read_summed_and_written_back_as_the_same_pattern() {
    let pattern = parse(GOOD);
    let forms: Vec<_> = pattern.motions().iter().map(|motion| (motion.motor(), motion.table())).collect();
    assert_eq!(forms, [(9, "wave"), (4, "wave"), (9, "ramp"), (9, "tone"), (3, "noise")]);
    let Motion::Wave(packed) = &pattern.motions()[1] else { panic!("{pattern:?}") };
    assert_eq!((&packed.um[..], packed.start_s, packed.rate_hz), (&[1.5_f32, 10.0][..], 0.0, 1000.0));
    let (motor, start_s, to_um, rise_s, hold_s) = (9, 0.0, 200.0, 0.05, 1.0);
    let ramp = RampHold { motor, start_s, to_um, rise_s, hold_s, fall_s: Some(0.1), shape: Shape::Cosine };
    assert_eq!(pattern.motions()[2], Motion::Ramp(ramp));
    let Motion::Tone(Tone { frequency_hz, end_hz, about_um, envelope, .. }) = pattern.motions()[3] else {
        panic!()
    };
    let hann = Some(Envelope::HANN);
    assert_eq!((frequency_hz, end_hz, about_um, envelope), (40.0, Some(80.0), Some(0.0), hann));
    let Motion::Noise(Noise { rms_um, envelope, .. }) = pattern.motions()[4] else { panic!() };
    let edges = Envelope::AttackRelease { attack_s: 0.1, release_s: 0.05 };
    assert_eq!((rms_um, envelope), (Some(3.0), Some(edges)));

    let motors: Vec<u8> = pattern.waveforms().iter().map(|(motor, _)| *motor).collect();
    assert_eq!(motors, [3, 4, 9]);
    let nine = &pattern.waveforms()[2].1;
    assert_eq!((nine.um_at(900_000_000), nine.um_at(2_010_000_000)), (200.0, 10.0));
    // Within the tone the sum is not flat.
    assert!((nine.um_at(340_000_000) - 200.0).abs() > 1.0);

    let text = pattern.to_toml();
    assert!(text.contains("samples = \"AADAPwAAIEE=\"") && !text.contains("um = ["), "{text}");
    assert_eq!(parse(&text), pattern);
    let json = serde_json::to_value(&pattern).unwrap();
    assert_eq!((&json["format"], &json["tone"][0]["end_hz"]), (&1.into(), &80.0.into()));
    assert_eq!(parse("format = 1\nname = \"p\"\n").to_toml(), "format = 1\nname = \"p\"\n");
}

#[test]
fn a_play_ends_with_the_last_drive_or_motion() {
    let text = GOOD.replace("duration_s = 5\n", "").replace("start_s = 3.0", "start_s = 3.0\nstop_s = 4.0");
    assert_eq!(ordered_end(&parse(&text), None), Some(4 * 85_000));
    let ramp = parse(&with("[[ramp]]\nmotor = 0\nto_um = 100\nrise_s = 0.1\nhold_s = 2\n"));
    assert_eq!(ordered_end(&ramp, None), Some(11 * 8500 * 2));
}

const MISTAKES: &str = r#"
motor = 4 => motor = 24 => 18: wave 2: `motor` is 24…0 to 23
motor = 4 => motr = 4 => 18: wave 2: unknown key `motr`…did you mean `motor`?
[[tone]] => [[tones]] => 30: unknown key `tones`…did you mean `tone`?
rate_hz = 1000 =>  => 17: wave 2: `rate_hz` is missing…1 to 8000 Hz
rate_hz = 1000 => rate_hz = 8001 => 17: wave 2: motor 4: rate_hz is 8001 Hz: must be 1 to 8000 Hz
rate_hz = 1000 => rate_hz = nan => 17: wave 2: motor 4: rate_hz is NaN Hz: must be 1 to 8000 Hz
rate_hz = 1000 => rate_hz = 1000⏎um = [1.0, 2.0] => 17: wave 2: needs one of um, samples and file…
samples = "AADAPwAAIEE=" =>  => 17: wave 2: needs one of um, samples and file…
samples = "AADAPwAAIEE=" => file = "a\nb.npy" => 20: wave 2: `file` is `a\nb.npy`: pack it first: `meissner pattern pack FILE`
samples = "AADAPwAAIEE=" => samples = "AADAPw" => 20: wave 2: `samples` is damaged: pack the pattern again…
samples = "AADAPwAAIEE=" => samples = "AADAPwAAIE==" => 20: wave 2: `samples` is damaged…
samples = "AADAPwAAIEE=" => samples = "AADAPw==" => 17: wave 2: motor 4: 1 samples: must be 2 to 4194302
samples = "AADAPwAAIEE=" => samples = "AADAPwAAwH8=" => 17: wave 2: motor 4: sample 1 at 0.001 s is NaN: must be a number
samples = "AADAPwAAIEE=" => samples = 5 => 20: wave 2: `samples` is integer…must be samples that
samples = "AADAPwAAIEE=" => samples = "AADAPwAAIEE="⏎scale_um = 2.0 => 21: wave 2: `scale_um` is for samples of a file…
samples = "AADAPwAAIEE=" => samples = "AADAPwAAIEE="⏎column = {} => 21: wave 2: `column`: must be a column's number…
20.5, => -0.5, => 11: wave 1: motor 9 goes to -0.500 um at 2.02 s, sample 2: must be 0 to 400 um
20.5, => 401, => 11: wave 1: motor 9 goes to 401.000 um at 2.02 s, sample 2: must be 0 to 400 um
20.5, => inf, => 11: wave 1: motor 9: sample 2 at 2.02 s is inf: must be a number
20.5, => "x", => 14: wave 1: `um[2]`…must be a number
start_s = 2.0 => start_s = -2.0 => 11: wave 1: motor 9: start_s is -2 s: must be 0 to 100000000 s
start_s = 2.0 => start_s = 4.99 => 11: wave 1: motor 9 moves until 5.02 s: make it shorter, or raise duration_s from 5
start_s = 2.0 => start_s = 2.95 => 11: wave 1: motor 9 needs 2.9460 to 3.0187 s for it, and drive 1 plays then: stop that one earlier…
to_um = 200.0 => to_um = 401.0 => 22: ramp 1: motor 9 goes to 400.…um at 0.…s: must be 0 to 400 um
to_um = 200.0 => to_um = 395.0 => 22: ramp 1: motor 9 goes to 400.…um at 0.…s, as the sum of ramp 1, tone 1: must be 0 to 400 um
to_um = 200.0 => to_um = -1.0 => 22: ramp 1: motor 9 goes to -0.…must be 0 to 400 um
to_um = 200.0 =>  => 22: ramp 1: `to_um` is missing…a height
rise_s = 0.05 => rise_s = -1 => 22: ramp 1: motor 9: rise_s is -1 s: must be 0 to…
hold_s = 1.0 => hold_s = nan => 22: ramp 1: motor 9: hold_s is NaN s: must be 0 to…
shape = "cosine" => shape = "round" => 28: ramp 1: `shape`: unknown variant `round`, expected `linear` or `cosine`
frequency_hz = 40.0 => frequency_hz = 301 => 30: tone 1: motor 9: frequency_hz is 301 Hz: must be 0.1 to 300 Hz
about_um = 0.0 => about_um = -300.0 => 22: ramp 1: motor 9 goes to -…as the sum of ramp 1, tone 1: must be 0 to 400 um
envelope = "hann" => envelope = "blackman" => 38: tone 1: `envelope`: must be "hann", or { attack_s…
envelope = "hann" => envelope = { attack = 1 } => 38: tone 1: `envelope`: must be "hann", or { attack_s…
duration_s = 0.5⏎frequency => duration_s = 1e7⏎frequency => 30: tone 1: motor 9: …samples: must be 2 to 4194302
high_hz = 50.0 => high_hz = 5.1⏎ => 40: noise 1: motor 3: noise of 0.5 s has no frequency from 5 to 5.1 Hz…
rms_um = 3.0 =>  => 40: noise 1: needs rms_um or peak_um, and only one
rms_um = 3.0 => rms_um = 3.0⏎peak_um = 9.0 => 40: noise 1: needs rms_um or peak_um, and only one
rms_um = 3.0 => rms_um = 300.0 => 40: noise 1: motor 3 goes to …um at …must be 0 to 400 um
seed = 7 => seed = -7 => 46: noise 1: `seed` is integer `-7`: must be a whole number, 0 or more
seed = 7 =>  => 40: noise 1: `seed` is missing…equal seeds
"#;

#[test]
fn a_mistake_is_refused_in_one_line_with_table_motor_sample_and_time() {
    assert_changes_refused(GOOD, MISTAKES, Pattern::parse);
}

#[test]
fn a_hold_is_bounded() {
    let hold =
        |seconds: f64| with(&format!("[[ramp]]\nmotor = 2\nto_um = 50\nrise_s = 0.5\nhold_s = {seconds}\n"));
    parse(&hold(59.0));
    assert_eq!(
        refused(&hold(60.5)),
        "p.toml:3: ramp 1: motor 2 stays at one height for 60.5 s from 0.5 s on: must be at most 59 s"
    );
    // Above rest all the time, but it moves.
    parse(&with(
        "[[ramp]]\nmotor = 2\nto_um = 50\nrise_s = 0.5\nhold_s = 80\n[[tone]]\nmotor = 2\nstart_s = 1\nduration_s = 75\n\
         frequency_hz = 1\namplitude_um = 5\nabout_um = 0\n",
    ));
    // Samples that stay, and rest, which may last.
    let still = |um: f64| {
        with(&format!("[[wave]]\nmotor = 2\nrate_hz = 1\num = [0, {}0]\n", format!("{um}, ").repeat(70)))
    };
    parse(&still(0.0));
    assert!(refused(&still(3.0)).contains("wave 1: motor 2 stays at one height for 69 s from 1 s on"));
}

#[test]
fn drives_and_motions_of_a_motor_leave_room_for_each_other() {
    let both = |stop_s: f64, start_s: f64| {
        with(&format!(
            "[[drive]]\nmotor = 1\nfrequency_hz = 60\namplitude_um = 80\nstop_s = {stop_s}\n\
             [[drive]]\nmotor = 1\nfrequency_hz = 60\namplitude_um = 80\nstart_s = {start_s}\n\
             [[ramp]]\nmotor = 1\nstart_s = 1\nto_um = 50\nrise_s = 0.5\n"
        ))
    };
    // 4 ms before, and after it 4 ms and the way down from 400 um at 11.536 mm/s.
    parse(&both(0.996, 2.0387));
    assert!(
        refused(&both(0.997, 2.0387))
            .contains("ramp 1: motor 1 needs 0.9960 to 2.0387 s for it, and drive 1")
    );
    assert!(refused(&both(0.996, 2.038)).contains("and drive 2 plays then"));
}

#[test]
fn amounts_are_bounded_before_memory_is_used() {
    let ramp = |start: usize| format!("[[ramp]]\nmotor = 1\nstart_s = {start}\nto_um = 5\nrise_s = 0.4\n");
    let ramps = |count: usize| with(&(0..count).map(ramp).collect::<String>());
    assert_eq!(parse(&ramps(4096)).motions().len(), 4096);
    assert_eq!(refused(&ramps(4097)), "p.toml: 4097 motions are too many: a pattern has at most 4096");
    let million = refused(&with(&"[[ramp]]\nmotor=1\n".repeat(1_000_000)));
    assert!(million.contains("more than 16384 tables"), "{million}");

    let list = |count: usize| {
        with(&format!("[[wave]]\nmotor = 1\nrate_hz = 1000\num = [{}]\n", "1.5,0.5,".repeat(count / 2)))
    };
    assert_eq!(parse(&list(200_000)).waveforms().len(), 1);
    let whole = list(0).replace("[]", &format!("[{}]", "1,0,".repeat(131_200)));
    assert!(refused(&whole).contains("more than 262144 values"));
    let comment = |bytes: usize| with(&format!("#{}\n", "x".repeat(bytes)));
    parse(&comment(MAX_FILE_BYTES - 100));
    let line = refused(&comment(MAX_FILE_BYTES));
    assert!(line.contains("bytes are too many: a pattern file has at most 1048576"), "{line}");

    // Tones that would fill the memory: 24 of 10 minutes at 200 Hz are 115 million samples.
    let tone = |motor: u8, seconds: f64| {
        format!("[[tone]]\nmotor = {motor}\nduration_s = {seconds}\nfrequency_hz = 200\namplitude_um = 5\n")
    };
    let tones = with(&(0..24).map(|motor| tone(motor, 500.0)).collect::<String>());
    let line = refused(&tones);
    assert!(line.contains("tone 5: the pattern has more than 16777216 samples with this one"), "{line}");
    let noise = "[[noise]]\nmotor = 1\nduration_s = 50\nlow_hz = 5\nhigh_hz = 100\nrms_um = 1\nseed = 1\n";
    let line = refused(&with(&noise.repeat(6)));
    assert!(line.contains("noise 5: the pattern's noise takes too long to make"), "{line}");
    let at_once = |count: usize| with(&tone(1, 1.0).repeat(count));
    parse(&at_once(MAX_AT_ONCE));
    let line = refused(&at_once(MAX_AT_ONCE + 1));
    assert!(line.contains("tone 17: motor 1 has more than 16 motions at 0 s"), "{line}");
    let source =
        with(&format!("[[wave]]\nmotor = 1\nrate_hz = 9\num = [1, 2]\nsource = \"{}\"\n", "x".repeat(513)));
    assert!(refused(&source).contains("wave 1: `source` is longer than 512 bytes"));
}

#[test]
fn the_largest_pattern_is_packed_and_read() {
    let um: Arc<[f32]> = (0..600_000).map(|k| (k % 400) as f32).collect();
    let motion = |motor| {
        let (start_s, rate_hz, um, source) = (0.0, 1000.0, um.clone(), None);
        Motion::Wave(Wave { motor, start_s, rate_hz, um, source })
    };
    let pattern = |motions| {
        let empty = Pattern::new(Array::paper(), "p", None, Vec::new(), toml::Table::new()).unwrap();
        empty.with_motions(motions)
    };
    let full = pattern((0..24).map(motion).collect()).unwrap();
    assert!(24 * um.len() <= MAX_PATTERN_SAMPLES);
    let text = full.to_toml();
    assert!((76_800_000..76_900_000).contains(&text.len()), "{}", text.len());
    let again = parse(&text);
    assert!(again == full);
    let more = pattern((0..28).map(|number| motion(number % 24)).collect()).unwrap_err().to_string();
    assert!(more.contains("p: wave 28: the pattern has more than 16777216 samples"), "{more}");
}

fn npy(um: &[f32]) -> Vec<u8> {
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, 2), }}", um.len() / 2);
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend(u16::try_from(header.len()).unwrap().to_le_bytes());
    file.extend(header.as_bytes());
    file.extend(um.iter().flat_map(|um| um.to_le_bytes()));
    file
}

#[test]
fn a_pattern_that_names_files_becomes_complete() {
    let wave =
        |motor: u8, file: &str, keys: &str| format!("[[wave]]\nmotor = {motor}\nfile = \"{file}\"\n{keys}\n");
    let text = with(
        &[
            wave(1, "touch.npy", "rate_hz = 500\ncolumn = 0"),
            wave(
                2,
                "touch.npy",
                "rate_hz = 500\ncolumn = 1\nscale_um = 10.0\noffset_um = 1.5\nsource = \"by hand\"",
            ),
            wave(3, "../t/a.csv", "column = \"pin_um\""),
        ]
        .concat(),
    );
    let mut asked = Vec::new();
    let mut files = |name: &str| {
        asked.push(name.to_owned());
        match name {
            "touch.npy" => Ok(npy(&[0.0, 1.0, 2.0, 3.0])),
            _ => Ok(b"time_s,pin_um\n0,5\n0.01,6\n0.02,7".to_vec()),
        }
    };
    let pattern = Pattern::parse_with_files(&text, "p.toml", &mut files).unwrap();
    assert_eq!(asked, ["touch.npy", "../t/a.csv"]);
    let waves = pattern.motions().iter().map(|motion| match motion {
        Motion::Wave(wave) => (wave.rate_hz, wave.um.to_vec(), wave.source.as_deref().unwrap()),
        _ => panic!("{motion:?}"),
    });
    let waves: Vec<_> = waves.collect();
    assert_eq!(waves[0], (500.0, vec![0.0, 2.0], "touch.npy: NPY <f4, column 0 of 2, 500 Hz"));
    assert_eq!(waves[1], (500.0, vec![11.5, 31.5], "by hand"));
    assert_eq!(waves[2], (100.0, vec![5.0, 6.0, 7.0], "../t/a.csv: CSV column pin_um, 100 Hz"));
    // Now without files.
    assert_eq!(parse(&pattern.to_toml()), pattern);

    let refuse = |text: &str, bytes: Result<Vec<u8>, String>| {
        in_one_line(Pattern::parse_with_files(text, "p.toml", &mut |_| bytes.clone())).unwrap_err()
    };
    let one = with(&wave(1, "t.npy", "rate_hz = 500\ncolumn = 1"));
    for (line, says) in [
        (
            refuse(&one, Err("no such\nfile".into())),
            "p.toml:5: wave 1: `file`: motor 1: `t.npy`: no such\\nfile",
        ),
        (
            refuse(&one, Ok(npy(&[0.0; 4])[..50].to_vec())),
            "p.toml:5: wave 1: `file`: motor 1: `t.npy`: not an NPY file: it ends",
        ),
        (
            refuse(&one, Ok(npy(&[0.0, 1.0, 2.0, f32::NAN]))),
            "motor 1: `t.npy`: sample 1 at 0.002 s is NaN: must be a number",
        ),
        (
            refuse(&one, Ok(npy(&[0.0, 1.0, 2.0, -3.0]))),
            "p.toml:3: wave 1: motor 1 goes to -3.000 um at 0.002 s, sample 1: must be 0 to 400 um",
        ),
        (refuse(&one.replace("column = 1", ""), Ok(npy(&[0.0; 4]))), "2 columns: add column = 0 to 1"),
        (
            refuse(&one.replace("column = 1", "channel = -1"), Ok(vec![])),
            "p.toml:7: wave 1: `channel` is integer `-1`: must be a whole number, 0 or more",
        ),
        (refuse(&one.replace("t.npy", "t.mat"), Ok(vec![])), "must end in .npy, .csv or .wav"),
    ] {
        assert!(line.contains(says), "{line}\n  does not say {says}");
    }
}

#[test]
fn the_patterns_of_the_reference_are_read() {
    let page = include_str!("../../../docs/reference/pattern.md");
    let blocks = page.split("```toml\n").skip(1).filter_map(|rest| rest.split_once("```"));
    let whole: Vec<_> = blocks.map(|(text, _)| text).filter(|text| text.contains("format = ")).collect();
    let kinds = whole.iter().map(|text| {
        let pattern = parse(text);
        (pattern.drives().len(), pattern.motions().len())
    });
    assert_eq!(kinds.collect::<Vec<_>>(), [(2, 0), (0, 3)]);
}
