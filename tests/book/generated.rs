//! Makes the reference pages from the program: commands from clap, configuration keys from the example file.
//!
//! With MEISSNER_RENEW set the test writes them: `MEISSNER_RENEW=1 cargo test --test tests manual`.

use super::pages::root;
use crate::harness::assert_up_to_date;
use clap::{Arg, Command};
use std::fmt::Write;
use std::fs;

fn one_line(text: impl ToString) -> String {
    text.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}

/// An argument as typed, and its meaning.
fn row(arg: &Arg) -> String {
    let value = arg.get_value_names().filter(|_| arg.get_action().takes_values());
    let value = value.map_or_else(String::new, |names| names.join(" "));
    let mut name = match (arg.get_short(), arg.get_long()) {
        (Some(short), Some(long)) => format!("-{short}, --{long} {value}"),
        (Some(short), None) => format!("-{short} {value}"),
        (None, Some(long)) => format!("--{long} {value}"),
        (None, None) => value,
    };
    name.truncate(name.trim_end().len());
    let mut meaning = arg.get_help().map(one_line).unwrap_or_default();
    let values = arg.get_possible_values();
    if arg.get_action().takes_values() && !values.is_empty() {
        let values = values.iter().map(|value| {
            let help = value.get_help().map_or_else(String::new, |help| format!(": {}", one_line(help)));
            format!("`{}`{help}", value.get_name())
        });
        let _ = write!(meaning, ". One of {}", values.collect::<Vec<_>>().join("; "));
    }
    let defaults: Vec<_> = arg.get_default_values().iter().filter_map(|value| value.to_str()).collect();
    if arg.get_action().takes_values() && !defaults.is_empty() {
        let _ = write!(meaning, " [default: {}]", defaults.join(", "));
    }
    format!("| `{}` | {} |\n", name.replace('|', "\\|"), meaning.replace('|', "\\|"))
}

/// A command's section, with a heading of this level.
fn section(command: &mut Command, level: usize, page: &mut String) {
    let usage = one_line(command.render_usage()).replacen("Usage: ", "", 1);
    let about = command.get_about().map(one_line).unwrap_or_default();
    let name = command.get_bin_name().unwrap_or(command.get_name());
    let _ = writeln!(page, "\n{} {name}\n\n{about}.\n\n```text\n{usage}\n```", "#".repeat(level));
    let is_shown = |arg: &&Arg| !arg.is_hide_set() && !["help", "version"].contains(&arg.get_id().as_str());
    let mut rows: Vec<&Arg> = command.get_positionals().filter(is_shown).collect();
    rows.extend(command.get_arguments().filter(|arg| !arg.is_positional()).filter(is_shown));
    if !rows.is_empty() {
        let _ = writeln!(page, "\n| argument | meaning |\n|---|---|");
        page.extend(rows.into_iter().map(row));
    }
}

/// The sections of a command's subcommands, and of theirs.
fn sections(command: &mut Command, level: usize, page: &mut String) {
    for below in command.get_subcommands_mut().filter(|below| !below.is_hide_set()) {
        section(below, level, page);
        sections(below, level + 1, page);
    }
}

fn commands() -> String {
    let mut command = meissner::cli::command().disable_help_subcommand(true);
    command.build();
    let mut page = "# Commands\n\n<!-- A test makes this page from the program: see tests/book/generated.rs. -->\n\n\
        Names and flags are stable. With `--json` a command prints one JSON document on stdout and nothing else; logs go \
        to stderr.\nA command that fails prints one line (what, where, what to do) on stderr and exits with 1; a command \
        line that cannot be\nunderstood exits with 2; Ctrl-C ends a command that\nwaits for a play, and `optimise`, \
        with 130; but for `optimise`, SIGTERM ends them with 143 and SIGHUP with 129.\n"
        .to_owned();
    sections(&mut command, 2, &mut page);
    page
}

/// The example file's comments, key by key.
fn configuration() -> String {
    let example = fs::read_to_string(root().join("deploy/meissner.toml")).unwrap();
    let mut page = "# Configuration\n\n<!-- A test makes this page from deploy/meissner.toml: see tests/book/generated.rs. -->\n\n\
        The daemon reads one TOML file: `meissner daemon --config FILE`. Every key is optional; an unknown key is an error \
        that names\nthe nearest known one. The installed service reads `/etc/meissner/meissner.toml`, which is\n\
        [`deploy/meissner.toml`](../../deploy/meissner.toml): the values below are those of that file.\n\
        [Install the service](../../deploy/README.md#configuration) says when a change takes effect.\n"
        .to_owned();
    let (mut table, mut comment) = (String::new(), Vec::new());
    for line in example.lines() {
        if let Some(text) = line.strip_prefix('#') {
            comment.push(text.trim());
        } else if let Some((key, value)) = line.split_once(" = ") {
            let _ = write!(page, "\n### `{table}{key}`\n\n`{value}`. {}\n", comment.join(" "));
            comment.clear();
        } else if line.starts_with('[') {
            let name = line.trim_matches(['[', ']']);
            let _ = write!(page, "\n## `{line}`\n\n{}\n", comment.join(" "));
            (table, comment) = (format!("{name}."), Vec::new());
        } else {
            // Skip the file's own heading, and blank lines between keys.
            comment.clear();
        }
    }
    page
}

#[test]
fn the_manual_in_the_book_is_up_to_date() {
    for (name, made) in [("commands", commands()), ("configuration", configuration())] {
        assert_up_to_date(format!("docs/reference/{name}.md"), made.as_bytes());
    }
}
