use crate::harness::assert_up_to_date;
use clap_complete::{Shell, generate};
use clap_mangen::Man;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// A page for the command and one for each below it.
fn pages(command: clap::Command, files: &mut BTreeMap<PathBuf, Vec<u8>>) {
    for below in command.get_subcommands().filter(|below| !below.is_hide_set()) {
        pages(below.clone(), files);
    }
    // Without a date, so that the page does not change from day to day.
    let page = Man::new(command).manual("meissner");
    let mut text = Vec::new();
    page.render(&mut text).unwrap();
    files.insert(Path::new("man").join(page.get_filename()), text);
}

fn made() -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    // Leave out `help`, which only repeats the pages.
    let mut command = meissner::cli::command().disable_help_subcommand(true);
    command.build();
    pages(command, &mut files);
    for (shell, name) in
        [(Shell::Bash, "meissner.bash"), (Shell::Zsh, "_meissner"), (Shell::Fish, "meissner.fish")]
    {
        let mut text = Vec::new();
        generate(shell, &mut meissner::cli::command(), "meissner", &mut text);
        files.insert(Path::new("completions").join(name), text);
    }
    files
}

/// The files are kept in the repository, so that a package can be built without building the tests. With MEISSNER_RENEW set this
/// test writes them.
#[test]
fn the_manual_and_the_completions_are_up_to_date() {
    let deploy = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy");
    let made = made();
    assert!(made.len() > 20);
    for (name, text) in &made {
        assert_up_to_date(Path::new("deploy").join(name), text);
    }
    let kept: BTreeSet<_> = ["man", "completions"]
        .iter()
        .flat_map(|folder| fs::read_dir(deploy.join(folder)).unwrap())
        .map(|entry| entry.unwrap().path().strip_prefix(&deploy).unwrap().to_owned())
        .collect();
    assert_eq!(kept, made.into_keys().collect(), "deploy has a file too many");
}
