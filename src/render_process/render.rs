//! The rendering of an object for a client: the pattern first, then how near it comes to the object on one finger.
//!
//! The daemon checks a [`Render`] with [`Render::check`] and sends it to the process, which carries it out. Files come with the request; only the process
//! reads them, because a small file may hold a large image.

use super::finger::{OF_PATTERN, afferents, finger, piece};
use crate::rendering::{
    AFTER_S, RenderingError, contact, judged_s, keys_or_name, levels, pattern, provenance,
};
use crate::store::{Stored, hash};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use meissner_api::{JudgedPattern, ObjectResponse, RenderMethod, Rendered};
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_input::message::{cut, quote};
use meissner_render::{Judge, Judged, Rival, TRACE_MM_S, response_of};
use meissner_skin::Finger;
use meissner_touch::{Contact, Object, respond};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::io;

/// The largest file of a pattern, bytes. Half a minute of 24 pins takes less.
const MAX_PATTERN: usize = 1 << 20;
/// The response covers so much of a touch at most, s.
const MAX_RESPONSE_S: f64 = 3.0;
/// The most spikes of the response under the object and under two patterns.
const MAX_SPIKES: usize = 150_000;

/// What to render.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Render {
    /// The keys of the object's file.
    pub object: Map<String, Value>,
    /// The files that it names, in base64.
    pub files: BTreeMap<String, String>,
    /// How heights are found.
    pub method: RenderMethod,
    /// The seed of the noise.
    pub seed: u64,
}

impl Render {
    /// Checks the object without reading its files; returns its name.
    ///
    /// # Errors
    /// What is wrong with the keys, or a file that is not there or no base64, in one line.
    pub fn check(&self) -> Result<String, String> {
        self.decoded()?;
        let mut needs_file = false;
        let mut open = |name: &str| {
            needs_file = self.files.contains_key(name);
            Err(if needs_file { io::Error::other("it is read later") } else { no_file(name) })
        };
        match Object::read_json(&self.text(), &mut open) {
            Ok(object) => Ok(object.name().to_owned()),
            // The name was checked before any file is asked for.
            Err(_) if needs_file => {
                Ok(self.object.get("name").and_then(Value::as_str).unwrap_or_default().to_owned())
            }
            Err(error) => Err(error.to_string()),
        }
    }

    fn text(&self) -> String {
        Value::from(self.object.clone()).to_string()
    }

    fn decoded(&self) -> Result<BTreeMap<&str, Vec<u8>>, String> {
        let decode = |(name, text): (&'_ String, &String)| match STANDARD.decode(text) {
            Ok(bytes) => Ok((name.clone(), bytes)),
            Err(error) => Err(format!("`files.{name}` is not base64: {error}")),
        };
        let decoded: Result<Vec<_>, _> = self.files.iter().map(decode).collect();
        Ok(self.files.keys().map(String::as_str).zip(decoded?.into_iter().map(|(_, bytes)| bytes)).collect())
    }

    fn object(&self) -> Result<Object, String> {
        let mut files = self.decoded()?;
        let mut open = |name: &str| files.remove(name).ok_or_else(|| no_file(name));
        Object::read_json(&self.text(), &mut open).map_err(|error| format!("the object is refused: {error}"))
    }

    /// Renders the object, calls `tell` with the file of the pattern, and judges it.
    pub(super) fn carry_out(&self, array: Array, tell: impl FnOnce(String)) -> Result<Rendered, String> {
        let object = self.object()?;
        let named = |error: RenderingError| format!("{}: {error}", object.name());
        let contact = contact(&object, &|_| ()).map_err(named)?;
        let found = self.pattern(array, &object, &contact).map_err(named)?;
        let stored = Stored::made(found);
        if stored.text.len() > MAX_PATTERN {
            let mib = MAX_PATTERN >> 20;
            return Err(format!("{}: its pattern has more than {mib} MiB: shorten the touch", object.name()));
        }
        let text = String::from_utf8_lossy(&stored.text).into_owned();
        tell(text.clone());
        let (judged, response) = self.judge(array, &object, &contact, &stored.pattern)?;
        Ok(Rendered {
            method: self.method,
            pattern: text,
            duration_s: stored.pattern.duration_s().unwrap_or(0.0),
            highest_um: stored.pattern.largest_um(),
            outline: object.lines_mm().unwrap_or_default(),
            object: self.object.clone().into(),
            judged,
            response,
            warnings: stored.run().listed_warnings(),
            sha256: stored.sha256,
        })
    }

    fn pattern(&self, array: Array, object: &Object, contact: &Contact) -> Result<Pattern, RenderingError> {
        let (levels, choice) = levels(array, object, contact, self.method, TRACE_MM_S)?;
        let pitch_mm = contact.grains().pitch_mm;
        // Keys that were read as JSON can be written as TOML.
        let keys = without_nulls(self.object.clone().into());
        let text = toml::to_string(&keys).unwrap_or_default();
        let made =
            provenance(keys_or_name(&text, object.name()), self.method, pitch_mm, None, choice.as_ref());
        pattern(&levels, array, object.name(), made.unwrap_or_default())
    }

    /// One finger feels the object, the found pattern, and those that it has to beat.
    fn judge(
        &self,
        array: Array,
        object: &Object,
        contact: &Contact,
        found: &Pattern,
    ) -> Result<(Vec<JudgedPattern>, ObjectResponse), String> {
        let (finger, touch) = (finger(), object.touch());
        let durations_s = found.duration_s();
        let seconds = match self.method {
            RenderMethod::Trace => durations_s.unwrap_or(0.0).max(touch.duration_s()) + AFTER_S,
            _ => judged_s(touch, durations_s.into_iter()),
        };
        let real_s = respond(contact, touch, finger.afferents(), Some(self.seed), &|_| ());
        let feel = |pattern: &Pattern| {
            response_of(&finger, pattern, seconds, self.seed.wrapping_add(OF_PATTERN))
                .map_err(|error| error.to_string())
        };
        let judge = Judge::new(&finger, &real_s, seconds);
        let name = serde_json::to_value(self.method).unwrap_or_default();
        let found_s = feel(found)?;
        let mut judged = vec![line(name.as_str().unwrap_or_default(), &judge.compare(&found_s))];
        // A trace needs no touch that could be rendered.
        let mut rival_s = |method: RenderMethod, name: &str| -> Result<Option<Vec<Vec<f64>>>, String> {
            if self.method == method {
                return Ok(Some(found_s.clone()));
            }
            let found = levels(array, object, contact, method, TRACE_MM_S).ok();
            let pattern = found.and_then(|(levels, _)| levels.pattern(array, name, toml::Table::new()).ok());
            let felt_s = pattern.map(|pattern| feel(&pattern)).transpose()?;
            judged.extend(felt_s.as_ref().map(|felt_s| line(name, &judge.compare(felt_s))));
            Ok(felt_s)
        };
        let rule_s = rival_s(RenderMethod::Rule, "rule")?.unwrap_or_else(|| vec![Vec::new(); found_s.len()]);
        if !touch.stays_in_place() {
            rival_s(RenderMethod::Stroke, "stroke")?;
        }
        let vibration = Rival::WithinReach.pattern(array, contact, touch);
        if let Ok(vibration) = vibration {
            judged.push(line("vibrate-60", &judge.compare(&feel(&vibration)?)));
        }
        Ok((judged, response(&finger, seconds, [&real_s, &found_s, &rule_s])))
    }
}

/// The SHA-256 of each of an object's files, as far as they are base64: what the session record keeps of them.
pub fn file_hashes(files: &BTreeMap<String, String>) -> Map<String, Value> {
    let of = |text: &String| STANDARD.decode(text).map_or(Value::Null, |bytes| hash(&bytes).into());
    files.iter().map(|(name, text)| (name.clone(), of(text))).collect()
}

fn no_file(name: &str) -> io::Error {
    io::Error::other(format!("`files` has no {}: add it in base64", quote(&cut(name, 100))))
}

/// Keys without those that are null, which count as absent.
fn without_nulls(value: Value) -> Value {
    match value {
        Value::Object(keys) => {
            let kept = keys.into_iter().filter(|(_, value)| !value.is_null());
            Value::Object(kept.map(|(key, value)| (key, without_nulls(value))).collect())
        }
        value => value,
    }
}

fn line(name: &str, judged: &Judged) -> JudgedPattern {
    let known = |number: f64| Some(number).filter(|number| number.is_finite());
    JudgedPattern {
        name: name.to_owned(),
        r: known(judged.r),
        error: known(judged.error),
        r_by_class: judged.r_by_class.map(known),
        error_by_class: judged.error_by_class.map(known),
        spikes: judged.spikes.map(known),
    }
}

/// The spikes under the object, the found pattern and the rule, within the bounds.
fn response(finger: &Finger, seconds: f64, spikes_s: [&Vec<Vec<f64>>; 3]) -> ObjectResponse {
    let within = |until_s: f64| {
        let all = spikes_s.iter().flat_map(|trains| trains.iter().flatten());
        all.filter(|at_s| **at_s < until_s).count()
    };
    let mut seconds = seconds.min(MAX_RESPONSE_S);
    while within(seconds) > MAX_SPIKES {
        seconds /= 2.0;
    }
    let [real_s, found_s, rule_s] = spikes_s.map(|trains| piece(trains, 0.0, seconds));
    let (places_mm, class) = afferents(finger);
    ObjectResponse { seconds, places_mm, class, real_s, found_s, rule_s }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn render(object: &Value) -> Render {
        let object = object.as_object().unwrap().clone();
        let files = [("map.png", "AAEC"), ("bad.png", "A*")];
        let files = files.map(|(name, text)| (name.to_owned(), text.to_owned())).into();
        Render { object, files, method: RenderMethod::Auto, seed: 0 }
    }

    #[test]
    fn an_object_is_checked_as_far_as_it_needs_no_file() {
        let map = |file: &str| {
            json!({
                "kind": "object", "name": "map", "shape": "heightmap", "file": file, "mm_per_pixel": 0.1,
                "um_per_level": 1, "touch": {"press": {"depth_um": 500}}
            })
        };
        let mut good = render(&map("map.png"));
        assert_eq!(
            good.check(),
            Err("`files.bad.png` is not base64: Invalid symbol 42, offset 1.".to_owned())
        );
        good.files.remove("bad.png");
        assert_eq!(good.check(), Ok("map".to_owned()));
        // The process reads the file.
        let error = good.carry_out(Array::paper(), |_| unreachable!()).unwrap_err();
        assert!(error.starts_with("the object is refused: `file` is not a PNG file: "), "{error}");
        let other = Render { object: map("other.png").as_object().unwrap().clone(), ..good };
        let error = other.check().unwrap_err();
        assert_eq!(error, "`file` is not readable: `files` has no `other.png`: add it in base64");
    }
}
