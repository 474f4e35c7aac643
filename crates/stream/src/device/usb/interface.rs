//! Finds the interface of a board that this program speaks to: vendor-specific, with a bulk endpoint each way.

use rusb::{Context, DeviceHandle, Direction, TransferType};

/// The interface class in its descriptor.
const VENDOR_SPECIFIC: u8 = 0xff;

/// An interface's number and its bulk endpoints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Interface {
    pub(super) number: u8,
    pub(super) input: u8,
    pub(super) output: u8,
}

impl Interface {
    /// The first vendor-specific interface with a bulk endpoint each way.
    pub(super) fn of(handle: &DeviceHandle<Context>) -> Result<Option<Self>, rusb::Error> {
        let config = handle.device().active_config_descriptor()?;
        for setting in config.interfaces().flat_map(|interface| interface.descriptors()) {
            if setting.class_code() != VENDOR_SPECIFIC || setting.setting_number() != 0 {
                continue;
            }
            let bulk = |direction| {
                let mut all = setting.endpoint_descriptors();
                all.find(|end| end.transfer_type() == TransferType::Bulk && end.direction() == direction)
            };
            if let (Some(input), Some(output)) = (bulk(Direction::In), bulk(Direction::Out)) {
                return Ok(Some(Self {
                    number: setting.interface_number(),
                    input: input.address(),
                    output: output.address(),
                }));
            }
        }
        Ok(None)
    }
}
