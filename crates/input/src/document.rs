//! Files of keys and values, read with serde, and what is wrong with one said in our words.
//!
//! Serde says the way to what is wrong; its messages are put into ours here, and a key that is not known is answered
//! with the nearest that is. What a kind of file holds, and which values are good, its own reader knows: it passes
//! what to add where a key is missing, and may have mistakes of its own ([`Fault`] carries either to its place).
//!
//! Invariant: what [`Mistake`] and [`Place`] display holds no line break.

use crate::message::{figure, nearest, one_line, quote};
use serde::de::value::MapAccessDeserializer;
use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use serde_path_to_error::{Path, Segment};
use std::borrow::Cow;
use std::fmt;
use std::marker::PhantomData;
use toml::de::{DeTable, DeValue};

/// What to add where a key is missing.
pub type Wanted = fn(&str) -> &'static str;

/// A place in a file of keys, or in what was built without one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// The file as the caller named it, if there is one.
    pub file: Option<String>,
    /// The line, from 1, if it is known.
    pub line: Option<usize>,
    /// The way to the key as `drives[3].frequency_hz`, lists counted from 0; empty if it is about the whole.
    pub path: String,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let joint = if self.file.is_some() && !self.path.is_empty() { ": " } else { "" };
        if let Some(file) = &self.file {
            write!(f, "{}", file.escape_debug())?;
        }
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if self.path.is_empty() { Ok(()) } else { write!(f, "{joint}`{}`", self.path) }
    }
}

impl Place {
    /// What stands between the place and what is wrong there: a problem with a value reads on from its key.
    pub fn joint(&self, problem: &dyn fmt::Display) -> &'static str {
        match () {
            () if *self == Self::default() => "",
            () if !self.path.is_empty() && reads_on(&problem.to_string()) => " ",
            () => ": ",
        }
    }
}

/// Whether a problem's text goes on after the name of its key.
fn reads_on(problem: &str) -> bool {
    problem.starts_with("is ") || problem.starts_with("holds ")
}

/// What can be wrong with any file of keys, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Mistake {
    #[error("not {language}: {message}")]
    Syntax { language: &'static str, message: String },
    #[error("unknown key {key}: did you mean `{nearest}`?")]
    UnknownKey { key: String, nearest: String },
    #[error("unknown key {key}: leave it out, no keys are known here")]
    NoKeys { key: String },
    #[error("is missing: add {wanted}")]
    Missing { wanted: &'static str },
    #[error("is there twice: leave one out")]
    Twice,
    /// A value that cannot be read as what the key wants.
    #[error("{message}")]
    Value { message: String },
    #[error("is {}: must be {range}", figure(*.found))]
    Range { found: f64, range: Cow<'static, str> },
}

/// What is wrong with a document: what can be wrong with any, or what its own reader found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Problem<P> {
    /// A mistake that any document can have.
    #[error(transparent)]
    Common(Mistake),
    /// A mistake that only this kind of document can have.
    #[error(transparent)]
    Own(P),
}

/// A document that was refused: what is wrong, and where.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{place}{}{problem}", .place.joint(.problem))]
pub struct Refused<P: std::error::Error + 'static> {
    /// Where it is wrong.
    pub place: Place,
    /// What is wrong.
    pub problem: Problem<P>,
}

/// A problem on its way to its place: the code that finds it knows the key, its callers what the key is part of, and the reader
/// the file.
#[derive(Debug)]
pub struct Fault<P> {
    /// The line, from 1, if it is known.
    pub line: Option<usize>,
    /// The path of keys, as in [`Place`].
    pub path: String,
    /// What is wrong.
    pub problem: Problem<P>,
}

impl<P> Fault<P> {
    /// About the whole document.
    pub const fn whole(line: Option<usize>, problem: P) -> Self {
        Self { line, path: String::new(), problem: Problem::Own(problem) }
    }

    /// About one key.
    pub fn key(key: &str, problem: P) -> Self {
        Self { line: None, path: key.to_owned(), problem: Problem::Own(problem) }
    }

    /// A mistake that any document can have.
    pub const fn common(line: Option<usize>, path: String, mistake: Mistake) -> Self {
        Self { line, path, problem: Problem::Common(mistake) }
    }

    /// The same, with the line of its key in a TOML text, or of what the key is part of.
    #[must_use]
    pub fn in_text(self, text: &str) -> Self {
        let mut path = self.path.as_str();
        let mut line = self.line;
        while line.is_none() && !path.is_empty() {
            line = line_of(text, path);
            path = path.rfind(['.', '[']).map_or("", |end| &path[..end]);
        }
        Self { line, ..self }
    }

    /// The key is part of `parent`.
    #[must_use]
    pub fn within(self, parent: &str) -> Self {
        Self { path: format!("{parent}.{}", self.path), ..self }
    }
}

impl<P: std::error::Error + 'static> Fault<P> {
    /// As an error about this file; without one it is about something built, and has no line.
    #[must_use]
    pub fn placed(self, file: Option<&str>) -> Refused<P> {
        let line = self.line.filter(|_| file.is_some());
        Refused {
            place: Place { file: file.map(str::to_owned), line, path: self.path },
            problem: self.problem,
        }
    }
}

/// Refuses a value that is not `good`.
///
/// # Errors
/// [`Mistake::Range`].
pub fn in_range<P>(
    key: &str,
    found: f64,
    good: bool,
    range: impl Into<Cow<'static, str>>,
) -> Result<(), Fault<P>> {
    let range = || Mistake::Range { found, range: range.into() };
    if good { Ok(()) } else { Err(Fault::common(None, key.to_owned(), range())) }
}

/// The line of what a path leads to in a TOML text, from 1; none if it is not there.
pub fn line_of(text: &str, path: &str) -> Option<usize> {
    let root = DeTable::parse(text).ok()?;
    let (mut table, mut start) = (Some(root.get_ref()), None);
    for step in path.split('.') {
        let mut names = step.split(['[', ']']).filter(|name| !name.is_empty());
        let mut value = table?.get(names.next()?)?;
        for index in names {
            value = value.get_ref().as_array()?.get(index.parse::<usize>().ok()?)?;
        }
        start = Some(value.span().start);
        table = match value.get_ref() {
            DeValue::Table(table) => Some(table),
            _ => None,
        };
    }
    start.map(|start| line_at(text, start))
}

fn line_at(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&byte| byte == b'\n').count()
}

/// Reads JSON; `wanted` says what to add where a key is missing.
pub fn from_json<'t, T: Deserialize<'t>, P>(text: &'t str, wanted: Wanted) -> Result<Keyed<T>, Fault<P>> {
    let mut source = serde_json::Deserializer::from_str(text);
    let read = serde_path_to_error::deserialize(&mut source).map_err(|error| {
        let (path, error) = (error.path().clone(), error.into_inner());
        let out_of_range = error.to_string().starts_with("number out of range");
        if error.is_data() || out_of_range {
            data(&path, Some(error.line()), &without_place(&error), wanted)
        } else {
            json_syntax(&error)
        }
    })?;
    source.end().map_err(|error| json_syntax(&error))?;
    Ok(read)
}

fn json_syntax<P>(error: &serde_json::Error) -> Fault<P> {
    let message = format!("{} (column {})", one_line(&without_place(error)), error.column());
    Fault::common(Some(error.line()), String::new(), Mistake::Syntax { language: "JSON", message })
}

/// What is wrong; the line is told elsewhere.
fn without_place(error: &serde_json::Error) -> String {
    let mut message = error.to_string();
    let place = format!(" at line {} column {}", error.line(), error.column());
    message.truncate(message.strip_suffix(&place).map_or(message.len(), str::len));
    message
}

/// Reads TOML; `wanted` says what to add where a key is missing.
pub fn from_toml<'t, T: Deserialize<'t>, P>(text: &'t str, wanted: Wanted) -> Result<Keyed<T>, Fault<P>> {
    let line = |error: &toml::de::Error| Some(line_at(text, error.span()?.start));
    let source = toml::Deserializer::parse(text).map_err(|error| {
        let message = one_line(error.message());
        Fault::common(line(&error), String::new(), Mistake::Syntax { language: "TOML", message })
    })?;
    serde_path_to_error::deserialize(source)
        .map_err(|error| data(error.path(), line(error.inner()), error.inner().message(), wanted))
}

/// Serde's message in our words.
fn data<P>(path: &Path, line: Option<usize>, message: &str, wanted: Wanted) -> Fault<P> {
    let mut keys: Vec<String> = path
        .iter()
        .map(|segment| match segment {
            Segment::Seq { index } => format!("[{index}]"),
            Segment::Map { key } => format!(".{key}"),
            Segment::Enum { .. } | Segment::Unknown => String::new(),
        })
        .collect();
    // Of a key that is itself what is wrong, the path may have it or not.
    let mut named = |key: &str, stays: bool| {
        keys.pop_if(|last| last.strip_prefix('.') == Some(key));
        if stays {
            keys.push(format!(".{key}"));
        }
    };
    let field = |kind: &str| message.strip_prefix(kind)?.strip_suffix('`');
    let problem = if let Some((key, known)) =
        message.strip_prefix("unknown field `").and_then(|rest| rest.rsplit_once("`, expected "))
    {
        named(key, false);
        let known: Vec<&str> = known.split('`').skip(1).step_by(2).collect();
        Mistake::UnknownKey { key: quote(key), nearest: nearest(&known, key).to_owned() }
    } else if let Some(key) =
        message.strip_prefix("unknown field `").and_then(|rest| rest.strip_suffix("`, there are no fields"))
    {
        named(key, false);
        Mistake::NoKeys { key: quote(key) }
    } else if let Some(key) = field("missing field `") {
        named(key, true);
        Mistake::Missing { wanted: wanted(key) }
    } else if let Some(key) = field("duplicate field `") {
        named(key, true);
        Mistake::Twice
    } else {
        Mistake::Value { message: in_words(message) }
    };
    let path = one_line(keys.concat().trim_start_matches('.'));
    Fault::common(line.filter(|&line| line > 0), path, problem)
}

fn in_words(message: &str) -> String {
    let mistyped = message.strip_prefix("invalid type: ").or_else(|| message.strip_prefix("invalid value: "));
    let Some((found, wanted)) = mistyped.and_then(|rest| rest.rsplit_once(", expected ")) else {
        return one_line(message);
    };
    let wanted = match wanted {
        "f64" => "a number",
        "u64" => "a whole number, 0 or more",
        "u32" => "a whole number, 0 to 4294967295",
        "u16" => "a whole number, 0 to 65535",
        "u8" => "a whole number, 0 to 255",
        "a boolean" => "true or false",
        "i64" => "a whole number",
        "a map" => "a table of keys and values",
        "path string" => "a path in quotes",
        "a sequence" => "a list",
        other => other,
    };
    format!("is {}: must be {wanted}", one_line(found))
}

/// A struct that is written with its keys. What serde derives would also take a list of its values.
#[derive(Debug, Serialize)]
#[serde(transparent)]
pub struct Keyed<T>(pub T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Keyed<T> {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        struct Keys<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Keys<T> {
            type Value = Keyed<T>;
            fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
                text.write_str("a table of keys and values")
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Keyed<T>, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map)).map(Keyed)
            }
        }
        source.deserialize_map(Keys(PhantomData))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_found_by_its_path() {
        let text = "a = 1\n\nlist = [\n  [1, 2],\n  [3,\n 4]]\n[t]\nb.c = 2\n[[ts]]\n[[ts]]\nd = 1\n";
        for (path, line) in [
            ("a", 1),
            ("list", 3),
            ("list[0]", 4),
            ("list[1]", 5),
            ("list[1][1]", 6),
            ("t.b.c", 8),
            ("ts[1].d", 11),
        ] {
            assert_eq!(line_of(text, path), Some(line), "{path}");
        }
        for path in ["", "b", "a.b", "a[0]", "list[2]", "list[x]", "t.c", "ts[1].e", "[0]"] {
            assert_eq!(line_of(text, path), None, "{path}");
        }
        assert_eq!(line_of("a = ", "a"), None);
    }
}
