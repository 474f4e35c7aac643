//! The page in the browser: files inside the program, served at `/` and below `/page/`.
//!
//! The page is plain HTML, CSS and JavaScript modules without a build step. It uses only the API (`assets/api.js`), so the OpenAPI
//! document covers everything that it does. `assets/estop.js` holds the parts that must work alone: the emergency stop, and the
//! state with its age. The modules read the state there, and only that script shows it. `served` answers requests for files: what a
//! browser has, it does not load again.
//!
//! The page has four views, each with modules and a style sheet of its own. `assets/views.js` says how a module adds a part to a view,
//! and `assets/control.js` how it says beside a control what came of it.
//!
//! Invariant: the page loads nothing from other sites, and its policy forbids that.

mod served;

use axum::Router;
use axum::extract::Path;
use axum::http::HeaderMap;
use axum::routing::get;

/// The address of the files but the first.
const FOLDER: &str = "/page/";
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
    ("/page/finger.js", SCRIPT, include_str!("assets/finger.js")),
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
    ("/page/calibration.js", SCRIPT, include_str!("assets/calibration.js")),
    ("/page/record.js", SCRIPT, include_str!("assets/record.js")),
    ("/page/session.js", SCRIPT, include_str!("assets/session.js")),
    ("/page/events.js", SCRIPT, include_str!("assets/events.js")),
    ("/page/experiment.js", SCRIPT, include_str!("assets/experiment.js")),
    ("/page/choice.js", SCRIPT, include_str!("assets/choice.js")),
    ("/page/export.js", SCRIPT, include_str!("assets/export.js")),
];

/// Whether a request is for a file of the page. They contain no secrets, so a client needs no token for them.
pub(super) fn is_file(method: &str, path: &str) -> bool {
    let kept = path.strip_prefix(FOLDER).and_then(|rest| rest.split_once('/'));
    let kept = kept.filter(|(version, _)| version.bytes().all(|byte| byte.is_ascii_hexdigit()));
    let is_known =
        |known: &str| known == path || kept.is_some_and(|(_, name)| known.strip_prefix(FOLDER) == Some(name));
    matches!(method, "GET" | "HEAD") && FILES.iter().any(|(known, ..)| is_known(known))
}

/// The routes of the page: each file at its address, and below `/page/VERSION/`, where a browser may keep it.
pub(super) fn routes<S: Clone + Send + Sync + 'static>() -> Router<S> {
    FILES.iter().enumerate().fold(Router::new(), |router, (index, (path, ..))| {
        let fresh = get(move |headers: HeaderMap| served::serve(index, None, headers));
        let router = router.route(path, fresh);
        let Some(name) = path.strip_prefix(FOLDER) else { return router };
        let kept = get(move |Path(version): Path<String>, headers: HeaderMap| {
            served::serve(index, Some(version), headers)
        });
        router.route(&format!("{FOLDER}{{version}}/{name}"), kept)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert!(is_file("GET", "/page/0123/app.js") && is_file("GET", "/favicon.ico"));
        for path in ["/page/0123/status", "/page/v1/app.js", "/page/0123/../app.js", "/page/0123//", "/page/"]
        {
            assert!(!is_file("GET", path), "{path}");
        }
    }
}
