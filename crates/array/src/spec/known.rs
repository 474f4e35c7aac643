//! The descriptions that the program knows.
//!
//! Invariant: a name stands for one description for as long as the program runs, so a handle never changes its meaning.

use super::ArraySpec;
use super::error::Problem;
use std::fmt;
use std::ops::Deref;
use std::sync::{LazyLock, PoisonError, RwLock};

/// A handle on a description that stays for the rest of the program.
#[derive(Clone, Copy)]
pub struct Array(&'static ArraySpec);

/// The shipped descriptions; the first is the default.
const SHIPPED: [(&str, &str); 4] = [
    ("tula35-6x4.toml", include_str!("../../../../library/arrays/tula35-6x4.toml")),
    ("ubi-pen-3x3.toml", include_str!("../../../../library/arrays/ubi-pen-3x3.toml")),
    ("tula35-2x3.toml", include_str!("../../../../library/arrays/tula35-2x3.toml")),
    ("simulated-8x8.toml", include_str!("../../../../library/arrays/simulated-8x8.toml")),
];

static KNOWN: LazyLock<RwLock<Vec<Array>>> = LazyLock::new(|| {
    let shipped = |(file, text): (&str, &str)| {
        let spec =
            ArraySpec::parse(text, file).unwrap_or_else(|error| panic!("a shipped description: {error}"));
        Array(Box::leak(Box::new(spec)))
    };
    RwLock::new(SHIPPED.into_iter().map(shipped).collect())
});

static PAPER: LazyLock<Array> = LazyLock::new(|| KNOWN.read().unwrap_or_else(PoisonError::into_inner)[0]);

/// No description has this name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "no array is called {name}: known are {known}; give the file of another one with --array, or as `description` in the table \
     `[array]` of the configuration"
)]
pub struct UnknownArray {
    /// The name, quoted.
    pub name: String,
    /// The known names.
    pub known: String,
}

/// The names of all known descriptions; the first is the default.
pub fn names() -> Vec<&'static str> {
    KNOWN.read().unwrap_or_else(PoisonError::into_inner).iter().map(|array| array.0.name()).collect()
}

impl Array {
    /// The array of the paper, with 6 × 4 pins: the default.
    pub fn paper() -> Self {
        *PAPER
    }

    /// The known description of this name.
    ///
    /// # Errors
    /// There is none.
    pub fn named(name: &str) -> Result<Self, UnknownArray> {
        let known = KNOWN.read().unwrap_or_else(PoisonError::into_inner);
        known.iter().copied().find(|array| array.name() == name).ok_or_else(|| UnknownArray {
            name: meissner_input::message::quote(name),
            known: known.iter().map(|array| array.0.name()).collect::<Vec<_>>().join(", "),
        })
    }

    /// Adds a description to the known ones. The same one again is the same handle.
    ///
    /// # Errors
    /// [`Problem::Shipped`] if another description has its name.
    pub fn known(spec: ArraySpec) -> Result<Self, Problem> {
        let mut known = KNOWN.write().unwrap_or_else(PoisonError::into_inner);
        if let Some(same) = known.iter().find(|array| array.name() == spec.name()) {
            return if same.hash() == spec.hash() {
                Ok(*same)
            } else {
                Err(Problem::Shipped { name: spec.name })
            };
        }
        let array = Self(Box::leak(Box::new(spec)));
        known.push(array);
        Ok(array)
    }

    /// Its description, for the rest of the program.
    pub const fn spec(self) -> &'static ArraySpec {
        self.0
    }
}

impl Default for Array {
    fn default() -> Self {
        Self::paper()
    }
}

impl Deref for Array {
    type Target = ArraySpec;
    fn deref(&self) -> &ArraySpec {
        self.0
    }
}

impl PartialEq for Array {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self.0, other.0)
    }
}

impl Eq for Array {}

impl fmt::Debug for Array {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Array({})", self.name())
    }
}

impl serde::Serialize for Array {
    fn serialize<S: serde::Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(self.name())
    }
}

impl<'de> serde::Deserialize<'de> for Array {
    fn deserialize<D: serde::Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        let name = String::deserialize(source)?;
        Self::named(&name).map_err(serde::de::Error::custom)
    }
}
