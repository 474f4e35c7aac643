//! Finds a USB controller that hangs, and sets it up again.
//!
//! By erratum RP2040-E15 a bus error in an IN transfer may hang the controller; only a reset of the peripheral ends that, and
//! embassy's driver has no workaround. A host begins a frame in each millisecond. So the controller hangs if
//! the device is configured and not suspended, and sees no frame and no packet for [`SILENT`] looks. [`supervise`] then takes it
//! off the bus, resets it and connects it again; the host enumerates it as after a re-plug. The link counts as lost as soon as
//! the hang is seen, so the pins return. The same looks find an unplugged cable ([`cable`](crate::cable)).

use crate::cable::{Cable, Change};
use crate::{control, counters};
use core::array;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::SeqCst};
use embassy_rp::interrupt;
use embassy_rp::interrupt::InterruptExt;
use embassy_rp::pac;
use embassy_time::{Duration, Timer};

/// Time between two looks.
const EVERY: Duration = Duration::from_millis(10);
/// Looks without a sign of life: 100 ms. A host that resumes a suspended bus sends no frame for up to 43 ms.
const SILENT: u32 = 10;
/// For how long the device stays off the bus, so that every host sees it.
const OFF: Duration = Duration::from_millis(20);

/// The host has configured the device.
static CONFIGURED: AtomicBool = AtomicBool::new(false);
/// The host has suspended the bus.
static SUSPENDED: AtomicBool = AtomicBool::new(false);
/// Number of USB interrupts.
static INTERRUPTS: AtomicU32 = AtomicU32::new(0);

pub(crate) fn set_configured(configured: bool) {
    CONFIGURED.store(configured, SeqCst);
}

pub(crate) fn set_suspended(suspended: bool) {
    SUSPENDED.store(suspended, SeqCst);
}

/// Something has happened on the bus. From the USB interrupt.
pub(crate) fn interrupted() {
    INTERRUPTS.store(INTERRUPTS.load(SeqCst).wrapping_add(1), SeqCst);
}

/// Looks for ever, and calls `lost` when the controller hangs or the cable is unplugged.
pub(crate) async fn supervise(lost: impl Fn()) -> ! {
    let (mut before, mut silent, mut cable) = ((0, 0), 0, Cable::NEW);
    loop {
        Timer::after(EVERY).await;
        match cable.look() {
            Change::None => {}
            Change::Plugged => connect(true),
            Change::Unplugged => {
                lost();
                set_configured(false);
                connect(false);
            }
        }
        let signs = (pac::USB.sof_rd().read().count(), INTERRUPTS.load(SeqCst));
        let expected = CONFIGURED.load(SeqCst) && !SUSPENDED.load(SeqCst);
        silent = if expected && signs == before { silent + 1 } else { 0 };
        before = signs;
        if silent == SILENT {
            lost();
            counters::usb_recovered();
            set_configured(false);
            reset();
            Timer::after(OFF).await;
            connect(!cable.is_unplugged());
            silent = 0;
        }
    }
}

/// Words of the controller's memory before the packets: the last SETUP packet, the endpoints' controls, those of their buffers.
const SETUP: usize = 2;
const CONTROLS: usize = 32;
const WORDS: usize = 64;
/// The bit that enables an endpoint.
const ENABLED: u32 = 1 << 31;
/// Words of registers, from the first one.
const REGISTERS: usize = 0x9c / 4;

/// Resets the controller and sets it up as embassy's driver has, off the bus. The endpoints keep their buffers and are disabled; the
/// host's reset of the bus, which follows, does the rest.
fn reset() {
    // Nothing else may touch the controller meanwhile: the tasks run on this executor, too.
    interrupt::USBCTRL_IRQ.disable();
    // A control transfer that is waited for ends.
    control::take_back();
    let memory = pac::USB_DPRAM.as_ptr().cast::<u32>();
    // SAFETY: these words are always there, and only the core writes them while the controller is off the bus.
    let mut words: [u32; WORDS] = array::from_fn(|at| unsafe { memory.wrapping_add(at).read_volatile() });
    words[..SETUP].fill(0);
    for control in &mut words[SETUP..CONTROLS] {
        *control &= !ENABLED;
    }
    pac::RESETS.reset().modify(|w| w.set_usbctrl(true));
    pac::RESETS.reset().modify(|w| w.set_usbctrl(false));
    while !pac::RESETS.reset_done().read().usbctrl() {}
    let usb = pac::USB;
    for at in 0..REGISTERS {
        // SAFETY: all of them are registers of the controller, as in embassy's driver.
        unsafe { usb.as_ptr().cast::<u32>().wrapping_add(at).write_volatile(0) };
    }
    for (at, word) in words.into_iter().enumerate() {
        // SAFETY: as above.
        unsafe { memory.wrapping_add(at).write_volatile(word) };
    }
    usb.usb_muxing().write(|w| {
        w.set_to_phy(true);
        w.set_softcon(true);
    });
    usb.usb_pwr().write(|w| {
        w.set_vbus_detect(true);
        w.set_vbus_detect_override_en(true);
    });
    usb.main_ctrl().write(|w| w.set_controller_en(true));
    usb.inte().write(|w| {
        w.set_bus_reset(true);
        w.set_buff_status(true);
        w.set_dev_resume_from_host(true);
        w.set_dev_suspend(true);
        w.set_setup_req(true);
    });
    usb.int_ep_ctrl().write(|w| w.set_int_ep_active(0xfffe));
    usb.sie_ctrl().write(|w| w.set_ep0_int_1buf(true));
    interrupt::USBCTRL_IRQ.unpend();
    // SAFETY: it was enabled before, and no critical section relies on it.
    unsafe { interrupt::USBCTRL_IRQ.enable() };
}

/// Shows the device to the host, or takes it off the bus.
fn connect(shown: bool) {
    pac::USB.sie_ctrl().modify(|w| w.set_pullup_en(shown));
}
