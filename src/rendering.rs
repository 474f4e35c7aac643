//! Renderings of objects: what the command `render` and the daemon's process for them share.
//!
//! An object is shipped ([`shipped_text`]), or read by its user. [`contact`] presses it on the finger, [`levels`] finds
//! the heights of the pins by one of [`METHODS`], and [`pattern`] makes the pattern that plays them, with its [`provenance`].
//!
//! Invariant: equal keys, files, array and method give the same bytes. An error is one line without the object's name.

use meissner_api::RenderMethod;
use meissner_array::pattern::{Pattern, PatternError};
use meissner_array::spec::Array;
use meissner_paper::shipped_text;
use meissner_render::{Choice, LONGEST_S, Levels, Method, STEP_S, TRACE_MM_S, TraceError, render, trace};
use meissner_touch::{Contact, ContactError, Object, Touch, no_files};
use serde_json::{Map, Value};
use toml::Table;

/// The first finger that judges a pattern: no table of rates was made with it and those after it.
pub(crate) const FIRST_FINGER: u64 = 5000;
/// After the object has left, afferents are counted for so long, s.
pub(crate) const AFTER_S: f64 = 0.1;

/// All methods: the name, and what it does. A new one also needs its variants of [`RenderMethod`] and [`Method`], and an arm of [`of_touch`].
pub(crate) const METHODS: &[(&str, &str)] = &[
    (
        "auto",
        "What two simulated fingers find nearest: a press with taps, or rule; for a motion also rate and stroke",
    ),
    ("rate", "The rates of afferents, from strokes"),
    ("field", "The skin's shape"),
    ("rule", "One press at full speed, graded by the distance from the object, which it follows"),
    ("stroke", "One stroke of each pin whenever the object passes; a press, if it stays in place"),
    ("trace", "A press that moves along the lines of the object, one after another, in its own time"),
];

/// How a method finds heights from the touch of the object; none for a trace.
pub(crate) const fn of_touch(method: RenderMethod) -> Option<Method> {
    match method {
        RenderMethod::Auto => Some(Method::Auto),
        RenderMethod::Rate => Some(Method::Rate),
        RenderMethod::Field => Some(Method::Field),
        RenderMethod::Rule => Some(Method::Rule),
        RenderMethod::Stroke => Some(Method::Stroke),
        RenderMethod::Trace => None,
    }
}

/// Why an object is not rendered.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RenderingError {
    #[error("the object never lies under the finger: move it onto the fingertip")]
    NotUnderFinger,
    #[error(transparent)]
    Contact(#[from] ContactError),
    #[error("the object moves, and a trace moves by itself: press it, or take another method")]
    Moves,
    #[error("heights have no lines to trace: draw it with shape = \"lines\", or take another method")]
    NoLines,
    #[error(transparent)]
    Trace(#[from] TraceError),
    #[error("the touch lasts {lasts_s} s: at most {LONGEST_S} s are rendered, shorten it")]
    TooLong { lasts_s: f64 },
    #[error("the touch lasts {lasts_s} s, and pins move every {STEP_S} s: let it last longer")]
    TooShort { lasts_s: f64 },
    #[error(
        "no pin moves for this object: press deeper or longer than 0.01 s, or bring it nearer to the pins"
    )]
    Still,
    #[error(transparent)]
    Pattern(#[from] PatternError),
}

/// The keys of a shipped object.
pub(crate) fn shipped_keys(name: &str) -> Option<Map<String, Value>> {
    let keys: Table = shipped_text(name)?.parse().ok()?;
    serde_json::to_value(keys).ok()?.as_object().cloned()
}

/// The contact of an object with the finger. Of rough objects it takes some seconds; `progress` is called with the completed share.
pub(crate) fn contact(object: &Object, progress: &dyn Fn(f64)) -> Result<Contact, RenderingError> {
    let grains = object.grains(object.pitch_mm());
    if grains.is_empty() {
        return Err(RenderingError::NotUnderFinger);
    }
    Ok(Contact::with_progress(grains, object.touch().most_depth_mm(), progress)?)
}

/// The heights of the pins, and what `auto` has chosen. A trace has this speed, 1 to 200 mm/s.
pub(crate) fn levels(
    array: Array,
    object: &Object,
    contact: &Contact,
    method: RenderMethod,
    trace_mm_s: f64,
) -> Result<(Levels, Option<Choice>), RenderingError> {
    let Some(method) = of_touch(method) else {
        return Ok((trace(array, &lines(object)?, trace_mm_s)?, None));
    };
    let lasts_s = object.touch().duration_s();
    if lasts_s > LONGEST_S {
        return Err(RenderingError::TooLong { lasts_s });
    }
    if lasts_s <= STEP_S {
        return Err(RenderingError::TooShort { lasts_s });
    }
    Ok(render(array, contact, object.touch(), method))
}

/// The lines that a trace follows.
fn lines(object: &Object) -> Result<Vec<Vec<[f64; 2]>>, RenderingError> {
    if !object.touch().stays_in_place() {
        return Err(RenderingError::Moves);
    }
    object.lines_mm().ok_or(RenderingError::NoLines)
}

/// The keys of an object for the provenance; its name alone if it needs files.
pub(crate) fn keys_or_name(text: &str, name: &str) -> toml::Value {
    let keys = Object::read(text, name, &mut no_files).ok().and_then(|_| text.parse::<Table>().ok());
    keys.map_or_else(|| name.into(), toml::Value::from)
}

/// What a pattern says about how it was made.
pub(crate) fn provenance(
    object: toml::Value,
    method: RenderMethod,
    pitch_mm: f64,
    trace_mm_s: Option<f64>,
    choice: Option<&Choice>,
) -> Result<Table, toml::ser::Error> {
    let mut table = Table::new();
    let mut put = |key: &str, value: toml::Value| table.insert(key.to_owned(), value);
    // The pattern holds its object, so that figures can show both.
    put("object", object);
    put("method", toml::Value::try_from(method)?);
    if let Some(Choice { taken, likeness }) = choice {
        put("taken", (*taken).into());
        let rounded = |likeness: f64| (likeness * 1e3).round() / 1e3;
        let likeness = likeness.iter().map(|(name, of)| ((*name).to_owned(), rounded(*of).into()));
        put("likeness", likeness.collect::<Table>().into());
    }
    put("pitch_mm", pitch_mm.into());
    if method == RenderMethod::Trace {
        put("trace_mm_s", trace_mm_s.unwrap_or(TRACE_MM_S).into());
    }
    put("program", format!("meissner {}", env!("CARGO_PKG_VERSION")).into());
    Ok(table)
}

/// The pattern that plays the heights.
pub(crate) fn pattern(
    levels: &Levels,
    array: Array,
    name: &str,
    provenance: Table,
) -> Result<Pattern, RenderingError> {
    let pattern = levels.pattern(array, name, provenance)?;
    if pattern.motions().is_empty() { Err(RenderingError::Still) } else { Ok(pattern) }
}

/// How long fingers feel patterns of these durations in s, s: until the last has ended, but not much longer than the touch.
pub(crate) fn judged_s(touch: &Touch, durations_s: impl Iterator<Item = f64>) -> f64 {
    durations_s.fold(touch.duration_s(), f64::max).min(2.0 * touch.duration_s()) + AFTER_S
}
