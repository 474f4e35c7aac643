//! The skin model: where RA afferents lie in the fingertip, and which spikes they send when pins move.
//!
//! - [`afferent`]: parameters, receptive fields and populations.
//! - [`simulate`]: scenes of drives and afferents, simulated exactly or with a time step.
//!
//! The crate opens no file and reads no clock.

pub mod afferent;
pub mod simulate;
