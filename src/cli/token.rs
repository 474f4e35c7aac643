//! `token`: creates, lists and revokes the access tokens of clients that come over the network.
//!
//! `create` prints the token alone on stdout, so that a script can keep it; the daemon does not show it again.

use super::arguments::{ClientOptions, choice};
use super::output::give;
use super::text;
use anyhow::Result;
use clap::Subcommand;
use meissner_api::{Role, TokenCreated, TokenInfo, TokenList, TokenRequest};
use meissner_client::{DISK_TIMEOUT, escape};
use std::io::{self, Write};
use std::process::ExitCode;

#[derive(Debug, Subcommand)]
pub(super) enum Token {
    /// Create an access token and print it: the only time that it is shown
    Create {
        /// Choose what a client with the token may do
        #[arg(long, value_name = "ROLE", value_parser = choice::<Role>(&[("observe", "Read and order an emergency stop"), ("operate", "Do everything but create and revoke tokens")]))]
        role: Role,
        /// Name who or what uses the token
        #[arg(long, value_name = "NAME")]
        name: String,
        #[command(flatten)]
        options: ClientOptions,
    },
    /// List the access tokens, without their secrets
    List(ClientOptions),
    /// Revoke an access token; it is not valid from the next request on
    Revoke {
        /// Revoke the token with this id
        id: String,
        #[command(flatten)]
        options: ClientOptions,
    },
}

pub(super) fn run(asked: &Token) -> Result<ExitCode> {
    match asked {
        Token::Create { role, name, options } => {
            let request = TokenRequest { role: *role, name: name.clone() };
            let created: TokenCreated =
                options.client()?.post_within(DISK_TIMEOUT, "/v1/tokens", &request)?;
            if !options.output.json {
                let TokenInfo { id, role, .. } = &created.info;
                // If stderr is closed, no one can read the message.
                let _ = writeln!(
                    io::stderr(),
                    "token {id} ({}): keep it now, it is not shown again; revoke it with `meissner token revoke {id}`",
                    role.name()
                );
            }
            give(options.output.json, &created, || created.token.clone())
        }
        Token::List(options) => {
            let list: TokenList = options.client()?.get("/v1/tokens")?;
            give(options.output.json, &list, || {
                let row = |token: &TokenInfo| {
                    vec![
                        token.id.clone(),
                        token.role.name().to_owned(),
                        token.created.clone(),
                        token.name.clone(),
                    ]
                };
                if list.tokens.is_empty() {
                    return "there is no access token".to_owned();
                }
                text::columns(&["token", "role", "created", "name"], list.tokens.iter().map(row))
            })
        }
        Token::Revoke { id, options } => {
            let revoked: TokenInfo = options.client()?.delete(&format!("/v1/tokens/{}", escape(id)))?;
            give(options.output.json, &revoked, || {
                format!("token {} ({}) is revoked", revoked.id, revoked.name)
            })
        }
    }
}
