//! Passes to the firmware the numbers of its array and a hash of its sources, and to the linker the memory layout.
//!
//! `MEISSNER_ARRAY` names the description of the array; without it, it is the paper's. The handshake reports the hash of the sources
//! as the build. A description that the chip cannot follow exactly is refused in one line.

#[path = "describe/clock.rs"]
mod clock;
#[path = "describe/described.rs"]
mod described;

use described::Described;
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
    let path = env::var_os("MEISSNER_ARRAY").map(PathBuf::from);
    if let Some(path) = &path {
        println!("cargo:rerun-if-changed={}", path.display());
    }
    match described::read(path.as_deref()).and_then(|array| numbers(&array)) {
        Ok(text) => fs::write(out.join("array.rs"), text).expect("the numbers can be written"),
        // Cargo prints the line and ends.
        Err(line) => {
            println!("cargo::error={line}");
            return;
        }
    }

    let mut files = Vec::new();
    for place in
        ["memory.x", "Cargo.toml", "Cargo.lock", "build.rs", "describe", "src", "../firmware-protocol/src"]
    {
        println!("cargo:rerun-if-changed={place}");
        list(Path::new(place), &mut files);
    }
    files.extend(path);
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

/// The numbers as Rust constants.
fn numbers(array: &Described) -> Result<String, String> {
    let clock = clock::exact(array.tick_hz, array.duty)?;
    let Described { name, tick_hz, duty, rails, chips, most_pulses, seek_pulses, hash } = array;
    let motors = rails.len();
    if motors > BOARD_LINES {
        return Err(format!("the array {name} has {motors} motors: a Pico has pins for {BOARD_LINES}"));
    }
    let mut text = String::new();
    let mut number = |name: &str, kind: &str, value: String| {
        let _ = writeln!(text, "pub(crate) const {name}: {kind} = {value};");
    };
    number("NAME", "&str", format!("{name:?}"));
    number("TICK_HZ", "u32", tick_hz.to_string());
    number("DUTY_UP", "u16", duty[0].to_string());
    number("DUTY_DOWN", "u16", duty[1].to_string());
    number("RAILS", &format!("[u8; {motors}]"), format!("{rails:?}"));
    number("CHIPS", &format!("[u8; {motors}]"), format!("{chips:?}"));
    number("MOST_PULSES", "u16", most_pulses.to_string());
    number("SEEK_PULSES", "u16", seek_pulses.to_string());
    number("HASH", "u64", hash.to_string());
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

fn list(place: &Path, files: &mut Vec<PathBuf>) {
    if place.is_dir() {
        for entry in fs::read_dir(place).expect("folders can be read") {
            list(&entry.expect("folders can be read").path(), files);
        }
    } else {
        files.push(place.to_owned());
    }
}
