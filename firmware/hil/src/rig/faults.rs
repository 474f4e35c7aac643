//! What fails between the host and a device: the line, the device's words, the host's process and clock, and the core.

use crate::bench::{Bench, CpuEvent};
use crate::judge::Quiet;
use crate::oracle;
use crate::rig::{Faults, Rig, RigError};
use crate::time::{TICK, host};
use firmware_protocol::message::DeviceMessage;
use meissner_stream::faulty::Line;
use meissner_stream::{Settings, Streamer};

impl Rig {
    /// Changes the faults of the line for the host's frames.
    pub fn set_faults(&mut self, faults: Faults) {
        self.cable.set(faults.line(), Line::default());
    }

    /// Changes the line, both ways. E-stops go by the frame alone while the line towards the device is bad: a request on endpoint
    /// 0 would go past it.
    pub fn set_lines(&mut self, to_device: Line, to_host: Line) {
        self.cable.set(to_device, to_host);
        self.requests_e_stops = self.cable.reaches_device();
    }

    /// Frames that the line has lost, repeated, damaged, delayed or held back so far.
    #[must_use]
    pub fn harmed_frames(&self) -> u64 {
        self.cable.harmed()
    }

    /// From here on each message of the device is changed on its way to the host. The tap reads the truth.
    pub fn lie(&mut self, lie: impl FnMut(&mut DeviceMessage) + Send + 'static) {
        self.cable.lie(Some(lie));
    }

    /// From here on the host reads what the device has sent.
    pub fn stop_lying(&mut self) {
        self.cable.lie(None::<fn(&mut DeviceMessage)>);
    }

    /// Bytes come as if from the device.
    pub fn inject(&mut self, bytes: &[u8]) {
        self.cable.inject(host(self.now), bytes);
    }

    /// From here on the device's clock runs fast by so many millionths, by the host's clock, and by so many more each second.
    pub fn set_clock_error(&mut self, ppm: f64, ppm_per_s: f64) {
        self.clock.set_error(self.now, ppm, ppm_per_s);
    }

    /// The host is suspended for so many cycles: its process and its clock stand still.
    pub fn suspend(&mut self, cycles: u64) {
        self.stall(self.now + cycles);
        self.clock.stand_still(cycles);
    }

    /// Stalls the host's process until a cycle.
    pub fn stall(&mut self, until: u64) {
        self.held_until = until;
    }

    /// Kills the host's process, which closes its tty. Its successor, which knows nothing of it, opens the tty at
    /// [`Self::close`] with `false`.
    ///
    /// # Errors
    /// As for [`Self::run_to`].
    pub fn replace_host(&mut self, settings: Settings) -> Result<(), RigError> {
        self.close(true)?;
        self.streamer = Streamer::new(settings);
        Ok(())
    }

    /// Whether the host has a device open.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.connected
    }

    /// Makes the core fail; the lines must be low a horizon later.
    ///
    /// # Errors
    /// As for [`Self::run_to`].
    pub fn fail(&mut self, event: CpuEvent) -> Result<(), RigError> {
        self.death = Some(self.now);
        self.low_from(oracle::HORIZON);
        if let Bench::Mock(_) = self.bench {
            self.end_boot();
            self.resets += 1;
        }
        self.bench.cpu(event)?;
        Ok(())
    }

    /// From this many ticks from now, all lines must be low until the next `arm` or onset.
    pub fn low_from(&mut self, ticks: u64) {
        self.quiets.push(Quiet { cycle: self.now + ticks * TICK });
    }

    /// The cycle at which the last pulse of all boots has fallen.
    #[must_use]
    pub fn low_since(&self) -> Option<u64> {
        let before = self.boots.iter().filter_map(|boot| boot.played.low_since(boot.grid));
        let now = match &self.bench {
            Bench::Mock(mock) => mock.log.end().map(|tick| mock.grid().cycle(tick)),
            Bench::Chip(chip) => chip.pins.low_since(u64::MAX),
        };
        before.chain(now).max()
    }
}
