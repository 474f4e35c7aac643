//! Queues bursts that belong to no play: moves, returns and seeks.
//!
//! Invariant: they are counted when they are queued, and begin as soon as the drivers are ready. Bursts that the limits on motors at
//! once keep apart follow each other without a pause.

use crate::array::{CAPACITY, MotorSet};
use crate::controller::player::pool::{Kind, Slot};
use crate::controller::player::{Player, at_once};
use crate::limits::Refusal;
use crate::stroke::{Direction, Stroke};

impl Player {
    /// Moves one pin by one burst, unless a limit refuses it; `pushes` of its pulses are against the lower stop. The queue is empty,
    /// so there is a slot.
    pub(in crate::controller) fn drive(
        &mut self,
        motor: u8,
        direction: Direction,
        pulses: u16,
        pushes: u16,
    ) -> Result<(), Refusal> {
        self.allowance.begin(self.rendered, motor.into(), pulses.into(), pushes, &self.layout)?;
        self.queue_burst(Kind::Internal, motor, direction, pulses, pushes);
        Ok(())
    }

    /// Whether every motor may push `pulses` more against the lower stop.
    pub(in crate::controller) fn allows_pushes(&mut self, pulses: u16) -> bool {
        self.allowance.allows_pushes(self.rendered, pulses.into())
    }

    /// Drives each pin down by its `pulses`, in turns; `pushes` of them are against the lower stop. No limit refuses it. The queue is
    /// empty, so there are slots.
    pub(in crate::controller) fn drive_down(
        &mut self,
        kind: Kind,
        pulses: &[u16; CAPACITY],
        pushes: &[u16; CAPACITY],
    ) {
        let mut waiting = MotorSet::EMPTY;
        for (motor, (&pulses, &pushes)) in pulses.iter().zip(pushes).enumerate() {
            if pulses > 0 {
                waiting.insert(motor as u8);
                self.allowance.count(self.rendered, motor, pulses, pushes);
                self.queue_burst(kind, motor as u8, Direction::Down, pulses, pushes);
            }
        }
        let (limits, ready) = (self.limits(), self.ready());
        at_once::take_turns(&mut self.pool, &self.layout, limits, waiting, ready);
    }

    fn queue_burst(&mut self, kind: Kind, motor: u8, direction: Direction, pulses: u16, pushes: u16) {
        let at = self.ready();
        let stroke = match direction {
            Direction::Up => {
                Stroke { motor, up: at, up_pulses: pulses, down: at + u64::from(pulses), down_pulses: 0 }
            }
            Direction::Down => Stroke { motor, up: at, up_pulses: 0, down: at, down_pulses: pulses },
        };
        let planned = [pulses.saturating_sub(pushes), stroke.down_pulses];
        self.queue(Slot { charged: Some(pulses), planned, pushes, ..Slot::new(stroke, kind) });
    }
}
