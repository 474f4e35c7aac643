//! Keys of a file that have a deprecated name as well: a file may have either, but not both.

use meissner_input::document::KeyError;

/// Both names of a key are there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{name}` and `{deprecated}` are both there and mean the same: keep `{name}`")]
pub struct TwoNames {
    name: &'static str,
    deprecated: &'static str,
}

/// The value of a key by the name or by the deprecated name, and which of the two the file has. Without a value, that
/// is the name.
///
/// # Errors
/// If both are there.
pub fn one_name<T>(
    (name, value): (&'static str, Option<T>),
    (deprecated, old): (&'static str, Option<T>),
) -> Result<(Option<T>, &'static str), TwoNames> {
    match (value, old) {
        (Some(_), Some(_)) => Err(TwoNames { name, deprecated }),
        (None, Some(value)) => Ok((Some(value), deprecated)),
        (value, None) => Ok((value, name)),
    }
}

/// A fault about the key `name`, or about a part of it, by the name that the file has.
#[must_use]
pub fn as_written<P>(fault: KeyError<P>, name: &str, written: &str) -> KeyError<P> {
    match fault.path.strip_prefix(name) {
        Some(rest) if rest.is_empty() || rest.starts_with(['.', '[']) => {
            KeyError { path: format!("{written}{rest}"), ..fault }
        }
        _ => fault,
    }
}
