//! The readers: what NumPy, a spreadsheet and a recorder write, every mistake in one line, and any bytes without a panic.
#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

use hound::{SampleFormat, WavSpec, WavWriter};
use meissner_samples::{Choice, Column, MAX_FILE_BYTES, MAX_SAMPLES, Samples, read};
use proptest::prelude::*;
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
        match spec.sample_format {
            SampleFormat::Int => writer.write_sample(*sample).unwrap(),
            SampleFormat::Float => writer.write_sample(*sample as f32 / 100.0).unwrap(),
        }
    }
    writer.finalize().unwrap();
    file.into_inner()
}

const STEREO: WavSpec =
    WavSpec { channels: 2, sample_rate: 4000, bits_per_sample: 16, sample_format: SampleFormat::Int };

fn at(rate_hz: f64) -> Choice {
    Choice { rate_hz: Some(rate_hz), ..Choice::default() }
}

fn column(number: usize) -> Choice {
    Choice { column: Some(Column::Number(number)), ..at(1000.0) }
}

fn named(name: &str) -> Choice {
    Choice { column: Some(Column::Name(name.to_owned())), ..at(1000.0) }
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
fn csv_is_read_with_and_without_names() {
    let commas = b"\xef\xbb\xbftime_s,pin 9\n\n0.0, 1.5\n0.001 ,2e0\n# a comment\n0.002,-3\n";
    let found = good("a.csv", commas, &named("pin 9"));
    assert_eq!((found.um, &*found.note), (vec![1.5, 2.0, -3.0], "CSV column 1 (pin 9) of 2, 1000 Hz"));
    assert_eq!(good("a.csv", commas, &column(1)).um.len(), 3);
    for text in ["1\n2\n3", "# a line of NumPy\r\n1\r\n2\r\n3\r\n", "\"height\"\n1\n2\n3\n"] {
        assert_eq!(good("a.csv", text.as_bytes(), &at(1.0)).um, [1.0, 2.0, 3.0], "{text}");
    }
    assert_eq!(good("a.csv", b"time,9\n0,1\n1,2\n", &named("9")).um, [1.0, 2.0]);
    for text in ["1;2\n3;4\n", "1\t2\n3\t4\n", "Weg\n\nt;um\n0,5;2,0\n1,5;4,0\n"] {
        assert_eq!(good("a.csv", text.as_bytes(), &column(1)).um, [2.0, 4.0], "{text}");
    }
}

/// A row is a sample: files that spreadsheets and pandas write, with rows that have no value.
#[test]
fn rows_without_a_value_are_refused() {
    let says = |text: &str, choice: &Choice| refused("a.csv", text.as_bytes(), choice);
    for (text, number, line) in [
        ("1\n\n3\n4\n", 0, 2),
        ("1\r\n\r\n3\r\n4\r\n", 0, 2),
        ("1\r\r3\r4\r", 0, 2),
        ("um\n1\n  \n\n3\n", 0, 3),
        ("um\n1\n# a comment\n\n3\n", 0, 4),
        ("um\n1\n\"\"\n3\n", 0, 3),
        ("um\n\"\"\n1\n3\n", 0, 2),
        ("um\nNaN\nNaN\n1\n3\n", 0, 2),
        ("um\n#N/A\n1\n3\n", 0, 2),
        ("NaN\n1\n3\n", 0, 1),
        ("t,um\n,\n0,1\n1,3\n", 1, 2),
        ("t,um\n0,1\n,\n2,3\n", 1, 3),
        ("t,um\n0,1\n\n2,3\n", 1, 3),
        ("t;um\n0,1;1,5\n;;\n0,2;3,5\n", 1, 3),
        ("t\tum\n0\t1\n\t\n2\t3\n", 1, 3),
        ("t\tum\n\t\n0\t1\n2\t3\n", 1, 2),
        ("t um\n0 1\n\n2 3\n", 1, 3),
    ] {
        let wanted = format!(
            "line {line} has no value, and each row is a sample: delete it, or write the missing value"
        );
        assert_eq!(says(text, &column(number)), wanted, "{text:?}");
    }
    assert_eq!(says("um\n1\n#DIV/0!\n3\n", &at(1.0)), "line 3: `#DIV/0!` is not a number");
    assert_eq!(says("t,um\n0,1\n1,\n2,3\n", &column(1)), "line 3: `` is not a number");
    // Empty lines above the numbers, at the end, and after line ends that were changed twice.
    for text in
        ["um\n\n\n1\n3\n\n\n", "1\n3\n,,\n ,\n", "um\r\r\n1\r\r\n3\r\r\n", "\n \n1\n3", "#\n\n1\r\n3\r\n\r\n"]
    {
        assert_eq!(good("a.csv", text.as_bytes(), &at(1.0)).um, [1.0, 3.0], "{text:?}");
    }
}

#[test]
fn a_unit_of_a_header_is_um_or_needs_a_scale() {
    for (header, number, note) in [
        ("um", 0, "CSV column 0 (um) of 1 in um, 1000 Hz"),
        ("height [\u{3bc}m]", 0, "CSV column 0 (height [\u{3bc}m]) of 1 in um, 1000 Hz"),
        ("t [s],height_um", 1, "CSV column 1 (height_um) of 2 in um, 1000 Hz"),
        ("t,height\ns,microns", 1, "CSV column 1 (height) of 2 in um, 1000 Hz"),
        ("Unit: um\nheight", 0, "CSV column 0 (height) of 1 in um, 1000 Hz"),
        ("pin 9", 0, "CSV column 0 (pin 9) of 1, 1000 Hz"),
        ("t,pin", 1, "CSV column 1 (pin) of 2, 1000 Hz"),
        ("height (filtered) [um]", 0, "CSV column 0 (height (filtered) [um]) of 1 in um, 1000 Hz"),
    ] {
        let text = format!("{header}\n{}", if number == 0 { "1\n2\n" } else { "0,1\n0.001,2\n" });
        let found = good("a.csv", text.as_bytes(), &column(number));
        assert_eq!((found.um, &*found.note), (vec![1.0, 2.0], note));
    }
    for (header, says) in [
        (
            "height [mm]",
            "the header says that column `height [mm]` is in mm, not um: add scale_um = 1000, or 1 if the values are um",
        ),
        ("height_nm", "column `height_nm` is in nm, not um: add scale_um = 0.001"),
        ("Weg / m", "column `Weg / m` is in m, not um: add scale_um = 1000000"),
        ("mm", "column `mm` is in mm"),
        ("height\n[mm]", "column `height` is in mm"),
        ("# height [mm]", "column `height [mm]` is in mm"),
        ("Unit: mm\nheight", "column `height` is in mm"),
        (
            "height [cm]",
            "the header says `cm` of column `height [cm]`, which is no unit of length: add scale_um, the um of",
        ),
        ("height_cm", "says `cm` of column"),
        ("height\nkPa", "says `kpa` of column `height`"),
        ("CH1 [V]", "says `v` of column"),
        ("velocity [um/s]", "says `um/s` of column"),
        ("Vertical Units:V\nheight", "says `V` of column `height`"),
        ("height [furlong]", "says `furlong` of column"),
        ("height [um]\nmm", "says `mm and height [um]` of column"),
    ] {
        let text = format!("{header}\n1\n2\n");
        let line = refused("a.csv", text.as_bytes(), &at(10.0));
        assert!(line.contains(says), "{line}\n  does not say {says}");
        let scaled = Choice { scale_um: Some(1000.0), ..at(10.0) };
        assert_eq!(good("a.csv", text.as_bytes(), &scaled).um, [1000.0, 2000.0], "{header}");
    }
}

#[test]
fn wav_of_integers_has_full_scale_and_its_own_rate() {
    let found = good("a.wav", &wav(STEREO, &[0, 16384, 0, -32768, 1, 0]), &channel(1));
    assert_eq!((found.rate_hz, found.um), (4000.0, vec![50.0, -100.0, 0.0]));
    assert_eq!(found.note, "WAV 16 bit, channel 1 of 2, 4000 Hz, full scale 100 um");
    for bits_per_sample in [8, 16, 24, 32] {
        let one = WavSpec { channels: 1, bits_per_sample, ..STEREO };
        let least = i32::MIN >> (32 - bits_per_sample);
        let found = good("a.wav", &wav(one, &[least, least / 2]), &Choice { offset_um: 100.0, ..channel(0) });
        assert_eq!(found.um, [0.0, 50.0], "{bits_per_sample} bits");
    }
    let float = WavSpec { bits_per_sample: 32, sample_format: SampleFormat::Float, channels: 1, ..STEREO };
    assert_eq!(good("a.wav", &wav(float, &[50, 25]), &channel(0)).um, [50.0, 25.0]);
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

/// What recorders, Audacity, SciPy and `soundfile` write. Python's reader has the same test.
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

/// Python's reader has the same test.
#[test]
fn times_that_contradict_the_rate_are_refused() {
    for (text, rate_hz, own) in [
        ("t,um\n0,1\n0.001,2\n0.002,3\n0.003,4\n", 1000.0, None),
        ("t,um\n0,1\n0.001,2\n0.002,3\n0.003,4\n", 1009.0, None),
        ("t,um\n0,1\n0.001,2\n0.002,3\n0.003,4\n", 500.0, Some("1000 Hz")),
        ("um,time\n1,0\n2,0.001\n3,0.002\n4,0.003\n", 8000.0, Some("1000 Hz")),
        ("um;Zeit [ms]\n1;5\n2;5,5\n3;6\n4;6,5\n", 2000.0, None),
        ("um;Zeit [ms]\n1;5\n2;5,5\n3;6\n4;6,5\n", 1000.0, Some("2000 Hz")),
        ("s,um\n0,1\n1,2\n2,3\n", 1.0, None),
        ("s,um\n0,1\n1,2\n2,3\n", 10.0, Some("1 Hz")),
        ("Time,height\nms,um\n0,1\n1,2\n2,3\n", 1000.0, None),
        ("Time,height\nms,um\n0,1\n1,2\n2,3\n", 44_100.0, Some("1000 Hz")),
        // Without a unit they may be in any, or numbers of rows.
        ("t,um\n0,1\n0.5,2\n1,3\n1.5,4\n", 2000.0, None),
        ("t,um\n0,1\n1,2\n2,3\n", 10.0, None),
        ("time [frames],um\n0,1\n2,2\n4,3\n", 10.0, None),
        // Rounded times, and those that are no measure.
        ("t,um\n0.000,1\n0.000,2\n0.000,3\n0.000,4\n0.001,5\n0.001,6\n", 8000.0, None),
        ("t,um\n0.000,1\n0.000,2\n0.001,3\n0.001,4\n0.002,5\n0.002,6\n0.003,7\n", 500.0, Some("2000 Hz")),
        ("t,um\n5,1\n5,2\n5,3\n", 10.0, None),
        ("t,um\n0,1\nnan,2\n0.2,3\n", 70.0, None),
        ("force,um\n0,1\n0.001,2\n0.002,3\n", 10.0, None),
    ] {
        let choice =
            Choice { column: Some(Column::Number(usize::from(!text.starts_with("um")))), ..at(rate_hz) };
        let found = read("a.csv", text.as_bytes(), &choice)
            .map(|found| found.um.len())
            .map_err(|error| error.to_string());
        match own {
            None => assert!(found.is_ok(), "{text:?} at {rate_hz}: {found:?}"),
            Some(own) => {
                let line = found.unwrap_err();
                assert!(line.contains(&format!("say {own}")) && !line.contains('\n'), "{line}");
            }
        }
    }
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

#[test]
fn every_mistake_is_one_line() {
    let array = |descr: &str, shape: &str, values: usize| npy(descr, "False", shape, &f4(&vec![1.0; values]));
    let two = array("'<f4'", "(2, 2)", 4);
    let text = |text: &str, choice: &Choice| refused("a.csv", text.as_bytes(), choice);
    let stereo = wav(STEREO, &[1; 20]);
    for (line, says) in [
        (refused("a.npy", &two, &at(1.0)), "2 columns: add column = 0 to 1"),
        (refused("a.npy", &two, &column(2)), "no column 2: 2 column(s), counted from 0"),
        (refused("a.npy", &two, &named("x")), "columns of an NPY file have no names"),
        (refused("a.npy", &two, &Choice::default()), "2 columns"),
        (refused("a.npy", &two, &channel(0)), "`channel` is for other files: use `column`"),
        (
            refused("a.npy", &two[..two.len() - 1], &column(0)),
            "truncated: it ends after 15 of 16 bytes of data",
        ),
        (refused("a.npy", &two[..40], &column(0)), "not an NPY file: it ends within its header"),
        (refused("a.npy", b"", &column(0)), "not an NPY file: it does not begin as one"),
        (refused("a.npy", b"\x93NUMPY\x07\x00\x00\x00", &column(0)), "its version 7 is unknown"),
        (refused("a.npy", b"\x93NUMPY\x02\x00\xff\xff\xff\xff{", &column(0)), "a header of 4294967295 bytes"),
        (
            refused("a.npy", &array("'|O'", "(3,)", 3), &at(1.0)),
            "the array holds Python objects: save it as float32",
        ),
        (refused("a.npy", &array("'<c8'", "(1,)", 3), &at(1.0)), "the array holds `<c8`: save it"),
        (
            refused("a.npy", &array("[('a', '<f4')]", "(3,)", 3), &at(1.0)),
            "the array holds `a structured type`",
        ),
        (
            refused("a.npy", &array("'<f4'", "(1, 1, 3)", 3), &at(1.0)),
            "the shape (1, 1, 3): must be (samples,) or",
        ),
        (refused("a.npy", &array("'<f4'", "()", 1), &at(1.0)), "the shape (): must"),
        (refused("a.npy", &array("'<f4'", "(-3,)", 3), &at(1.0)), "the shape `-3,`"),
        (
            refused("a.npy", &array("'<f4'", "(4294967296, 4294967296)", 3), &column(0)),
            "the shape (4294967296, 4294967296)",
        ),
        (refused("a.npy", &array("'<f4'", "(99999999, 9)", 3), &column(0)), "truncated"),
        (refused("a.npy", &array("'<f4'", "(1,)", 1), &at(1.0)), "1 samples: must be 2 to 4194302"),
        (refused("a.npy", &array("'<f4'", "(2,)", 2), &Choice::default()), "add rate_hz"),
        (refused("a.npy", &array("'<f4'", "(2,)", 2), &at(0.5)), "rate_hz is 0.5: must be 1 to 192000 Hz"),
        (refused("a.npy", &array("'<f4'", "(2,)", 2), &at(f64::NAN)), "rate_hz is NaN"),
        (refused("a.npy", &array("'<f4'", "(2,)", 2), &at(8000.5)), "rate_hz is 8000.5"),
        (
            refused("a.npy", &npy("'<f4'", "False", "(3,)", &f4(&[0.0, 1.0, f32::NAN])), &at(500.0)),
            "sample 2 at 0.004 s is NaN: must be a number",
        ),
        (
            refused(
                "a.npy",
                &npy("'<f8'", "False", "(2,)", &[1.0, 1e300].map(f64::to_le_bytes).concat()),
                &at(500.0),
            ),
            "sample 1 at 0.002 s is 1000",
        ),
        (
            refused(
                "a.npy",
                &array("'<f4'", "(2,)", 2),
                &Choice { scale_um: Some(f64::INFINITY), ..at(1.0) },
            ),
            "scale_um is inf: must be a number",
        ),
        (text("", &at(1.0)), "0 samples: must be 2"),
        (text("time\n", &at(1.0)), "0 samples"),
        (text("a,b\n1,2\n", &at(1.0)), "2 columns: add column"),
        (text("a,b\n1,2\n", &named("c")), "no column named `c`: the names above the numbers are `a`, `b`"),
        (text("1,2\n3,4\n", &named("c")), "no column named `c`: the names above the numbers are none"),
        (text("a,a\n1,2\n", &named("a")), "several columns are named `a`: give the number, from 0"),
        // Decimal commas between commas; R's `write.table`, which gives the numbers of its rows no name.
        (
            text("t,um\n0,1,1,5\n0,2,2,5\n", &column(1)),
            "2 names stand above 4 columns of numbers: correct the names; if",
        ),
        (text("x um\n1 0.5 2\n2 0.6 3\n", &column(1)), "2 names stand above 3 columns of numbers"),
        // The rows above those with the usual number of cells are no header.
        (
            text("t,um\n0,1,5\n1,2\n2,3\n", &column(1)),
            "line 2 has 3 cells, other rows have 2: complete the row",
        ),
        (
            text("t,um\nx,1\n1,2\n2,3\n3,4\n", &column(1)),
            "line 2: `1` stands in a row above the numbers that is not like",
        ),
        (text("t,um\n0\n1,2\n2,3\n", &column(1)), "line 2 has 1 cells, other rows have 2"),
        (text("1000\n0,1\n1,2\n", &column(1)), "line 1 has 1 cells, other rows have 2"),
        (text("t,um\n0,1\n1, \"2\"\n2,3\n", &column(1)), "line 3: a space stands before a quotation mark"),
        (
            text("t,um\n0,1\n1,2,5\n2,3\n", &column(1)),
            "line 3 has 3 cells, other rows have 2: complete the row, or delete",
        ),
        (text("1\n2\nthree\n", &at(1.0)), "line 3: `three` is not a number"),
        (text("1,2\n3\n", &column(1)), "line 2 has 1 cells, other rows have 2"),
        (
            text("0,5;1\n0.5;2\n", &column(0)),
            "line 2: `0.5` has another decimal mark than the numbers above it",
        ),
        (text("1\ninf\n", &at(1.0)), "sample 1 at 1 s is inf"),
        (refused("a.csv", b"1\n\xff\n", &at(1.0)), "line 2: `\u{ff}` is not a number"),
        (
            refused("a.wav", &stereo, &Choice { channel: None, ..channel(0) }),
            "2 channels: add channel = 0 to 1",
        ),
        (refused("a.wav", &stereo, &channel(2)), "no channel 2: 2 channel(s), counted from 0"),
        (
            refused("a.wav", &stereo, &Choice { scale_um: None, ..channel(0) }),
            "add scale_um: the displacement of full",
        ),
        (refused("a.wav", &stereo, &column(0)), "`column` is for other files: use `channel`"),
        (refused("a.wav", &stereo, &Choice { rate_hz: Some(1000.0), ..channel(0) }), "the file says 4000 Hz"),
        (
            refused("a.wav", &stereo[..stereo.len() - 5], &channel(1)),
            "truncated: it ends after 8 of 10 samples",
        ),
        (refused("a.wav", &stereo[..30], &channel(1)), "not a WAV file"),
        (refused("a.wav", b"RIFFxxxxWAVE", &channel(1)), "not a WAV file"),
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

proptest! {
    /// Also bytes that begin as a file does, and files with some bytes changed.
    #[test]
    fn no_bytes_make_a_reader_panic(
        kind in 0..3_usize,
        whole in any::<bool>(),
        bytes in prop::collection::vec(any::<u8>(), 0..300),
        changes in prop::collection::vec((0..200_usize, any::<u8>()), 0..6),
        cut in 0..400_usize,
        number in 0..3_usize,
    ) {
        let names = ["a.npy", "a.csv", "a.wav"];
        let mut file = match kind {
            _ if !whole => bytes,
            0 => npy("'<f4'", "False", "(6, 2)", &f4(&[1.0; 12])),
            1 => b"x,y\n1,2\n3,4\n5,6\n".to_vec(),
            _ => wav(STEREO, &[7; 40]),
        };
        for (place, byte) in changes {
            if let Some(old) = file.get_mut(place) {
                *old = byte;
            }
        }
        file.truncate(cut.max(4));
        let choices = [column(number), named("y"), channel(number), at(44_100.0), Choice::default()];
        for choice in choices {
            match read(names[kind], &file, &choice) {
                Ok(samples) => prop_assert!(samples.um.iter().all(|um| um.is_finite()) && samples.um.len() >= 2),
                Err(error) => prop_assert!(!error.to_string().contains('\n')),
            }
        }
    }

    #[test]
    fn npy_round_trip(values in prop::collection::vec(-1e6_f32..1e6, 2..200)) {
        let file = npy("'<f4'", "False", &format!("({},)", values.len()), &f4(&values));
        prop_assert_eq!(good("a.npy", &file, &at(1000.0)).um, values);
    }
}
