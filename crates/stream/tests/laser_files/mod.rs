//! Recordings as the programs of sensors, oscilloscopes, LabVIEW and spreadsheets write them: each is read right, or refused in a
//! line that says what to do. The same 200 samples stand in every file.

/// Headers, units, columns and times.
mod columns;

use meissner_stream::calibrate::{Layout, LengthUnit, Recording};
use std::io::Write;

const ROWS: usize = 200;

/// A row: its number. Samples are 1 ms apart.
#[derive(Clone, Copy)]
struct Row(usize);

impl Row {
    fn nanometres(self) -> i64 {
        ((self.0 as f64 * 0.13).sin() * 12_345.0) as i64
    }

    fn ms(self) -> String {
        self.0.to_string()
    }

    fn s(self) -> String {
        format!("{:.3}", self.0 as f64 / 1e3)
    }

    fn um(self) -> String {
        format!("{:.3}", self.nanometres() as f64 / 1e3)
    }

    fn mm(self) -> String {
        format!("{:.6}", self.nanometres() as f64 / 1e6)
    }

    fn m(self) -> String {
        format!("{:e}", self.nanometres() as f64 / 1e9)
    }
}

fn comma(number: &str) -> String {
    number.replace('.', ",")
}

/// A header, and a line for each row.
fn file(header: &str, line: impl Fn(Row) -> String) -> String {
    header.to_owned() + &(0..ROWS).map(|n| line(Row(n)) + "\n").collect::<String>()
}

/// Time and displacement in s and um.
fn plain(header: &str) -> String {
    file(header, |row| format!("{},{}", row.s(), row.um()))
}

/// The same with another cell in every tenth row.
fn dropping(word: &str) -> String {
    file("time_s,displacement_um\n", |row| {
        format!("{},{}", row.s(), if is_dropped(row.0) { word.to_owned() } else { row.um() })
    })
}

const fn is_dropped(n: usize) -> bool {
    n % 10 == 7
}

/// The same with one line, of index 9, replaced.
fn broken(line: &str) -> String {
    let text = plain("time_s,displacement_um\n");
    text.lines().enumerate().map(|(at, old)| if at == 9 { line } else { old }.to_owned() + "\n").collect()
}

fn utf16(text: &str, unit: fn(u16) -> [u8; 2]) -> Vec<u8> {
    text.encode_utf16().flat_map(unit).collect()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(bytes).unwrap();
    packed.finish().unwrap()
}

/// A time of day that begins shortly before midnight, or at noon.
fn clock(row: Row, hour: usize) -> String {
    let ms = (hour * 3600 + 59 * 60 + 59) * 1000 + 900 + row.0;
    let (hours, rest) = (ms / 3_600_000 % 24, ms % 3_600_000);
    format!("{hours:02}:{:02}:{:02}.{:03}", rest / 60_000, rest / 1000 % 60, rest % 1000)
}

#[derive(Clone, Copy)]
enum Wanted {
    /// All samples are right.
    Right,
    /// So are all but the dropped ones.
    Dropped,
    /// The line begins so.
    Refused(&'static str),
}
use Wanted::{Dropped, Refused, Right};

fn layout(edit: impl Fn(&mut Layout)) -> Layout {
    let mut layout = Layout::default();
    edit(&mut layout);
    layout
}

fn in_um() -> Layout {
    layout(|layout| layout.displacement_unit = Some(LengthUnit::Micrometres))
}

fn in_mm() -> Layout {
    layout(|layout| layout.displacement_unit = Some(LengthUnit::Millimetres))
}

fn at_1000_hz() -> Layout {
    layout(|layout| layout.rate_hz = Some(1000.0))
}

fn column(name: &str) -> Layout {
    layout(|layout| layout.column = Some(name.to_owned()))
}

fn time_column(name: &str) -> Layout {
    layout(|layout| layout.time_column = Some(name.to_owned()))
}

/// Runs a table of files; returns how many it had.
fn check<B: Into<Vec<u8>>>(files: impl IntoIterator<Item = (&'static str, B, Layout, Wanted)>) -> usize {
    let mut count = 0;
    for (name, bytes, layout, wanted) in files {
        count += 1;
        let found = Recording::read(&bytes.into(), &layout);
        match (wanted, found) {
            (Refused(says), found) => {
                let line = found.map(|found| found.samples()[..3].to_vec()).unwrap_err().to_string();
                assert!(line.starts_with(says) && !line.contains('\n') && line.len() < 300, "{name}: {line}");
            }
            (_, Err(error)) => panic!("{name}: {error}"),
            (_, Ok(found)) => {
                let kept = |n: &usize| matches!(wanted, Right) || !is_dropped(*n);
                let wanted: Vec<Row> = (0..ROWS).filter(kept).map(Row).collect();
                assert_eq!(
                    (found.samples().len(), found.dropouts()),
                    (wanted.len(), ROWS - wanted.len()),
                    "{name}"
                );
                let first_s = found.samples()[0].seconds;
                for (sample, row) in found.samples().iter().zip(wanted) {
                    let (s, um) = (sample.seconds - first_s, row.nanometres() as f64 / 1e3);
                    assert!((s - row.0 as f64 / 1e3).abs() < 1e-6, "{name}: row {}: {s} s", row.0);
                    assert!(
                        (sample.um - um).abs() < 1e-9,
                        "{name}: row {}: {} instead of {um}",
                        row.0,
                        sample.um
                    );
                }
            }
        }
    }
    count
}

#[test]
fn encodings_and_line_ends() {
    let none = Layout::default;
    let umlaut = file("Zeit (ms);Auslenkung (\u{b5}m)\n", |row| format!("{};{}", row.ms(), comma(&row.um())));
    let latin: Vec<u8> = umlaut.chars().map(|c| u8::try_from(u32::from(c)).unwrap()).collect();
    let mut shift_jis = b"\x8e\x9e\x8a\xd4(ms),\x95\xcf\x88\xca(\x83\xcam)\n".to_vec();
    shift_jis.extend(file("", |row| format!("{},{}", row.ms(), row.um())).into_bytes());
    let marked = format!("\u{feff}{umlaut}");
    let quoted = plain("\"Time\n[s]\",\"Displacement\r\n[um]\"\n");
    let mut unfinished = plain("time_s,displacement_um\n");
    unfinished.pop();
    let count = check([
        ("UTF-8", umlaut.clone().into_bytes(), none(), Right),
        ("UTF-8 with its mark", marked.clone().into_bytes(), none(), Right),
        ("UTF-16, little first", utf16(&marked, u16::to_le_bytes), none(), Right),
        ("UTF-16, big first", utf16(&marked, u16::to_be_bytes), none(), Right),
        ("UTF-16 without a mark", utf16(&umlaut, u16::to_le_bytes), none(), Right),
        ("Windows", latin, none(), Right),
        ("Shift JIS", shift_jis, none(), Right),
        ("CRLF", umlaut.replace('\n', "\r\n").into_bytes(), none(), Right),
        ("CR", umlaut.replace('\n', "\r").into_bytes(), none(), Right),
        ("empty lines", umlaut.replace('\n', "\n\n").into_bytes(), none(), Right),
        ("no end of the last line", unfinished.into_bytes(), none(), Right),
        ("line ends in quotes", quoted.into_bytes(), none(), Right),
        ("gzip", gzip(umlaut.as_bytes()), none(), Right),
        ("UTF-16 in gzip", gzip(&utf16(&marked, u16::to_le_bytes)), none(), Right),
        (
            "cut gzip",
            gzip(umlaut.as_bytes())[..300].to_vec(),
            none(),
            Refused("is damaged: it ends too early"),
        ),
        (
            "Excel",
            b"PK\x03\x04and more".to_vec(),
            none(),
            Refused("is an Excel workbook or a ZIP archive, not text"),
        ),
        (
            "LabVIEW TDMS",
            b"TDSm and more".to_vec(),
            none(),
            Refused("is a TDMS file, not text: export the numbers as CSV"),
        ),
        ("binary", [0, 0, 1, 2].repeat(500), none(), Refused("is a binary file, not text")),
        ("nothing", Vec::new(), none(), Refused("has no row of numbers")),
        ("a page", b"<html><body>not found</body></html>".to_vec(), none(), Refused("has no row of numbers")),
    ]);
    assert_eq!(count, 20);
}

#[test]
fn delimiters_quotes_and_numbers() {
    let none = Layout::default;
    let of = |line: &dyn Fn(Row) -> String| file("time_s,displacement_um\n", line);
    let count = check([
        ("commas", plain("time_s,displacement_um\n"), none(), Right),
        (
            "semicolons, decimal commas",
            file("Zeit [s];Abstand [mm]\n", |row| comma(&format!("{};{}", row.s(), row.mm()))),
            none(),
            Right,
        ),
        (
            "tabs, decimal commas",
            file("Zeit [s]\tWeg [mm]\n", |row| comma(&format!("{}\t{}", row.s(), row.mm()))),
            none(),
            Right,
        ),
        (
            "bars",
            file("Time [s]|Position [um]\n", |row| format!("{} | {}", row.s(), row.um())),
            none(),
            Right,
        ),
        (
            "columns by spaces",
            file("time_s  displacement_um\n", |row| format!("{:>10} {:>12}", row.s(), row.um())),
            none(),
            Right,
        ),
        ("a delimiter at the end", of(&|row| format!("{},{},", row.s(), row.um())), none(), Right),
        ("blanks after commas", of(&|row| format!(" {}, {} ", row.s(), row.um())), none(), Right),
        (
            "all quoted",
            file("\"Time [s]\",\"Displacement [um]\"\n", |row| format!("\"{}\",\"{}\"", row.s(), row.um())),
            none(),
            Right,
        ),
        (
            "decimal commas in quotes",
            of(&|row| format!("\"{}\",\"{}\"", comma(&row.s()), comma(&row.um()))),
            none(),
            Right,
        ),
        (
            "signs",
            of(&|row| format!("+{},{:+010.3}", row.s(), row.um().parse::<f64>().unwrap())),
            none(),
            Right,
        ),
        ("exponents", of(&|row| format!("{}E+00,{}E-03", row.s(), row.nanometres())), none(), Right),
        (
            "a typographic minus",
            of(&|row| format!("{},{}", row.s(), row.um().replace('-', "\u{2212}"))),
            none(),
            Right,
        ),
        ("one column, decimal commas", file("Weg [mm]\n", |row| comma(&row.mm())), at_1000_hz(), Right),
        (
            "decimal commas between commas",
            of(&|row| comma(&format!("{},{}", row.s(), row.um()))),
            none(),
            Refused("has several columns that may be the "),
        ),
        (
            "points and commas",
            broken("\"0,008\",1.5"),
            none(),
            Refused("line 10: `0,008` has another decimal mark"),
        ),
        (
            "thousands",
            broken("0.008,\"1,234.5\""),
            none(),
            Refused("line 10: the displacement is `1,234.5`, not a number"),
        ),
        (
            "an apostrophe",
            broken("0.008,1'234.5"),
            none(),
            Refused("line 10: the displacement is `1\\'234.5`"),
        ),
        (
            "a unit in a cell",
            broken("0.008,1.5 um"),
            none(),
            Refused("line 10: the displacement is `1.5 um`"),
        ),
        (
            "an unclosed quote",
            broken("0.008,\"1.5") + &"0.3,1\n".repeat(20_000),
            none(),
            Refused("line 10: a quotation mark is not closed"),
        ),
        (
            "a quote at the end",
            broken("0.008,\"1.5"),
            none(),
            Refused("line 10: the displacement is `1.5\\n0.009"),
        ),
        ("a short row", broken("0.008"), none(), Refused("line 10: has 1 cells, other rows have 2")),
        ("a long row", broken("0.008,1.5,7"), none(), Refused("line 10: has 3 cells, other rows have 2")),
        ("a cut end", plain("time_s,displacement_um\n") + "0.2", none(), Refused("line 202: has 1 cells")),
    ]);
    assert_eq!(count, 23);
}

#[test]
fn lines_are_counted_as_an_editor_counts_them() {
    let none = Layout::default;
    let bad = broken("0.008,what");
    let commented = bad.replacen('\n', "\n# a remark\n\n", 1);
    let quoted = bad.replace("time_s,", "\"time\n(s)\",");
    let says = "line 10: the displacement is `what`, not a number: correct the row, or delete it";
    let later = |line| Refused(line);
    let count = check([
        ("LF", bad.clone(), none(), Refused(says)),
        ("CRLF", bad.replace('\n', "\r\n"), none(), Refused(says)),
        ("CR", bad.replace('\n', "\r"), none(), Refused(says)),
        ("remarks", commented.clone(), none(), later("line 12: the displacement is `what`")),
        (
            "remarks, CRLF",
            commented.replace('\n', "\r\n"),
            none(),
            later("line 12: the displacement is `what`"),
        ),
        ("quoted line ends", quoted.clone(), none(), later("line 11: the displacement is `what`")),
        (
            "quoted line ends, CRLF",
            quoted.replace('\n', "\r\n"),
            none(),
            later("line 11: the displacement is `what`"),
        ),
        ("empty lines", bad.replace('\n', "\n\n"), none(), later("line 19: the displacement is `what`")),
        (
            "rows of commas",
            bad.replace("0.007", ",,\n0.007"),
            none(),
            later("line 11: the displacement is `what`"),
        ),
        (
            "a second header",
            broken("time_s,displacement_um"),
            none(),
            later("line 10: the time is `time_s`, not a number"),
        ),
        (
            "a last word",
            plain("time_s,displacement_um\n") + "EOF,\n",
            none(),
            later("line 202: the time is `EOF`"),
        ),
        (
            "time stands",
            broken("0.007,1"),
            none(),
            later("line 10: the time 0.007 s is not after the one before, 0.007 s"),
        ),
    ]);
    assert_eq!(count, 12);
}

/// What instruments write where they have no value.
#[test]
fn dropouts() {
    let none = Layout::default;
    let words = [
        "-FFFFFFF",
        "+FFFFFFF",
        "XXXXXXX",
        "-------",
        "",
        "NaN",
        "-nan",
        "inf",
        "-Infinity",
        "\u{221e}",
        "1.#QNAN",
        "#N/A",
        "OVER",
        "Over Range",
        "overflow",
        "Error",
        "null",
        "****",
        "9.9E37",
        "-3.40282E+38",
        "-999.9999",
        "99999",
        "-32768",
    ];
    assert_eq!(check(words.map(|word| (word, dropping(word), none(), Dropped))), 23);
    let long: String =
        plain("time_s,displacement_um\n").lines().take(50).map(|line| line.to_owned() + "\n").collect();
    let mostly = file("time_s,displacement_um\n", |row| {
        format!("{},{}", row.s(), if row.0 % 3 == 0 { row.um() } else { "NaN".into() })
    });
    let count = check([
        (
            "an unknown word",
            dropping("weak"),
            none(),
            Refused("line 9: the displacement is `weak`, not a number"),
        ),
        ("no time", broken("NaN,1.5"), none(), Refused("line 10: the time is `NaN`, not a number")),
        ("few", long, none(), Refused("has 49 samples: must be at least 100")),
        ("mostly none", mostly, none(), Refused("has 67 samples: must be at least 100")),
        (
            "by rate",
            file("OUT1 [um]\n", |row| if is_dropped(row.0) { "-FFFFFFF".into() } else { row.um() }),
            at_1000_hz(),
            Dropped,
        ),
    ]);
    assert_eq!(count, 5);
}

/// Rows that pandas and spreadsheets write for no value. By rate the time goes on; with times it does not matter.
#[test]
fn rows_without_a_value() {
    let one =
        |word: &'static str| file("um\n", |row| if is_dropped(row.0) { word.to_owned() } else { row.um() });
    let two = |word: &'static str| {
        file("a,displacement_um\n", |row| {
            if is_dropped(row.0) { word.to_owned() } else { format!("7,{}", row.um()) }
        })
    };
    let words = [
        ("an empty line", ""),
        ("spaces", "  "),
        ("quotes", "\"\""),
        ("a tab", "\t"),
        ("an error", "#DIV/0!"),
    ];
    let count = check(words.map(|(name, word)| (name, one(word), at_1000_hz(), Dropped)))
        + check(words.map(|(name, word)| (name, one(word).replace('\n', "\r\n"), at_1000_hz(), Dropped)))
        + check(words.map(|(name, word)| (name, one(word).replace('\n', "\r"), at_1000_hz(), Dropped)));
    assert_eq!(count, 15);
    let ends = format!("\n{}\n\n,\n", plain("time_s,displacement_um\n\n"));
    let twice = one("").replace('\n', "\r\r\n");
    let spaced = plain("time_s,displacement_um\n").replace('\n', "\n\n");
    let commented = two("# a comment").replace("# a comment", "# a comment\n\n# and one more");
    let count = check([
        ("an empty line among two columns", two(""), at_1000_hz(), Dropped),
        ("empty cells", two(","), at_1000_hz(), Dropped),
        ("empty cells, one more", two(" , ,"), at_1000_hz(), Dropped),
        ("signs of no value", two("NaN,NaN"), at_1000_hz(), Dropped),
        ("an empty line among comments", commented, at_1000_hz(), Dropped),
        ("line ends that were changed twice", twice, at_1000_hz(), Dropped),
        ("none of it", file("um\n", Row::um).replace('\n', "\r\r\n"), at_1000_hz(), Right),
        ("above and below", ends, Layout::default(), Right),
        ("above and below, by rate", format!("um\n\n\n{}\n\n\"\"\n", file("", Row::um)), at_1000_hz(), Right),
        ("with times", spaced, Layout::default(), Right),
        ("first", format!("um\nNaN\n#N/A\n{}", file("", Row::um)), at_1000_hz(), Right),
    ]);
    assert_eq!(count, 11);
}
