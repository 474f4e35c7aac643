//! The page in the browser: files inside the program, served at `/` and below `/page/`.
//!
//! The page is plain HTML, CSS and JavaScript modules without a build step. It uses only the API (`assets/api.js`), so the OpenAPI
//! document covers everything that it does. `assets/estop.js` holds the parts that must work alone: the emergency stop, and the
//! state with its age. The modules read the state there, and only that script shows it.
//!
//! The page has four views, each with modules and a style sheet of its own. `assets/views.js` says how a module adds a part to a view,
//! and `assets/control.js` how it says beside a control what came of it.
//!
//! Invariant: the page loads nothing from other sites, and its policy forbids that.

use axum::Router;
use axum::http::HeaderName;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, REFERRER_POLICY};
use axum::routing::get;

/// The policy: scripts, styles and requests of this daemon alone; no frame around it.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";
const STYLE: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// Address, media type and text of every file.
const FILES: [(&str, &str, &str); 35] = [
    ("/", "text/html; charset=utf-8", include_str!("assets/index.html")),
    ("/page/page.css", STYLE, include_str!("assets/page.css")),
    ("/page/play.css", STYLE, include_str!("assets/play.css")),
    ("/page/design.css", STYLE, include_str!("assets/design.css")),
    ("/page/record.css", STYLE, include_str!("assets/record.css")),
    ("/page/device.css", STYLE, include_str!("assets/device.css")),
    ("/page/icon.svg", "image/svg+xml", include_str!("assets/icon.svg")),
    ("/page/api.js", SCRIPT, include_str!("assets/api.js")),
    ("/page/array.js", SCRIPT, include_str!("assets/array.js")),
    ("/page/estop.js", SCRIPT, include_str!("assets/estop.js")),
    ("/page/alive.js", SCRIPT, include_str!("assets/alive.js")),
    ("/page/app.js", SCRIPT, include_str!("assets/app.js")),
    ("/page/words.js", SCRIPT, include_str!("assets/words.js")),
    ("/page/views.js", SCRIPT, include_str!("assets/views.js")),
    ("/page/control.js", SCRIPT, include_str!("assets/control.js")),
    ("/page/finger.js", SCRIPT, include_str!("assets/finger.js")),
    ("/page/designer.js", SCRIPT, include_str!("assets/designer.js")),
    ("/page/compare.js", SCRIPT, include_str!("assets/compare.js")),
    ("/page/history.js", SCRIPT, include_str!("assets/history.js")),
    ("/page/number.js", SCRIPT, include_str!("assets/number.js")),
    ("/page/paper.js", SCRIPT, include_str!("assets/paper.js")),
    ("/page/picture.js", SCRIPT, include_str!("assets/picture.js")),
    ("/page/rendering.js", SCRIPT, include_str!("assets/rendering.js")),
    ("/page/thing.js", SCRIPT, include_str!("assets/thing.js")),
    ("/page/live.js", SCRIPT, include_str!("assets/live.js")),
    ("/page/maps.js", SCRIPT, include_str!("assets/maps.js")),
    ("/page/pad.js", SCRIPT, include_str!("assets/pad.js")),
    ("/page/patterns.js", SCRIPT, include_str!("assets/patterns.js")),
    ("/page/queue.js", SCRIPT, include_str!("assets/queue.js")),
    ("/page/receipt.js", SCRIPT, include_str!("assets/receipt.js")),
    ("/page/device.js", SCRIPT, include_str!("assets/device.js")),
    ("/page/doctor.js", SCRIPT, include_str!("assets/doctor.js")),
    ("/page/calibration.js", SCRIPT, include_str!("assets/calibration.js")),
    ("/page/plot.js", SCRIPT, include_str!("assets/plot.js")),
    ("/page/record.js", SCRIPT, include_str!("assets/record.js")),
];

/// Whether a request is for a file of the page. They contain no secrets, so a client needs no token for them.
pub(super) fn is_file(method: &str, path: &str) -> bool {
    matches!(method, "GET" | "HEAD") && FILES.iter().any(|(known, ..)| *known == path)
}

/// The routes of the page.
pub(super) fn routes<S: Clone + Send + Sync + 'static>() -> Router<S> {
    FILES.into_iter().fold(Router::new(), |router, (path, kind, text)| {
        let head: [(HeaderName, &str); 4] = [
            (CONTENT_TYPE, kind),
            (CONTENT_SECURITY_POLICY, POLICY),
            (REFERRER_POLICY, "no-referrer"),
            // A newer daemon has newer files.
            (CACHE_CONTROL, "no-cache"),
        ];
        router.route(path, get(async move || (head, text)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Uncompressed, bytes.
    const MOST: usize = 300_000;

    #[test]
    fn the_page_is_small_and_loads_nothing_from_elsewhere() {
        assert!(FILES.iter().map(|(.., text)| text.len()).sum::<usize>() <= MOST);
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
    }
}
