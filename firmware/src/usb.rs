//! USB: a serial port (CDC-ACM) and a vendor interface with two bulk endpoints, the same frames on both.
//!
//! Packets go to the shell as they come and bytes from it as they are there; what they say is not looked at, but for
//! an e-stop, which the interrupt itself sees ([`Peek`]). A port that is closed, a bus that is reset or suspended and
//! a configuration that is taken back are told to the shell as a lost link.
//!
//! Bounds: [`PACKETS`] from the host (then it has to wait), [`BYTES`] to it (then the controller keeps them).

use crate::board::{NAME, PRODUCT, VENDOR};
use crate::shell;
use core::cell::UnsafeCell;
use core::slice;
use core::sync::atomic::{AtomicU32, Ordering::SeqCst};
use embassy_futures::join::{join, join3};
use embassy_futures::yield_now;
use embassy_rp::interrupt::typelevel::{Handler as OnInterrupt, USBCTRL_IRQ};
use embassy_rp::peripherals::USB;
use embassy_rp::usb::{Driver, Endpoint, In, InterruptHandler, Out};
use embassy_rp::{Peri, bind_interrupts, pac};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_usb::class::cdc_acm::{CdcAcmClass, ControlChanged, Receiver, Sender, State};
use embassy_usb::driver::{Endpoint as _, EndpointError, EndpointIn, EndpointOut};
use embassy_usb::{Builder, Config, Handler};
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::urgent::{Urgent, Watch};
use heapless::spsc::{Consumer, Producer, Queue};
use static_cell::StaticCell;

/// Full speed's longest bulk packet.
const PACKET: usize = 64;
/// Packets from the host that wait for the shell, less one.
const PACKETS: usize = 4;
/// Bytes that wait for the host, less one.
const BYTES: usize = 1024;
/// The serial port and the bulk interface.
pub(crate) const PIPES: usize = 2;
const SERIAL: usize = 0;
const BULK: usize = 1;
/// Both pipes, as a lost link.
pub(crate) const ALL: usize = PIPES;

/// Bit p: pipe p has lost its host; the last one: the bus.
static LOST: AtomicU32 = AtomicU32::new(0);
/// The pipe whose host has the session.
static ACTIVE: AtomicU32 = AtomicU32::new(SERIAL as u32);
/// Rung when there are bytes for the host.
static READY: [Signal<CriticalSectionRawMutex, ()>; PIPES] = [const { Signal::new() }; PIPES];

bind_interrupts!(struct Irqs {
    USBCTRL_IRQ => Peek, InterruptHandler<USB>;
});

/// Up to a USB packet of bytes.
pub(crate) struct Packet {
    bytes: [u8; PACKET],
    len: usize,
}

impl Packet {
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes[..self.len]
    }
}

type Packets = Queue<Packet, PACKETS>;
type Bytes = Queue<u8, BYTES>;

/// The shell's ends of all pipes.
pub(crate) struct Ports {
    from_host: [Consumer<'static, Packet>; PIPES],
    to_host: [Producer<'static, u8>; PIPES],
}

impl Ports {
    /// The next packet, and its pipe.
    pub(crate) fn take(&mut self) -> Option<(usize, Packet)> {
        self.from_host.iter_mut().enumerate().find_map(|(pipe, queue)| Some((pipe, queue.dequeue()?)))
    }

    /// Whether a frame can be put.
    pub(crate) fn has_room(&self, pipe: usize) -> bool {
        self.to_host[pipe].capacity() - self.to_host[pipe].len() >= MAX_FRAME
    }

    pub(crate) fn put(&mut self, pipe: usize, frame: &[u8]) {
        for &byte in frame {
            // There was room.
            let _ = self.to_host[pipe].enqueue(byte);
        }
        READY[pipe].signal(());
    }
}

/// A link that has been lost since the last call: a pipe's, or [`ALL`].
pub(crate) fn take_lost() -> Option<usize> {
    critical_section::with(|_| {
        let lost = LOST.load(SeqCst);
        let pipe = lost.trailing_zeros();
        LOST.store(lost & lost.wrapping_sub(1), SeqCst);
        (lost != 0).then_some(pipe as usize)
    })
}

fn lose(pipe: usize) {
    critical_section::with(|_| LOST.store(LOST.load(SeqCst) | 1 << pipe, SeqCst));
    shell::wake();
}

/// From now on this pipe's e-stops count.
pub(crate) fn set_active(pipe: usize) {
    ACTIVE.store(pipe as u32, SeqCst);
}

/// Looks at each packet before embassy does, for an e-stop.
struct Peek;

struct Watches(UnsafeCell<[Watch; PIPES]>);
// SAFETY: only the USB interrupt touches them, which does not preempt itself.
unsafe impl Sync for Watches {}
static WATCHES: Watches = Watches(UnsafeCell::new([const { Watch::new() }; PIPES]));
/// Number of each pipe's OUT endpoint.
static ENDPOINTS: [AtomicU32; PIPES] = [const { AtomicU32::new(0) }; PIPES];

impl OnInterrupt<USBCTRL_IRQ> for Peek {
    unsafe fn on_interrupt() {
        let full = pac::USB.buff_status().read();
        for (pipe, endpoint) in ENDPOINTS.iter().enumerate() {
            let endpoint = endpoint.load(SeqCst) as usize;
            if endpoint == 0 || !full.ep_out(endpoint) {
                continue;
            }
            let len = pac::USB_DPRAM.ep_out_buffer_control(endpoint).read().length(0);
            let at = pac::USB_DPRAM.ep_out_control(endpoint - 1).read().buffer_address();
            let start = pac::USB_DPRAM.as_ptr().cast::<u8>().wrapping_add(at.into());
            // SAFETY: the packet is in this memory until the endpoint is read, by a task below this interrupt.
            let packet = unsafe { slice::from_raw_parts(start, usize::from(len).min(PACKET)) };
            // SAFETY: see `Watches`.
            let watch = unsafe { &mut (*WATCHES.0.get())[pipe] };
            if let Some(Urgent::EStop(epoch)) = watch.look(packet)
                && pipe == ACTIVE.load(SeqCst) as usize
            {
                shell::e_stop(epoch);
            }
        }
    }
}

/// Tells the shell of a bus that is gone.
struct Bus;

impl Handler for Bus {
    fn enabled(&mut self, _: bool) {
        lose(ALL);
    }
    fn reset(&mut self) {
        lose(ALL);
    }
    fn configured(&mut self, configured: bool) {
        if !configured {
            lose(ALL);
        }
    }
    fn suspended(&mut self, suspended: bool) {
        if suspended {
            lose(ALL);
        }
    }
}

/// The device, to be run.
pub(crate) struct Usb {
    device: embassy_usb::UsbDevice<'static, Driver<'static, USB>>,
    serial: (
        Sender<'static, Driver<'static, USB>>,
        Receiver<'static, Driver<'static, USB>>,
        ControlChanged<'static>,
    ),
    bulk: (Endpoint<'static, USB, In>, Endpoint<'static, USB, Out>),
    to_shell: [Producer<'static, Packet>; PIPES],
    from_shell: [Consumer<'static, u8>; PIPES],
}

/// Sets up the device with this serial number.
pub(crate) fn new(usb: Peri<'static, USB>, serial_number: &'static str) -> (Usb, Ports) {
    static PACKET_QUEUES: StaticCell<[Packets; PIPES]> = StaticCell::new();
    static BYTE_QUEUES: StaticCell<[Bytes; PIPES]> = StaticCell::new();
    static DESCRIPTORS: StaticCell<[[u8; 256]; 2]> = StaticCell::new();
    static CONTROL: StaticCell<[u8; 64]> = StaticCell::new();
    static STATE: StaticCell<State<'static>> = StaticCell::new();
    static BUS: StaticCell<Bus> = StaticCell::new();

    let mut config = Config::new(VENDOR, PRODUCT);
    config.manufacturer = Some(NAME);
    config.product = Some(NAME);
    config.serial_number = Some(serial_number);
    let [configuration, bos] = DESCRIPTORS.init([[0; 256]; 2]);
    let driver = Driver::new(usb, Irqs);
    let mut builder = Builder::new(driver, config, configuration, bos, &mut [], CONTROL.init([0; 64]));
    builder.handler(BUS.init(Bus));
    let class = CdcAcmClass::new(&mut builder, STATE.init(State::new()), PACKET as u16);
    let (sender, receiver, control) = class.split_with_control();
    let mut function = builder.function(0xff, 0, 0);
    let mut interface = function.interface();
    let mut setting = interface.alt_setting(0xff, 0, 0, None);
    let out = setting.endpoint_bulk_out(None, PACKET as u16);
    let into = setting.endpoint_bulk_in(None, PACKET as u16);
    drop(function);
    ENDPOINTS[BULK].store(out.info().addr.index() as u32, SeqCst);
    // The serial port's is the only other one.
    ENDPOINTS[SERIAL].store(out.info().addr.index() as u32 - 1, SeqCst);

    let [a, b] = PACKET_QUEUES.init([const { Queue::new() }; PIPES]).each_mut().map(Queue::split);
    let [c, d] = BYTE_QUEUES.init([const { Queue::new() }; PIPES]).each_mut().map(Queue::split);
    let ports = Ports { from_host: [a.1, b.1], to_host: [c.0, d.0] };
    let usb = Usb {
        device: builder.build(),
        serial: (sender, receiver, control),
        bulk: (into, out),
        to_shell: [a.0, b.0],
        from_shell: [c.1, d.1],
    };
    (usb, ports)
}

impl Usb {
    /// Runs for ever.
    pub(crate) async fn run(self) {
        let Self { mut device, serial: (sender, receiver, control), bulk: (into, out), to_shell, from_shell } =
            self;
        let ([to_serial, to_bulk], [from_serial, from_bulk]) = (to_shell, from_shell);
        join3(
            device.run(),
            join3(
                inbound(SERIAL, receiver, to_serial),
                outbound(SERIAL, sender, from_serial),
                closed(control),
            ),
            join(inbound(BULK, out, to_bulk), outbound(BULK, into, from_bulk)),
        )
        .await;
    }
}

/// What packets come from.
trait Source {
    async fn open(&mut self);
    async fn read(&mut self, packet: &mut [u8; PACKET]) -> Result<usize, EndpointError>;
}

/// Where packets go.
trait Sink {
    async fn open(&mut self);
    async fn write(&mut self, packet: &[u8]) -> Result<(), EndpointError>;
}

impl Source for Receiver<'static, Driver<'static, USB>> {
    async fn open(&mut self) {
        self.wait_connection().await;
    }
    async fn read(&mut self, packet: &mut [u8; PACKET]) -> Result<usize, EndpointError> {
        self.read_packet(packet).await
    }
}

impl Sink for Sender<'static, Driver<'static, USB>> {
    async fn open(&mut self) {
        self.wait_connection().await;
    }
    async fn write(&mut self, packet: &[u8]) -> Result<(), EndpointError> {
        self.write_packet(packet).await
    }
}

impl Source for Endpoint<'static, USB, Out> {
    async fn open(&mut self) {
        self.wait_enabled().await;
    }
    async fn read(&mut self, packet: &mut [u8; PACKET]) -> Result<usize, EndpointError> {
        EndpointOut::read(self, packet).await
    }
}

impl Sink for Endpoint<'static, USB, In> {
    async fn open(&mut self) {
        self.wait_enabled().await;
    }
    async fn write(&mut self, packet: &[u8]) -> Result<(), EndpointError> {
        EndpointIn::write(self, packet).await
    }
}

/// Packets to the shell, in order; it takes each one before the next can come.
async fn inbound(pipe: usize, mut source: impl Source, mut shell: Producer<'static, Packet>) {
    loop {
        source.open().await;
        let mut bytes = [0; PACKET];
        while let Ok(len) = source.read(&mut bytes).await {
            let mut packet = Packet { bytes, len };
            while let Err(unsent) = shell.enqueue(packet) {
                packet = unsent;
                yield_now().await;
            }
            shell::wake();
        }
        lose(pipe);
    }
}

/// Bytes from the shell, in packets. What waits when a host goes reaches the next one, who knows by its session that it
/// is not meant: embassy's endpoints wait for a host rather than fail.
async fn outbound(pipe: usize, mut sink: impl Sink, mut shell: Consumer<'static, u8>) {
    loop {
        sink.open().await;
        while shell.dequeue().is_some() {}
        loop {
            let mut packet = [0; PACKET];
            let mut len = 0;
            while len < PACKET
                && let Some(byte) = shell.dequeue()
            {
                packet[len] = byte;
                len += 1;
            }
            if len == 0 {
                READY[pipe].wait().await;
                continue;
            }
            // A transfer of full packets would not end for the host without an empty one.
            if sink.write(&packet[..len]).await.is_err()
                || (len == PACKET && shell.is_empty() && sink.write(&[]).await.is_err())
            {
                break;
            }
            // There may be room again for a frame that the controller keeps.
            shell::wake();
        }
    }
}

/// Tells the shell when a program has closed the serial port.
async fn closed(control: ControlChanged<'static>) {
    let mut open = false;
    loop {
        control.control_changed().await;
        if open && !control.dtr() {
            lose(SERIAL);
        }
        open = control.dtr();
    }
}
