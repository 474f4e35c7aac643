//! `meissner manual FOLDER`: the man pages, the completions of three shells and the OpenAPI document, made from the program.
//!
//! Packages and `deploy/install` run it, so that no copies are kept.

use anyhow::{Context as _, Result};
use clap_complete::{Shell, generate};
use clap_mangen::Man;
use meissner_api::openapi;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// A page for the command and one for each below it.
fn pages(command: clap::Command, files: &mut BTreeMap<PathBuf, Vec<u8>>) -> Result<()> {
    for below in command.get_subcommands() {
        pages(below.clone(), files)?;
    }
    // No date: the page must not differ from day to day.
    let page = Man::new(command).manual("meissner");
    let mut text = Vec::new();
    page.render(&mut text)?;
    files.insert(Path::new("man").join(page.get_filename()), text);
    Ok(())
}

/// The files' names and texts.
fn made(command: &clap::Command) -> Result<BTreeMap<PathBuf, Vec<u8>>> {
    let mut files = BTreeMap::new();
    // `help` says nothing that the pages do not.
    let mut pages_of = command.clone().disable_help_subcommand(true);
    pages_of.build();
    pages(pages_of, &mut files)?;
    for (shell, name) in
        [(Shell::Bash, "meissner.bash"), (Shell::Zsh, "_meissner"), (Shell::Fish, "meissner.fish")]
    {
        let mut text = Vec::new();
        generate(shell, &mut command.clone(), "meissner", &mut text);
        files.insert(Path::new("completions").join(name), text);
    }
    files.insert("openapi.json".into(), format!("{:#}\n", openapi::document()).into_bytes());
    Ok(files)
}

pub(super) fn manual(command: &clap::Command, folder: &Path) -> Result<()> {
    for (name, text) in made(command)? {
        let file = folder.join(name);
        file.parent()
            .map_or(Ok(()), fs::create_dir_all)
            .and_then(|()| fs::write(&file, text))
            .with_context(|| format!("{} cannot be written", file.display()))?;
    }
    Ok(())
}
