//! Makes the book's page `docs/reference/api.md` from the OpenAPI document.

use meissner_api::openapi::method_name;
use meissner_api::{Code, Route};
use serde_json::Value;
use std::fmt::Write;

/// Writes a line to the page.
macro_rules! put {
    ($($line:tt)*) => { writeln!($($line)*).unwrap() };
}

/// The page.
pub(super) fn page(document: &Value) -> String {
    let mut out = String::new();
    put!(
        out,
        "# API\n\n<!-- Made by `MEISSNER_RENEW=1 cargo test --test tests openapi` from the types in crates/api. -->\n"
    );
    put!(out, "{}\n", text(&document["info"]["description"]));
    put!(out, "The daemon serves the OpenAPI document of this page at `GET /v1/openapi.json`.\n");
    put!(
        out,
        "```bash\ncurl --unix-socket \"$XDG_RUNTIME_DIR/meissner.sock\" http://localhost/v1/status\n```\n"
    );
    put!(out, "## Routes\n\n| route | |\n|---|---|");
    for route in Route::ALL {
        let operation = route.operation();
        let method = method_name(operation.method).to_uppercase();
        let anchor = format!("{method} {}", operation.path).to_lowercase();
        let anchor: String = anchor
            .chars()
            .filter_map(|c| match c {
                ' ' => Some('-'),
                c if c.is_alphanumeric() || c == '_' => Some(c),
                _ => None,
            })
            .collect();
        put!(out, "| [`{method} {}`](#{anchor}) | {} |", operation.path, operation.summary);
    }
    for route in Route::ALL {
        operation(&mut out, document, route);
    }
    events(&mut out, document);
    errors(&mut out);
    put!(out, "\n## Types");
    let schemas = document["components"]["schemas"].as_object().unwrap();
    for (name, schema) in schemas.iter().filter(|(name, _)| *name != "Event") {
        put!(out, "\n### {name}\n\n{}", text(&schema["description"]));
        table(&mut out, document, schema);
    }
    out
}

fn text(value: &Value) -> String {
    value.as_str().unwrap_or_default().replace('\n', " ")
}

fn operation(out: &mut String, document: &Value, route: Route) {
    let operation = route.operation();
    let method = method_name(operation.method);
    let described = &document["paths"][operation.path][method];
    put!(out, "\n### {} {}\n", method.to_uppercase(), operation.path);
    put!(out, "{}. {}", operation.summary, operation.description);
    for parameter in described["parameters"].as_array().into_iter().flatten() {
        let (name, about) = (text(&parameter["name"]), text(&parameter["description"]));
        match parameter["in"].as_str() {
            Some("query") if parameter["schema"]["type"] == "boolean" => {
                put!(out, "\n`?{name}=true`: {about}.");
            }
            Some("query") if parameter["schema"]["type"] == "string" => {
                put!(out, "\n`?{name}=`, 64 of 0-9 and a-f: {about}.");
            }
            Some("query") => put!(
                out,
                "\n`?{name}=`, {} to {}: {about}.",
                parameter["schema"]["minimum"],
                parameter["schema"]["maximum"]
            ),
            _ => put!(out, "\n`{{{name}}}`: {about}."),
        }
    }
    if let Some(body) = described["requestBody"].as_object() {
        let optional = if body["required"] == true { "" } else { ", may be empty" };
        content(out, route, &format!("Body{optional}"), &body["content"]);
    }
    let responses = described["responses"].as_object().unwrap();
    let mut statuses: Vec<String> = Vec::new();
    for (status, meaning) in operation.statuses {
        statuses.push(format!("`{status}` ({})", meaning.to_lowercase()));
    }
    let success = &responses[&operation.statuses[0].0.to_string()];
    content(out, route, &format!("Answer {}", statuses.join(" or ")), &success["content"]);
    let is_error = |status: &str| status.starts_with(['4', '5']);
    let errors: Vec<String> = responses
        .iter()
        .filter(|(status, _)| is_error(status))
        .map(|(status, answer)| format!("{status}: {}", text(&answer["description"])))
        .collect();
    put!(out, "\nErrors: {}.", errors.join("; "));
}

/// A body or an answer: its media type, its type and an example. Most commands answer with the status, which is shown once.
fn content(out: &mut String, route: Route, title: &str, content: &Value) {
    for (media, content) in content.as_object().unwrap() {
        let kind =
            content["schema"]["$ref"].as_str().map_or_else(String::new, |way| format!(", {}", link(way)));
        if kind.contains("#status)") && route != Route::Status {
            put!(out, "\n{title}: `{media}`{kind}, as of [`GET /v1/status`](#get-v1status)");
            continue;
        }
        put!(out, "\n{title}: `{media}`{kind}\n");
        match &content["example"] {
            Value::String(example) => put!(out, "```text\n{}\n```", example.trim_end()),
            example => put!(out, "```json\n{example:#}\n```"),
        }
    }
}

fn link(reference: &str) -> String {
    let name = reference.rsplit('/').next().unwrap();
    let anchor = if name == "Event" { "events".to_owned() } else { name.to_lowercase() };
    format!("[{name}](#{anchor})")
}

/// The name of a variant of the events, and an example.
pub(super) fn event(document: &Value, variant: &Value) -> (String, Value) {
    let parts = variant["allOf"].as_array().map_or_else(|| vec![variant], |parts| parts.iter().collect());
    let part = parts.iter().find(|part| part["properties"]["event"].is_object()).unwrap();
    let name = part["properties"]["event"]["enum"][0].as_str().unwrap().to_owned();
    let example = if name == "ended" {
        let receipt = &document["components"]["schemas"]["Receipt"]["examples"][0];
        serde_json::json!({"event": "ended", "receipt": receipt})
    } else {
        part["examples"][0].clone()
    };
    (name, example)
}

fn events(out: &mut String, document: &Value) {
    let schema = &document["components"]["schemas"]["Event"];
    put!(out, "\n## Events\n\n`GET /v1/events` sends these. The key `event` names the kind.");
    for variant in schema["oneOf"].as_array().unwrap() {
        let (name, example) = event(document, variant);
        put!(out, "\n### {name}\n\n{}", text(&variant["description"]));
        table(out, document, variant);
        if name != "ended" {
            put!(out, "\n```json\n{example}\n```");
        }
    }
}

fn errors(out: &mut String) {
    put!(
        out,
        "\n## Errors\n\nEvery error is a [Problem](#problem). Its `type` is `urn:meissner:problem:CODE`.\n"
    );
    put!(out, "| code | status | meaning | routes |\n|---|---|---|---|");
    for &code in Code::ALL {
        let (name, status, title) = code.parts();
        let gives = |route: &&Route| route.operation().errors().any(|given| given == code);
        let routes: Vec<_> = Route::ALL.iter().filter(gives).collect();
        let routes = match routes.len() {
            0 => "any address".to_owned(),
            many if many == Route::ALL.len() => "every route".to_owned(),
            many if many + 1 == Route::ALL.len() => "every route but `/v1/estop`".to_owned(),
            _ => {
                let name = |route: &&Route| {
                    let operation = route.operation();
                    format!("`{} {}`", method_name(operation.method).to_uppercase(), operation.path)
                };
                routes.iter().map(name).collect::<Vec<_>>().join(", ")
            }
        };
        put!(out, "| `{name}` | {status} | {title} | {routes} |");
    }
}

/// The keys of a schema, with those of the schemas it takes in.
fn table(out: &mut String, document: &Value, schema: &Value) {
    let mut rows = String::new();
    keys(&mut rows, document, schema);
    if !rows.is_empty() {
        write!(out, "\n| key | type | range | |\n|---|---|---|---|\n{rows}").unwrap();
    }
}

fn keys(rows: &mut String, document: &Value, schema: &Value) {
    for part in schema["allOf"].as_array().into_iter().flatten() {
        let way = part["$ref"].as_str().map(|way| way.trim_start_matches('#'));
        keys(rows, document, way.map_or(part, |way| document.pointer(way).unwrap()));
    }
    let required = schema["required"].as_array();
    for (key, value) in
        schema["properties"].as_object().into_iter().flatten().filter(|(key, _)| *key != "event")
    {
        let (inner, null) = match value["oneOf"].as_array() {
            Some(choices) => (&choices[0], " or null"),
            None => (value, ""),
        };
        let optional = required.is_none_or(|names| !names.contains(&key.as_str().into()));
        let optional = if optional { ", optional" } else { "" };
        let range = if inner["items"].is_object() && inner["maxItems"].is_null() {
            range(&inner["items"])
        } else {
            range(inner)
        };
        let meaning = text(&inner["description"]).replace('|', "\\|");
        put!(rows, "| `{key}` | {}{null}{optional} | {range} | {meaning} |", kind(inner));
    }
}

fn kind(schema: &Value) -> String {
    if let Some(way) = schema["$ref"].as_str() {
        return link(way);
    }
    let types: Vec<_> = match &schema["type"] {
        Value::Array(several) => several.iter().filter_map(Value::as_str).collect(),
        one => one.as_str().into_iter().collect(),
    };
    types
        .into_iter()
        .map(
            |name| {
                if name == "array" { format!("list of {}", kind(&schema["items"])) } else { name.to_owned() }
            },
        )
        .collect::<Vec<_>>()
        .join(" or ")
}

fn range(schema: &Value) -> String {
    let number = |key: &str| schema[key].as_f64();
    if let Some(values) = schema["enum"].as_array().filter(|values| values.len() < 10) {
        return values.iter().map(|value| format!("`{}`", text(value))).collect::<Vec<_>>().join(", ");
    }
    match (number("minimum"), number("maximum"), number("exclusiveMaximum")) {
        (Some(least), Some(most), _) => format!("{least} to {most}"),
        (Some(least), None, Some(below)) => format!("{least} to below {below}"),
        (Some(least), None, None) => format!("{least} or more"),
        _ => match (schema["minItems"].as_u64(), schema["maxItems"].as_u64()) {
            (Some(least), Some(most)) => format!("{least} to {most} items"),
            (None, Some(most)) => format!("at most {most} items"),
            _ => String::new(),
        },
    }
}
