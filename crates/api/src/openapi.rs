//! The OpenAPI document, made from the route table and from the types' schemas.
//!
//! The daemon serves [`document`] at `GET /v1/openapi.json`; the book holds a page made from it. Descriptions are
//! the types' doc comments, so those give units and meaning; examples stand beside the types.

use crate::answer::{AnswerTaken, PlayAnswer};
use crate::array::ArrayDetails;
use crate::order::{Item, LIVE_TERMS};
use crate::problem::{Code, Problem};
use crate::route::{Answer, Body, Method, Operation, Query, Route};
use crate::{
    ArmRequest, CalibrateRequest, CalibrationReport, DisarmRequest, DoctorReport, EdgeRequest, Event,
    ImportedPattern, LiveAccepted, LiveAnswer, LiveMessage, LiveRequest, Order, PatternDetails, PatternList,
    PatternPreview, PinHeights, PlanCheck, PlayAccepted, Receipt, RemovedPattern, Rendering,
    RenderingRequest, ResetRequest, Session, SessionList, SessionPlays, SessionRequest, SessionStarted,
    Status, Terms, TokenCreated, TokenInfo, TokenList, TokenRequest,
};
use meissner_input::document::keys_of;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use utoipa::OpenApi;

/// The schemas; those that they refer to come along.
#[derive(OpenApi)]
#[openapi(components(schemas(
    AnswerTaken,
    ArrayDetails,
    ArmRequest,
    DisarmRequest,
    ResetRequest,
    CalibrateRequest,
    CalibrationReport,
    DoctorReport,
    EdgeRequest,
    Event,
    ImportedPattern,
    LiveAccepted,
    LiveAnswer,
    LiveMessage,
    LiveRequest,
    PatternDetails,
    PatternList,
    PatternPreview,
    PinHeights,
    PlanCheck,
    PlayAccepted,
    PlayAnswer,
    Order,
    Terms,
    Problem,
    Receipt,
    RemovedPattern,
    Rendering,
    RenderingRequest,
    Session,
    SessionList,
    SessionPlays,
    SessionRequest,
    SessionStarted,
    Status,
    TokenCreated,
    TokenInfo,
    TokenList,
    TokenRequest,
)))]
struct Schemas;

/// A pattern file, as the example of a body.
const PATTERN: &str = "format = 1\nname = \"two-pins\"\nduration_s = 1.0\n\n[[drive]]\nmotor = 9\nfrequency_hz = 60.0\n\
                       amplitude_um = 40.0\nstop_s = 0.5\n";

/// A calibration file.
const CALIBRATION: &str = "format = 1\n\n[[motor]]\nmotor = 3\nup = { gain = 1.05, slope_um_per_pulse = 0.1425, \
                           slope_se_um_per_pulse = 0.0015, offset_um = 0.02, relative_sd = 0.1, blocks = 36 }\n\
                           down = { gain = 0.98, slope_um_per_pulse = 0.133, slope_se_um_per_pulse = 0.0015, \
                           offset_um = -0.01, relative_sd = 0.1, blocks = 36 }\n\n[provenance]\ndevice = \"serial\"\n\
                           firmware = \"0.1.0\"\nidentity = \"E6614C311B4A2F2C\"\ntelemetry = \"laser\"\n\
                           pulses = [7, 70]\nrepetitions = 1\ngroups = 2\num_per_pulse = 0.1357142857142857\n";

const ABOUT: &str = "HTTP/1.1 over the daemon's Unix socket: `$MEISSNER_SOCKET`, else `$XDG_RUNTIME_DIR/meissner.sock`, else \
                     `/run/meissner/meissner.sock`. At most 64 clients are connected at the same time; the daemon closes a connection \
                     that sends nothing for 10 minutes, or earlier if another client needs its place. Who may use the socket may use the whole API. \
                     With `listen` in the configuration the daemon serves the API over TCP, too; a request from another machine then \
                     needs an access token (`unauthorized`, `forbidden`). The body of a command has at \
                     most 16 KiB. A key that is null counts as absent, but a number may not be null; an unknown key is an error. Every error, also of an unknown \
                     address (`not-found`) or method (`method-not-allowed`), is `application/problem+json` with a stable `code`. \
                     Times: `_s` is seconds, `_ms` milliseconds, ticks are those of the device's clock: `GET /v1/array` has their number \
                     per second (`tick_hz`), the motors' numbers, where their pins stand, and their largest amplitude.";

/// The document.
pub fn document() -> Value {
    // Schemas are plain data: they can always be written.
    let mut schemas = serde_json::to_value(Schemas::openapi().components).unwrap_or_default();
    schemas["schemas"]["Problem"]["properties"]["code"]["enum"] =
        Code::ALL.iter().map(|code| code.parts().0).collect::<Vec<_>>().into();
    // Their keys stand beside those of another object.
    let [item, terms] = ["Item", "Terms"].map(|name| schemas["schemas"][name]["properties"].clone());
    for (into, from, keys) in [
        ("Order", &item, keys_of::<Item>()),
        ("Order", &terms, keys_of::<Terms>()),
        ("PlayOrder", &terms, keys_of::<Terms>()),
        ("LiveRequest", &terms, &LIVE_TERMS[..]),
    ] {
        for key in keys {
            schemas["schemas"][into]["properties"][*key] = from[*key].clone();
        }
    }
    let always = json!(["items", "late", "replace", "open_loop"]);
    for (name, required) in [("Order", json!([])), ("LiveRequest", json!([])), ("PlayOrder", always)] {
        schemas["schemas"][name]["required"] = required;
        schemas["schemas"][name]["additionalProperties"] = false.into();
    }
    for (name, schema) in schemas["schemas"].as_object_mut().into_iter().flatten() {
        // An answer to a message has one of its keys.
        if name != "LiveAnswer" {
            complete(schema);
        }
        refuse_null(schema);
    }
    let example = |schema: &str| schemas["schemas"][schema]["examples"][0].clone();
    let mut paths: BTreeMap<&str, Map<String, Value>> = BTreeMap::new();
    for route in Route::ALL {
        let operation = route.operation();
        paths
            .entry(operation.path)
            .or_default()
            .insert(method_name(operation.method).to_owned(), described(route, &operation, &example));
    }
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "meissner",
            "description": ABOUT,
            "version": env!("CARGO_PKG_VERSION"),
            "license": {"name": "MIT OR Apache-2.0", "identifier": "MIT OR Apache-2.0"}
        },
        "servers": [{"url": "http://localhost", "description": "over the daemon's Unix socket"}],
        "paths": paths,
        "components": schemas
    })
}

/// A number that may be left out is not null: see [`meissner_input::document::given`].
fn refuse_null(schema: &mut Value) {
    let required = schema["required"].as_array().cloned().unwrap_or_default();
    // `schema["properties"]` would write a null into a schema that has none.
    for (key, property) in schema.get_mut("properties").and_then(Value::as_object_mut).into_iter().flatten() {
        let kinds = property["type"].as_array().cloned().unwrap_or_default();
        let is_number = kinds.iter().any(|kind| kind == "number" || kind == "integer");
        if is_number && !required.iter().any(|name| name == key) {
            property["type"] = kinds[0].clone();
        }
    }
}

/// Offsets and differences may be below 0, and so may a reached lead; other numbers may not.
const SIGNED: [&str; 7] =
    ["level", "rt_ms", "lead_ms", "onset_um", "offset_um", "rest_error_um", "travel_um"];

/// The daemon writes every key of its answers, without a value as null; only `mine` of a session is in the status alone. The types of requests
/// refuse unknown keys.
fn complete(schema: &mut Value) {
    for parts in ["oneOf", "allOf"] {
        schema.get_mut(parts).and_then(Value::as_array_mut).into_iter().flatten().for_each(complete);
    }
    let is_answer = schema.get("additionalProperties") != Some(&Value::Bool(false));
    let Some(properties) = schema.get_mut("properties").and_then(Value::as_object_mut) else { return };
    for (_, property) in properties.iter_mut().filter(|(key, _)| !SIGNED.contains(&key.as_str())) {
        let kinds = property.get("type").map(Value::to_string).unwrap_or_default();
        if (kinds.contains("number") || kinds.contains("integer")) && property.get("minimum").is_none() {
            property["minimum"] = 0.into();
        }
    }
    if is_answer {
        let required: Vec<_> = properties.keys().filter(|key| *key != "mine").cloned().collect();
        schema["required"] = required.into();
    }
}

/// A method as OpenAPI writes it.
pub const fn method_name(method: Method) -> &'static str {
    match method {
        Method::Get => "get",
        Method::Post => "post",
        Method::Put => "put",
        Method::Delete => "delete",
    }
}

fn reference(schema: &str) -> Value {
    json!({"$ref": format!("#/components/schemas/{schema}")})
}

fn described(route: Route, operation: &Operation, example: &dyn Fn(&str) -> Value) -> Value {
    let json_of =
        |schema| json!({"application/json": {"schema": reference(schema), "example": example(schema)}});
    let mut out = json!({
        "operationId": format!("{route:?}"),
        "summary": operation.summary,
        "description": operation.description,
    });
    let name = operation.path.split_once('{').and_then(|(_, rest)| rest.split_once('}'));
    if let (Some(text), Some((name, _))) = (operation.parameter, name) {
        out["parameters"] = json!([
            {"name": name, "in": "path", "required": true, "description": text, "schema": {"type": "string"}}
        ]);
    }
    for &query in operation.queries {
        let (name, text, schema) = match query {
            Query::Number { name, most, about } => {
                (name, about, json!({"type": "number", "minimum": 0, "maximum": most}))
            }
            Query::Sha256 { name, about } => {
                (name, about, json!({"type": "string", "pattern": "^[0-9a-f]{64}$"}))
            }
            Query::Flag { name, about } => (name, about, json!({"type": "boolean", "default": false})),
        };
        let parameter =
            json!({"name": name, "in": "query", "required": false, "description": text, "schema": schema});
        match out["parameters"].as_array_mut() {
            Some(parameters) => parameters.push(parameter),
            None => out["parameters"] = json!([parameter]),
        }
    }
    let body = match operation.body {
        Body::None => None,
        Body::Empty => Some((
            json!({"application/json": {"schema": {"type": "object", "additionalProperties": false}, "example": {}}}),
            false,
        )),
        Body::Json(schema) => Some((json_of(schema), true)),
        Body::OptionalJson(schema) => Some((json_of(schema), false)),
        Body::Toml => {
            Some((json!({"application/toml": {"schema": {"type": "string"}, "example": PATTERN}}), true))
        }
        Body::Calibration => {
            Some((json!({"application/toml": {"schema": {"type": "string"}, "example": CALIBRATION}}), true))
        }
    };
    if let Some((content, required)) = body {
        out["requestBody"] = json!({"content": content, "required": required});
    }
    let content = match operation.answer {
        Answer::Json(schema) => json_of(schema),
        Answer::Events => json!({"text/event-stream": {"schema": reference("Event"), "example": EVENT}}),
        Answer::Text(media, example) => json!({media: {"schema": {"type": "string"}, "example": example}}),
        Answer::OpenApi => json!({
            "application/json": {"schema": {"type": "object"}, "example": {"openapi": "3.1.0"}}
        }),
    };
    let mut responses = Map::new();
    for (status, meaning) in operation.statuses {
        responses.insert(status.to_string(), json!({"description": meaning, "content": content}));
    }
    // Any route may answer with a problem; `Problem` lists the codes.
    let problem = json!({"application/problem+json": {"schema": reference("Problem")}});
    responses.insert("default".to_owned(), json!({"description": "A problem", "content": problem}));
    out["responses"] = responses.into();
    out
}

/// One event as it is sent.
const EVENT: &str =
    "event: queued\ndata: {\"event\":\"queued\",\"id\":7,\"pattern\":\"edge-45\",\"seconds\":2.0}\n\n";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        ArmRequest, CalibrateRequest, DisarmRequest, LiveMessage, LiveRequest, Order, PlayAnswer,
        RenderingRequest, ResetRequest, SessionRequest, TokenRequest,
    };
    use std::collections::BTreeSet;

    /// Each number that a request may leave out, of every type of request, is null in turn. Left out it would mean full, endless or all.
    #[test]
    fn a_number_that_is_null_is_refused() {
        type Read = fn(&[u8]) -> Option<String>;
        macro_rules! read {
            ($type:ty) => {
                (|body| <$type>::parse(body).err().map(|problem| problem.detail)) as Read
            };
        }
        let play: (Value, Read) = (json!({"pattern": "a", "trigger": {}}), read!(Order));
        let sequence: (Value, Read) = (json!({"items": [{"pattern": "a"}]}), read!(Order));
        let live: (Value, Read) = (json!({}), read!(LiveRequest));
        let drive =
            json!({"seq": 1, "pose": {}, "drives": [{"motor": 1, "frequency_hz": 60, "amplitude_um": 80}]});
        let message: (Value, Read) = (drive, read!(LiveMessage));
        let schemas = document()["components"]["schemas"].clone();
        let cases = [
            ("Order", "", &play),
            ("Order/properties/trigger", "/trigger", &play),
            ("Item", "/items/0", &sequence),
            ("LiveRequest", "", &live),
            ("LiveMessage", "", &message),
            ("LivePose", "/pose", &message),
            ("LiveDrive", "/drives/0", &message),
            ("ArmRequest", "", &(json!({}), read!(ArmRequest))),
            ("ResetRequest", "", &(json!({}), read!(ResetRequest))),
            ("DisarmRequest", "", &(json!({}), read!(DisarmRequest))),
            ("EdgeRequest", "", &(json!({}), read!(EdgeRequest))),
            ("CalibrateRequest", "", &(json!({}), read!(CalibrateRequest))),
            ("RenderingRequest", "", &(json!({"object": "dot"}), read!(RenderingRequest))),
            ("SessionRequest", "", &(json!({"participant": "P07"}), read!(SessionRequest))),
            ("PlayAnswer", "", &(json!({"response": "left"}), read!(PlayAnswer))),
            ("TokenRequest", "", &(json!({"role": "observe", "name": "a"}), read!(TokenRequest))),
        ];
        let mut refused = BTreeSet::new();
        for (name, place, (body, read)) in cases {
            assert_eq!(read(body.to_string().as_bytes()), None, "{name}");
            let schema = schemas.pointer(&format!("/{name}")).unwrap();
            for (key, property) in schema["properties"].as_object().unwrap() {
                let kind = property["type"].as_str().unwrap_or_default();
                let is_pulses = property["items"]["type"] == "integer";
                let mut body = body.clone();
                let object = body.pointer_mut(place).unwrap().as_object_mut().unwrap();
                if !(["number", "integer"].contains(&kind) || is_pulses) || object.contains_key(key) {
                    continue;
                }
                object.insert(key.clone(), Value::Null);
                let detail = read(body.to_string().as_bytes()).unwrap_or_else(|| panic!("{body} is taken"));
                assert!(detail.contains(&format!("{key}` is null: must be a ")), "{detail}");
                assert!(!detail.contains('\n'), "{detail}");
                refused.insert(format!("{name}.{key}"));
            }
        }
        for key in ["Order.scale", "Item.seconds", "LiveRequest.scale", "CalibrateRequest.motor"] {
            assert!(refused.contains(key), "{refused:?}");
        }
        let named: BTreeSet<&str> = cases.iter().map(|(name, ..)| *name).collect();
        for route in Route::ALL {
            if let Body::Json(schema) | Body::OptionalJson(schema) = route.operation().body {
                assert!(named.contains(schema), "{schema} is not tried");
            }
        }
    }
}
