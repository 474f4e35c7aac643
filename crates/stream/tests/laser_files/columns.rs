//! What a header, its units and its columns may be.

use super::Wanted::{Refused, Right};
use super::{Row, at_1000_hz, check, clock, column, comma, file, in_mm, in_um, layout, plain, time_column};
use meissner_stream::calibrate::{Layout, TimeUnit};

#[test]
fn headers_and_units() {
    let none = Layout::default;
    let ms_mm = |header: &str| file(header, |row| format!("{},{}", row.ms(), row.mm()));
    let lvm = |unit: &str| {
        let header = format!(
            "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\nDate\t2026/03/04\nTime\t12:00:00.5\n\
             ***End_of_Header***\t\n\t\nChannels\t1\nSamples\t200\nY_Unit_Label\t{unit}\nX_Dimension\tTime\nX0\t0.0\nDelta_X\t0.001\n\
             ***End_of_Header***\t\nX_Value\tUntitled\tComment\n"
        );
        file(&header, |row| format!("{}\t{}", row.s(), row.mm()))
    };
    let tektronix = file("", |row| {
        let side = match row.0 {
            0 => "Record Length,2.0e+02,",
            1 => "Sample Interval,1.0e-03,",
            2 => "Vertical Units,V,",
            _ => ",,",
        };
        format!("{side},{},{},", row.s(), row.mm())
    });
    let count = check([
        ("names and units below", ms_mm("Time,Displacement\nms,mm\n"), none(), Right),
        ("PicoScope", ms_mm("Time,Channel A\n(ms),(mm)\n\n"), none(), Right),
        (
            "PicoScope, volts",
            ms_mm("Time,Channel A\n(ms),(V)\n\n"),
            none(),
            Refused("the displacement in column `Channel A` has the unit `v`, which is not read"),
        ),
        ("volts that the user knows", ms_mm("Time,Channel A\n(ms),(V)\n\n"), in_mm(), Right),
        (
            "millivolts",
            ms_mm("t_ms,CH1_mV\n"),
            none(),
            Refused("the displacement in column `CH1_mV` has the unit `mv`"),
        ),
        (
            "a speed",
            ms_mm("Time [ms],Velocity [mm/s]\n"),
            none(),
            Refused("the displacement in column `Velocity [mm/s]` has the unit `mm/s`"),
        ),
        (
            "inches",
            ms_mm("Time [ms],Position (in)\n"),
            none(),
            Refused("the displacement in column `Position (in)` has the unit `in`"),
        ),
        (
            "degrees",
            ms_mm("Time [ms],T1 [\u{b0}C]\n"),
            none(),
            Refused("the displacement in column `T1 [\u{b0}C]` has the unit"),
        ),
        (
            "two units",
            ms_mm("Time [ms],Displacement [um]\nms,mm\n"),
            none(),
            Refused("the displacement in column `Displacement [um]` has the unit `mm and Displacement [um]`"),
        ),
        (
            "hours",
            ms_mm("Time [h],Displacement [mm]\n"),
            none(),
            Refused("the time in column `Time [h]` has the unit `h`"),
        ),
        (
            "no unit",
            plain("Time,Displacement\n"),
            none(),
            Refused("does not say the unit of the displacement: give --displacement-unit"),
        ),
        ("no header", plain(""), none(), Refused("does not say the unit of the displacement")),
        ("no header, a given unit", plain(""), in_um(), Right),
        ("a line of the unit", plain("Sensor: LK-H022\nUnit: \u{b5}m\n\nTime,OUT1\n"), none(), Right),
        ("axes", plain("Vertical Units,um\nHorizontal Units,s\nTIME,CH1\n"), none(), Right),
        (
            "axes in volts",
            plain("Vertical Units,V\nHorizontal Units,s\nTIME,CH1\n"),
            none(),
            Refused("the displacement in column `CH1` has the unit `V`"),
        ),
        (
            "Keysight",
            plain("x-axis,1\nsecond,Volt\n"),
            none(),
            Refused("the displacement in column `1` has the unit `volt`"),
        ),
        (
            "Rigol",
            file("X,CH1,Start,Increment,\nSequence,Volt,0,1e-3,\n", |row| {
                format!("{},{},", row.ms(), row.um())
            }),
            none(),
            Refused("does not say the unit"),
        ),
        ("LabVIEW", lvm("Millimeters"), none(), Right),
        (
            "LabVIEW, volts",
            lvm("Volts"),
            none(),
            Refused("the displacement in column `Untitled` has the unit `Volts`"),
        ),
        ("LabVIEW, no unit", lvm(""), none(), Refused("does not say the unit")),
        ("Tektronix", tektronix.clone(), none(), Refused("does not say the unit")),
        ("Tektronix, a given unit", tektronix, in_mm(), Right),
        (
            "vibrometer",
            file(
                "Source File Name:\ta.pvd\nSignal:\tVib - Displacement\n\n\nTime\tDisplacement\n[ s ]\t[ m ]\n",
                |row| format!("{}\t{}", row.s(), row.m()),
            ),
            none(),
            Right,
        ),
        (
            "NumPy, commas",
            file("# time_ms,displacement_mm\n", |row| format!("{:.18e},{}", row.0 as f64, row.mm())),
            none(),
            Right,
        ),
        (
            "NumPy, spaces",
            file("# time_ms displacement_mm\n", |row| format!("{} {}", row.ms(), row.mm())),
            none(),
            Refused("does not say the unit"),
        ),
        ("a long header", plain(&("words, words\n".repeat(99) + "time_s,displacement_um\n")), none(), Right),
        (
            "a longer header",
            plain(&("words, words\n".repeat(100) + "time_s,displacement_um\n")),
            none(),
            Refused("has no row of numbers below a header of up to 100 rows"),
        ),
        (
            "microseconds",
            file("Time (\u{b5}s),Weg / nm\n", |row| format!("{},{}", 1000 * row.0, row.nanometres())),
            none(),
            Right,
        ),
        (
            "nanoseconds of the epoch",
            file("timestamp_ns,displacement_nm\n", |row| {
                format!("{},{}", 1_772_000_000_000_000_000_u64 + 1_000_000 * row.0 as u64, row.nanometres())
            }),
            none(),
            Right,
        ),
        (
            "seconds for milliseconds",
            ms_mm("Time,Displacement [mm]\n").replace("\n199,", "\n1990,"),
            none(),
            Refused("lasts 1990 s: at most 1800 s can be read; check the unit"),
        ),
        (
            "a given unit of time",
            ms_mm("Time,Displacement [mm]\n"),
            layout(|layout| layout.time_unit = Some(TimeUnit::Milliseconds)),
            Right,
        ),
    ]);
    assert_eq!(count, 32);
}

#[test]
fn columns() {
    let none = Layout::default;
    let two = file("Time [s],Distance 1 [mm],Distance 2 [um]\n", |row| format!("{},5,{}", row.s(), row.um()));
    let times = file("Time A [s],Time B [s],OUT1 [um]\n", |row| format!("7,{},{}", row.s(), row.um()));
    let count = check([
        (
            "displacement first",
            file("Displacement [um],Time [s]\n", |row| format!("{},{}", row.um(), row.s())),
            none(),
            Right,
        ),
        (
            "a number first",
            file("No.,Time [ms],OUT1 [\u{3bc}m]\n", |row| format!("{},{},{}", row.0 + 1, row.ms(), row.um())),
            none(),
            Right,
        ),
        (
            "temperature and state",
            file("n;Time (us);Displacement (nm);T (\u{b0}C);State\n", |row| {
                format!("{};{};{};21,5;OK", row.0, row.0 * 1000, row.nanometres())
            }),
            none(),
            Right,
        ),
        (
            "speed beside displacement",
            file("Time [s]\tVelocity [m/s]\tDisplacement [um]\n", |row| {
                format!("{}\t0.5\t{}", row.s(), row.um())
            }),
            none(),
            Right,
        ),
        (
            "intensity beside displacement",
            file("Time [s],OUT1 [um],Intensity [%]\n", |row| format!("{},{},55", row.s(), row.um())),
            none(),
            Right,
        ),
        (
            "two displacements",
            two.clone(),
            none(),
            Refused(
                "has several columns that may be the displacement: `Distance 1 [mm]`, `Distance 2 [um]`; name one with --column",
            ),
        ),
        ("two displacements, one named", two.clone(), column("Distance 2"), Right),
        ("two displacements, one by its number", two.clone(), column("2"), Right),
        (
            "no such column",
            two.clone(),
            column("Distance 3"),
            Refused("--column: no column is called `Distance 3`: there are `Time [s]`, `Distance 1 [mm]`"),
        ),
        ("no column of this number", two, column("3"), Refused("--column: no column is called `3`")),
        (
            "two times",
            times.clone(),
            none(),
            Refused(
                "has several columns that may be the time: `Time A [s]`, `Time B [s]`; name one with --time-column",
            ),
        ),
        ("two times, one named", times, time_column("time b"), Right),
        (
            "three columns without names",
            file("", |row| format!("{},{},1", row.s(), row.um())),
            in_um(),
            Refused("has several columns that may be the displacement: 0, 1, 2"),
        ),
        ("no time", file("OUT1 [um]\n", Row::um), none(), Refused("has no column of times: give --rate-hz")),
        ("a rate", file("OUT1 [um]\n", Row::um), at_1000_hz(), Right),
        (
            "a number is no time",
            file("Sample,Displacement [um]\n", |row| format!("{},{}", row.0, row.um())),
            none(),
            Refused("has no column of times: give --rate-hz"),
        ),
        (
            "a number and a rate",
            file("Sample,Displacement [um]\n", |row| format!("{},{}", row.0, row.um())),
            at_1000_hz(),
            Right,
        ),
        (
            "a wrong rate",
            file("OUT1 [um]\n", Row::um),
            layout(|layout| layout.rate_hz = Some(0.0)),
            Refused("--rate-hz is 0: must be 1 to 10000000"),
        ),
        ("no displacement", file("Time [s]\n", Row::s), none(), Refused("has no column of displacements")),
    ]);
    assert_eq!(count, 19);
}

#[test]
fn dates_and_times_of_day() {
    let none = Layout::default;
    let by = |header: &str, time: &dyn Fn(Row) -> String| {
        file(header, |row| format!("{};{}", time(row), comma(&row.um())))
    };
    let header = "Time;Displacement [um]\n";
    let count = check([
        ("a time of day", by(header, &|row| clock(row, 12)), none(), Right),
        ("over midnight", by(header, &|row| clock(row, 23)), none(), Right),
        ("decimal commas", by(header, &|row| comma(&clock(row, 12))), none(), Right),
        (
            "a colon before the milliseconds",
            by(header, &|row| clock(row, 12).replace('.', ":")),
            none(),
            Right,
        ),
        ("a date before it", by(header, &|row| format!("04.03.2026 {}", clock(row, 12))), none(), Right),
        ("ISO 8601", by(header, &|row| format!("2026-03-04T{}+01:00", clock(row, 12))), none(), Right),
        ("half days", by(header, &|row| format!("3/4/2026 {} AM", clock(row, 9))), none(), Right),
        (
            "a column of dates",
            by("Date;Time;Weg [um]\n", &|row| format!("2026/03/04;{}", clock(row, 12))),
            none(),
            Right,
        ),
        ("no header", by("", &|row| format!("2026/03/04;{}", clock(row, 12))), in_um(), Right),
        (
            "elapsed time beside it",
            by("Date Time;Time [ms];Weg [um]\n", &|row| format!("2026-03-04 12:00:00;{}", row.ms())),
            none(),
            Right,
        ),
        (
            "minutes",
            by(header, &|row| clock(row, 12)[3..].to_owned()).replace("\n00:", "\n60:"),
            none(),
            Refused("line 102: the time is `60:00.000`, not a number"),
        ),
        (
            "whole seconds",
            by(header, &|row| clock(row, 12)[..8].to_owned()),
            none(),
            Refused(
                "line 3: the time 46799 s is not after the one before, 46799 s: times must increase; if they are rounded, give --rate-hz",
            ),
        ),
        ("whole seconds and a rate", by(header, &|row| clock(row, 12)[..8].to_owned()), at_1000_hz(), Right),
        (
            "a mixture",
            by(header, &|row| if row.0 == 9 { row.s() } else { clock(row, 12) }),
            none(),
            Refused("line 11: the time is `0.009`, not a number"),
        ),
    ]);
    assert_eq!(count, 14);
}
