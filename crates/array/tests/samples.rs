//! The readers of samples: what NumPy, pandas and a recorder write, every mistake in one line, and any bytes without a panic.

use hound::{SampleFormat, WavSpec, WavWriter};
use meissner_array::samples::{
    Choice, Column, MAX_FILE_BYTES, MAX_SAMPLES, Samples, read, read_columns, read_profile,
};
use meissner_test_support::documents::assert_documents_refused;
use std::io::Cursor;

fn npy(descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': {descr}, 'fortran_order': {fortran}, 'shape': {shape}, }}");
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let length = u16::try_from(header.len()).unwrap().to_le_bytes();
    [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), data].concat()
}

fn f4(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn wav(spec: WavSpec, samples: &[i32]) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut writer = WavWriter::new(&mut file, spec).unwrap();
    for sample in samples {
        writer.write_sample(*sample).unwrap();
    }
    writer.finalize().unwrap();
    file.into_inner()
}

const STEREO: WavSpec =
    WavSpec { channels: 2, sample_rate: 4000, bits_per_sample: 16, sample_format: SampleFormat::Int };

fn at(rate_hz: f64) -> Choice {
    Choice { rate_hz: Some(rate_hz), ..Choice::default() }
}

fn column(number: u32) -> Choice {
    Choice { column: Some(Column::Number(number)), ..at(1000.0) }
}

fn named(name: &str) -> Choice {
    Choice { column: Some(Column::Name(name.to_owned())), ..Choice::default() }
}

fn channel(channel: usize) -> Choice {
    Choice { channel: Some(channel), scale_um: Some(100.0), ..Choice::default() }
}

fn good(name: &str, bytes: &[u8], choice: &Choice) -> Samples {
    read(name, bytes, choice).unwrap()
}

fn refused(name: &str, bytes: &[u8], choice: &Choice) -> String {
    let line = read(name, bytes, choice).unwrap_err().to_string();
    assert!(!line.contains('\n'), "{line}");
    line
}

#[test]
fn npy_of_each_type_and_order_is_read() {
    let wanted = [1.0, -2.0, 3.0];
    let bytes = |each: &dyn Fn(f64) -> Vec<u8>| wanted.iter().flat_map(|um| each(*um)).collect::<Vec<u8>>();
    for (descr, data) in [
        ("'<f4'", bytes(&|um| (um as f32).to_le_bytes().into())),
        ("'>f4'", bytes(&|um| (um as f32).to_be_bytes().into())),
        ("'<f8'", bytes(&|um| um.to_le_bytes().into())),
        ("'>f8'", bytes(&|um| um.to_be_bytes().into())),
        ("'<i2'", bytes(&|um| (um as i16).to_le_bytes().into())),
        ("'>i4'", bytes(&|um| (um as i32).to_be_bytes().into())),
    ] {
        let found = good("a.NPY", &npy(descr, "False", "(3,)", &data), &at(500.0));
        assert_eq!((found.rate_hz, found.um), (500.0, wanted.map(|um| um as f32).to_vec()), "{descr}");
    }
    let data = f4(&[0.0, 10.0, 1.0, 11.0, 2.0, 12.0]);
    let c_order = good("a.npy", &npy("'<f4'", "False", "(3, 2)", &data), &column(1));
    assert_eq!((c_order.um, &*c_order.note), (vec![10.0, 11.0, 12.0], "NPY <f4, column 1 of 2, 1000 Hz"));
    let fortran = good("a.npy", &npy("'<f4'", "True", "(3, 2)", &data), &column(1));
    assert_eq!(fortran.um, [11.0, 2.0, 12.0]);
    let single = npy("'<f4'", "False", "(6, 1)", &data);
    let scaled = Choice { scale_um: Some(2.0), offset_um: -1.0, ..at(1000.0) };
    let scaled = good("a.npy", &single, &scaled);
    assert_eq!((scaled.um[1], &*scaled.note), (19.0, "NPY <f4, 1000 Hz, times 2 um, plus -1 um"));
    // As NumPy 2.1 wrote it: numpy.save(f, numpy.arange(4, dtype="<i2").reshape(2, 2, order="F")).
    let mut real =
        b"\x93NUMPY\x01\x00v\x00{'descr': '<i2', 'fortran_order': True, 'shape': (2, 2), }".to_vec();
    real.resize(127, b' ');
    real.extend(b"\n\x00\x00\x01\x00\x02\x00\x03\x00");
    assert_eq!(good("real.npy", &real, &column(1)).um, [2.0, 3.0]);
}

#[test]
fn csv_says_its_times_and_units() {
    let csv = |text: &str, choice: &Choice| good("a.csv", text.as_bytes(), choice);
    // As pandas, spreadsheets and this program write it.
    let found = csv("time_s,pin_um\n0.0,1.5\n0.001,2e0\n0.002,-3\n", &Choice::default());
    assert_eq!((found.rate_hz, found.um), (1000.0, vec![1.5, 2.0, -3.0]));
    assert_eq!(found.note, "CSV column pin_um, 1000 Hz");
    let found = csv("\u{feff}\"height_mm\", time_s\r\n0.5, 10\r\n1, 10.5\r\n", &Choice::default());
    assert_eq!((found.rate_hz, found.um), (2.0, vec![500.0, 1000.0]));
    let two = "time_s,a_nm,b_m\n0,500,1e-6\n0.5,1000,2e-6\n1.0,0,3e-6";
    assert_eq!(csv(two, &named("a_nm")).um, [0.5, 1.0, 0.0]);
    let shifted = csv(two, &Choice { offset_um: 4.0, rate_hz: Some(2.0), ..named("b_m") });
    assert_eq!((&*shifted.um, &*shifted.note), (&[5.0, 6.0, 7.0][..], "CSV column b_m, 2 Hz, plus 4 um"));
    // Rounded times.
    let rows = |hz: f64| {
        let row = |k: u32| format!("{:.6},{k}\n", f64::from(k) / hz);
        "time_s,x_um\n".to_owned() + &(0..2000).map(row).collect::<String>()
    };
    for hz in [60.0, 1000.0, 7000.0] {
        assert_eq!(csv(&rows(hz), &Choice::default()).rate_hz, hz);
    }
    assert_eq!(csv(&rows(44_100.0), &Choice::default()).rate_hz, 8000.0);
    let profile = |text: &str| read_profile("p.csv", text.as_bytes(), None, None).unwrap();
    assert_eq!(profile("height_mm\n0\n0.25\n"), [0.0, 250.0]);
    let columns = read_columns(b"a,t_s,b\n1,0,x\n2,nan,y\n", ["t_s", "a"]).unwrap();
    assert!(columns[0][1].is_nan() && columns[1] == [1.0, 2.0]);
}

#[test]
fn wav_has_full_scale_and_its_own_rate() {
    let found = good("a.wav", &wav(STEREO, &[0, 16384, 0, -32768, 1, 0]), &channel(1));
    assert_eq!((found.rate_hz, found.um), (4000.0, vec![50.0, -100.0, 0.0]));
    assert_eq!(found.note, "WAV 16 bit, channel 1 of 2, 4000 Hz, full scale 100 um");
}

/// A mono WAV file of 1 kHz with a plain or an extensible header, of a length that may be odd.
fn raw_wav(kind: u16, bits: u16, container: u16, is_extensible: bool, samples: &[u8]) -> Vec<u8> {
    let tag = if is_extensible { 0xFFFE } else { kind };
    let mut format = Vec::new();
    for word in
        [tag, 1, 1000, 0, 1000 * container, 0, container, if is_extensible { 8 * container } else { bits }]
    {
        format.extend(u16::to_le_bytes(word));
    }
    if is_extensible {
        for word in [22, bits, 4, 0, kind] {
            format.extend(u16::to_le_bytes(word));
        }
        format.extend(*b"\0\0\0\0\x10\0\x80\0\0\xaa\0\x38\x9b\x71");
    }
    let chunk = |name: &[u8], data: &[u8]| {
        let length = u32::try_from(data.len()).unwrap().to_le_bytes();
        [name, &length[..], data, &[0][..data.len() % 2]].concat()
    };
    let chunks =
        [chunk(b"LIST", b"odd"), chunk(b"fmt ", &format), chunk(b"fact", &[0; 4]), chunk(b"data", samples)];
    [b"RIFF\0\0\0\0WAVE".to_vec(), chunks.concat()].concat()
}

/// What recorders, Audacity, SciPy and `soundfile` write.
#[test]
fn wav_of_each_form_is_read() {
    let read = |kind, bits, container, samples: &[u8]| {
        for is_extensible in [false, true] {
            let file = raw_wav(kind, bits, container, is_extensible, samples);
            let found = good("a.wav", &file, &Choice { offset_um: 100.0, ..channel(0) });
            assert_eq!(
                (found.um, found.rate_hz),
                (vec![150.0, 0.0, 100.0], 1000.0),
                "{kind} {bits} {is_extensible}"
            );
        }
    };
    read(1, 8, 1, &[192, 0, 128]);
    read(1, 12, 2, &[0, 64, 0, 128, 0, 0]);
    read(1, 16, 2, &[0, 64, 0, 128, 0, 0]);
    read(1, 24, 3, &[0, 0, 64, 0, 0, 128, 0, 0, 0]);
    read(1, 24, 4, &[0, 0, 0, 64, 0, 0, 0, 128, 0, 0, 0, 0]);
    read(1, 32, 4, &[0, 0, 0, 64, 0, 0, 0, 128, 0, 0, 0, 0]);
    read(3, 32, 4, &[0.5_f32, -1.0, 0.0].map(f32::to_le_bytes).concat());
    read(3, 64, 8, &[0.5_f64, -1.0, 0.0].map(f64::to_le_bytes).concat());
    for (kind, bits, container) in
        [(6, 8, 1), (2, 4, 1), (1, 64, 8), (3, 16, 2), (1, 24, 2), (1, 0, 0), (85, 0, 1)]
    {
        let file = raw_wav(kind, bits, container, false, &[0; 24]);
        assert!(refused("a.wav", &file, &channel(0)).contains("save it as PCM"), "{kind} {bits} {container}");
    }
    let nan = raw_wav(3, 32, 4, false, &[0.5_f32, f32::NAN, 0.0].map(f32::to_le_bytes).concat());
    assert!(refused("a.wav", &nan, &channel(0)).contains("sample 1 at 0.001 s is NaN: must be a number"));
}

#[test]
fn a_recording_is_resampled_and_says_so() {
    let spec = WavSpec { channels: 1, sample_rate: 44_100, ..STEREO };
    let sine: Vec<i32> = (0..44_100)
        .map(|k| (16_384.0 * (f64::from(k) * 60.0 / 44_100.0 * std::f64::consts::TAU).sin()) as i32)
        .collect();
    let choice = Choice { offset_um: 60.0, ..channel(0) };
    let found = good("a.wav", &wav(spec, &sine), &choice);
    assert_eq!((found.rate_hz, found.um.len()), (8000.0, 8000));
    assert_eq!(found.note, "WAV 16 bit, 44100 Hz, full scale 100 um, plus 60 um, resampled to 8000 Hz");
    for (k, um) in found.um.iter().enumerate().take(7900).skip(100) {
        let wanted = 60.0 + 50.0 * (k as f64 * 60.0 / 8000.0 * std::f64::consts::TAU).sin();
        assert!((f64::from(*um) - wanted).abs() < 0.02, "sample {k}: {um} instead of {wanted}");
    }
    let array = npy("'<f4'", "False", "(9,)", &f4(&[3.0; 9]));
    assert_eq!(good("a.npy", &array, &at(20_000.0)).um.len(), 4);
}

/// Documents of CSV; `␍` is a carriage return.
const CSV_MISTAKES: &str = r#"
 => …line 1: no column is named `time_s`: the names are …
time_s,a_um⏎ => …0 samples: must be 2…
time_s,a_um⏎0,1⏎ => …1 samples: must be 2…
time_s⏎0⏎ => …add column = and the name of one, in quotes: there are `time_s`…
time_s,a_um,b_um⏎ => …there are `time_s`, `a_um`, `b_um`…
time_s,a⏎0,1⏎1,2⏎ => …line 1: `a` must end with its unit, _um, _mm, _nm or _m; a CSV…
time_s,ch1_V⏎0,1⏎1,2⏎ => …line 1: `ch1_V` must end with its unit…
1⏎2⏎3⏎ => …line 1: no column is named `time_s`: the names are `1`…
t;um⏎0,5;2,0⏎ => …the names are `t;um`; a CSV file begins with names such as time_s,…
time_s,a_um⏎0,1⏎1,2,5⏎ => …line 3: 3 cells, but 2 names; …
time_s,a_um⏎0,1⏎⏎1⏎ => …line 4: 1 cells, but 2 names; …
time_s,a_um⏎0,1⏎0.1,⏎ => …line 3: `` is no number; …
time_s,a_um⏎0,1⏎0.1,"2,5"⏎ => …line 3: `2,5` is no number; …
time_s,a_um⏎⏎0,1␍⏎1,2⏎⏎⏎3,4⏎4,5⏎ => …line 7 is at 3 s, the row before at 1 s…
time_s,a_um⏎0,1⏎0,2⏎ => …line 3 is at 0 s…
time_s,a_um⏎1,1⏎0,2⏎ => …line 3 is at 0 s, the row before at 1 s…
time_s,a_um⏎0,1⏎nan,2⏎1,2⏎ => …line 3 is at NaN s…
time_s,a_um⏎0,1⏎0.1,nan⏎ => …sample 1 at 0.1 s is NaN: must be a number…
"#;

#[test]
fn every_mistake_is_one_line() {
    let array = |descr: &str, shape: &str, values: usize| npy(descr, "False", shape, &f4(&vec![1.0; values]));
    let two = array("'<f4'", "(2, 2)", 4);
    let numpy = |bytes: &[u8], choice: &Choice| refused("a.npy", bytes, choice);
    let shaped = |shape: &str, choice: &Choice| numpy(&array("'<f4'", shape, 3), choice);
    let of_type = |descr: &str| numpy(&array(descr, "(1,)", 3), &at(1.0));
    let text = |text: &str, choice: &Choice| refused("a.csv", text.as_bytes(), choice);
    assert_documents_refused("a.csv", CSV_MISTAKES, |text, file| {
        let read = read(file, text.replace('␍', "\r").as_bytes(), &Choice::default());
        read.map_err(|error| format!("{file}: {error}"))
    });
    let wave = |bytes: &[u8], choice: &Choice| refused("a.wav", bytes, choice);
    let (stereo, none) = (wav(STEREO, &[1; 20]), Choice::default());
    for (line, says) in [
        (numpy(&two, &at(1.0)), "2 columns: add column = 0 to 1"),
        (numpy(&two, &column(2)), "no column 2: 2 column(s), counted from 0"),
        (numpy(&two, &named("x")), "columns of an NPY file have no names"),
        (numpy(&two, &Choice::default()), "2 columns"),
        (numpy(&two, &channel(0)), "`channel` is for other files: use `column`"),
        (numpy(&two[..two.len() - 1], &column(0)), "truncated: it ends after 15 of 16 bytes of data"),
        (numpy(&two[..40], &column(0)), "not an NPY file: it ends within its header"),
        (numpy(b"", &column(0)), "not an NPY file: it does not begin as one"),
        (numpy(b"\x93NUMPY\x07\x00\x00\x00", &column(0)), "its version 7 is unknown"),
        (numpy(b"\x93NUMPY\x02\x00\xff\xff\xff\xff{", &column(0)), "a header of 4294967295 bytes"),
        (of_type("'|O'"), "the array holds Python objects: save it as float32"),
        (of_type("'<c8'"), "the array holds `<c8`: save it"),
        (of_type("[('a', '<f4')]"), "the array holds `a structured type`"),
        (shaped("(1, 1, 3)", &at(1.0)), "the shape (1, 1, 3): must be (samples,) or"),
        (shaped("()", &at(1.0)), "the shape (): must"),
        (shaped("(-3,)", &at(1.0)), "the shape `-3,`"),
        (shaped("(4294967296, 4294967296)", &column(0)), "the shape (4294967296, 4294967296)"),
        (shaped("(99999999, 9)", &column(0)), "truncated"),
        (shaped("(1,)", &at(1.0)), "1 samples: must be 2 to 4194302"),
        (shaped("(2,)", &Choice::default()), "add rate_hz"),
        (shaped("(2,)", &at(0.5)), "rate_hz is 0.5: must be 1 to 192000 Hz"),
        (shaped("(2,)", &at(f64::NAN)), "rate_hz is NaN"),
        (shaped("(2,)", &at(8000.5)), "rate_hz is 8000.5"),
        (
            numpy(&npy("'<f4'", "False", "(3,)", &f4(&[0.0, 1.0, f32::NAN])), &at(500.0)),
            "sample 2 at 0.004 s is NaN: must be a number",
        ),
        (
            numpy(&npy("'<f8'", "False", "(2,)", &[1.0, 1e300].map(f64::to_le_bytes).concat()), &at(500.0)),
            "sample 1 at 0.002 s is 1000",
        ),
        (
            shaped("(2,)", &Choice { scale_um: Some(f64::INFINITY), ..at(1.0) }),
            "scale_um is inf: must be a number",
        ),
        (text("time_s,a_um\n", &column(1)), "add column = and the name of one"),
        (text("time_s,a_um\n", &named("c_um")), "no column is named `c_um`: the names are `time_s`, `a_um`"),
        (text("time_s,a_um,a_um\n", &named("a_um")), "line 1: several columns are named `a_um`"),
        (text("time_s,a_um\n0,1\n0.1,2\n", &at(20.0)), "rate_hz is 20, but the file says 10 Hz"),
        (
            text("time_s,a_um\n0,1\n0.1,2\n", &Choice { scale_um: Some(2.0), ..Choice::default() }),
            "the name of a CSV file's column says its unit: leave the scale out",
        ),
        (refused("a.csv", b"time_s,a_um\n0,1\n1,\xff\n", &none), "line 3: not UTF-8 text; a CSV file begins"),
        (refused("a.csv", b"\xff\xfet\0i\0", &none), "line 1: not UTF-8 text"),
        (wave(&stereo, &Choice { channel: None, ..channel(0) }), "2 channels: add channel = 0 to 1"),
        (wave(&stereo, &channel(2)), "no channel 2: 2 channel(s), counted from 0"),
        (wave(&stereo, &Choice { scale_um: None, ..channel(0) }), "add scale_um: the displacement of full"),
        (wave(&stereo, &column(0)), "`column` is for other files: use `channel`"),
        (wave(&stereo, &Choice { rate_hz: Some(1000.0), ..channel(0) }), "the file says 4000 Hz"),
        (wave(&stereo[..stereo.len() - 5], &channel(1)), "truncated: it ends after 8 of 10 samples"),
        (wave(&stereo[..30], &channel(1)), "not a WAV file"),
        (wave(b"RIFFxxxxWAVE", &channel(1)), "not a WAV file"),
        (refused("a.mat", &stereo, &at(1.0)), "must end in .npy, .csv or .wav"),
        (refused("npy", &stereo, &at(1.0)), "must end in .npy, .csv or .wav"),
    ] {
        assert!(line.contains(says), "{line}\n  does not say {says}");
    }
}

#[test]
fn sizes_are_bounded() {
    assert!(
        refused("a.npy", &vec![0; MAX_FILE_BYTES + 1], &at(1.0)).starts_with("67108865 bytes are too many")
    );
    let many = MAX_SAMPLES + 1;
    let large = npy("'<i2'", "False", &format!("({many},)"), &vec![0; 2 * many]);
    assert_eq!(refused("a.npy", &large, &at(8000.0)), format!("{many} samples: must be 2 to {MAX_SAMPLES}"));
}
