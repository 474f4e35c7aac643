//! Answers requests for the page's files.
//!
//! A browser asks again for a file at its plain address, with the tag of what it has; unless the file differs, the answer is 304.
//! `/` names the others below an address that contains the hash of all of them. A browser keeps those, so to reload the page it
//! asks for `/` alone.
//!
//! Invariant: only a file of this very version is answered as one that a browser may keep.

use crate::daemon::page::{FILES, FOLDER};
use crate::daemon::system::gzip::{self, Compression};
use crate::store;
use axum::body::Bytes;
use axum::http::header::{
    CACHE_CONTROL, CONTENT_ENCODING, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, IF_NONE_MATCH,
    REFERRER_POLICY, VARY,
};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use std::sync::{LazyLock, OnceLock};

/// The policy: scripts, styles and requests of this daemon alone; no frame around it.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";
/// Hexadecimal digits of a hash that are used.
const DIGITS: usize = 16;

/// A file as it is served.
struct File {
    kind: &'static str,
    text: Bytes,
    /// The hash of the text.
    hash: String,
    /// The text in gzip's format, once a client has asked for it.
    gzip: OnceLock<Bytes>,
}

/// The files, in the order of [`FILES`].
struct Page {
    version: String,
    files: Vec<File>,
}

static PAGE: LazyLock<Page> = LazyLock::new(|| {
    let all: String = FILES.iter().map(|(.., text)| *text).collect();
    let version = hash(all.as_bytes());
    let file = |&(path, kind, text): &(&str, &'static str, &'static str)| {
        let text = match path {
            "/" => with_version(text, &version).into(),
            _ if path.ends_with(".js") => without_comments(text).into(),
            _ => Bytes::from_static(text.as_bytes()),
        };
        File { kind, hash: hash(&text), text, gzip: OnceLock::new() }
    };
    let files = FILES.iter().map(file).collect();
    Page { version, files }
});

fn hash(text: &[u8]) -> String {
    let mut hash = store::hash(text);
    hash.truncate(DIGITS);
    hash
}

/// The first file, with the addresses of the others that a browser may keep.
fn with_version(text: &str, version: &str) -> String {
    let folder = &FOLDER[1..];
    let kept = format!("\"{folder}{version}/");
    text.replace(&format!("\"{folder}"), &kept)
}

/// A script whose lines that are comments are empty: they are for who reads the source, and lines keep their numbers.
fn without_comments(script: &str) -> String {
    let line =
        |line: &str| if line.trim_start().starts_with("//") { "\n".to_owned() } else { format!("{line}\n") };
    script.lines().map(line).collect()
}

/// Answers a request for the file at this place of [`FILES`], of the version that its address names.
pub(super) async fn serve(index: usize, version: Option<String>, request: HeaderMap) -> Response {
    let page = &*PAGE;
    let file = &page.files[index];
    let compressed = if gzip::is_accepted(&request) { file.compressed().await } else { None };
    // The two texts of a file differ, and so must their tags.
    let tag = format!("\"{}{}\"", file.hash, if compressed.is_some() { "-gzip" } else { "" });
    let is_kept = version.is_some_and(|version| version == page.version);
    let caching = if is_kept { "max-age=31536000, immutable" } else { "no-cache" };
    let mut headers = HeaderMap::new();
    for (name, value) in [
        (CONTENT_SECURITY_POLICY, POLICY),
        (REFERRER_POLICY, "no-referrer"),
        (CACHE_CONTROL, caching),
        (VARY, "accept-encoding"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    if let Ok(tag) = HeaderValue::from_str(&tag) {
        headers.insert(ETAG, tag);
    }
    if has(&request, &file.hash) {
        return (StatusCode::NOT_MODIFIED, headers).into_response();
    }
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(file.kind));
    if compressed.is_some() {
        headers.insert(CONTENT_ENCODING, HeaderValue::from_static("gzip"));
    }
    (headers, compressed.unwrap_or_else(|| file.text.clone())).into_response()
}

/// Whether the client has the file with this hash, compressed or not.
fn has(request: &HeaderMap, hash: &str) -> bool {
    let values = request.get_all(IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|tag| {
        let tag = tag.trim();
        let tag = tag.strip_prefix("W/").unwrap_or(tag).trim_matches('"');
        tag.strip_suffix("-gzip").unwrap_or(tag) == hash
    })
}

impl File {
    /// The text in gzip's format; none if that is no shorter.
    async fn compressed(&self) -> Option<Bytes> {
        if self.gzip.get().is_none() {
            let compressed = gzip::compress(&self.text, Compression::default()).await.unwrap_or_default();
            let _ = self.gzip.set(compressed.into());
        }
        self.gzip.get().filter(|gzip| !gzip.is_empty() && gzip.len() < self.text.len()).cloned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::page::{is_file, routes};
    use axum::body::{Body, to_bytes};
    use axum::http::Request;
    use flate2::read::GzDecoder;
    use std::io::Read;
    use tower::ServiceExt;

    /// The status, headers and body of an answer.
    fn get(path: &str, headers: &[(&str, &str)]) -> (u16, HeaderMap, Bytes) {
        let request =
            headers.iter().fold(Request::get(path), |request, (name, value)| request.header(*name, *value));
        crate::daemon::runtime().unwrap().block_on(async {
            let answer = routes::<()>().oneshot(request.body(Body::empty()).unwrap()).await.unwrap();
            let (head, body) = answer.into_parts();
            (head.status.as_u16(), head.headers, to_bytes(body, usize::MAX).await.unwrap())
        })
    }

    fn text(bytes: &[u8]) -> &str {
        std::str::from_utf8(bytes).unwrap()
    }

    #[test]
    fn a_file_that_the_browser_has_is_not_sent_again() {
        for (path, ..) in FILES {
            for encoding in ["identity", "gzip"] {
                let (status, headers, body) = get(path, &[("accept-encoding", encoding)]);
                assert_eq!((status, &headers[CACHE_CONTROL]), (200, &HeaderValue::from_static("no-cache")));
                assert!(!body.is_empty());
                let tag = headers[ETAG].to_str().unwrap();
                for tags in [tag.to_owned(), format!("\"other\", W/{tag}")] {
                    let (status, headers, body) =
                        get(path, &[("accept-encoding", encoding), ("if-none-match", &tags)]);
                    assert_eq!(
                        (status, &*body, headers[ETAG].to_str().unwrap()),
                        (304, &b""[..], tag),
                        "{path}"
                    );
                }
                assert_eq!(get(path, &[("if-none-match", "\"other\"")]).0, 200);
            }
        }
    }

    #[test]
    fn a_script_is_sent_without_its_comments_and_its_lines_keep_their_numbers() {
        let script = "// Why.\nlet a = 1; // here\n  // there\nlet b = \"//\";\n";
        assert_eq!(without_comments(script), "\nlet a = 1; // here\n\nlet b = \"//\";\n");
        for (path, _, source) in FILES.iter().filter(|(path, ..)| path.ends_with(".js")) {
            let (_, _, sent) = get(path, &[]);
            assert_eq!(text(&sent).lines().count(), source.lines().count(), "{path}");
        }
    }

    /// What is sent, compressed and not, bytes.
    #[test]
    fn the_page_is_small() {
        let size = |headers: &[(&str, &str)]| {
            FILES.iter().map(|(path, ..)| get(path, headers).2.len()).sum::<usize>()
        };
        let sent = [size(&[]), size(&[("accept-encoding", "gzip")])];
        println!("the page: {} bytes, {} as they are sent", sent[0], sent[1]);
        assert!(sent[0] <= 300_000 && sent[1] <= 150_000, "{sent:?}");
    }

    #[test]
    fn compressed_files_are_the_same_and_have_other_tags() {
        let mut sent = [0, 0];
        for (path, ..) in FILES {
            let (_, plain_headers, plain) = get(path, &[]);
            let (_, headers, compressed) = get(path, &[("accept-encoding", "br, gzip")]);
            assert_eq!(headers[CONTENT_ENCODING], "gzip", "{path}");
            assert!(!plain_headers.contains_key(CONTENT_ENCODING));
            assert_ne!(headers[ETAG], plain_headers[ETAG]);
            let mut unpacked = Vec::new();
            GzDecoder::new(&*compressed).read_to_end(&mut unpacked).unwrap();
            assert_eq!(unpacked, plain, "{path}");
            sent = [sent[0] + plain.len(), sent[1] + compressed.len()];
        }
        assert!(2 * sent[1] < sent[0], "{sent:?} bytes");
    }

    #[test]
    fn a_browser_may_keep_every_file_but_the_first() {
        let (_, _, page) = get("/", &[]);
        let named: Vec<String> = text(&page)
            .split('"')
            .filter(|part| part.starts_with("page/"))
            .map(|part| format!("/{part}"))
            .collect();
        assert!(named.len() >= 4, "{named:?}");
        for path in &named {
            let (status, headers, body) = get(path, &[]);
            assert_eq!(status, 200, "{path}");
            assert!(text(headers[CACHE_CONTROL].as_bytes()).contains("immutable"), "{path}");
            let plain = format!("/page/{}", path.rsplit('/').next().unwrap());
            assert_eq!(body, get(&plain, &[]).2, "{path}");
            assert!(is_file("GET", path), "{path} needs no token");
        }
        // Files that scripts load are named from where the script is.
        for (path, _, text) in FILES.iter().filter(|(path, ..)| path.ends_with(".js")) {
            assert!(!text.contains("\"page/"), "{path}");
        }
    }

    /// A browser may have kept the page of another daemon.
    #[test]
    fn files_of_another_version_are_sent_but_not_to_be_kept() {
        let (status, headers, body) = get("/page/0123456789abcdef/app.js", &[]);
        assert_eq!((status, &headers[CACHE_CONTROL]), (200, &HeaderValue::from_static("no-cache")));
        assert_eq!(body, get("/page/app.js", &[]).2);
    }
}
