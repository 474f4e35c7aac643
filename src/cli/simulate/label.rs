//! The name of a method: the keys `method`, `step_us`, `integrator` and `precision` of a document, and a text.
//!
//! Invariant: the exact method has no step, no integrator and no precision.

use meissner_skin::{Integrator, Method, Precision, Stepping};
use serde::Serialize;
use std::fmt;

/// A method, as documents and texts name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(in crate::cli) struct MethodLabel {
    /// `exact` or `stepped`.
    pub(in crate::cli) method: &'static str,
    /// The step, µs; none if exact.
    pub(in crate::cli) step_us: Option<u32>,
    /// None if exact.
    pub(in crate::cli) integrator: Option<Integrator>,
    /// None if exact.
    pub(in crate::cli) precision: Option<Precision>,
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
        match (self.integrator, self.precision, self.step_us) {
            (Some(integrator), Some(precision), Some(step_us)) => {
                write!(f, "{} in {} at {step_us} us", integrator.name(), precision.name())
            }
            _ => write!(f, "{}", self.method),
        }
    }
}
