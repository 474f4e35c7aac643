//! The shell: the one place that has the controller, in an interrupt of its own.
//!
//! Woken at each block and with each packet it renders what is due, gives the controller what came in, and
//! takes what is to be sent. It runs below the interrupts of clock and USB and above everything else, and nothing
//! shares the controller with it. It decides nothing about strokes.
//!
//! Invariant: the lines do what the controller has booked. Rendered too late is a fault, and forced low.

use crate::{usb, wave};
use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering::SeqCst};
use embassy_rp::interrupt;
use embassy_rp::interrupt::{InterruptExt, Priority};
use firmware_protocol::controller::{BLOCK, Controller, HORIZON, Identity, newer};
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::{Cause, State};
use firmware_protocol::tick::Tick;
use firmware_protocol::urgent::{Urgent, Watch};

/// Least ticks between a block being rendered and its first word being fetched, while enabled: the bench reads it.
#[unsafe(no_mangle)]
static SLACK_MIN: AtomicU32 = AtomicU32::new(HORIZON);
/// How often it has been woken: the watchdog is fed only while it goes on.
static TURNS: AtomicU32 = AtomicU32::new(0);
/// The controller's epoch as the USB interrupt may know it: [`OPEN`] and the epoch, or 0.
static EPOCH: AtomicU32 = AtomicU32::new(0);
/// An e-stop that the controller has not been told of: [`OPEN`] and its epoch, or 0.
static E_STOP: AtomicU32 = AtomicU32::new(0);
const OPEN: u32 = 1 << 16;

struct Owned<T>(UnsafeCell<T>);
// SAFETY: `start` alone touches what is in it before the interrupt is enabled, and after that the interrupt alone.
unsafe impl<T> Sync for Owned<T> {}
/// Made by the compiler: it would take the better part of the stack.
static CONTROLLER: Owned<Controller> = Owned(UnsafeCell::new(Controller::new(Identity::NONE)));
static SHELL: Owned<MaybeUninit<Shell>> = Owned(UnsafeCell::new(MaybeUninit::uninit()));

struct Shell {
    controller: &'static mut Controller,
    ports: usb::Ports,
    /// The pipe whose host has the session.
    active: usize,
    /// Looks for another host's hello on the other pipes.
    watches: [Watch; usb::PIPES],
    /// What is being sent.
    frame: [u8; MAX_FRAME],
}

/// Takes the controller and begins.
pub(crate) fn start(identity: Identity, cause: Cause, ports: usb::Ports) {
    // SAFETY: this is called once, before the interrupt is enabled.
    let controller = unsafe { &mut *CONTROLLER.0.get() };
    controller.introduce(identity, cause);
    let shell = Shell {
        controller,
        ports,
        active: 0,
        watches: [const { Watch::new() }; usb::PIPES],
        frame: [0; MAX_FRAME],
    };
    // SAFETY: the interrupt is not enabled yet, nobody else has it.
    unsafe { (*SHELL.0.get()).write(shell) };
    interrupt::SWI_IRQ_0.set_priority(Priority::P2);
    // SAFETY: no critical section relies on it being disabled.
    unsafe { interrupt::SWI_IRQ_0.enable() };
}

/// Has the shell look. From any context.
pub(crate) fn wake() {
    interrupt::SWI_IRQ_0.pend();
}

/// How often it has looked.
pub(crate) fn turns() -> u32 {
    TURNS.load(SeqCst)
}

/// An e-stop of the active host, seen in the USB interrupt: lines low at once, if it is news.
pub(crate) fn e_stop(epoch: u16) {
    let present = EPOCH.load(SeqCst);
    if present & OPEN != 0 && newer(epoch, present as u16) && E_STOP.load(SeqCst) == 0 {
        wave::freeze_low();
        E_STOP.store(OPEN | u32::from(epoch), SeqCst);
        wake();
    }
}

#[embassy_rp::interrupt]
fn SWI_IRQ_0() {
    // SAFETY: it was filled before this interrupt was enabled, which alone touches it and does not preempt itself.
    unsafe { (*SHELL.0.get()).assume_init_mut() }.turn();
    TURNS.store(turns().wrapping_add(1), SeqCst);
}

impl Shell {
    fn turn(&mut self) {
        // One thing at a time: blocks may have fallen due meanwhile.
        loop {
            self.take_e_stop();
            self.hold();
            self.render();
            let followed = self.controller.poll(wave::now());
            self.publish();
            if !(followed || self.take_lost() || self.send() || self.take_packet()) {
                break;
            }
        }
    }

    /// Holds the outputs low for as long as the controller says so, and lets them go in the tick in which it ends.
    fn hold(&self) {
        if self.controller.forced_off(wave::now()) {
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
        let e_stop = E_STOP.load(SeqCst);
        if e_stop & OPEN != 0 {
            self.controller.e_stop(wave::now(), e_stop as u16);
            E_STOP.store(0, SeqCst);
            wave::go_on();
        }
    }

    /// Tells the USB interrupt which e-stop would be news.
    fn publish(&self) {
        EPOCH.store(self.controller.epoch().map_or(0, |epoch| OPEN | u32::from(epoch)), SeqCst);
    }

    /// Renders each block that fits the horizon.
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
                SLACK_MIN.store(slack.min(SLACK_MIN.load(SeqCst)), SeqCst);
                if slack == 0 {
                    // Some of it may have been fetched before it was written.
                    self.starved(now);
                }
            }
        }
    }

    /// The DMA has come to what is not rendered. The lines are low there; what should have been played is not caught up with.
    fn starved(&mut self, now: Tick) {
        if matches!(self.controller.state(), State::Armed | State::Returning) {
            wave::force_low();
            self.controller.fault(now, Cause::Starved);
        }
        while self.controller.rendered() <= now + wave::FETCHED {
            // Whole blocks, whatever changes in them: the ring is cleared by blocks.
            let end = self.controller.rendered() + u64::from(BLOCK);
            while self.controller.rendered() < end {
                self.controller.render((end - self.controller.rendered()) as u32);
            }
        }
    }

    /// Gives the controller the next packet; `false` when there is none.
    fn take_packet(&mut self) -> bool {
        let Some((pipe, packet)) = self.ports.take() else { return false };
        let now = wave::now();
        if pipe != self.active {
            // A stray byte on the other pipe is nothing; a hello is another host.
            let Some(Urgent::Hello(session)) = self.watches[pipe].look(packet.bytes()) else { return true };
            self.active = pipe;
            usb::set_active(pipe);
            // Ends what the host before may have begun to say.
            self.controller.receive(now, &[0]);
            // It may have begun in a packet before; as far as it is in this one, it is a repetition.
            self.controller.open_session(now, session);
        }
        self.controller.receive(now, packet.bytes());
        true
    }

    /// Sends the next frame, if there is one and room for it.
    fn send(&mut self) -> bool {
        if !self.ports.has_room(self.active) {
            return false;
        }
        let len = self.controller.transmit(wave::now(), &mut self.frame);
        if len > 0 {
            self.ports.put(self.active, &self.frame[..len]);
        }
        len > 0
    }
}
