use meissner::config::{Config, LOGBOOK_DAYS, PatternsDir};
use meissner::session_record::Location;
use meissner_stream::device::Spec;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The example holds every key, commented with its meaning, at its default.
#[test]
fn the_example_configuration_is_the_default() {
    let file = root().join("deploy/meissner.toml");
    let mut config = Config::read(&file).unwrap();
    let default = Config::default();
    assert_eq!(config.patterns, PatternsDir::Configured(PathBuf::from("/var/lib/meissner/patterns")));
    assert_eq!(config.socket, PathBuf::from("/run/meissner/meissner.sock"));
    assert_eq!(config.device, Spec::Auto);
    assert_eq!(config.calibration, Some(PathBuf::from("/var/lib/meissner/calibration.toml")));
    let (dir, days) = (PathBuf::from("/var/lib/meissner/logbook"), LOGBOOK_DAYS);
    assert_eq!(config.logbook, Some(Location { dir, days }));
    config.logbook.clone_from(&default.logbook);
    (config.patterns, config.socket) = (default.patterns.clone(), default.socket.clone());
    config.calibration.clone_from(&default.calibration);
    assert_eq!(config, default);
}

/// The blocks of the README that begin with ```sh, in order, in one shell that stops at the first failure.
///
/// A block is run from the root with the built program on the path as `meissner`, and with `cargo run --release --`
/// and a bare `cargo test` standing for it and for nothing: both were built and run already. What is not to be run
/// is marked with another word than `sh`.
#[test]
fn every_command_of_the_readme_works() {
    let text = fs::read_to_string(root().join("README.md")).unwrap();
    let blocks = text.split("```sh\n").skip(1).filter_map(|rest| rest.split("```").next());
    let dir = tempfile::tempdir().unwrap();
    let program = Path::new(env!("CARGO_BIN_EXE_meissner"));
    // `demo` and `play --wait` exit with 1 if a stall of this machine made strokes late: no fault of the README's.
    let head = r#"
        set -euo pipefail
        trap 'kill $(jobs -p) 2>/dev/null || true; wait' EXIT
        meissner() {
            case "$*" in
                demo* | *--wait*) command meissner "$@" || [ $? = 1 ] ;;
                daemon*) exec meissner "$@" ;;
                *) command meissner "$@" ;;
            esac
        }
        cargo() {
            case "$1" in
                run) shift; while [ "$1" != -- ]; do shift; done; shift; meissner "$@" ;;
                test) ;;
                *) command cargo "$@" ;;
            esac
        }
    "#;
    let script: String = std::iter::once(head).chain(blocks).collect();
    let path = format!("{}:{}", program.parent().unwrap().display(), std::env::var("PATH").unwrap());
    let output = Command::new("bash")
        .args(["-c", &script])
        .current_dir(root())
        .env("PATH", path)
        .env("MEISSNER_SOCKET", dir.path().join("m.sock"))
        .env("XDG_DATA_HOME", dir.path())
        .env_remove("STATE_DIRECTORY")
        .output()
        .unwrap();
    assert!(output.status.success(), "{script}\n{}", String::from_utf8_lossy(&output.stderr));
}

/// What the documents link to within the project is there.
#[test]
fn every_link_leads_somewhere() {
    let mut links = 0;
    for document in ["README.md", "docs/decisions.md", "docs/measurements.md"] {
        let file = root().join(document);
        let text = fs::read_to_string(&file).unwrap();
        for target in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            if !target.contains("://") {
                links += 1;
                assert!(file.parent().unwrap().join(target).exists(), "{document} links to {target}");
            }
        }
    }
    assert!(links > 4);
}
