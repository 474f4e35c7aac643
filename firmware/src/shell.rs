//! The shell: owns the controller, and runs it in a software interrupt.
//!
//! At each block and with each packet it renders the blocks that are due, passes incoming packets to the controller and
//! takes the frames to send. Its priority is below the interrupts of clock and USB and above all tasks. Nothing else
//! touches the controller, and the shell decides nothing about strokes.
//!
//! Invariant: the lines do what the controller has booked. A block rendered too late is a fault, and the lines are forced low.

use crate::array::LAYOUT;
use crate::self_test::Run as SelfTestRun;
use crate::{beat, counters, edge, estop, usb, wake, wave};
use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering::SeqCst};
use embassy_rp::interrupt;
use embassy_rp::interrupt::{InterruptExt, Priority};
use firmware_protocol::controller::{BLOCK, Controller, HORIZON, Identity};
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::{Cause, State};
use firmware_protocol::tick::Tick;
use firmware_protocol::urgent::{Urgent, Watch};

/// Number of turns the shell has taken. The watchdog is fed only while it grows.
static TURNS: AtomicU32 = AtomicU32::new(0);

/// Most bytes of a packet decoded at a time.
const DECODED: usize = 32;

struct Owned<T>(UnsafeCell<T>);
// SAFETY: only `start` touches the content before the interrupt is enabled, and only the interrupt after that.
unsafe impl<T> Sync for Owned<T> {}
/// Initialised at compile time, because to build it at run time would take most of the stack.
static CONTROLLER: Owned<Controller> = Owned(UnsafeCell::new(Controller::new(Identity::NONE, LAYOUT)));
static SHELL: Owned<MaybeUninit<Shell>> = Owned(UnsafeCell::new(MaybeUninit::uninit()));

struct Shell {
    controller: &'static mut Controller,
    ports: usb::Ports,
    /// The pipe of the host that has the session.
    active: usize,
    /// Look for another host's hello on the other pipes.
    watches: [Watch; usb::PIPES],
    /// The packet being read, its pipe, and how much of it is read.
    packet: Option<(usize, usb::Packet, usize)>,
    /// The frame being sent, and its length until it is put on its pipe: to make one and to put it there are two pieces of work.
    frame: [u8; MAX_FRAME],
    made: usize,
    executor: beat::Watch,
    /// The self-test under way.
    self_test: Option<SelfTestRun>,
}

/// Sets up the shell and enables its interrupt.
pub(crate) fn start(identity: Identity, cause: Cause, ports: usb::Ports) {
    // SAFETY: called once, before the interrupt is enabled.
    let controller = unsafe { &mut *CONTROLLER.0.get() };
    controller.introduce(identity, cause);
    let shell = Shell {
        controller,
        ports,
        active: 0,
        watches: [const { Watch::new() }; usb::PIPES],
        packet: None,
        frame: [0; MAX_FRAME],
        made: 0,
        executor: beat::Watch::NEW,
        self_test: None,
    };
    // SAFETY: the interrupt is not enabled yet, and nothing else uses it.
    unsafe { (*SHELL.0.get()).write(shell) };
    interrupt::SWI_IRQ_0.set_priority(Priority::P2);
    // SAFETY: no critical section relies on this interrupt being disabled.
    unsafe { interrupt::SWI_IRQ_0.enable() };
}

/// Number of turns the shell has taken.
pub(crate) fn turns() -> u32 {
    TURNS.load(SeqCst)
}

#[embassy_rp::interrupt]
fn SWI_IRQ_0() {
    // SAFETY: `start` filled it before it enabled this interrupt. Only this interrupt touches it, and it does not preempt itself.
    unsafe { (*SHELL.0.get()).assume_init_mut() }.turn();
    TURNS.store(turns().wrapping_add(1), SeqCst);
}

impl Shell {
    fn turn(&mut self) {
        // One piece of work at a time: meanwhile a block may have become due.
        loop {
            self.take_e_stop();
            self.take_failure();
            let now = wave::now();
            self.take_stall(now);
            self.take_edge(now);
            self.hold(now);
            self.render();
            let advanced = self.controller.advance(wave::now());
            estop::set_epoch(self.controller.epoch());
            if !(advanced || self.take_lost() || self.send() || self.take_frame()) {
                break;
            }
        }
        self.test();
    }

    /// Does a step of a self-test, if the controller wants one.
    fn test(&mut self) {
        if !self.controller.is_testing() {
            self.self_test = None;
            return;
        }
        if let Some(result) = self.self_test.get_or_insert_with(SelfTestRun::new).step() {
            self.self_test = None;
            self.controller.tested(result);
            wake::shell();
        }
    }

    /// Holds the outputs low while the controller says so, and releases them in the tick in which that ends.
    fn hold(&self, now: Tick) {
        if self.controller.forced_off(now) {
            wave::force_low();
        } else {
            wave::release();
        }
    }

    fn take_lost(&mut self) -> bool {
        let lost = usb::take_lost();
        if lost.is_some_and(|pipe| pipe == usb::ALL || pipe == self.active) {
            self.controller.link_lost(wave::now());
        }
        lost.is_some()
    }

    fn take_e_stop(&mut self) {
        if let Some(epoch) = estop::pending() {
            self.controller.e_stop(wave::now(), epoch);
            // Set the epoch first, so that a repetition is not a new e-stop.
            estop::set_epoch(self.controller.epoch());
            estop::done();
        }
    }

    /// Tells the controller that PIO or DMA have failed. The pads are forced low already, and stay so.
    fn take_failure(&mut self) {
        if let Some(followed) = wave::failed()
            && self.controller.state() != State::Faulted
        {
            self.controller.output_failed(followed);
        }
    }

    /// Returns the pins if the executor hangs: the host cannot be heard, and the watchdog will restart the chip.
    fn take_stall(&mut self, now: Tick) {
        if self.executor.hangs(now) {
            counters::stalled();
            self.controller.link_lost(now);
        }
    }

    fn take_edge(&mut self, now: Tick) {
        if let Some(tick) = edge::take() {
            self.controller.edge(tick);
        }
        edge::listen(now);
    }

    /// Renders each block that fits the horizon.
    #[inline(never)]
    fn render(&mut self) {
        let now = wave::now();
        if self.controller.rendered() <= now + wave::FETCHED {
            self.starved(now);
        }
        while self.controller.rendered() + u64::from(BLOCK) <= now + u64::from(HORIZON) {
            let begin = self.controller.rendered();
            let end = begin + u64::from(BLOCK);
            let enabled = matches!(self.controller.state(), State::Armed | State::Returning);
            while self.controller.rendered() < end {
                let at = self.controller.rendered();
                let run = self.controller.render((end - at) as u32);
                wave::write(at, &run, enabled);
            }
            if enabled {
                let now = wave::now();
                let slack = (begin - (now + wave::FETCHED)) as u32;
                counters::rendered(slack);
                self.controller.rendered_with(slack);
                if slack == 0 {
                    // Some words may have been fetched before they were written.
                    self.starved(now);
                }
            }
        }
    }

    /// The DMA has reached ticks that are not rendered. The lines are low there; those ticks are skipped, not played later.
    fn starved(&mut self, now: Tick) {
        if matches!(self.controller.state(), State::Armed | State::Returning) {
            wave::force_low();
            self.controller.fault(now, Cause::Starved);
        }
        while self.controller.rendered() <= now + wave::FETCHED {
            // Whole blocks, because the ring is cleared by blocks.
            let end = self.controller.rendered() + u64::from(BLOCK);
            while self.controller.rendered() < end {
                self.controller.render((end - self.controller.rendered()) as u32);
            }
        }
    }

    /// Has the controller read the next frame, or the rest of a packet. Returns `false` if there is no packet.
    #[inline(never)]
    fn take_frame(&mut self) -> bool {
        let now = wave::now();
        let (pipe, packet, at) = match self.packet.take() {
            Some(packet) => packet,
            None => {
                let Some((pipe, packet)) = self.ports.take() else { return false };
                (pipe, packet, 0)
            }
        };
        if pipe != self.active {
            // Ignore stray bytes on the other pipe; a hello there is another host.
            let Some(Urgent::Hello(session)) = self.watches[pipe].look(packet.bytes()) else { return true };
            self.active = pipe;
            usb::set_active(pipe);
            // Ends a frame that the previous host may have begun.
            self.controller.receive(now, &[0]);
            // The hello may have begun in an earlier packet. If it is all in this one, what follows is a repetition.
            self.controller.open_session(now, session);
        }
        let left = &packet.bytes()[at..];
        let mut rest = &left[..left.len().min(DECODED)];
        let begun = rest.len();
        self.controller.read(now, &mut rest);
        let read = begun - rest.len();
        if read < left.len() {
            self.packet = Some((pipe, packet, at + read));
        }
        true
    }

    /// Makes the next frame if there is one and room for it, or sends the one that was made.
    #[inline(never)]
    fn send(&mut self) -> bool {
        if self.made > 0 {
            let len = core::mem::take(&mut self.made);
            self.ports.put(self.active, &self.frame[..len]);
            return true;
        }
        if !self.ports.has_room(self.active) {
            return false;
        }
        if self.controller.wants_measures() {
            self.controller.measured(counters::read());
        }
        self.made = self.controller.transmit(wave::now(), &mut self.frame);
        self.made > 0
    }
}
