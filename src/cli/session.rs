//! `session`: starts, ends and shows sessions; [`plan`] checks one before it begins, [`export`] writes its plays.
//!
//! `start` keeps the owner's token for the commands of this terminal ([`session_token`]); `end` forgets it. If the token cannot be kept, `start`
//! ends the session again.

use super::arguments::{ClientOptions, label};
use super::output::{give, say, tell};
use super::{export, plan, session_token, text};
use anyhow::{Result, bail};
use clap::Subcommand;
use meissner_api::{self as api, Code, RecordNeed, SessionList, SessionRequest, SessionStarted};
use meissner_client::{ClientError, DISK_TIMEOUT, escape};
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Debug, Subcommand)]
pub(super) enum Session {
    /// Start a session; plays belong to it until it ends
    Start {
        /// Name the participant by this pseudonym
        #[arg(long, value_name = "P")]
        participant: String,
        /// Name the experiment
        #[arg(long, value_name = "E")]
        experiment: Option<String>,
        /// Record a label; up to 16 of them
        #[arg(long = "label", value_name = "KEY=VALUE", value_parser = label)]
        labels: Vec<(String, String)>,
        /// Record the seed of the experiment's random numbers
        #[arg(long, value_name = "N")]
        seed: Option<u64>,
        /// Let others only read, stop, disarm and order emergency stops
        #[arg(long)]
        exclusive: bool,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// End the running session
    End {
        /// End it only if it has this id
        id: Option<String>,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// Forget the session that this terminal has started; it goes on, and other commands of this terminal do not belong to it
    Leave,
    /// List the recorded sessions, the oldest first; exit 1 if something of the record is missing or cannot be read
    List(ClientOptions),
    /// Export the recorded plays of a session as CSV, one row per stimulus; with --json as one document; exit 1 if the record does not
    /// have the session whole
    Export {
        /// Export the session with this id
        id: String,
        /// Write to FILE [default: stdout]
        #[arg(short, long, value_name = "FILE")]
        output: Option<PathBuf>,
        /// Export what there is of a session that the record does not have whole
        #[arg(long)]
        incomplete: bool,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// Tell before the first trial whether the plays of a study would stop at the drift limit on a board; exit 1 if so
    Check(plan::Check),
    /// Show a session
    Show {
        /// Show the session with this id [default: the running one]
        id: Option<String>,
        #[command(flatten)]
        options: ClientOptions,
    },
}

pub(super) fn run(asked: &Session) -> Result<ExitCode> {
    match asked {
        Session::Start { participant, experiment, labels, seed, exclusive, options } => {
            let request = SessionRequest {
                participant: participant.clone(),
                experiment: experiment.clone(),
                labels: labels.iter().cloned().collect(),
                seed: *seed,
                exclusive: *exclusive,
                record: RecordNeed::Required,
            };
            start(options, &request)
        }
        Session::End { id, options } => end(options, id.as_deref()),
        Session::Leave => leave(),
        Session::List(options) => list(options),
        Session::Export { id, output, incomplete, options } => {
            export::run(options, id, output.as_deref(), *incomplete)
        }
        Session::Check(asked) => plan::run(asked),
        Session::Show { id, options } => {
            let session: api::Session = options.client()?.get_within(DISK_TIMEOUT, &path(id.as_deref()))?;
            give(options.output.json, &session, || text::session(&session))
        }
    }
}

fn path(id: Option<&str>) -> String {
    format!("/v1/sessions/{}", id.map_or_else(|| "running".to_owned(), escape))
}

fn start(options: &ClientOptions, request: &SessionRequest) -> Result<ExitCode> {
    let mut client = options.client()?;
    let started: SessionStarted = client.post("/v1/sessions", request)?;
    let kept = session_token::keep(&started.token, &started.id).inspect_err(|_| {
        client.set_token(Some(started.token.clone()));
        // Without the token the session has no owner. If ending it fails, too, the owner's silence soon lets others act.
        let _ = client.post::<api::Session>(&format!("{}/end", path(Some(&started.id))), &json!({}));
    })?;
    if let Some(problem) = &started.record_problem {
        tell(&format!("warning: {problem}"));
    }
    give(options.output.json, &started, || {
        text::pairs(&[
            ("session", format!("{} with {}", started.id, request.participant)),
            (
                "owner",
                format!(
                    "the commands of this terminal; for others set {} from {}",
                    session_token::VARIABLE,
                    kept.display()
                ),
            ),
        ])
    })
}

fn end(options: &ClientOptions, id: Option<&str>) -> Result<ExitCode> {
    let mut client = options.client()?;
    let own = session_token::session();
    // The argument may name another session than this terminal's.
    let another = id.is_some() && own.is_some() && id != own.as_deref();
    if another {
        client.set_token(None);
    }
    match client.post::<api::Session>(&format!("{}/end", path(id)), &json!({})) {
        Ok(ended) => {
            if !another {
                session_token::forget();
            }
            give(options.output.json, &ended, || text::session(&ended))
        }
        // The session has already ended. Another one may run, which must not be ended in its place.
        Err(ClientError::Problem(problem))
            if problem.code == Code::SessionRunning.parts().0 && own.is_some() =>
        {
            session_token::forget();
            bail!(
                "session {} of this terminal was over already, and this terminal has left it; nothing was ended",
                own.unwrap_or_default()
            )
        }
        Err(error) => Err(error.into()),
    }
}

fn leave() -> Result<ExitCode> {
    if std::env::var_os(session_token::VARIABLE).is_some() {
        bail!("{} names the session: unset it", session_token::VARIABLE);
    }
    let said = match session_token::session() {
        Some(session) => format!("left session {session}; `meissner status` shows whether it runs"),
        None => "this terminal has no session".to_owned(),
    };
    session_token::forget();
    say(&said)?;
    Ok(ExitCode::SUCCESS)
}

fn list(options: &ClientOptions) -> Result<ExitCode> {
    let list: SessionList = options.client()?.get_within(DISK_TIMEOUT, "/v1/sessions")?;
    export::warn_unreadable(list.unreadable, &list.problems);
    let given = give(options.output.json, &list, || {
        let row = |session: &api::Session| {
            let stands = session.reason.clone().unwrap_or_else(|| "runs".to_owned());
            vec![
                session.id.clone(),
                session.participant.clone(),
                session.experiment.clone().unwrap_or_else(|| "-".to_owned()),
                session.plays.to_string(),
                stands,
                text::lost(session).unwrap_or_else(|| "-".to_owned()),
            ]
        };
        match list.sessions.is_empty() {
            true => "no session is recorded".to_owned(),
            false => {
                let head = ["session", "participant", "experiment", "plays", "ended", "lost"];
                text::columns(&head, list.sessions.iter().map(row))
            }
        }
    })?;
    let lacks = |session: &api::Session| session.lost.any();
    Ok(if list.unreadable > 0 || list.sessions.iter().any(lacks) { ExitCode::FAILURE } else { given })
}
