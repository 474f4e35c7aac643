//! A method in the words of a document: `method`, `step_us`, `integrator`, `precision`.
//!
//! Invariant: the exact method has no step, no integrator and no precision.

use meissner_skin::{Integrator, Method, Precision, Stepping};
use serde::Serialize;
use std::fmt;

/// A method, for documents and people.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct MethodLabel {
    /// `exact` or `stepped`.
    pub method: &'static str,
    /// None: exact.
    pub step_us: Option<u32>,
    /// None: exact.
    pub integrator: Option<Integrator>,
    /// None: exact.
    pub precision: Option<Precision>,
}

impl MethodLabel {
    /// The integrator and precision as one writes them.
    #[must_use]
    pub fn names(&self) -> Option<(&'static str, &'static str)> {
        Some((self.integrator?.name(), self.precision?.name()))
    }
}

impl From<Method> for MethodLabel {
    fn from(method: Method) -> Self {
        match method {
            Method::Exact => Self { method: "exact", step_us: None, integrator: None, precision: None },
            Method::Stepped(Stepping { step_us, integrator, precision }) => Self {
                method: "stepped",
                step_us: Some(step_us),
                integrator: Some(integrator),
                precision: Some(precision),
            },
        }
    }
}

impl fmt::Display for MethodLabel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.names(), self.step_us) {
            (Some((integrator, precision)), Some(step_us)) => {
                write!(f, "{integrator} in {precision} at {step_us} us")
            }
            _ => write!(f, "{}", self.method),
        }
    }
}
