//! The daemon's routes and answers agree with the OpenAPI document.

/// Checks a value against a schema.
mod schema;

use crate::harness::{Daemon, PATIENT, TIMEOUT, next, problem};
use meissner_api::ArrayDetails;
use meissner_api::route::{Answer, Body};
use meissner_api::{
    AnswerTaken, ArmRequest, CalibrateRequest, CalibrationReport, Code, DisarmRequest, DoctorReport,
    EdgeRequest, Event, ImportedPattern, LiveAccepted, LiveAnswer, LiveRequest, Method, PatternDetails,
    PatternList, PatternPreview, PlanCheck, PlayAccepted, PlayAnswer, PlayRequest, Problem, Receipt,
    RemovedPattern, Rendering, RenderingRequest, RenderingState, ResetRequest, Route, SequenceRequest,
    Session, SessionList, SessionPlays, SessionRequest, SessionStarted, Status, TokenCreated, TokenInfo,
    TokenList, TokenRequest, openapi,
};
use meissner_array::spec::{Array, ArraySpec, MAX_MOTORS};
use schema::check;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::collections::BTreeSet;

/// Calls `see` with each schema below this one, and the path to it.
fn walk(schema: &Value, way: &str, see: &mut dyn FnMut(&Value, &str)) {
    see(schema, way);
    match schema {
        Value::Object(keys) => {
            for (key, below) in keys.iter().filter(|(key, _)| *key != "examples" && *key != "example") {
                walk(below, &format!("{way}/{key}"), see);
            }
        }
        Value::Array(items) => items.iter().for_each(|below| walk(below, way, see)),
        _ => {}
    }
}

#[test]
fn every_key_has_a_description_and_every_number_its_unit_and_range() {
    // Offsets and differences may be negative, and so may a reached lead.
    const SIGNED: [&str; 10] = [
        "level",
        "rest_error_um",
        "onset_um",
        "offset_um",
        "contrast",
        "lead_ms",
        "rt_ms",
        "items",
        "travel_um",
        "about_um",
    ];
    const UNITS: [(&str, &str); 9] = [
        ("_s", ", s"),
        ("_ms", ", ms"),
        ("_us", ", µs"),
        ("_ns", ", ns"),
        ("um", ", µm"),
        ("_hz", ", Hz"),
        ("tick", "tick"),
        ("seconds", ", s"),
        ("bytes_per_s", ", bytes/s"),
    ];
    let document = openapi::document();
    let mut numbers = 0;
    walk(&document["components"]["schemas"], "", &mut |value, way| {
        let Some(keys) = value["properties"].as_object() else { return };
        for (key, below) in keys.iter().filter(|(key, _)| *key != "event") {
            let place = format!("{way}: {key}");
            let text = below["description"].as_str().or(below["oneOf"][0]["description"].as_str());
            let text = text.unwrap_or_else(|| panic!("{place} has no description"));
            assert!(!text.contains("[`"), "{place}: a link that the book cannot follow: {text}");
            let is_number = below["type"] == "number"
                || below["type"] == "integer"
                || below["type"]
                    .as_array()
                    .is_some_and(|of| of.contains(&"number".into()) || of.contains(&"integer".into()));
            if !is_number {
                continue;
            }
            numbers += 1;
            assert!(SIGNED.contains(&key.as_str()) || below["minimum"].is_number(), "{place} has no minimum");
            let rate = ["um_per_pulse", "pulses_per_s", "moves_per_s", "speed_mm_s", "turn_deg_s"]
                .contains(&key.as_str());
            let unit = UNITS.iter().rev().find(|(end, _)| key.ends_with(end) && !rate);
            if let Some((_, unit)) = unit {
                assert!(text.contains(unit), "{place} has no unit `{unit}`: {text}");
            }
        }
    });
    assert!(numbers > 60, "{numbers}");
}

/// The keys of a schema, as often as a value may have them.
fn keys(schema: &Value, schemas: &Value) -> Vec<String> {
    let named = schema["$ref"].as_str().and_then(|path| path.rsplit('/').next());
    let own = schema["properties"].as_object().into_iter().flat_map(|keys| keys.keys().cloned());
    let parts = schema["allOf"].as_array().into_iter().flatten().flat_map(|part| keys(part, schemas));
    named.map_or_else(|| own.chain(parts).collect(), |name| keys(&schemas[name], schemas))
}

/// A part of a value that is written into it must not have its keys.
#[test]
fn no_answer_and_no_event_has_a_key_twice() {
    let document = openapi::document();
    let schemas = &document["components"]["schemas"];
    let mut joined = 0;
    walk(schemas, "", &mut |schema, way| {
        if schema["allOf"].is_array() {
            joined += 1;
            let keys = keys(schema, schemas);
            let unique: BTreeSet<_> = keys.iter().collect();
            assert_eq!(unique.len(), keys.len(), "{way}: {keys:?}");
        }
    });
    assert!(joined > 3, "{joined}");
}

#[test]
fn ranges_are_those_that_the_daemon_checks() {
    use meissner_array::pattern::{FREQUENCY_HZ, MAX_SECONDS};
    use meissner_stream::calibrate::{MAX_GROUPS, pulses_range};
    let document = openapi::document();
    // A schema that flattens another is written as `allOf`; its own keys are in one of the parts.
    let property = |schema: &str, key: &str| {
        let schema = &document["components"]["schemas"][schema];
        let parts = schema["allOf"].as_array().map_or_else(|| std::slice::from_ref(schema), Vec::as_slice);
        parts
            .iter()
            .map(|part| &part["properties"][key])
            .find(|found| !found.is_null())
            .cloned()
            .unwrap_or_default()
    };
    let range = |value: &Value| (value["minimum"].as_f64().unwrap(), value["maximum"].as_f64().unwrap());
    let drive = |key| range(&property("LiveDrive", key));
    assert_eq!(drive("frequency_hz"), (*FREQUENCY_HZ.start(), *FREQUENCY_HZ.end()));
    assert_eq!(drive("amplitude_um"), (0.0, 5000.0));
    assert_eq!(drive("motor"), (0.0, (MAX_MOTORS - 1) as f64));
    assert_eq!(range(&property("PlayRequest", "seconds")), (0.0, MAX_SECONDS));
    assert_eq!(range(&property("PlayRequest", "at_ms")), (0.0, meissner_api::MAX_AT_MS));
    assert_eq!(property("SequenceRequest", "items")["maxItems"], meissner_api::MAX_SEQUENCE_ITEMS);
    assert_eq!(meissner_api::MAX_SEQUENCE_ITEMS, meissner_array::strokes::MAX_ITEMS);
    let pulses = property("CalibrateRequest", "pulses");
    let most = meissner_array::spec::names()
        .into_iter()
        .map(|name| *pulses_range(Array::named(name).unwrap()).end())
        .max();
    assert_eq!(range(&pulses["items"]), (1.0, most.unwrap().into()));
    assert_eq!(pulses["maxItems"], MAX_GROUPS);
    assert_eq!(property("CalibrateRequest", "repetitions")["maximum"], MAX_GROUPS / 2);
    assert_eq!(property("Receipt", "refusals")["maxItems"], meissner_api::MAX_LISTED);
    assert_eq!(property("Status", "lease_ms")["maximum"].as_f64().unwrap(), meissner::config::MAX_LEASE_MS);
}

fn parses<T: DeserializeOwned>(value: &Value) {
    let read: Result<T, _> = serde_json::from_value(value.clone());
    if let Err(error) = read {
        panic!("{}: {error}: {value}", std::any::type_name::<T>());
    }
}

/// The name of a variant of the events, and an example.
fn event_example(document: &Value, variant: &Value) -> (String, Value) {
    let parts = variant["allOf"].as_array().map_or_else(|| vec![variant], |parts| parts.iter().collect());
    let part = parts.iter().find(|part| part["properties"]["event"].is_object()).unwrap();
    let name = part["properties"]["event"]["enum"][0].as_str().unwrap().to_owned();
    let example = if name == "ended" {
        json!({"event": "ended", "receipt": document["components"]["schemas"]["Receipt"]["examples"][0]})
    } else {
        part["examples"][0].clone()
    };
    (name, example)
}

#[test]
fn every_route_has_examples_that_parse() {
    let document = openapi::document();
    let parse = |schema: &str, example: &Value| match schema {
        "ResetRequest" => drop(ResetRequest::parse(example.to_string().as_bytes()).unwrap()),
        "DisarmRequest" => drop(DisarmRequest::parse(example.to_string().as_bytes()).unwrap()),
        "EdgeRequest" => drop(EdgeRequest::parse(example.to_string().as_bytes()).unwrap()),
        "ArmRequest" => drop(ArmRequest::parse(example.to_string().as_bytes()).unwrap()),
        "SequenceRequest" => drop(SequenceRequest::parse(example.to_string().as_bytes()).unwrap()),
        "PlayRequest" => drop(PlayRequest::parse(example.to_string().as_bytes()).unwrap()),
        "LiveRequest" => drop(LiveRequest::parse(example.to_string().as_bytes()).unwrap()),
        "LiveAccepted" => parses::<LiveAccepted>(example),
        "LiveAnswer" => parses::<LiveAnswer>(example),
        "CalibrateRequest" => {
            let request = CalibrateRequest::parse(example.to_string().as_bytes()).unwrap();
            meissner::receipts::calibration_plan(Array::paper(), &request).unwrap();
        }
        "PlayAccepted" => parses::<PlayAccepted>(example),
        "Status" => parses::<Status>(example),
        "Receipt" => parses::<Receipt>(example),
        "PatternList" => parses::<PatternList>(example),
        "ArrayDetails" => {
            let ArrayDetails { toml, .. } = serde_json::from_value(example.clone()).unwrap();
            drop(ArraySpec::parse(&toml, "example").unwrap());
        }
        "PatternDetails" => parses::<PatternDetails>(example),
        "PatternPreview" => parses::<PatternPreview>(example),
        "PlanCheck" => parses::<PlanCheck>(example),
        "PlayAnswer" => drop(PlayAnswer::parse(example.to_string().as_bytes()).unwrap()),
        "AnswerTaken" => parses::<AnswerTaken>(example),
        "ImportedPattern" => parses::<ImportedPattern>(example),
        "RemovedPattern" => parses::<RemovedPattern>(example),
        "RenderingRequest" => drop(RenderingRequest::parse(example.to_string().as_bytes()).unwrap()),
        "Rendering" => parses::<Rendering>(example),
        "DoctorReport" => parses::<DoctorReport>(example),
        "CalibrationReport" => parses::<CalibrationReport>(example),
        "SessionRequest" => drop(SessionRequest::parse(example.to_string().as_bytes()).unwrap()),
        "SessionStarted" => parses::<SessionStarted>(example),
        "Session" => parses::<Session>(example),
        "SessionPlays" => parses::<SessionPlays>(example),
        "SessionList" => parses::<SessionList>(example),
        "TokenRequest" => drop(TokenRequest::parse(example.to_string().as_bytes()).unwrap()),
        "TokenCreated" => parses::<TokenCreated>(example),
        "TokenList" => parses::<TokenList>(example),
        "TokenInfo" => parses::<TokenInfo>(example),
        other => panic!("{other} has no example that is tested"),
    };
    let shown = |content: &Value| {
        for (media, content) in content.as_object().unwrap() {
            let example = &content["example"];
            let is_error = media == "application/problem+json";
            assert!(is_error || !example.is_null(), "{content}");
            let schema = content["schema"]["$ref"].as_str().and_then(|way| way.rsplit('/').next());
            if let Some(schema) = schema.filter(|_| !is_error && media != "text/event-stream") {
                check(&document, &content["schema"], example).unwrap();
                parse(schema, example);
            }
        }
    };
    for route in Route::ALL {
        let operation = route.operation();
        let described = &document["paths"][operation.path][openapi::method_name(operation.method)];
        if operation.body != Body::None {
            shown(&described["requestBody"]["content"]);
        }
        for answer in described["responses"].as_object().unwrap().values() {
            shown(&answer["content"]);
        }
    }
    parses::<Problem>(&document["components"]["schemas"]["Problem"]["examples"][0]);
    let pattern = &document["paths"]["/v1/patterns/{name}"]["put"]["requestBody"]["content"]["application/toml"]
        ["example"];
    meissner_array::pattern::Pattern::parse(pattern.as_str().unwrap(), "example").unwrap();
    let mut names = BTreeSet::new();
    for variant in document["components"]["schemas"]["Event"]["oneOf"].as_array().unwrap() {
        let (name, example) = event_example(&document, variant);
        check(&document, &json!({"$ref": "#/components/schemas/Event"}), &example).unwrap();
        let event: Event = serde_json::from_value(example).unwrap();
        assert_eq!(event.name(), name);
        names.insert(name);
    }
    assert_eq!(names.len(), 23);
}

#[test]
fn every_code_has_a_route_or_belongs_to_addresses_without_one() {
    let given: BTreeSet<&str> = Route::ALL
        .iter()
        .flat_map(|route| route.operation().errors().collect::<Vec<_>>())
        .map(|code| code.parts().0)
        .collect();
    let all: BTreeSet<&str> = Code::ALL.iter().map(|code| code.parts().0).collect();
    assert_eq!(all.difference(&given).copied().collect::<Vec<_>>(), [Code::MethodNotAllowed.parts().0]);
}

/// A call with any method.
fn call(daemon: &Daemon, method: &str, path: &str, body: &str) -> (u16, Value) {
    let length = body.len();
    let head = format!(
        "{method} {path} HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: {length}\r\n\r\n"
    );
    let answer = daemon.raw((head + body).as_bytes());
    let status = answer[9..12].parse().unwrap();
    let body = answer.split_once("\r\n\r\n").unwrap().1;
    (status, serde_json::from_str(body).unwrap_or_default())
}

#[test]
fn the_daemon_and_the_document_have_the_same_routes() {
    let daemon = Daemon::start();
    let document = openapi::document();
    let (status, served) = call(&daemon, "GET", "/v1/openapi.json", "");
    assert!(status == 200 && served == document);
    for path in document["paths"].as_object().unwrap().keys().filter(|path| *path != "/v1/events") {
        let at = path.replace("{id}", "99").replace("{name}", "none");
        for method in ["GET", "POST", "PUT", "DELETE", "PATCH"] {
            let (status, answer) = call(&daemon, method, &at, "not JSON");
            let described = &document["paths"][path][method.to_lowercase()];
            assert_eq!(status != 405, described.is_object(), "{method} {path}: {answer}");
            if described.is_object() && status >= 400 {
                let code = answer["code"].as_str().unwrap_or_else(|| panic!("{method} {path}: {status}"));
                let codes = &described["responses"][status.to_string()]["content"]["application/problem+json"]
                    ["schema"]["properties"]["code"]["enum"];
                assert!(
                    codes.as_array().is_some_and(|codes| codes.contains(&code.into())),
                    "{method} {path}: {answer}"
                );
            }
        }
    }
    // Conversely, each line of the router must be a route of the table, which the document shows.
    let operations: usize =
        document["paths"].as_object().unwrap().values().map(|of| of.as_object().unwrap().len()).sum();
    assert_eq!(operations, Route::ALL.len());
    assert_eq!(call(&daemon, "GET", "/v1/play/", "").0, 404);
}

#[test]
fn a_daemon_s_answers_fit_the_document() {
    // With little scatter a short calibration always measures gains accurately enough to be stored.
    let daemon = Daemon::with("mock", &format!("{PATIENT}mock.gain_sd = 0.02\n"));
    let document = openapi::document();
    let mut client = daemon.client();
    let fits = |route: Route, answer: &Value| {
        let Answer::Json(schema) = route.operation().answer else { panic!("{route:?} answers no JSON") };
        let reference = json!({"$ref": format!("#/components/schemas/{schema}")});
        check(&document, &reference, answer).unwrap_or_else(|error| panic!("{route:?}: {error}: {answer}"));
    };
    let event = |event: &Event| {
        let event = serde_json::to_value(event).unwrap();
        check(&document, &json!({"$ref": "#/components/schemas/Event"}), &event)
            .unwrap_or_else(|error| panic!("{error}: {event}"));
    };
    let refused = |route: Route, answer| {
        let problem = problem(answer);
        check(
            &document,
            &json!({"$ref": "#/components/schemas/Problem"}),
            &serde_json::to_value(&problem).unwrap(),
        )
        .unwrap();
        assert!(
            route
                .operation()
                .errors()
                .any(|code| code.parts().0 == problem.code && code.parts().1 == problem.status),
            "{route:?}: {problem:?}"
        );
    };
    // At first everything is refused, because the motors are disarmed.
    refused(Route::Play, client.post("/v1/play", &json!({"pattern": "edge-45"})));
    refused(Route::Play, client.post("/v1/play", &json!({"pattern": "none"})));
    refused(Route::Play, client.post("/v1/play", &json!({"pattern": "wave"})));
    refused(Route::Calibrate, client.post("/v1/calibrate", &json!({"repetitions": 0})));
    refused(Route::Calibration, client.get("/v1/calibration"));
    refused(Route::Home, client.post("/v1/home", &json!({})));
    refused(Route::Arm, client.post("/v1/arm", &json!({})));
    refused(Route::Receipt, client.get("/v1/plays/last"));
    refused(Route::Import, client.put("/v1/patterns/edge-45", String::new()));
    refused(Route::Pattern, client.get("/v1/patterns/none"));
    refused(Route::Remove, client.delete("/v1/patterns/none"));
    refused(Route::Remove, client.delete("/v1/patterns/edge-45"));
    for route in [Route::Status, Route::Doctor, Route::Patterns] {
        assert_eq!(route.method(), Method::Get);
        fits(route, &client.get(route.path()).unwrap());
    }
    let list: PatternList = client.get("/v1/patterns").unwrap();
    for pattern in list.patterns {
        fits(Route::Pattern, &client.get(&format!("/v1/patterns/{}", pattern.name)).unwrap());
    }
    let mine = "format = 1\nname = \"mine\"\nduration_s = 1\n[[drive]]\nmotor = 3\nfrequency_hz = 300\namplitude_um = 80\nstart_s = 0.5\n";
    fits(Route::Import, &client.put("/v1/patterns/mine", mine.to_owned()).unwrap());
    fits(Route::Pattern, &client.get("/v1/patterns/mine").unwrap());
    refused(Route::Import, client.put("/v1/patterns/mine", mine.to_owned()));
    refused(Route::Import, client.put("/v1/patterns/mine?replace=maybe", mine.to_owned()));
    fits(Route::Import, &client.put("/v1/patterns/mine?replace=true", mine.to_owned()).unwrap());
    fits(Route::Remove, &client.delete("/v1/patterns/mine").unwrap());
    let mut events = client.events().unwrap();
    refused(Route::RenderingShow, client.get("/v1/renderings/last"));
    for object in [json!("none"), json!({"name": "a"})] {
        refused(Route::RenderingStart, client.post("/v1/renderings", &json!({"object": object})));
    }
    fits(
        Route::RenderingStart,
        &client.post("/v1/renderings", &json!({"object": "dot", "method": "field"})).unwrap(),
    );
    fits(Route::RenderingShow, &client.get("/v1/renderings/1").unwrap());
    next(&mut events, |next| {
        event(&next);
        matches!(next, Event::Rendering { state: RenderingState::Done, .. }).then_some(())
    });
    fits(Route::RenderingShow, &client.get("/v1/renderings/last").unwrap());
    fits(Route::Pattern, &client.get("/v1/patterns/rendering:1").unwrap());
    fits(Route::RenderingCancel, &client.delete("/v1/renderings/1").unwrap());
    refused(Route::RenderingCancel, client.delete("/v1/renderings/2"));
    fits(
        Route::Preview,
        &client.get_within(TIMEOUT, "/v1/patterns/rendering:1/preview?seconds=0.1").unwrap(),
    );
    refused(Route::Preview, client.get("/v1/patterns/none/preview"));
    let started: Value =
        client.post("/v1/sessions", &json!({"participant": "P07", "exclusive": true})).unwrap();
    fits(Route::SessionStart, &started);
    refused(Route::Home, client.post("/v1/home", &json!({})));
    refused(Route::SessionStart, client.post("/v1/sessions", &json!({"participant": "P08"})));
    fits(Route::Sessions, &client.get("/v1/sessions").unwrap());
    fits(Route::SessionShow, &client.get("/v1/sessions/running").unwrap());
    refused(Route::SessionShow, client.get("/v1/sessions/none"));
    fits(Route::Status, &client.get("/v1/status").unwrap());
    client.set_token(started["token"].as_str().map(str::to_owned));
    let id = started["id"].as_str().unwrap();
    fits(Route::SessionPlays, &client.get(&format!("/v1/sessions/{id}/plays")).unwrap());
    refused(Route::SessionPlays, client.get(&format!("/v1/sessions/{id}/plays?from=-1")));
    fits(Route::SessionEnd, &client.post("/v1/sessions/running/end", &json!({})).unwrap());
    client.set_token(None);
    fits(Route::Sessions, &client.get("/v1/sessions").unwrap());
    fits(Route::Arm, &client.post("/v1/arm", &json!({"assume_rest": true})).unwrap());
    fits(Route::Play, &client.post("/v1/play", &json!({"pattern": "edge-45", "seconds": 0.3})).unwrap());
    fits(Route::Status, &client.get("/v1/status").unwrap());
    fits(Route::Receipt, &client.get("/v1/plays/last").unwrap());
    next(&mut events, |next| {
        event(&next);
        matches!(next, Event::Ended { .. }).then_some(())
    });
    fits(Route::Receipt, &client.get("/v1/plays/last").unwrap());
    fits(
        Route::Calibrate,
        &client.post("/v1/calibrate", &json!({"motor": 3, "pulses": [70, 140], "repetitions": 1})).unwrap(),
    );
    let problem = next(&mut events, |next| {
        event(&next);
        if let Event::Calibrated { problem, .. } = next { Some(problem) } else { None }
    });
    assert_eq!(problem, None);
    fits(Route::Calibration, &client.get("/v1/calibration").unwrap());
    for route in [Route::Edge, Route::Stop, Route::Disarm, Route::EStop, Route::Reset] {
        fits(route, &client.post(route.path(), &json!({})).unwrap());
    }
}
