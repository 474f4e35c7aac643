//! The daemon's routes and answers agree with the OpenAPI document.

/// Checks a value against a schema.
mod schema;

use crate::harness::{Daemon, PATIENT, TIMEOUT, next, problem};
use meissner_api::route::{Answer, Body};
use meissner_api::{Event, PatternList, RenderingState, Route, openapi};
use meissner_array::spec::MAX_MOTORS;
use schema::check;
use serde_json::{Value, json};
use std::collections::BTreeSet;

#[test]
fn ranges_are_those_that_the_daemon_checks() {
    use meissner_array::pattern::{FREQUENCY_HZ, MAX_SECONDS};
    use meissner_stream::calibrate::MAX_GROUPS;
    let document = openapi::document();
    let range = |schema: &str, key: &str| {
        let property = &document["components"]["schemas"][schema]["properties"][key];
        (property["minimum"].as_f64(), property["maximum"].as_f64().or(property["maxItems"].as_f64()))
    };
    for (schema, key, least, most) in [
        ("LiveDrive", "frequency_hz", Some(*FREQUENCY_HZ.start()), *FREQUENCY_HZ.end()),
        ("LiveDrive", "motor", Some(0.0), (MAX_MOTORS - 1) as f64),
        ("Order", "seconds", Some(0.0), MAX_SECONDS),
        ("Order", "items", None, meissner_array::strokes::MAX_ITEMS as f64),
        ("CalibrateRequest", "pulses", None, MAX_GROUPS as f64),
    ] {
        assert_eq!(range(schema, key), (least, Some(most)), "{schema}.{key}");
    }
}

#[test]
fn every_example_fits_its_schema() {
    let document = openapi::document();
    let schema = |content: &Value, place: &str| {
        for (media, content) in content.as_object().unwrap() {
            let is_error = media == "application/problem+json";
            assert!(is_error || !content["example"].is_null(), "{place}: {content}");
            if content["schema"]["$ref"].is_string() && !is_error && media != "text/event-stream" {
                check(&document, &content["schema"], &content["example"])
                    .unwrap_or_else(|error| panic!("{place}: {error}"));
            }
        }
    };
    for route in Route::ALL {
        let operation = route.operation();
        let described = &document["paths"][operation.path][openapi::method_name(operation.method)];
        if operation.body != Body::None {
            schema(&described["requestBody"]["content"], operation.path);
        }
        for answer in described["responses"].as_object().unwrap().values() {
            schema(&answer["content"], operation.path);
        }
    }
    let mut names = BTreeSet::new();
    for variant in document["components"]["schemas"]["Event"]["oneOf"].as_array().unwrap() {
        let parts = variant["allOf"].as_array().map_or_else(|| vec![variant], |parts| parts.iter().collect());
        let part = parts.iter().find(|part| part["properties"]["event"].is_object()).unwrap();
        let name = part["properties"]["event"]["enum"][0].as_str().unwrap();
        let receipt = &document["components"]["schemas"]["Receipt"]["examples"][0];
        let example = if name == "ended" {
            json!({"event": "ended", "receipt": receipt})
        } else {
            part["examples"][0].clone()
        };
        check(&document, &json!({"$ref": "#/components/schemas/Event"}), &example).unwrap();
        let event: Event = serde_json::from_value(example).unwrap();
        assert_eq!(event.name(), name);
        names.insert(name);
    }
    assert!(names.len() > 20, "{names:?}");
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

fn the_daemon_and_the_document_have_the_same_routes(daemon: &Daemon) {
    let document = openapi::document();
    let (status, served) = call(daemon, "GET", "/v1/openapi.json", "");
    assert!(status == 200 && served == document);
    for path in document["paths"].as_object().unwrap().keys().filter(|path| *path != "/v1/events") {
        let at = path.replace("{id}", "99").replace("{name}", "none");
        for method in ["GET", "POST", "PUT", "DELETE", "PATCH"] {
            let (status, answer) = call(daemon, method, &at, "not JSON");
            let described = &document["paths"][path][method.to_lowercase()];
            assert_eq!(status != 405, described.is_object(), "{method} {path}: {answer}");
            if described.is_object() && status >= 400 {
                check(&document, &json!({"$ref": "#/components/schemas/Problem"}), &answer)
                    .unwrap_or_else(|error| panic!("{method} {path}: {error}: {answer}"));
            }
        }
    }
    // Conversely, each line of the router must be a route of the table, which the document shows.
    let operations: usize =
        document["paths"].as_object().unwrap().values().map(|of| of.as_object().unwrap().len()).sum();
    assert_eq!(operations, Route::ALL.len());
    assert_eq!(call(daemon, "GET", "/v1/play/", "").0, 404);
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
    let refused = |answer| {
        let problem = serde_json::to_value(problem(answer)).unwrap();
        check(&document, &json!({"$ref": "#/components/schemas/Problem"}), &problem).unwrap();
    };
    // At first everything is refused, because the motors are disarmed.
    refused(client.post("/v1/play", &json!({"pattern": "edge-45"})));
    refused(client.post("/v1/calibrate", &json!({"repetitions": 0})));
    refused(client.get("/v1/calibration"));
    refused(client.post("/v1/home", &json!({})));
    refused(client.post("/v1/arm", &json!({})));
    refused(client.delete("/v1/patterns/edge-45"));
    for route in [Route::Status, Route::Heights, Route::Doctor, Route::Patterns, Route::Array] {
        fits(route, &client.get(route.path()).unwrap());
    }
    let list: PatternList = client.get("/v1/patterns").unwrap();
    for pattern in list.patterns {
        fits(Route::Pattern, &client.get(&format!("/v1/patterns/{}", pattern.name)).unwrap());
    }
    let mine = "format = 1\nname = \"mine\"\nduration_s = 1\n[[drive]]\nmotor = 3\nfrequency_hz = 300\namplitude_um = 80\nstart_s = 0.5\n";
    fits(Route::Import, &client.put("/v1/patterns/mine", mine.to_owned()).unwrap());
    refused(client.put("/v1/patterns/mine", mine.to_owned()));
    fits(Route::Import, &client.put("/v1/patterns/mine?replace=true", mine.to_owned()).unwrap());
    fits(Route::Remove, &client.delete("/v1/patterns/mine").unwrap());
    let mut events = client.events().unwrap();
    refused(client.post("/v1/renderings", &json!({"object": "none"})));
    let dot = json!({"object": "dot", "method": "field"});
    fits(Route::RenderingStart, &client.post("/v1/renderings", &dot).unwrap());
    next(&mut events, |next| {
        event(&next);
        matches!(next, Event::Rendering { state: RenderingState::Done, .. }).then_some(())
    });
    fits(Route::RenderingShow, &client.get("/v1/renderings/last").unwrap());
    fits(Route::RenderingCancel, &client.delete("/v1/renderings/1").unwrap());
    let preview = client.get_within(TIMEOUT, "/v1/patterns/rendering:1/preview?seconds=0.1");
    fits(Route::Preview, &preview.unwrap());
    let started: Value =
        client.post("/v1/sessions", &json!({"participant": "P07", "exclusive": true})).unwrap();
    fits(Route::SessionStart, &started);
    refused(client.post("/v1/home", &json!({})));
    refused(client.post("/v1/sessions", &json!({"participant": "P08"})));
    fits(Route::SessionShow, &client.get("/v1/sessions/running").unwrap());
    fits(Route::Status, &client.get("/v1/status").unwrap());
    client.set_token(started["token"].as_str().map(str::to_owned));
    fits(Route::Arm, &client.post("/v1/arm", &json!({"assume_rest": true})).unwrap());
    fits(Route::Play, &client.post("/v1/play", &json!({"pattern": "edge-45", "seconds": 0.3})).unwrap());
    fits(Route::Status, &client.get("/v1/status").unwrap());
    fits(Route::Receipt, &client.get("/v1/plays/last").unwrap());
    next(&mut events, |next| {
        event(&next);
        matches!(next, Event::Ended { .. }).then_some(())
    });
    fits(Route::Receipt, &client.get("/v1/plays/last").unwrap());
    fits(Route::PlayAnswer, &client.post("/v1/plays/1/answer", &json!({"response": "left"})).unwrap());
    let id = started["id"].as_str().unwrap();
    fits(Route::SessionPlays, &client.get(&format!("/v1/sessions/{id}/plays")).unwrap());
    fits(Route::SessionEnd, &client.post("/v1/sessions/running/end", &json!({})).unwrap());
    client.set_token(None);
    fits(Route::Sessions, &client.get("/v1/sessions").unwrap());
    let quick = json!({"motor": 3, "pulses": [70, 140], "repetitions": 1});
    fits(Route::Calibrate, &client.post("/v1/calibrate", &quick).unwrap());
    let problem = next(&mut events, |next| {
        event(&next);
        if let Event::Calibrated { problem, .. } = next { Some(problem) } else { None }
    });
    assert_eq!(problem, None);
    fits(Route::Calibration, &client.get("/v1/calibration").unwrap());
    for route in [Route::Edge, Route::Stop, Route::Disarm, Route::EStop, Route::Reset] {
        fits(route, &client.post(route.path(), &json!({})).unwrap());
    }
    the_daemon_and_the_document_have_the_same_routes(&daemon);
}
