//! Renderings and previews: each in a process of its own.
//!
//! [`rendering`] follows a rendering's process, [`preview`] that of a preview, which its request awaits. [`renderings`] and [`previews`] are their
//! handlers.

pub(in crate::daemon) mod preview;
pub(in crate::daemon) mod previews;
pub(in crate::daemon) mod process;
pub(in crate::daemon) mod rendering;
pub(in crate::daemon) mod renderings;
pub(in crate::daemon) mod state;
