//! Documents: a text is read or refused, and what is written reads back as the same.
//!
//! The first byte chooses the kind of document, so that inputs of all kinds share what they find out about TOML and JSON.

use crate::input::{text, told};
use arbitrary::Unstructured;
use meissner::config::Config;
use meissner::exposure::{Account, Now, ParticipantLimits};
use meissner::record::reader;
use meissner_api::{
    ArmRequest, CalibrateRequest, LiveMessage, LiveRequest, Order, RenderingRequest, ResetRequest,
    SessionRequest, TokenRequest,
};
use meissner_array::pattern::Pattern;
use meissner_array::samples;
use meissner_paper::Target;
use meissner_skin::AnyScene;
use meissner_stream::calibrate::Calibration;
use meissner_stream::device::Spec;
use serde::Serialize;
use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// Tries one kind of document.
pub type Read = fn(&[u8]);

/// The kinds of documents; the number is the first byte of an input.
pub const KINDS: [(&str, Read); 16] = [
    ("pattern", pattern),
    ("target", target),
    ("scene", scene),
    ("configuration", configuration),
    ("calibration", calibration),
    ("table", |bytes| samples(&["a.csv"], bytes)),
    ("samples", |bytes| samples(&["a.npy", "a.wav"], bytes)),
    ("session record", session_record),
    ("exposure", exposure),
    ("play", |bytes| body(bytes, Order::parse)),
    ("rendering", |bytes| body(bytes, RenderingRequest::parse)),
    ("session", |bytes| body(bytes, SessionRequest::parse)),
    ("live", |bytes| body(bytes, LiveRequest::parse)),
    ("live message", |bytes| body(bytes, LiveMessage::parse)),
    ("other requests", other_requests),
    ("device", |bytes| text(bytes, device)),
];

/// See the module.
pub fn run(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let kind = usize::from(crate::input::byte(&mut input));
    let (_, read) = KINDS[kind % KINDS.len()];
    read(input.take_rest());
}

fn pattern(bytes: &[u8]) {
    text(bytes, |text| match Pattern::parse(text, "file") {
        Ok(pattern) => {
            let written = pattern.to_toml();
            assert_eq!(Pattern::parse(&written, "file").expect("a written pattern"), pattern, "{written}");
            let _ = Target::made_for(&pattern);
        }
        Err(error) => told(error),
    });
}

fn target(bytes: &[u8]) {
    text(bytes, |text| match Target::read(text, "file") {
        Ok(target) => {
            let written = toml::to_string(&target.definition()).expect("a table can be written");
            assert_eq!(Target::read(&written, "file").expect("a written target"), target, "{written}");
        }
        Err(error) => told(error),
    });
}

fn scene(bytes: &[u8]) {
    text(bytes, |text| match AnyScene::read(text, "file", None) {
        Ok(scene) => assert!(scene.array().motors() > 0),
        Err(error) => told(error),
    });
}

fn configuration(bytes: &[u8]) {
    text(bytes, |text| {
        if let Err(error) = Config::parse(text, Path::new("file")) {
            told(error);
        }
    });
}

fn calibration(bytes: &[u8]) {
    text(bytes, |text| match Calibration::parse(text, "file") {
        Ok(calibration) => {
            let written = calibration.to_toml();
            assert_eq!(
                Calibration::parse(&written, "file").expect("a written calibration"),
                calibration,
                "{written}"
            );
        }
        Err(error) => told(error),
    });
}

fn samples(names: &[&str], bytes: &[u8]) {
    for name in names {
        if let Err(error) = samples::read(name, bytes, &samples::Choice::default()) {
            told(error);
        }
    }
}

/// A directory for the one file of a session record. `verify/fuzz/run` names one in memory.
static RECORD: LazyLock<PathBuf> = LazyLock::new(|| {
    let dir = std::env::temp_dir().join(format!("meissner-fuzz-{}", std::process::id()));
    std::fs::create_dir_all(&dir).expect("a directory can be made");
    dir
});

/// The file of a session, and its plays.
fn session_record(bytes: &[u8]) {
    let dir = &*RECORD;
    let id = "20260102T000000Z-000000";
    std::fs::create_dir_all(dir.join("sessions")).expect("a directory can be made");
    std::fs::write(dir.join(format!("sessions/{id}.jsonl")), bytes).expect("a file can be written");
    let list = reader::sessions(dir, &[]).expect("the directory can be read");
    assert!(list.sessions.len() == 1);
    let id = &list.sessions[0].id;
    let read = reader::plays(dir, id, &[], 0).expect("the directory can be read");
    let (plays, _) = read.expect("a session that is listed");
    let lines = bytes.iter().filter(|&&byte| byte == b'\n').count() + 1;
    assert!(plays.unreadable <= lines as u64 + 1);
    let _ = reader::read_text(dir, &"0".repeat(64));
}

fn exposure(bytes: &[u8]) {
    let mut account = Account::new(ParticipantLimits::default());
    let now = Now::read();
    if account.restore(bytes, now).is_ok()
        && let Some(text) = account.text(now)
    {
        let mut again = Account::new(ParticipantLimits::default());
        again.restore(text.as_bytes(), now).expect("a written account");
        assert_eq!(again.status(now).day_used_s, account.status(now).day_used_s);
    }
}

/// A request that is read reads the same when it is written.
fn body<T: Serialize + PartialEq + Debug, E: std::fmt::Display>(
    bytes: &[u8],
    parse: impl Fn(&[u8]) -> Result<T, E>,
) {
    match parse(bytes) {
        Ok(request) => {
            let written = serde_json::to_vec(&request).expect("a request can be written");
            match parse(&written) {
                Ok(again) => assert_eq!(again, request),
                Err(error) => panic!("{} is refused: {error}", String::from_utf8_lossy(&written)),
            }
        }
        Err(problem) => told(problem),
    }
}

fn other_requests(bytes: &[u8]) {
    let Some((kind, rest)) = bytes.split_first() else { return };
    match kind % 4 {
        0 => body(rest, ArmRequest::parse),
        1 => body(rest, ResetRequest::parse),
        2 => body(rest, CalibrateRequest::parse),
        _ => body(rest, TokenRequest::parse),
    }
    if let Ok(text) = std::str::from_utf8(rest) {
        let _ = Order::parse_file(text);
    }
}

fn device(text: &str) {
    match text.parse::<Spec>() {
        Ok(spec) => assert_eq!(spec.to_string().parse::<Spec>().as_ref(), Ok(&spec), "{text:?}"),
        Err(error) => told(error),
    }
}
