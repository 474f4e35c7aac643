//! What runs beside the requests, on threads and tasks of its own.
//!
//! [`event_loop`] processes the streamer's events; [`connector`] opens devices;
//! [`calibration`] fits and stores calibrations; [`rendering`] follows a rendering's process, [`preview`] that of a preview, which its request awaits;
//! [`service`] speaks with the service manager.

pub(in crate::daemon) mod calibration;
pub(in crate::daemon) mod connector;
pub(in crate::daemon) mod event_loop;
pub(in crate::daemon) mod preview;
mod render_process;
mod rendering;
pub(in crate::daemon) mod service;
