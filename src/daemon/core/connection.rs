//! The connection to the device: its state, or why there is none, and the channel to the thread that opens devices.

use crossbeam_channel::Sender;
use meissner_api::EndCause;
use meissner_stream::device::Device;
use meissner_stream::device::mock::TruePositions;
use std::sync::Arc;

/// A message to the connector's thread.
#[derive(Debug)]
pub(in crate::daemon) enum ConnectorMessage {
    /// The device is gone; drop it.
    Gone(Option<Box<Device>>),
    /// The daemon is ending.
    Quit,
}

/// See the module.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Connection {
    connector: Option<Sender<ConnectorMessage>>,
    /// The true positions of simulated motors.
    pub(in crate::daemon) true_positions: Option<Arc<TruePositions>>,
    /// Why the device was lost, until one answers again.
    lost: Option<EndCause>,
    /// Why no device is connected, by the last try.
    pub(in crate::daemon) missing: Option<String>,
    /// Whether a client has requested to arm, with or without a device.
    pub(in crate::daemon) armed_once: bool,
}

impl Connection {
    /// Sets the channel to the thread that takes devices back.
    pub(in crate::daemon) fn set_connector(&mut self, connector: Sender<ConnectorMessage>) {
        self.connector = Some(connector);
    }

    pub(in crate::daemon) fn tell_connector(&self, message: ConnectorMessage) {
        // There is one message per connection, and the connector empties its channel, so it cannot be full.
        if let Some(connector) = &self.connector {
            let _ = connector.try_send(message);
        }
    }

    /// Notes that a device has answered.
    pub(in crate::daemon) fn established(&mut self) {
        (self.lost, self.missing) = (None, None);
    }

    /// Notes that the device of that kind is gone. Returns whether the reason is new.
    pub(in crate::daemon) fn lost(&mut self, kind: &str, reason: &EndCause) -> bool {
        self.missing = Some(format!("{kind}: {reason}"));
        self.lost.replace(reason.clone()).as_ref() != Some(reason)
    }
}
