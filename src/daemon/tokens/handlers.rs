//! Access tokens: creates, lists and revokes them. The gate lets only clients of the Unix socket reach them.

use crate::daemon::net::answer::{Answer, PathPart, path};
use crate::daemon::net::app::{App, Call};
use crate::daemon::net::body;
use crate::daemon::net::request_log::LoggedRequest;
use crate::daemon::sessions::right;
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::StatusCode;
use meissner_api::{TokenCreated, TokenInfo, TokenList, TokenRequest};
use serde_json::json;
use std::sync::Arc;

pub(in crate::daemon) async fn create(
    Call { app, by }: Call,
    body: Body,
) -> Answer<(StatusCode, Json<TokenCreated>)> {
    let mut logged = LoggedRequest::of(&app.engine, "token-create", &by);
    let result = async {
        let request = TokenRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        let gate = Arc::clone(&app.engine.gate);
        let created =
            right::changing(&app.engine, &by, move || gate.tokens.create(request.role, &request.name))
                .await??;
        // Never record the token itself.
        logged.set_arguments(&created.info);
        Ok((StatusCode::CREATED, Json(created)))
    }
    .await;
    logged.result(result)
}

pub(in crate::daemon) async fn list(State(app): State<App>) -> Json<TokenList> {
    Json(TokenList { tokens: app.engine.gate.tokens.list() })
}

pub(in crate::daemon) async fn revoke(Call { app, by }: Call, id: PathPart) -> Answer<Json<TokenInfo>> {
    let mut logged = LoggedRequest::of(&app.engine, "token-revoke", &by);
    let result = async {
        let id: String = path(id)?.chars().take(100).collect();
        logged.set_arguments(&json!({"id": id}));
        let engine = Arc::clone(&app.engine);
        let revoked = right::changing(&app.engine, &by, move || {
            let revoked = engine.gate.tokens.revoke(&id);
            // Do this even if the file could not be written: the token is no longer valid.
            engine.lock().rights_changed();
            revoked
        });
        Ok(Json(revoked.await??))
    }
    .await;
    logged.result(result)
}
