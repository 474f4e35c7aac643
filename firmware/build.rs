//! Passes the memory layout to the linker and a hash of the sources to the firmware.
//!
//! The handshake reports the hash as the build.

use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets it"));
    fs::copy("memory.x", out.join("memory.x")).expect("the layout can be copied");
    println!("cargo:rustc-link-search={}", out.display());
    for argument in ["--nmagic", "-Tlink.x", "-Tlink-rp.x"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }

    let mut files = Vec::new();
    for place in ["memory.x", "Cargo.toml", "Cargo.lock", "src", "../firmware-protocol/src"] {
        println!("cargo:rerun-if-changed={place}");
        list(Path::new(place), &mut files);
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

fn list(place: &Path, files: &mut Vec<PathBuf>) {
    if place.is_dir() {
        for entry in fs::read_dir(place).expect("folders can be read") {
            list(&entry.expect("folders can be read").path(), files);
        }
    } else {
        files.push(place.to_owned());
    }
}
