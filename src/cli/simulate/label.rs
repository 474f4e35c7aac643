//! The name of a method: the keys `method`, `step_us` and `integrator` of a document, and a text.
//!
//! Invariant: the exact method has no step and no integrator.

use meissner_skin::{Integrator, Method, Stepping};
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
}

impl From<Method> for MethodLabel {
    fn from(method: Method) -> Self {
        match method {
            Method::Exact => Self { method: "exact", step_us: None, integrator: None },
            Method::Stepped(Stepping { step_us, integrator }) => {
                Self { method: "stepped", step_us: Some(step_us), integrator: Some(integrator) }
            }
        }
    }
}

impl fmt::Display for MethodLabel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.integrator, self.step_us) {
            (Some(integrator), Some(step_us)) => write!(f, "{} at {step_us} us", integrator.name()),
            _ => write!(f, "{}", self.method),
        }
    }
}
