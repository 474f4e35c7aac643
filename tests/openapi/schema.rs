//! Checks a JSON value against a schema of the OpenAPI document: the keywords that the document uses, and nothing else.
//!
//! It is stricter than JSON Schema in one point: a key that no schema names is an error, so that an answer cannot hold undocumented
//! keys.

use serde_json::{Map, Value};
use std::collections::BTreeSet;

/// Checks a value.
///
/// # Errors
/// The first thing that is wrong, and where.
pub(super) fn check(document: &Value, schema: &Value, value: &Value) -> Result<(), String> {
    let mut known = BTreeSet::new();
    part(document, schema, value, &mut known)?;
    let free = resolve(document, schema) == &serde_json::json!({"type": "object"})
        || schema == &serde_json::json!({});
    match value.as_object().and_then(|keys| keys.keys().find(|key| !known.contains(key.as_str()))) {
        Some(key) if !free => Err(format!("`{key}` is in no schema")),
        _ => Ok(()),
    }
}

fn resolve<'d>(document: &'d Value, schema: &'d Value) -> &'d Value {
    match schema["$ref"].as_str() {
        Some(reference) => document.pointer(reference.trim_start_matches('#')).unwrap_or(&Value::Null),
        None => schema,
    }
}

/// Checks a value against one of possibly several schemas; collects the keys that this one names.
fn part<'d>(
    document: &'d Value,
    schema: &'d Value,
    value: &'d Value,
    known: &mut BTreeSet<&'d str>,
) -> Result<(), String> {
    let schema = resolve(document, schema);
    let keywords = schema.as_object().ok_or("a reference that leads nowhere")?;
    if let Some(all) = schema["allOf"].as_array() {
        all.iter().try_for_each(|schema| part(document, schema, value, known))?;
    }
    if let Some(one) = schema["oneOf"].as_array() {
        let fits = |schema: &&Value| check(document, schema, value);
        let fitting: Vec<_> = one.iter().filter(|schema| fits(schema).is_ok()).collect();
        let [fitting] = fitting[..] else {
            let errors: Vec<_> = one.iter().filter_map(|schema| fits(&schema).err()).collect();
            return Err(format!("{} of the choices fit: {}", fitting.len(), errors.join("; ")));
        };
        part(document, fitting, value, known)?;
    }
    if let Some(values) = schema["enum"].as_array().filter(|values| !values.contains(value)) {
        return Err(format!("{value} is none of {values:?}"));
    }
    let types: Vec<&str> = match &schema["type"] {
        Value::String(one) => vec![one],
        Value::Array(several) => several.iter().filter_map(Value::as_str).collect(),
        _ => Vec::new(),
    };
    let is = |kind: &&str| match *kind {
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        "string" => value.is_string(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        "number" => value.is_number(),
        "integer" => value.is_u64() || value.is_i64(),
        _ => false,
    };
    if !types.is_empty() && !types.iter().any(is) {
        return Err(format!("{value} is not {types:?}"));
    }
    if let Some(number) = value.as_f64() {
        let bound = |key: &str| schema[key].as_f64();
        let good = bound("minimum").is_none_or(|least| number >= least)
            && bound("maximum").is_none_or(|most| number <= most)
            && bound("exclusiveMaximum").is_none_or(|most| number < most);
        if !good {
            return Err(format!("{number} is out of range"));
        }
    }
    if let Some(items) = value.as_array() {
        let most = schema["maxItems"].as_u64().unwrap_or(u64::MAX);
        if items.len() as u64 > most {
            return Err(format!("more than {most} items"));
        }
        items.iter().try_for_each(|item| check(document, &schema["items"], item))?;
    }
    value.as_object().map_or(Ok(()), |keys| object(document, keywords, keys, known))
}

fn object<'d>(
    document: &'d Value,
    keywords: &'d Map<String, Value>,
    keys: &'d Map<String, Value>,
    known: &mut BTreeSet<&'d str>,
) -> Result<(), String> {
    for required in keywords.get("required").and_then(Value::as_array).into_iter().flatten() {
        let required = required.as_str().unwrap_or_default();
        if !keys.contains_key(required) {
            return Err(format!("`{required}` is missing"));
        }
    }
    if keywords.get("additionalProperties").is_some_and(Value::is_object) {
        known.extend(keys.keys().map(String::as_str));
    }
    for (key, schema) in keywords.get("properties").and_then(Value::as_object).into_iter().flatten() {
        known.insert(key);
        if let Some(value) = keys.get(key) {
            check(document, schema, value).map_err(|error| format!("{key}: {error}"))?;
        }
    }
    Ok(())
}
