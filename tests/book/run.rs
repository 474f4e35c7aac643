//! Runs the commands of each page in order: `sh` and `python` blocks in one shell, in the page's own directory.
//!
//! The directory shows the repository's files. The built program replaces `meissner` and `cargo run --release --`, but nothing
//! else: a bare `cargo test` does nothing. A TOML block whose first line is a file name in a comment is written to that file. `py`
//! blocks need the Python package: `python/check` runs them. Without python3 or curl the test skips the blocks that need them, and
//! prints that.
//!
//! Invariant: a page's shell stops at the first command that fails.

use super::pages::{Page, book, root};
use crate::harness::PROGRAM;
use std::fmt::Write;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;
use std::thread;

/// A page must work on a busy machine:
/// - `demo` and `play --wait` may exit with 1: a stall of the machine made strokes late, which is no fault of a page.
/// - `live` may be silent for 20 s. With that lead the line carries 40 updates a second.
/// - Each daemon has the settings of [`PATIENT`].
/// - `status` fails until the device has answered and the line is measured: then it takes commands at once.
const HEAD: &str = r#"
set -euo pipefail
asked=0
trap 'kill $(jobs -p) 2>/dev/null || true; wait' EXIT
meissner() {
    case "$*" in
        demo) command meissner demo --seconds 1 || [ $? = 1 ] ;;
        *--wait*) command meissner "$@" || [ $? = 1 ] ;;
        live*) command meissner "$@" --timeout-ms 20000 --updates-hz 40 ;;
        status)
            ((++asked < 400)) || exit 1
            command meissner status && [[ $(command meissner status --json) == *'"bytes_per_s":'[0-9]* ]] ;;
        daemon*--check-config*) command meissner "$@" ;;
        daemon*--config*) cat "$PATIENT" >> "${!#}"; exec meissner "$@" ;;
        daemon*) exec meissner "$@" --config "$PATIENT" ;;
        *) command meissner "$@" ;;
    esac
}
cargo() {
    case "$1" in
        run) shift; while [ "$1" != -- ]; do shift; done; shift; meissner "$@" ;;
        test) ;;
        *) echo "a page runs cargo $1: mark the block \`bash\`" >&2; return 1 ;;
    esac
}
curl() {
    if type -P curl >/dev/null; then command curl --fail-with-body "$@"; else echo "curl is missing" >&2; fi
}
python() {
    if type -P python3 >/dev/null; then python3 -; else cat >/dev/null; echo "python3 is missing" >&2; fi
}
"#;

/// A long lead and a long host watchdog timeout outlast stalls. With little scatter a short calibration is always accurate enough
/// to be stored.
const PATIENT: &str = "lead_ms = 1000\nlease_ms = 10000\nmock.gain_sd = 0.02\n";

/// The page's commands as one script; none if it has no commands.
fn script(page: &Page) -> Option<String> {
    let mut script = HEAD.to_owned();
    let mut commands = 0;
    for block in page.blocks() {
        let text = block.text;
        // Writing to a string does not fail.
        let _ = match block.language {
            "sh" => writeln!(script, "{text}"),
            "python" => writeln!(script, "python <<'END_OF_BLOCK'\n{text}\nEND_OF_BLOCK"),
            "toml" => match text.lines().next().and_then(|line| line.strip_prefix("# ")) {
                Some(file) if file.ends_with(".toml") => {
                    writeln!(script, "cat > {file} <<'END_OF_BLOCK'\n{text}\nEND_OF_BLOCK")
                }
                _ => continue,
            },
            _ => continue,
        };
        commands += usize::from(block.language != "toml");
    }
    (commands > 0).then_some(script)
}

fn run(page: &Page, script: &str) {
    let dir = tempfile::tempdir().unwrap();
    for entry in fs::read_dir(root()).unwrap() {
        let name = entry.unwrap().file_name();
        if name != "target" {
            symlink(root().join(&name), dir.path().join(&name)).unwrap();
        }
    }
    let patient = dir.path().join("patient.conf");
    fs::write(&patient, PATIENT).unwrap();
    let temporary = dir.path().join("tmp");
    fs::create_dir(&temporary).unwrap();
    let program = Path::new(PROGRAM);
    let path = format!("{}:{}", program.parent().unwrap().display(), std::env::var("PATH").unwrap());
    let output = Command::new("bash")
        .args(["-c", script])
        .current_dir(dir.path())
        .env("PATH", path)
        .env("PATIENT", &patient)
        .env("TMPDIR", &temporary)
        .env("MEISSNER_SOCKET", dir.path().join("m.sock"))
        .env("XDG_DATA_HOME", dir.path())
        .env("XDG_STATE_HOME", dir.path().join("state"))
        .env("XDG_RUNTIME_DIR", dir.path())
        .env_remove("STATE_DIRECTORY")
        .output()
        .unwrap();
    let (stdout, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{}:\n{script}\n{stdout}\n{stderr}", page.name);
    for line in stderr.lines().filter(|line| line.ends_with("is missing")) {
        println!("{}: {line}, so a block was left out", page.name);
    }
}

#[test]
fn every_command_works() {
    let scripts: Vec<_> = book().filter_map(|page| script(&page).map(|script| (page, script))).collect();
    assert!(scripts.len() > 8, "{}", scripts.len());
    thread::scope(|scope| {
        for (page, script) in &scripts {
            scope.spawn(|| run(page, script));
        }
    });
}
