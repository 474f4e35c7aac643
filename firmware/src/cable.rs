//! Whether the USB cable is plugged in, by its 5 V: a Pico leads them to GPIO 24, which its maker uses for nothing else.
//!
//! Only a board with a supply of its own can see it unplugged. It must then take its pull-up off the bus (USB 2.0, 7.1.5: a
//! device supplies no current to a host that is off), and it knows the unplugged cable from a suspended bus.
//!
//! Other boards lead nothing to GPIO 24, and a Pico W the data of its radio, which has no power here. So a low level means
//! something only once the level has been high; until then, this module changes nothing.

use embassy_rp::pac;

const SENSE: u32 = 1 << 24;
/// Looks that must find no voltage: a contact that bounces is no unplugged cable.
const ABSENT: u32 = 2;

/// What has happened to the cable since the last look.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Change {
    None,
    Plugged,
    Unplugged,
}

pub(crate) struct Cable {
    /// The board leads the voltage to the GPIO.
    sensed: bool,
    /// Looks in a row without it, up to [`ABSENT`].
    absent: u32,
}

impl Cable {
    pub(crate) const NEW: Self = Self { sensed: false, absent: 0 };

    pub(crate) fn is_unplugged(&self) -> bool {
        self.absent == ABSENT
    }

    pub(crate) fn look(&mut self) -> Change {
        let was_unplugged = self.is_unplugged();
        if pac::SIO.gpio_in(0).read() & SENSE != 0 {
            (self.sensed, self.absent) = (true, 0);
        } else if self.sensed {
            self.absent = (self.absent + 1).min(ABSENT);
        }
        match (was_unplugged, self.is_unplugged()) {
            (false, true) => Change::Unplugged,
            (true, false) => Change::Plugged,
            _ => Change::None,
        }
    }
}
