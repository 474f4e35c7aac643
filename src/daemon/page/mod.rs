//! The page in the browser: files inside the program, served at `/` and below `/page/`.
//!
//! The page is plain HTML, CSS and JavaScript modules without a build step. It uses only the API (`assets/api.js`), so the OpenAPI
//! document covers everything that it does. `assets/estop.js` holds the parts that must work alone: the emergency stop, and the
//! state with its age. The modules read the state there, and only that script shows it. A browser asks again for each file with the tag
//! of what it has; unless the file differs, the answer is 304.
//!
//! The page has four views, each with modules and a style sheet of its own. `assets/views.js` says how a module adds a part to a view,
//! and `assets/control.js` how it says beside a control what came of it.
//!
//! Invariant: the page loads nothing from other sites, and its policy forbids that.

use crate::store;
use axum::Router;
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, HOST, IF_NONE_MATCH, REFERRER_POLICY,
};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use std::sync::LazyLock;

/// The tag of all files: they come and go together, with the program.
static TAG: LazyLock<String> = LazyLock::new(|| {
    let all: String = FILES.iter().map(|(.., text)| *text).collect();
    format!("\"{}\"", store::hash(all.as_bytes()))
});
const STYLE: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// Address, media type and text of every file.
const FILES: &[(&str, &str, &str)] = &[
    ("/", "text/html; charset=utf-8", include_str!("assets/index.html")),
    ("/page/page.css", STYLE, include_str!("assets/page.css")),
    ("/page/play.css", STYLE, include_str!("assets/play.css")),
    ("/page/design.css", STYLE, include_str!("assets/design.css")),
    ("/page/record.css", STYLE, include_str!("assets/record.css")),
    ("/page/device.css", STYLE, include_str!("assets/device.css")),
    ("/page/icon.svg", "image/svg+xml", include_str!("assets/icon.svg")),
    // Browsers ask for it although the page names its icon.
    ("/favicon.ico", "image/svg+xml", include_str!("assets/icon.svg")),
    ("/page/api.js", SCRIPT, include_str!("assets/api.js")),
    ("/page/array.js", SCRIPT, include_str!("assets/array.js")),
    ("/page/estop.js", SCRIPT, include_str!("assets/estop.js")),
    ("/page/alive.js", SCRIPT, include_str!("assets/alive.js")),
    ("/page/app.js", SCRIPT, include_str!("assets/app.js")),
    ("/page/words.js", SCRIPT, include_str!("assets/words.js")),
    ("/page/views.js", SCRIPT, include_str!("assets/views.js")),
    ("/page/control.js", SCRIPT, include_str!("assets/control.js")),
    ("/page/feed.js", SCRIPT, include_str!("assets/feed.js")),
    ("/page/pins.js", SCRIPT, include_str!("assets/pins.js")),
    ("/page/replay.js", SCRIPT, include_str!("assets/replay.js")),
    ("/page/stage.js", SCRIPT, include_str!("assets/stage.js")),
    ("/page/take.js", SCRIPT, include_str!("assets/take.js")),
    ("/page/designer.js", SCRIPT, include_str!("assets/designer.js")),
    ("/page/compare.js", SCRIPT, include_str!("assets/compare.js")),
    ("/page/history.js", SCRIPT, include_str!("assets/history.js")),
    ("/page/number.js", SCRIPT, include_str!("assets/number.js")),
    ("/page/picture.js", SCRIPT, include_str!("assets/picture.js")),
    ("/page/rendering.js", SCRIPT, include_str!("assets/rendering.js")),
    ("/page/thing.js", SCRIPT, include_str!("assets/thing.js")),
    ("/page/live.js", SCRIPT, include_str!("assets/live.js")),
    ("/page/pad.js", SCRIPT, include_str!("assets/pad.js")),
    ("/page/patterns.js", SCRIPT, include_str!("assets/patterns.js")),
    ("/page/chosen.js", SCRIPT, include_str!("assets/chosen.js")),
    ("/page/preview.js", SCRIPT, include_str!("assets/preview.js")),
    ("/page/toml.js", SCRIPT, include_str!("assets/toml.js")),
    ("/page/files.js", SCRIPT, include_str!("assets/files.js")),
    ("/page/pin-test.js", SCRIPT, include_str!("assets/pin-test.js")),
    ("/page/queue.js", SCRIPT, include_str!("assets/queue.js")),
    ("/page/receipt.js", SCRIPT, include_str!("assets/receipt.js")),
    ("/page/device.js", SCRIPT, include_str!("assets/device.js")),
    ("/page/doctor.js", SCRIPT, include_str!("assets/doctor.js")),
    ("/page/record.js", SCRIPT, include_str!("assets/record.js")),
    ("/page/session.js", SCRIPT, include_str!("assets/session.js")),
    ("/page/events.js", SCRIPT, include_str!("assets/events.js")),
];

/// Whether a request is for a file of the page. They contain no secrets, so a client needs no token for them.
pub(super) fn is_file(method: &str, path: &str) -> bool {
    matches!(method, "GET" | "HEAD") && FILES.iter().any(|(known, ..)| *known == path)
}

/// The routes of the page.
pub(super) fn routes<S: Clone + Send + Sync + 'static>() -> Router<S> {
    FILES.iter().fold(Router::new(), |router, &(path, kind, text)| {
        router.route(path, get(move |headers: HeaderMap| async move { serve(kind, text, &headers) }))
    })
}

/// The policy: scripts, styles and requests of this daemon alone, which takes emergency stops at the
/// port above the one that the browser asks; no frame around it.
fn policy(request: &HeaderMap) -> String {
    let host = request.get(HOST).and_then(|host| host.to_str().ok());
    let estop = host.and_then(estop_source).unwrap_or_default();
    format!(
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; \
         connect-src 'self'{estop}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}

/// The port for emergency stops at this host, for the policy.
fn estop_source(host: &str) -> Option<String> {
    // Browsers send no port if it is 80.
    let (name, port) = host.rsplit_once(':').filter(|(_, port)| !port.ends_with(']')).unwrap_or((host, "80"));
    let port = port.parse::<u16>().ok()?.checked_add(1)?;
    // A policy cannot name an IPv6 address.
    if name.starts_with('[') {
        return Some(format!(" *:{port}"));
    }
    let is_name = name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b".-_".contains(&byte));
    is_name.then(|| format!(" {name}:{port}"))
}

/// Answers a request for a file.
fn serve(kind: &'static str, text: &'static str, request: &HeaderMap) -> Response {
    let policy = policy(request);
    let headers = [
        (CONTENT_TYPE, kind),
        (CONTENT_SECURITY_POLICY, policy.as_str()),
        (REFERRER_POLICY, "no-referrer"),
        (CACHE_CONTROL, "no-cache"),
        (ETAG, TAG.as_str()),
    ];
    let is_known = request
        .get_all(IF_NONE_MATCH)
        .iter()
        .any(|tags| tags.to_str().is_ok_and(|tags| tags.contains(TAG.as_str())));
    if is_known {
        (StatusCode::NOT_MODIFIED, headers).into_response()
    } else {
        (headers, text).into_response()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    #[test]
    fn the_page_loads_nothing_from_elsewhere() {
        for (path, _, text) in FILES {
            for scheme in ["http://", "https://", "//cdn"] {
                let foreign =
                    text.match_indices(scheme).find(|(at, _)| !text[*at..].starts_with("http://www.w3.org/"));
                assert_eq!(foreign, None, "{path}");
            }
            assert!(
                !text.contains("innerHTML") && !text.contains("eval("),
                "{path}: text of others is never code"
            );
            assert!(
                !text.contains(" style=") && !text.contains(" onclick="),
                "{path}: the policy forbids it"
            );
        }
    }

    #[test]
    fn every_file_that_the_page_names_is_served() {
        let files: Vec<&str> = FILES.iter().map(|(path, ..)| *path).collect();
        for (path, _, text) in FILES {
            for part in text.split(['"', '\'']) {
                let named = part
                    .strip_prefix("./")
                    .filter(|_| path.ends_with(".js"))
                    .map(|name| format!("/page/{name}"));
                let named = named.or_else(|| part.strip_prefix("page/").map(|name| format!("/page/{name}")));
                assert!(named.is_none_or(|named| files.contains(&named.as_str())), "{path} names {part}");
            }
        }
    }

    #[test]
    fn files_alone_need_no_token() {
        assert!(is_file("GET", "/") && is_file("HEAD", "/page/app.js"));
        assert!(
            !is_file("POST", "/") && !is_file("GET", "/v1/status") && !is_file("GET", "/page/../v1/status")
        );
        assert!(is_file("GET", "/favicon.ico") && !is_file("GET", "/page/"));
    }

    #[test]
    fn the_policy_allows_this_daemon_alone_and_its_port_for_emergency_stops() {
        let allowed = |host: &'static str| {
            let text = policy(&HeaderMap::from_iter([(HOST, HeaderValue::from_static(host))]));
            text.split("; ").find_map(|rule| rule.strip_prefix("connect-src ")).unwrap().to_owned()
        };
        for (host, sources) in [
            ("lab-pc.local:8765", "'self' lab-pc.local:8766"),
            ("10.0.0.7", "'self' 10.0.0.7:81"),
            ("[::1]:8765", "'self' *:8766"),
            ("[::1]", "'self' *:81"),
            ("lab:65535", "'self'"),
            ("*:8765", "'self'"),
            ("lab,*; *:8765", "'self'"),
        ] {
            assert_eq!(allowed(host), sources, "{host}");
        }
    }

    #[test]
    fn a_file_that_the_browser_has_is_not_sent_again() {
        let (kind, text) = (FILES[0].1, FILES[0].2);
        let known = |tags: &str| {
            let request = HeaderMap::from_iter([(IF_NONE_MATCH, HeaderValue::from_str(tags).unwrap())]);
            serve(kind, text, &request).status()
        };
        let first = serve(kind, text, &HeaderMap::new());
        assert_eq!(
            (first.status(), first.headers()[CACHE_CONTROL].as_bytes()),
            (StatusCode::OK, &b"no-cache"[..])
        );
        let tag = first.headers()[ETAG].to_str().unwrap();
        for tags in [tag.to_owned(), format!("\"other\", W/{tag}")] {
            assert_eq!(known(&tags), StatusCode::NOT_MODIFIED, "{tags}");
        }
        assert_eq!(known("\"other\""), StatusCode::OK);
    }
}
