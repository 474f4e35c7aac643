//! Object files: what they say, and what is refused, in one line.

use meissner_touch::{MAX_BYTES, Object, ObjectError, bytes};
use proptest::prelude::{ProptestConfig, any, prop_assert, proptest};
use std::io;

fn read(text: &str) -> Result<Object, ObjectError> {
    read_with(text, &[])
}

/// Reads an object whose files are these.
fn read_with(text: &str, files: &[(&str, Vec<u8>)]) -> Result<Object, ObjectError> {
    let mut open = |name: &str| {
        let found = files.iter().find(|(known, _)| *known == name);
        found.map(|(_, bytes)| bytes.clone()).ok_or_else(|| io::Error::from(io::ErrorKind::NotFound))
    };
    Object::read(text, "o.toml", &mut open)
}

const PRESS: &str = "[touch]\npress = { depth_um = 500 }\n";

fn object(shape: &str) -> String {
    format!("kind = \"object\"\nname = \"o\"\n{shape}\n{PRESS}")
}

fn touching(touch: &str) -> String {
    format!(
        "kind = \"object\"\nname = \"o\"\nshape = \"bar\"\nlength_mm = 12\nwidth_mm = 0.8\n[touch]\n{touch}\n"
    )
}

fn png(color: png::ColorType, depth: png::BitDepth, size: [u32; 2], data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size[0], size[1]);
    encoder.set_color(color);
    encoder.set_depth(depth);
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(data).expect("an image");
    drop(writer);
    bytes
}

fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let length = (header.len() as u16).to_le_bytes();
    [&b"\x93NUMPY\x01\x00"[..], &length, header.as_bytes(), data].concat()
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

#[test]
fn every_shape_makes_grains_of_its_size() {
    let grey = png(png::ColorType::Grayscale, png::BitDepth::Eight, [40, 20], &[255; 800]);
    let deep = png(png::ColorType::Grayscale, png::BitDepth::Sixteen, [40, 20], &[255; 1600]);
    let array = npy("<f4", "(20, 40)", &floats(&[0.0; 800]));
    let profile = b"height_um\n0\n0\n0\n0\n".to_vec();
    let files = [("m.png", grey), ("d.png", deep), ("m.npy", array), ("p.csv", profile)];
    let pad = std::f64::consts::PI * 10.0 * 13.0;
    for (shape, area) in [
        ("shape = \"bar\"\nlength_mm = 12\nwidth_mm = 0.8", 9.6),
        ("shape = \"gap\"\nlength_mm = 10\nwidth_mm = 0.8\ngap_mm = 2", 16.0),
        ("shape = \"edge\"\nangle_deg = 30", pad / 2.0),
        (
            "shape = \"segment\"\npoints = [[-3, 0], [3, 4]]\nwidth_mm = 1",
            7.2111 + std::f64::consts::PI / 4.0,
        ),
        ("shape = \"polyline\"\npoints = [[-3, 0], [3, 0], [3, 0]]", 4.8 + 0.16 * std::f64::consts::PI),
        ("shape = \"disc\"\nradius_mm = 3\ncenter_mm = [1, 0]", 9.0 * std::f64::consts::PI),
        ("shape = \"dots\"\npoints = [[0, 0], [4, 1]]\ndiameter_mm = 2", 2.0 * std::f64::consts::PI),
        ("shape = \"grating\"\nperiod_mm = 4\nridge_mm = 1\nangle_deg = 90", pad / 4.0),
        ("shape = \"braille\"\ntext = \"b ⠿\"\ndiameter_mm = 1", 8.0 * std::f64::consts::PI / 4.0),
        ("shape = \"polygon\"\npoints = [[0, 0], [6, 0], [0, 6]]", 18.0),
        (
            "shape = \"lines\"\nlines = [[[-4, 0], [4, 0]], [[0, 5], [0, -5]], [[6, 6]]]\nwidth_mm = 1",
            17.0 + 0.75 * std::f64::consts::PI,
        ),
        ("shape = \"heightmap\"\nfile = \"m.png\"\nmm_per_pixel = 0.2\num_per_level = 2", 32.0),
        ("shape = \"heightmap\"\nfile = \"d.png\"\nmm_per_pixel = 0.2\num_per_level = 0.01", 32.0),
        ("shape = \"heightmap\"\nfile = \"m.npy\"\nmm_per_pixel = 0.2", 32.0),
        ("shape = \"texture\"\nfile = \"p.csv\"\nmm_per_pixel = 0.5", 2.0 * 26.0),
    ] {
        let object = read_with(&object(shape), &files).unwrap_or_else(|error| panic!("{shape}: {error}"));
        let pitch_mm = object.pitch_mm();
        let grains = object.grains(pitch_mm);
        let found = grains.len() as f64 * pitch_mm * pitch_mm;
        assert!((found / area - 1.0).abs() < 0.04, "{shape}: {found} of {area} mm² at {pitch_mm}");
        assert!(grains.are_flat() && bytes(&grains) < MAX_BYTES, "{shape}");
        assert!(grains.heights_mm.iter().all(|&height_mm| height_mm <= 0.0), "{shape}");
    }
}

/// What a trace follows, on the skin, and the gaps that observers read.
#[test]
fn an_object_has_lines() {
    let at = "center_mm = [1, 0]\nangle_deg = 90";
    let read = |shape: &str| read_with(&object(shape), &[("p.csv", b"height_um\n0\n1\n".to_vec())]).unwrap();
    let lines = |shape: &str| -> Vec<Vec<[f64; 2]>> {
        let rounded = |at: [f64; 2]| at.map(|place| (place * 1e6).round() / 1e6 + 0.0);
        let lines = read(&format!("{shape}\n{at}")).lines_mm().unwrap().into_iter();
        lines.map(|line| line.into_iter().map(rounded).collect()).collect()
    };
    let bar = "length_mm = 12\nwidth_mm = 1";
    assert_eq!(lines(&format!("shape = \"bar\"\n{bar}")), [[[1.0, -6.0], [1.0, 6.0]]]);
    assert_eq!(
        lines("shape = \"bar\"\nlength_mm = 1\nwidth_mm = 12").concat(),
        [[7.0, 0.0], [-5.0, 0.0]],
        "a bar that is wider than long"
    );
    assert_eq!(
        lines(&format!("shape = \"gap\"\ngap_mm = 3\n{bar}")),
        [[[3.0, -6.0], [3.0, 6.0]], [[-1.0, -6.0], [-1.0, 6.0]]]
    );
    assert_eq!(
        lines("shape = \"polygon\"\npoints = [[0, 0], [2, 0], [0, 2]]"),
        [[[1.0, 0.0], [1.0, 2.0], [-1.0, 0.0], [1.0, 0.0]]]
    );
    assert_eq!(
        lines("shape = \"dots\"\npoints = [[0, 1], [3, 0]]\ndiameter_mm = 1"),
        [[[0.0, 0.0]], [[1.0, 3.0]]]
    );
    assert_eq!(
        lines("shape = \"lines\"\nlines = [[[0, 0], [1, 0], [1, 2]], [[4, 4]]]\nwidth_mm = 1"),
        [vec![[1.0, 0.0], [1.0, 1.0], [-1.0, 1.0]], vec![[-3.0, 4.0]]]
    );
    let texture = read("shape = \"texture\"\nfile = \"p.csv\"\nmm_per_pixel = 0.5");
    assert_eq!(texture.lines_mm(), None);
}

#[test]
fn a_pixel_lies_where_the_image_shows_it() {
    // One bright pixel at the upper right of 3 × 2.
    let bright = png(png::ColorType::Grayscale, png::BitDepth::Eight, [3, 2], &[0, 0, 100, 0, 0, 0]);
    let text = object("shape = \"heightmap\"\nfile = \"m.png\"\nmm_per_pixel = 1\num_per_level = 10");
    let object = read_with(&text, &[("m.png", bright)]).unwrap();
    let height_mm = |x, y| object.surface().height_mm([x, y]);
    assert_eq!(
        (height_mm(1.2, 0.5), height_mm(-1.2, 0.5), height_mm(1.2, -0.5)),
        (Some(0.0), Some(-1.0), Some(-1.0))
    );
    assert_eq!((height_mm(1.6, 0.5), height_mm(0.0, 1.1)), (None, None));
}

#[test]
fn a_path_of_a_file_moves_the_object_from_its_place() {
    let path = "t_s,x_mm,y_mm,angle_deg,depth_um\n0,0,0,0,0\n0.1,0,0,0,400\n0.2,1,2,10,400\n";
    let text = touching("path.file = \"path.csv\"")
        .replace("[touch]", "center_mm = [3, 0]\nangle_deg = 20\n[touch]");
    let object = read_with(&text, &[("path.csv", path.into())]).unwrap();
    let pose = object.touch().pose(0.15);
    let close = |a: f64, b: f64| (a - b).abs() < 1e-12;
    assert!(close(pose.x_mm, 3.5) && close(pose.y_mm, 1.0), "{pose:?}");
    assert!(close(pose.angle_deg, 25.0) && close(pose.depth_mm, 0.4), "{pose:?}");
    assert_eq!(object.touch().duration_s(), 0.2);
}

#[test]
fn what_is_wrong_is_said_in_one_line() {
    let bar = "shape = \"bar\"\nlength_mm = 12\nwidth_mm = 0.8";
    let long = format!("shape = \"braille\"\ntext = \"{}\"", "a".repeat(700));
    for (text, line) in [
        (object(&bar.replace("0.8", "nan")), "o.toml:5: `width_mm` is NaN: must be 0.1 to 100 mm"),
        (object(&bar.replace("0.8", "200")), "o.toml:5: `width_mm` is 200: must be 0.1 to 100 mm"),
        (object("shape = \"bar\"\nwidth_mm = 1"), "o.toml: `length_mm` is missing: add a length, mm"),
        (object(&format!("{bar}\nlenght = 1")), "o.toml:6: unknown key `lenght`: did you mean `length_mm`?"),
        (
            object(&format!("{bar}\ngap_mm = 1")),
            "o.toml:6: `gap_mm` is a key of shape = gap, and this is a bar: leave it out, or change `shape`",
        ),
        (
            object(&format!("{bar}\nangle_deg = 400")),
            "o.toml:6: `angle_deg` is 400: must be -360 to 360 degrees",
        ),
        (object(bar).replace("\"object\"", "\"target\""), "o.toml:1: `kind` is `target`: must be \"object\""),
        (object(bar).replace("\"o\"", "\"O\""), "o.toml:2: `name` is `O`: must be 1 to 64 of a-z, 0-9 and -"),
        (
            object("shape = \"ball\""),
            "o.toml:3: `shape`: unknown variant `ball`, expected one of `bar`, `edge`, `segment`, `polyline`, `disc`, `dots`, `gap`, `grating`, `braille`, `lines`, `polygon`, `heightmap`, `texture`",
        ),
        (
            object("shape = \"dots\"\npoints = []\ndiameter_mm = 1"),
            "o.toml:4: `points` is a list of 0: must be 1 to 4096 dots",
        ),
        (
            object("shape = \"lines\"\nlines = [[[0, 0]], []]\nwidth_mm = 1"),
            "o.toml:4: `lines` has 1 points in all: must be 1 to 4096, and one or more in each line",
        ),
        (
            object("shape = \"lines\"\nlines = [[[0, 200]]]\nwidth_mm = 1"),
            "o.toml:4: `lines` is 200: must be -100 to 100 mm each",
        ),
        (
            object("shape = \"lines\"\nwidth_mm = 1"),
            "o.toml: `lines` is missing: add lines = [[[x, y], [x, y], ...], ...], in mm",
        ),
        (
            object("shape = \"grating\"\nperiod_mm = 2\nridge_mm = 2"),
            "o.toml:5: `ridge_mm` is 2: must be less than period_mm",
        ),
        (
            object("shape = \"braille\"\ntext = \"aB\""),
            "o.toml:4: `text` holds `B`: must be letters a to z, six-dot Braille characters, U+2800 to U+283F, and spaces",
        ),
        (
            object("shape = \"braille\"\ntext = \"  \""),
            "o.toml:4: `text` has no dot: the object never touches; write a letter",
        ),
        (
            object("shape = \"braille\"\ncharacter = \"hi\""),
            "o.toml:4: `character` is `hi`: must be one character; write a word as text = \"...\"",
        ),
        (object(&long), "o.toml:4: `text` is a list of 700: must be at most 682 characters"),
        (touching(""), "o.toml:6: `touch` needs one of press, scan and path: it has 0"),
        (
            touching("press.depth_um = 0"),
            "o.toml:7: `touch.press`: the depth is 0 at all times: the object never touches; give a depth above 0",
        ),
        (
            touching("press.depth_um = 2001"),
            "o.toml:7: `touch.press.depth_um` is 2001: must be above 0, at most 2000 um",
        ),
        (
            touching("press.depth_um = -5"),
            "o.toml:7: `touch.press.depth_um` is -5: must be above 0, at most 2000 um",
        ),
        (
            touching("press = { depth_um = 2000, rise_s = 0.001 }"),
            "o.toml:7: `touch.press`: the path jumps: its depth goes at 2000 mm/s from pose 0 to 1, at 0.001 s; at most 500 mm/s",
        ),
        (
            touching("press = { depth_um = 500, hold_s = 61 }"),
            "o.toml:7: `touch.press`: hold_s is 61: must be 0 to 60 s",
        ),
        (
            touching("scan = { depth_um = 500, speed_mm_s = 20 }"),
            "o.toml:7: `touch.scan` needs duration_s or distance_mm, one of them",
        ),
        (
            touching("scan = { depth_um = 500, speed_mm_s = 501, duration_s = 1 }"),
            "o.toml:7: `touch.scan`: speed_mm_s is 501: must be 0 to 500 mm/s",
        ),
        (
            touching("scan = { depth_um = 500, speed_mm_s = 0, distance_mm = 1 }"),
            "o.toml:7: `touch.scan`: duration_s is inf: must be 0.001 to 60 s",
        ),
        (
            touching("scan = { depth_um = 500, speed_mm_s = 100, duration_s = 10 }"),
            "o.toml:7: `touch.scan`: x_mm is -500: must be -100 to 100 mm",
        ),
        (
            touching("path.poses = [[0, 0, 0, 0, 100], [0.1, 60, 0, 0, 100]]"),
            "o.toml:7: `touch.path`: the path jumps: the object goes at 600 mm/s from pose 0 to 1, at 0.1 s; at most 500 mm/s",
        ),
        (
            touching("path.poses = [[0, 0, 0, 0, 100], [0, 1, 0, 0, 100]]"),
            "o.toml:7: `touch.path`: pose 1 is at 0 s: the first must be at 0 s, and each later than the one before",
        ),
        (
            touching("path.poses = [[0, 0, 0, 0, 0], [1, 1, 0, 0, 0]]"),
            "o.toml:7: `touch.path`: the depth is 0 at all times: the object never touches; give a depth above 0",
        ),
        (
            touching("path.poses = [[0, nan, 0, 0, 10], [1, 1, 0, 0, 0]]"),
            "o.toml:7: `touch.path`: x_mm is NaN: must be -100 to 100 mm",
        ),
        (
            touching("path.poses = [[0, 0, 0, 0, 10], [1, 1, 0, 0, 2500]]"),
            "o.toml:7: `touch.path`: depth_mm is 2.5: must be 0 to 2 mm",
        ),
        (
            touching("path.poses = [[0, 0, 0, 0, 10]]"),
            "o.toml:7: `touch.path`: 1 poses: a path has 2 to 100000",
        ),
        (
            touching("path.file = \"none.csv\""),
            "o.toml:7: `touch.path.file` is not readable: entity not found",
        ),
    ] {
        assert_eq!(read(&text).unwrap_err().to_string(), line, "{text}");
    }
    let huge = format!("# {}", "x".repeat(300_000));
    assert_eq!(
        read(&huge).unwrap_err().to_string(),
        "o.toml: 300002 bytes are too many: an object file has at most 262144"
    );
}

#[test]
fn bad_images_and_profiles_are_refused_in_one_line() {
    use png::{BitDepth, ColorType};
    let map = |name: &str| {
        object(&format!("shape = \"heightmap\"\nfile = \"{name}\"\nmm_per_pixel = 0.1\num_per_level = 2"))
    };
    let grey = png(ColorType::Grayscale, BitDepth::Eight, [9, 9], &[7; 81]);
    let mut objects = npy("|O", "(2, 2)", b"....");
    objects.extend([0; 40]);
    let colour = "with 8 or 16 bits, as by `magick in.png -alpha off -colorspace Gray out.png`";
    for (name, bytes, line) in [
        (
            "m.png",
            png(ColorType::Rgb, BitDepth::Eight, [2, 1], &[0; 6]),
            format!("holds colour: save it in grey {colour}"),
        ),
        (
            "m.png",
            png(ColorType::GrayscaleAlpha, BitDepth::Eight, [2, 1], &[0; 4]),
            format!("holds grey with transparency: save it in grey {colour}"),
        ),
        (
            "m.png",
            png(ColorType::Grayscale, BitDepth::One, [8, 1], &[0]),
            "has 1 bits of grey: save it with 8 or 16 bits".to_owned(),
        ),
        ("m.png", grey[..grey.len() - 20].to_vec(), "is not a PNG file: it is truncated".to_owned()),
        ("m.png", grey[..20].to_vec(), "is not a PNG file: it is truncated".to_owned()),
        ("m.png", b"GIF89a..".to_vec(), "is not a PNG file: Invalid PNG signature.".to_owned()),
        (
            "m.png",
            png(ColorType::Grayscale, BitDepth::Eight, [4097, 1], &[0; 4097]),
            "has 4097 × 1 pixels: must be 1 to 4096 each".to_owned(),
        ),
        ("m.jpg", grey.clone(), "is of another kind: the name must end in .png or .npy".to_owned()),
        (
            "m.npy",
            npy("<f4", "(2, 2)", &floats(&[0.0, 1.0, f32::NAN, 0.0])),
            "has no number at column 0 of row 1: NaN and infinity are no heights".to_owned(),
        ),
        (
            "m.npy",
            npy("<f4", "(3, 2)", &floats(&[0.0; 4])),
            ": truncated: it ends after 16 of 24 bytes of data".to_owned(),
        ),
        (
            "m.npy",
            objects,
            ": the array holds Python objects: save it as float32, float64, int16 or int32 with numpy.save"
                .to_owned(),
        ),
        (
            "m.npy",
            npy("<f4", "(2, 2, 1)", &floats(&[0.0; 4])),
            ": the array has the shape (2, 2, 1): must be (samples,) or (samples, columns)".to_owned(),
        ),
        (
            "m.npy",
            npy("<f4", "(4,)", &floats(&[0.0; 4])),
            "is a profile, an array of one column: take shape = \"texture\", or save rows and columns"
                .to_owned(),
        ),
        ("m.npy", npy("<f4", "(0, 2)", &[]), "has 2 × 0 pixels: must be 1 to 4096 each".to_owned()),
    ] {
        let line = format!("o.toml:4: `file`{}{line}", if line.starts_with(':') { "" } else { " " });
        let error = read_with(&map(name), &[(name, bytes)]).unwrap_err().to_string();
        assert_eq!(error, line);
    }
    let error = |text: String| read_with(&text, &[("m.png", grey.clone())]).unwrap_err().to_string();
    assert_eq!(
        error(map("m.png").replace("0.1", "10").replace("um_per_level = 2", "")),
        "o.toml: `um_per_level` is missing: add um_per_level, the height of a step of grey, um"
    );
    let profile = |name: &str, keys: &str| {
        let text = object(&format!("shape = \"texture\"\nfile = \"p.csv\"\nmm_per_pixel = 0.5{keys}"));
        read_with(&text, &[("p.csv", format!("{name}\n0\n0.1\n").into())]).map_err(|error| error.to_string())
    };
    assert!(profile("height_mm", "").is_ok());
    let line = profile("height", "").unwrap_err();
    assert!(line.starts_with("o.toml:4: `file`: line 1: `height` must end with its unit, _um,"), "{line}");
    let line = profile("height_mm", "\num_per_level = 1000").unwrap_err();
    assert_eq!(line, "o.toml:4: `file`: the name of a CSV file's column says its unit: leave the scale out");
    let wide = png(ColorType::Grayscale, BitDepth::Eight, [1001, 9], &[7; 9009]);
    let found = read_with(&map("w.png"), &[("w.png", wide)]).unwrap_err().to_string();
    assert_eq!(
        found,
        "o.toml:5: `mm_per_pixel` is too large: the map has 100.1 × 0.9 mm, and may have 100 mm each"
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// No bytes make a reader panic, and each error is one line.
    #[test]
    fn broken_files_are_refused_in_one_line(
        bytes in proptest::collection::vec(any::<u8>(), 0..200),
        at in 0_usize..100,
        kind in 0_usize..3,
    ) {
        let grey = png(png::ColorType::Grayscale, png::BitDepth::Eight, [9, 9], &[7; 81]);
        let array = npy("<f4", "(2, 2)", &floats(&[0.0; 4]));
        let (name, mut file) =
            [("m.png", grey), ("m.npy", array), ("p.csv", b"t_s,x_mm\n0,0\n1,1\n".to_vec())][kind].clone();
        let end = (at + bytes.len()).min(file.len());
        file.splice(at.min(end)..end, bytes);
        let text = match kind {
            2 => touching("path.file = \"p.csv\""),
            _ => object(&format!("shape = \"heightmap\"\nfile = \"{name}\"\nmm_per_pixel = 0.1\num_per_level = 2")),
        };
        if let Err(error) = read_with(&text, &[(name, file)]) {
            prop_assert!(!error.to_string().contains('\n'), "{error}");
        }
    }

    /// The same of the object's own text.
    #[test]
    fn broken_texts_are_refused_in_one_line(at in 0_usize..90, length in 0_usize..30, with in "\\PC{0,12}") {
        let mut text: Vec<char> = touching("press = { depth_um = 500 }").chars().collect();
        let end = (at + length).min(text.len());
        text.splice(at.min(end)..end, with.chars());
        if let Err(error) = read(&text.into_iter().collect::<String>()) {
            prop_assert!(!error.to_string().contains('\n'), "{error}");
        }
    }
}
