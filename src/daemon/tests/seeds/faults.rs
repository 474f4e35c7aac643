//! What goes wrong, and ends again after a while.

use super::{World, rules};
use crate::daemon::tests::bench::DISK_STALLS;
use crate::record::simulated_disk::{FAILS, ROOM};
use firmware_protocol::message::{Cause, DeviceMessage, State};
use meissner_stream::Line;
use meissner_stream::faulty::Liar;
use meissner_stream::time::set_wall;
use meissner_test_support::random::Random;
use std::time::Duration;

/// A day, ns.
pub(super) const DAY_NS: i64 = 86_400 * 1_000_000_000;

/// A fault that ends.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    Line,
    /// Nothing arrives.
    Dead,
    Unplugged,
    Hangs,
    Lies,
    Disk,
    Stall,
}

/// The faults now.
#[derive(Debug, Default)]
pub(super) struct Trouble {
    /// Those that end, and when, s.
    ends: Vec<(f64, Fault)>,
    /// Until when the array or its line may be bad, and what was said by it wrong, s.
    array_until_s: f64,
    /// Until when the disk is bad, s.
    disk_until_s: f64,
    /// Since when the array hears nothing, s, if pins come down then.
    dead_since_s: Option<f64>,
    /// Since when it takes nothing, s.
    nothing_since_s: Option<f64>,
    /// When it stood still last, s.
    stalled_s: Option<f64>,
}

/// The array's lease, and a return of all pins, s.
const LEASE_OVER_S: f64 = 0.5;
/// How long a disk that works again takes for what has waited, s.
const DRAINED_S: f64 = 0.1;
/// How long the effects of a fault last, s: the link needs some seconds to trust a device again.
const AFTER_S: f64 = 8.0;
/// The same of a fault of the disk, s.
const DISK_AFTER_S: f64 = 3.0;

impl Trouble {
    /// Whether the array and its line are good, and have been for a while.
    pub(super) fn array_is_good(&self, now_s: f64) -> bool {
        now_s > self.array_until_s
    }

    /// Whether the disk takes all, and has for a while.
    pub(super) fn disk_is_good(&self, now_s: f64) -> bool {
        now_s > self.disk_until_s
    }

    /// Since when the disk takes nothing, s, if that was seen before.
    pub(super) fn takes_nothing_since(&mut self, now_s: f64) -> Option<f64> {
        let takes_nothing = !DISK_STALLS.get() && (FAILS.get() || ROOM.get() == 0);
        let since_s = self.nothing_since_s.unwrap_or(now_s);
        self.nothing_since_s = takes_nothing.then_some(since_s);
        self.nothing_since_s
    }

    /// Whether entries may wait for a disk that stands still, or did until just now.
    pub(super) fn disk_stalls(&self, now_s: f64) -> bool {
        DISK_STALLS.get() || self.stalled_s.is_some_and(|at_s| now_s < at_s + DRAINED_S)
    }

    /// Whether the array has heard nothing for so long that its lease is over and all pins are down.
    pub(super) fn lease_is_over(&self, now_s: f64) -> bool {
        self.dead_since_s.is_some_and(|since_s| now_s > since_s + LEASE_OVER_S)
    }

    /// The array is a new one, the disk is the same.
    pub(super) fn after_kill(mut self) -> Self {
        self.ends.retain(|(_, fault)| [Fault::Disk, Fault::Stall].contains(fault));
        self.dead_since_s = None;
        self
    }
}

/// Begins one.
pub(super) fn begin(world: &mut World) {
    world.report.faults += 1;
    let (random, now_s) = (&mut world.random, world.daemon.now(super::seconds));
    let which = random.below(10);
    let mut shared = world.daemon.faults();
    let (fault, longest_s) = match which {
        0 | 1 => {
            let line = Line {
                loss: if random.chance(0.5) { random.between(0.0, 0.5) } else { 0.0 },
                corrupt: if random.chance(0.5) { random.between(0.0, 0.5) } else { 0.0 },
                repeat: if random.chance(0.3) { 0.3 } else { 0.0 },
                byte_loss: if random.chance(0.3) { 0.01 } else { 0.0 },
                delay: Duration::from_secs_f64(if random.chance(0.5) {
                    random.between(0.0, 0.3)
                } else {
                    0.0
                }),
                jitter: Duration::from_secs_f64(if random.chance(0.3) {
                    random.between(0.0, 0.1)
                } else {
                    0.0
                }),
                bytes_per_s: 0,
                holds: random.chance(0.2),
            };
            (shared.to_device.line, shared.to_host.line) = (line, line);
            (Fault::Line, 3.0)
        }
        2 => {
            shared.is_unplugged = true;
            (Fault::Unplugged, 5.0)
        }
        3 => {
            shared.hangs = true;
            (Fault::Hangs, 3.0)
        }
        4 => {
            shared.fault = Some([Cause::Output, Cause::Panic, Cause::Watchdog][random.below(3)]);
            (Fault::Lies, 0.1)
        }
        5 => {
            shared.liar = Some(Liar::new(lie(random.below(1 << 20) as u64)));
            (Fault::Lies, 3.0)
        }
        6 => {
            ROOM.set(random.below(2000));
            (Fault::Disk, 20.0)
        }
        7 => {
            FAILS.set(true);
            (Fault::Disk, 10.0)
        }
        8 => {
            DISK_STALLS.set(true);
            (Fault::Stall, 8.0)
        }
        _ => {
            drop(shared);
            return set_clock(world);
        }
    };
    drop(shared);
    let until_s = now_s + random.between(0.0, longest_s);
    match fault {
        Fault::Disk | Fault::Stall => {
            world.trouble.disk_until_s = world.trouble.disk_until_s.max(until_s + DISK_AFTER_S);
        }
        _ => {
            world.trouble.array_until_s = world.trouble.array_until_s.max(until_s + AFTER_S);
            // No second fault of the array hides what the first one does.
            world.trouble.dead_since_s = None;
        }
    }
    world.trouble.ends.push((until_s, fault));
    world.trace(&format!("{fault:?} until {until_s}"));
}

/// Nothing arrives any more, for longer than the array's lease.
pub(super) fn line_dies(world: &mut World) {
    let (now_s, line) = (world.now_s(), Line { loss: 1.0, ..Line::default() });
    let pins_come_down = world.trouble.array_is_good(now_s) && world.state != "faulted";
    world.report.faults += 1;
    let mut shared = world.daemon.faults();
    (shared.to_device.line, shared.to_host.line) = (line, line);
    drop(shared);
    let until_s = now_s + world.random.between(1.0, 3.0);
    world.trouble.dead_since_s = pins_come_down.then_some(now_s);
    world.trouble.array_until_s = world.trouble.array_until_s.max(until_s + AFTER_S);
    world.trouble.ends.push((until_s, Fault::Dead));
}

/// Somebody sets the wall clock, or it is set right again.
fn set_clock(world: &mut World) {
    let was_right = world.machine.wall_set == world.life.wall_set;
    let (random, hour_ns) = (&mut world.random, DAY_NS / 24);
    world.machine.wall_set += match random.below(5) {
        0 => DAY_NS * (1 + random.below(40) as i64),
        1 => -DAY_NS * (1 + random.below(3) as i64),
        2 => hour_ns,
        3 => -hour_ns,
        _ => {
            // A minute before midnight.
            let now = world.daemon.now(crate::clock::local);
            let midnight = now.tomorrow().unwrap().start_of_day().unwrap();
            now.duration_until(&midnight).as_nanos() as i64 - 60_000_000_000
        }
    };
    let (set, used_s) = (world.machine.wall_set, world.status().participant.day_used_s);
    set_wall(set);
    world.trace(&format!("the clock is set by {set}"));
    if was_right {
        rules::clock_gives_no_new_day(world, used_s);
    }
}

/// Ends those whose time is over.
pub(super) fn end_due(world: &mut World) {
    let now_s = world.daemon.now(super::seconds);
    for (_, fault) in world.trouble.ends.extract_if(.., |(until_s, _)| *until_s <= now_s).collect::<Vec<_>>()
    {
        // Later than planned, if time has passed meanwhile.
        match fault {
            Fault::Disk | Fault::Stall => {
                world.trouble.disk_until_s = world.trouble.disk_until_s.max(now_s + DISK_AFTER_S);
            }
            _ => world.trouble.array_until_s = world.trouble.array_until_s.max(now_s + AFTER_S),
        }
        let mut shared = world.daemon.faults();
        match fault {
            Fault::Line | Fault::Dead => {
                (shared.to_device.line, shared.to_host.line) = Default::default();
                world.trouble.dead_since_s = None;
            }
            Fault::Unplugged => shared.is_unplugged = false,
            Fault::Hangs => shared.hangs = false,
            Fault::Lies => shared.liar = None,
            Fault::Disk => heal_disk(),
            Fault::Stall => {
                DISK_STALLS.set(false);
                world.trouble.stalled_s = Some(now_s);
            }
        }
    }
}

fn heal_disk() {
    ROOM.set(usize::MAX);
    FAILS.set(false);
}

/// Ends all.
pub(super) fn end_all(world: &mut World) {
    let now_s = world.daemon.now(super::seconds);
    world.trouble.ends.iter_mut().for_each(|(until_s, _)| *until_s = now_s);
    end_due(world);
}

/// The disk of this thread is good again, after the last day.
pub(super) fn heal() {
    heal_disk();
    DISK_STALLS.set(false);
}

/// A device that says one thing wrong, in some of its messages.
fn lie(seed: u64) -> impl FnMut(&mut DeviceMessage) + Send {
    let mut random = Random::new(seed);
    let (kind, share) = (random.below(8), random.between(0.05, 1.0));
    move |message| {
        if !random.chance(share) {
            return;
        }
        let any = random.below(1 << 16) as u16;
        match message {
            DeviceMessage::Hello(hello) => hello.boot ^= 1,
            DeviceMessage::Status(status) => match kind {
                0 => {
                    let states = [State::Disarmed, State::Armed, State::Returning, State::Faulted];
                    status.state = states[random.below(4)];
                }
                1 => status.tick.0[2] = status.tick.0[2].wrapping_add(1 + any as u8 / 2),
                2 => status.counters.played += u64::from(any),
                3 => status.next_seq = status.next_seq.wrapping_add(any),
                4 => status.credits = any,
                5 => status.outstanding = any.into(),
                6 => status.position_known = !status.position_known,
                _ => status.epoch = status.epoch.wrapping_add(1),
            },
            _ => {}
        }
    }
}
