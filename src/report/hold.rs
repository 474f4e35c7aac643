//! What the closed loop is worth: how far pins rest from where they ought to, against the best there can be.

mod bound;

pub use bound::rest_bound_um;
