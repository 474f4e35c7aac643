//! Tests of objects on a finger.

mod contact;
mod response;
