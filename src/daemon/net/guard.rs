//! The check before every handler: who may send a request, and the end of a waiting request whose client loses its right.
//!
//! The state checks again when a change is made, because a session may begin, or a token be revoked, while a body arrives.
//!
//! Invariant: a request that the guard refuses changes nothing; a change is recorded like any refused command.

use crate::daemon::net::answer::ErrorResponse;
use crate::daemon::net::app::App;
use crate::daemon::net::body;
use crate::daemon::net::request_log::LoggedRequest;
use crate::daemon::sessions::caller::{Asker, Caller};
use crate::daemon::sessions::right::{Answering, Right};
use crate::daemon::sessions::rights::{NoRight, going_on};
use axum::extract::{Extension, Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use meissner_api::{Method, Route};
use std::sync::Arc;

/// Notes a sign of life of the client; refuses a request that it may not make, and ends a waiting request when the client's right
/// ends.
pub(in crate::daemon) async fn guard(
    State((app, route)): State<(App, Route)>,
    Extension(caller): Extension<Caller>,
    mut request: Request,
    next: Next,
) -> Response {
    let (access, peer) = (route.access(), caller.peer);
    let (checked, breaks) = {
        let mut state = app.engine.lock();
        state.hear(&caller);
        (state.check_right(&caller, access), state.commands.breaks())
    };
    if let Err(NoRight { problem, .. }) = checked {
        body::discard(request.into_body()).await;
        let refused = ErrorResponse::from(problem);
        return if route.method() == Method::Get {
            refused.into_response()
        } else {
            let logged = LoggedRequest::new(&app.engine, route.operation().command, peer);
            logged.result(Err::<(), _>(refused)).into_response()
        };
    }
    let _answering = Answering::new(&app.engine, &caller);
    let right = Right::new(Arc::clone(&app.engine), caller.clone(), going_on(access));
    request.extensions_mut().insert(right.clone());
    request.extensions_mut().insert(Asker { caller, access, breaks });
    tokio::select! {
        answer = next.run(request) => answer,
        NoRight { problem, .. } = right.ended(), if route.operation().waits => ErrorResponse(problem).into_response(),
    }
}
