//! The name of a method: the keys `method`, `step_us`, `integrator` and `precision` of a document, and a text.
//!
//! Invariant: the exact method has no step, no integrator and no precision.

use meissner_skin::{Integrator, Method, Precision, Stepping};
use serde::Serialize;
use std::fmt;

/// A method, as documents and texts name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct MethodLabel {
    /// `exact` or `stepped`.
    pub method: &'static str,
    /// The step, µs; none if exact.
    pub step_us: Option<u32>,
    /// None if exact.
    pub integrator: Option<Integrator>,
    /// None if exact.
    pub precision: Option<Precision>,
}

impl MethodLabel {
    /// The names of integrator and precision; none if exact.
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
