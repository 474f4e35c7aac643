//! Access tokens: creates, lists and revokes them. The gate lets only clients of the Unix socket reach them.

use crate::daemon::http::answer::{Answer, path};
use crate::daemon::http::app::App;
use crate::daemon::http::body;
use crate::daemon::http::request_log::LoggedRequest;
use crate::daemon::system::runtime::blocking;
use crate::session_record::Peer;
use axum::Json;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, State};
use axum::http::StatusCode;
use meissner_api::{TokenCreated, TokenInfo, TokenList, TokenRequest};
use serde_json::json;

pub(in crate::daemon::http) async fn create(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<(StatusCode, Json<TokenCreated>)> {
    let mut logged = LoggedRequest::new(&app.engine, "token-create", peer);
    let result = async {
        let request = TokenRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        let created = blocking(move || app.engine.gate.tokens.create(request.role, &request.name)).await??;
        // Never record the token itself.
        logged.set_arguments(&created.info);
        Ok((StatusCode::CREATED, Json(created)))
    }
    .await;
    logged.result(result)
}

pub(in crate::daemon::http) async fn list(State(app): State<App>) -> Json<TokenList> {
    app.engine.gate.refresh_tokens().await;
    Json(TokenList { tokens: app.engine.gate.tokens.list() })
}

pub(in crate::daemon::http) async fn revoke(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    id: Result<Path<String>, PathRejection>,
) -> Answer<Json<TokenInfo>> {
    let mut logged = LoggedRequest::new(&app.engine, "token-revoke", peer);
    let result = async {
        let id: String = path(id)?.chars().take(100).collect();
        logged.set_arguments(&json!({"id": id}));
        let revoked = blocking(move || {
            let revoked = app.engine.gate.tokens.revoke(&id);
            // Do this even if the file could not be written: the token is no longer valid.
            app.engine.lock().rights_changed();
            revoked
        });
        Ok(Json(revoked.await??))
    }
    .await;
    logged.result(result)
}
