//! Requests to the daemon's routes: none makes it panic or answer 500, and an e-stop is always answered.
//!
//! A daemon with a simulated array runs in this process; requests enter where its server would hand them over. An input is up to
//! four requests, each a line with method and address, headers, an empty line, and a body; or, behind a byte 255, what the port for
//! emergency stops gets. The daemon keeps its state between two inputs: a finding may need those before it.

use arbitrary::Unstructured;
use axum::body::Body;
use axum::http::{HeaderName, HeaderValue, Method, Request, StatusCode, Uri};
use http_body_util::BodyExt;
use meissner::config::Config;
use meissner::daemon::{Daemon, Fuzzed, estop_token};
use std::cell::OnceCell;
use std::net::{IpAddr, Ipv4Addr};
use std::path::Path;
use std::time::Duration;
use tokio::runtime::Runtime;

/// How long a request may wait before its client hangs up: many wait for the end of a play.
const PATIENCE: Duration = Duration::from_millis(30);
/// How long an e-stop may take on a busy machine.
const ESTOP: Duration = Duration::from_secs(5);
/// Most bytes read of an answer: streams of events do not end.
const MOST_READ: usize = 4096;

struct Served {
    runtime: Runtime,
    daemon: Fuzzed,
}

thread_local! {
    static SERVED: OnceCell<Served> = const { OnceCell::new() };
}

fn serve() -> Served {
    let dir =
        std::env::temp_dir().join(format!("meissner-fuzz-{}", std::process::id())).display().to_string();
    std::fs::create_dir_all(format!("{dir}/patterns")).expect("a directory can be made");
    let text = format!(
        "device = \"mock\"\nsocket = \"{dir}/socket\"\nlisten = \"127.0.0.1:0\"\nlisten_token = \"always\"\ntokens = \"{dir}/tokens\"\n\
         patterns_dir = \"{dir}/patterns\"\ncalibration = \"{dir}/calibration.toml\"\nlogbook_dir = \"{dir}/record\"\n"
    );
    let config = Config::parse(&text, Path::new("fuzz")).expect("a configuration");
    let runtime = meissner::daemon::runtime().expect("a runtime");
    let daemon = Fuzzed::new(Daemon::start(&config).expect("a daemon")).expect("a thread");
    Served { runtime, daemon }
}

/// See the module.
pub fn run(data: &[u8]) {
    SERVED.with(|served| {
        let Served { runtime, daemon } = served.get_or_init(serve);
        let mut input = Unstructured::new(data);
        let first = crate::input::byte(&mut input);
        if first == u8::MAX {
            return on_estop_port(input.take_rest());
        }
        let from = match first % 4 {
            1 => Some(IpAddr::V4(Ipv4Addr::LOCALHOST)),
            2 => Some(IpAddr::V4(Ipv4Addr::new(192, 0, 2, 7))),
            _ => None,
        };
        for text in split(input.take_rest(), b"\n---\n").take(4) {
            if let Some(request) = request(text) {
                runtime.block_on(ask(daemon, request, from));
            }
        }
    });
}

/// A request on the port for emergency stops that is complete stays what it is when more bytes come.
fn on_estop_port(sent: &[u8]) {
    for cut in (0..sent.len()).step_by(sent.len() / 8 + 1) {
        if let Some(token) = estop_token(&sent[..cut]) {
            assert_eq!(estop_token(sent), Some(token));
        }
    }
}

/// The parts of bytes between separators.
fn split<'a>(bytes: &'a [u8], separator: &'a [u8]) -> impl Iterator<Item = &'a [u8]> {
    let mut rest = Some(bytes);
    std::iter::from_fn(move || {
        let all = rest.take()?;
        let at = all.windows(separator.len()).position(|part| part == separator);
        let (part, next) = match at {
            Some(at) => (&all[..at], Some(&all[at + separator.len()..])),
            None => (all, None),
        };
        rest = next;
        Some(part)
    })
}

/// The request of such a text, if hyper would read it.
fn request(text: &[u8]) -> Option<Request<Body>> {
    let (head, body) = match text.windows(2).position(|two| two == b"\n\n") {
        Some(at) => (&text[..at], &text[at + 2..]),
        None => (text, &[][..]),
    };
    let mut lines = head.split(|&byte| byte == b'\n');
    let first = lines.next()?;
    let space = first.iter().position(|&byte| byte == b' ')?;
    let method = Method::from_bytes(&first[..space]).ok()?;
    let uri = Uri::try_from(&first[space + 1..]).ok()?;
    let mut request = Request::new(Body::from(body.to_vec()));
    (*request.method_mut(), *request.uri_mut()) = (method, uri);
    for line in lines.take(16) {
        let colon = line.iter().position(|&byte| byte == b':')?;
        let name = HeaderName::from_bytes(&line[..colon]).ok()?;
        let value = HeaderValue::from_bytes(line[colon + 1..].trim_ascii()).ok()?;
        request.headers_mut().append(name, value);
    }
    Some(request)
}

async fn ask(daemon: &Fuzzed, request: Request<Body>, from: Option<IpAddr>) {
    let (method, path) = (request.method().clone(), request.uri().path().to_owned());
    let is_estop =
        method == Method::POST && path == "/v1/estop" && from.is_none() && request.headers().is_empty();
    let patience = if is_estop { ESTOP } else { PATIENCE };
    let answered = tokio::time::timeout(patience, async {
        let response = daemon.answer(request, from).await;
        let status = response.status();
        let mut body = response.into_body();
        let mut bytes = Vec::new();
        while bytes.len() < MOST_READ {
            match tokio::time::timeout(Duration::from_millis(5), body.frame()).await {
                Ok(Some(Ok(frame))) => bytes.extend_from_slice(frame.data_ref().map_or(&[][..], |data| data)),
                Ok(Some(Err(error))) => panic!("an answer broke off: {error}"),
                Ok(None) | Err(_) => break,
            }
        }
        (status, bytes)
    })
    .await;
    let Ok((status, bytes)) = answered else {
        assert!(!is_estop, "an e-stop has no answer");
        return;
    };
    if is_estop {
        assert_eq!(status, StatusCode::OK, "{}", String::from_utf8_lossy(&bytes));
    }
    // This process is not the program, so that it cannot render: that is its only error of its own.
    let cannot_render = method == Method::POST && path == "/v1/renderings";
    assert!(
        status != StatusCode::INTERNAL_SERVER_ERROR || cannot_render,
        "{method} {path}: {}",
        String::from_utf8_lossy(&bytes)
    );
    // An answer to HEAD has no body.
    if method != Method::HEAD && (status.is_client_error() || status.is_server_error()) {
        let problem: serde_json::Value = serde_json::from_slice(&bytes).expect("a problem in JSON");
        assert_eq!(problem["status"], status.as_u16());
        let detail = problem["detail"].as_str().expect("a detail");
        assert!(!detail.is_empty() && !detail.contains(['\n', '\u{1b}']), "{detail:?}");
    }
}
