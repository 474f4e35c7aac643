//! `answer`: records a participant's answer to a play of the running session.

use super::arguments::{ClientOptions, label};
use super::output::give;
use anyhow::Result;
use clap::Args;
use meissner_api::{AnswerTaken, PlayAnswer};
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct Answer {
    /// Answer the play with this id
    play: u64,
    /// Record this response: any text, as it is
    #[arg(allow_hyphen_values = true)]
    response: String,
    /// Record that it is right
    #[arg(long, conflicts_with = "wrong")]
    correct: bool,
    /// Record that it is wrong
    #[arg(long)]
    wrong: bool,
    /// Record the response time, ms
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    rt_ms: Option<f64>,
    /// Record the level of the stimulus
    #[arg(long, value_name = "X", allow_negative_numbers = true)]
    level: Option<f64>,
    /// Record a factor of the trial; may be repeated
    #[arg(long = "factor", value_name = "KEY=VALUE", value_parser = label)]
    factors: Vec<(String, String)>,
    #[command(flatten)]
    options: ClientOptions,
}

pub(super) fn run(asked: Answer) -> Result<ExitCode> {
    let Answer { play, response, correct, wrong, rt_ms, level, factors, options } = asked;
    let correct = (correct || wrong).then_some(correct);
    let answer = PlayAnswer { response, correct, rt_ms, level, factors: factors.into_iter().collect() };
    let taken: AnswerTaken = options.client()?.post(&format!("/v1/plays/{play}/answer"), &answer)?;
    give(options.output.json, &taken, || format!("play {play}: answer recorded"))
}
