//! The streamer's settings: those in use, and those a reload brought while motors were armed.

use meissner_stream::Settings;

/// See the module.
#[derive(Clone, Copy, Debug)]
pub(in crate::daemon) struct ActiveSettings {
    /// In use.
    pub(in crate::daemon) current: Settings,
    /// In use from the next `arm` on.
    next: Settings,
}

impl ActiveSettings {
    pub(in crate::daemon) const fn new(settings: Settings) -> Self {
        Self { current: settings, next: settings }
    }

    /// Sets the settings from the next `arm` on, or at once if the motors are disarmed.
    pub(in crate::daemon) const fn set(&mut self, settings: Settings, is_armed: bool) {
        self.next = settings;
        if !is_armed {
            self.current = settings;
        }
    }

    /// Motors are being armed.
    pub(super) const fn advance(&mut self) {
        self.current = self.next;
    }
}
