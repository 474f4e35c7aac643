//! Passes to the firmware the numbers of its array and a hash of its sources, and to the linker the memory layout.
//!
//! `MEISSNER_TRIGGER=input` makes the trigger output an input. `MEISSNER_ARRAY` names the description of the array; without it, it is the paper's. The handshake reports the hash of the sources
//! as the build. A description that the chip cannot follow exactly is refused in one line.

mod clock;

use firmware_protocol::array::Layout;
use meissner_array::spec::ArraySpec;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets it"));
    fs::copy("memory.x", out.join("memory.x")).expect("the layout can be copied");
    println!("cargo:rustc-link-search={}", out.display());
    for argument in ["--nmagic", "-Tlink.x", "-Tlink-rp.x"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }

    println!("cargo:rerun-if-env-changed=MEISSNER_ARRAY");
    let description = env::var_os("MEISSNER_ARRAY").map_or_else(|| PathBuf::from(PAPER), PathBuf::from);
    println!("cargo:rerun-if-env-changed=MEISSNER_TRIGGER");
    match trigger_is_input().and_then(|input| numbers(&read(&description)?, input)) {
        Ok(text) => fs::write(out.join("array.rs"), text).expect("the numbers can be written"),
        // Cargo prints the line and ends.
        Err(line) => {
            println!("cargo::error={line}");
            return;
        }
    }

    let mut files = Vec::new();
    let sources =
        ["memory.x", "Cargo.toml", "Cargo.lock", "build.rs", "clock.rs", "src", "../firmware-protocol/src"];
    for place in sources.iter().map(Path::new).chain([&*description]) {
        println!("cargo:rerun-if-changed={}", place.display());
        list(place, &mut files);
    }
    files.sort();
    // FNV-1a: distinguishes builds; not for security.
    let mut hash = 0x811c_9dc5_u32;
    for file in files {
        for byte in fs::read(file).expect("sources can be read") {
            hash = (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        }
    }
    println!("cargo:rustc-env=BUILD_HASH={hash}");
}

/// Reads a description.
fn read(path: &Path) -> Result<ArraySpec, String> {
    let file = path.display().to_string();
    let text = fs::read_to_string(path).map_err(|error| format!("{file}: {error}"))?;
    ArraySpec::parse(&text, &file).map_err(|error| error.to_string())
}

/// Whether GPIO 27 is the trigger input instead of the trigger output.
fn trigger_is_input() -> Result<bool, String> {
    match env::var("MEISSNER_TRIGGER").as_deref() {
        Err(_) | Ok("" | "output") => Ok(false),
        Ok("input") => Ok(true),
        Ok(other) => {
            Err(format!("MEISSNER_TRIGGER is `{other}`: set it to `input` or `output`, or leave it out"))
        }
    }
}

/// The numbers as Rust constants.
fn numbers(array: &ArraySpec, trigger_is_input: bool) -> Result<String, String> {
    let layout = array.layout();
    let id = layout.id();
    let motors = layout.motors();
    let clock = clock::exact(id.tick_hz, [id.duty_up, id.duty_down])?;
    if motors > BOARD_LINES {
        return Err(format!("the array {} has {motors} motors: a Pico has pins for {BOARD_LINES}", id.name));
    }
    let of = |group: fn(&Layout, usize) -> u8| {
        let groups: Vec<_> = (0..motors).map(|motor| group(layout, motor)).collect();
        format!("{groups:?}")
    };
    let mut text = String::new();
    let mut number = |name: &str, kind: &str, value: String| {
        let _ = writeln!(text, "pub(crate) const {name}: {kind} = {value};");
    };
    number("TRIGGER_IS_INPUT", "bool", trigger_is_input.to_string());
    number("NAME", "&str", format!("{:?}", id.name.as_str()));
    number("TICK_HZ", "u32", id.tick_hz.to_string());
    number("DUTY_UP", "u16", id.duty_up.to_string());
    number("DUTY_DOWN", "u16", id.duty_down.to_string());
    number("RAILS", &format!("[u8; {motors}]"), of(Layout::rail));
    number("CHIPS", &format!("[u8; {motors}]"), of(Layout::chip));
    number("MOST_PULSES", "u16", layout.max_up_pulses().to_string());
    number("SEEK_PULSES", "u16", layout.max_seek().to_string());
    number("HASH", "u64", id.hash.to_string());
    number("PLL_FEEDBACK", "u16", clock.feedback.to_string());
    number("PLL_POST1", "u8", clock.post[0].to_string());
    number("PLL_POST2", "u8", clock.post[1].to_string());
    number("CYCLES_PER_TICK", "u32", clock.cycles.to_string());
    number("PIO_DIVIDER", "u16", clock.divider.to_string());
    number("WORD_CYCLES", "[u8; 4]", format!("{:?}", clock.words));
    Ok(text)
}

/// Lines of the board (`src/board.rs`).
const BOARD_LINES: usize = 24;
/// The description without `MEISSNER_ARRAY`.
const PAPER: &str = "../library/arrays/tula35-6x4.toml";

fn list(place: &Path, files: &mut Vec<PathBuf>) {
    if place.is_dir() {
        for entry in fs::read_dir(place).expect("folders can be read") {
            list(&entry.expect("folders can be read").path(), files);
        }
    } else {
        files.push(place.to_owned());
    }
}
