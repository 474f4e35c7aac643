//! USB: a serial port (CDC-ACM) and a vendor interface with two bulk endpoints, which carry the same frames.
//!
//! Tasks move packets to the shell and bytes from it without reading them. Only e-stops are looked for, in the interrupt
//! itself ([`Peek`]). A closed port, a reset or suspended bus and a lost configuration count as a lost link.
//!
//! Bounds: [`PACKETS`] from the host, then the host waits; [`BYTES`] to the host, then the controller keeps its frames.

use crate::board::{INTERFACE_GUIDS, NAME, PRODUCT, VENDOR};
use crate::setup::Driver;
use crate::{beat, control, estop, revive, setup, wake};
use core::cell::UnsafeCell;
use core::slice;
use core::sync::atomic::{AtomicU32, Ordering::SeqCst};
use embassy_futures::join::{join3, join4};
use embassy_futures::yield_now;
use embassy_rp::interrupt::typelevel::{Handler as OnInterrupt, USBCTRL_IRQ};
use embassy_rp::peripherals::USB;
use embassy_rp::usb::{Endpoint, In, InterruptHandler, Out};
use embassy_rp::{Peri, bind_interrupts, pac};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::Instant;
use embassy_usb::class::cdc_acm::{CdcAcmClass, ControlChanged, Receiver, Sender, State};
use embassy_usb::control::{OutResponse, Recipient, Request, RequestType};
use embassy_usb::driver::{Endpoint as _, EndpointError, EndpointIn, EndpointOut};
use embassy_usb::msos::{
    CompatibleIdFeatureDescriptor, PropertyData, RegistryPropertyFeatureDescriptor, windows_version,
};
use embassy_usb::{Builder, Config, Handler};
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::urgent::{Watch, e_stop_request, e_stop_requested};
use heapless::spsc::{Consumer, Producer, Queue};
use static_cell::StaticCell;

/// The longest bulk packet at full speed.
const PACKET: usize = 64;
/// Packets from the host that can wait for the shell, plus one.
const PACKETS: usize = 4;
/// Bytes that can wait for the host, plus one.
const BYTES: usize = 1024;
/// The serial port and the bulk interface.
pub(crate) const PIPES: usize = 2;
const SERIAL: usize = 0;
const BULK: usize = 1;
/// Stands for both pipes, when the bus is lost.
pub(crate) const ALL: usize = PIPES;

/// The vendor request by which Windows reads what driver the vendor interface wants (Microsoft OS 2.0 descriptors).
const WINDOWS_REQUEST: u8 = b'M';
const _: () = assert!(WINDOWS_REQUEST != e_stop_request(0)[1]);

/// Bit p: pipe p has lost its host. Bit [`ALL`]: the bus is lost.
static LOST: AtomicU32 = AtomicU32::new(0);
/// The pipe of the host that has the session.
static ACTIVE: AtomicU32 = AtomicU32::new(SERIAL as u32);
/// Signalled when there are bytes for the host.
static READY: [Signal<CriticalSectionRawMutex, ()>; PIPES] = [const { Signal::new() }; PIPES];

bind_interrupts!(struct Irqs {
    USBCTRL_IRQ => Peek, InterruptHandler<USB>, PeekAgain;
});

/// The bytes of a USB packet.
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

    /// Whether the pipe has room for a frame.
    pub(crate) fn has_room(&self, pipe: usize) -> bool {
        self.to_host[pipe].capacity() - self.to_host[pipe].len() >= MAX_FRAME
    }

    pub(crate) fn put(&mut self, pipe: usize, frame: &[u8]) {
        for &byte in frame {
            // The caller has checked that there is room.
            let _ = self.to_host[pipe].enqueue(byte);
        }
        READY[pipe].signal(());
    }
}

/// A link that was lost since the last call: a pipe's number, or [`ALL`].
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
    wake::shell();
}

/// E-stops of this pipe take effect from now on.
pub(crate) fn set_active(pipe: usize) {
    ACTIVE.store(pipe as u32, SeqCst);
}

/// Looks for an e-stop in each SETUP packet and each packet of the pipes, before embassy handles it.
struct Peek;

struct Watches(UnsafeCell<[Watch; PIPES]>);
// SAFETY: only the USB interrupt touches them, and it does not preempt itself.
unsafe impl Sync for Watches {}
static WATCHES: Watches = Watches(UnsafeCell::new([const { Watch::new() }; PIPES]));
/// Number of each pipe's OUT endpoint.
static ENDPOINTS: [AtomicU32; PIPES] = [const { AtomicU32::new(0) }; PIPES];

/// Looks for an e-stop in the last SETUP packet.
#[inline(always)]
fn take_setup() {
    if let Some(epoch) = e_stop_requested(setup::packet()) {
        estop::found(epoch, true);
    }
}

/// Looks at a SETUP packet that embassy has not been told of, if there is one. It is called again between the frames of a packet,
/// because some packets take longer to look into than the next SETUP packet takes to come.
#[inline(always)]
fn take_request() {
    if pac::USB.ints().read().setup_req() {
        take_setup();
        // Before the host's next packet: what is armed was for an earlier request.
        control::take_back();
    }
}

impl OnInterrupt<USBCTRL_IRQ> for Peek {
    unsafe fn on_interrupt() {
        // First: it takes the same time whatever the pipes bring.
        take_request();
        let full = pac::USB.buff_status().read();
        let mut waiting = 0;
        for (pipe, endpoint) in ENDPOINTS.iter().enumerate() {
            let endpoint = endpoint.load(SeqCst) as usize;
            if endpoint == 0 {
                continue;
            }
            if full.ep_out(endpoint) {
                look(pipe, endpoint);
            } else if is_waiting(endpoint) {
                waiting |= 1 << pipe;
            }
        }
        WAITING.store(waiting, SeqCst);
        // embassy's handler takes a third of a pulse period.
        take_request();
    }
}

/// Looks at what came after [`Peek`] had looked, but before embassy's handler did. The handler has taken note of it, so no
/// interrupt comes for it any more, and embassy's task may be late.
struct PeekAgain;

/// Bit p: pipe p was waiting for a packet when [`Peek`] had looked.
static WAITING: AtomicU32 = AtomicU32::new(0);

impl OnInterrupt<USBCTRL_IRQ> for PeekAgain {
    unsafe fn on_interrupt() {
        revive::interrupted();
        // A SETUP packet that embassy's task has not read yet. A packet that was seen before is found again, which changes
        // nothing.
        if pac::USB.sie_status().read().setup_rec() {
            take_setup();
        }
        let waiting = WAITING.load(SeqCst);
        if waiting == 0 {
            return;
        }
        for (pipe, endpoint) in ENDPOINTS.iter().enumerate() {
            let endpoint = endpoint.load(SeqCst) as usize;
            // If its bit is set, the packet came later still, and the next interrupt looks.
            if waiting >> pipe & 1 == 1
                && !is_waiting(endpoint)
                && !pac::USB.buff_status().read().ep_out(endpoint)
            {
                look(pipe, endpoint);
            }
        }
    }
}

/// Whether the endpoint has a buffer for the host's next packet.
fn is_waiting(endpoint: usize) -> bool {
    pac::USB_DPRAM.ep_out_buffer_control(endpoint).read().available(0)
}

/// Looks for an e-stop in the packet that has come for this pipe.
fn look(pipe: usize, endpoint: usize) {
    let len = pac::USB_DPRAM.ep_out_buffer_control(endpoint).read().length(0);
    let at = pac::USB_DPRAM.ep_out_control(endpoint - 1).read().buffer_address();
    let start = pac::USB_DPRAM.as_ptr().cast::<u8>().wrapping_add(at.into());
    // SAFETY: the packet stays in this memory until a task below the USB interrupt reads the endpoint.
    let mut packet = unsafe { slice::from_raw_parts(start, usize::from(len).min(PACKET)) };
    // SAFETY: see `Watches`.
    let watch = unsafe { &mut (*WATCHES.0.get())[pipe] };
    let is_active = pipe == ACTIVE.load(SeqCst) as usize;
    let is_new = |epoch| {
        take_request();
        is_active && estop::is_new(epoch)
    };
    while let Some(epoch) = watch.e_stop(&mut packet, is_new) {
        estop::found(epoch, false);
    }
}

/// Reports a lost bus to the shell, and accepts the request of an e-stop.
struct Bus;

impl Handler for Bus {
    fn control_out(&mut self, request: Request, _: &[u8]) -> Option<OutResponse> {
        let Request { request_type, recipient, request, value, index, length, .. } = request;
        let [low, high] = value.to_le_bytes();
        let vendor =
            (request_type, recipient, index, length) == (RequestType::Vendor, Recipient::Device, 0, 0);
        let setup = [0x40, request, low, high, 0, 0, 0, 0];
        let epoch = e_stop_requested(setup).filter(|_| vendor)?;
        // Needed if the SETUP packet came while embassy had its interrupt off. Otherwise it is a repetition.
        critical_section::with(|_| estop::found(epoch, true));
        Some(OutResponse::Accepted)
    }
    fn enabled(&mut self, _: bool) {
        lose(ALL);
    }
    fn reset(&mut self) {
        revive::set_configured(false);
        revive::set_suspended(false);
        lose(ALL);
    }
    fn configured(&mut self, configured: bool) {
        revive::set_configured(configured);
        if !configured {
            lose(ALL);
        }
    }
    fn suspended(&mut self, suspended: bool) {
        revive::set_suspended(suspended);
        if suspended {
            lose(ALL);
        }
    }
}

/// The USB device, ready to run.
pub(crate) struct Usb {
    device: embassy_usb::UsbDevice<'static, Driver>,
    serial: (Sender<'static, Driver>, Receiver<'static, Driver>, ControlChanged<'static>),
    bulk: (Endpoint<'static, USB, In>, Endpoint<'static, USB, Out>),
    to_shell: [Producer<'static, Packet>; PIPES],
    from_shell: [Consumer<'static, u8>; PIPES],
}

/// Sets up the device with this serial number.
pub(crate) fn new(usb: Peri<'static, USB>, serial_number: &'static str) -> (Usb, Ports) {
    static PACKET_QUEUES: StaticCell<[Packets; PIPES]> = StaticCell::new();
    static BYTE_QUEUES: StaticCell<[Bytes; PIPES]> = StaticCell::new();
    static DESCRIPTORS: StaticCell<[[u8; 256]; 3]> = StaticCell::new();
    static CONTROL: StaticCell<[u8; 64]> = StaticCell::new();
    static STATE: StaticCell<State<'static>> = StaticCell::new();
    static BUS: StaticCell<Bus> = StaticCell::new();

    let mut config = Config::new(VENDOR, PRODUCT);
    config.manufacturer = Some(NAME);
    config.product = Some(NAME);
    config.serial_number = Some(serial_number);
    let [configuration, bos, windows] = DESCRIPTORS.init([[0; 256]; 3]);
    let driver = Driver(embassy_rp::usb::Driver::new(usb, Irqs));
    let mut builder = Builder::new(driver, config, configuration, bos, windows, CONTROL.init([0; 64]));
    builder.handler(BUS.init(Bus));
    builder.msos_descriptor(windows_version::WIN8_1, WINDOWS_REQUEST);
    let class = CdcAcmClass::new(&mut builder, STATE.init(State::new()), PACKET as u16);
    let (sender, receiver, control) = class.split_with_control();
    let mut function = builder.function(0xff, 0, 0);
    // Windows then gives the vendor interface its own driver, by which a program without rights reaches it, and its e-stop request.
    function.msos_feature(CompatibleIdFeatureDescriptor::new("WINUSB", ""));
    let guids = PropertyData::RegMultiSz(INTERFACE_GUIDS);
    function.msos_feature(RegistryPropertyFeatureDescriptor::new("DeviceInterfaceGUIDs", guids));
    let mut interface = function.interface();
    let mut setting = interface.alt_setting(0xff, 0, 0, None);
    let out = setting.endpoint_bulk_out(None, PACKET as u16);
    let into = setting.endpoint_bulk_in(None, PACKET as u16);
    drop(function);
    ENDPOINTS[BULK].store(out.info().addr.index() as u32, SeqCst);
    // The serial port's is the only other OUT endpoint.
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
    /// Runs the device. Never ends.
    pub(crate) async fn run(self) {
        let Self { mut device, serial: (sender, receiver, lines), bulk: (into, out), to_shell, from_shell } =
            self;
        let ([to_serial, to_bulk], [from_serial, from_bulk]) = (to_shell, from_shell);
        join4(
            device.run(),
            revive::supervise(|| lose(ALL)),
            join3(inbound(SERIAL, receiver, to_serial), outbound(SERIAL, sender, from_serial), closed(lines)),
            join3(control::watch(), inbound(BULK, out, to_bulk), outbound(BULK, into, from_bulk)),
        )
        .await;
    }
}

/// An endpoint that packets come from.
trait Source {
    async fn open(&mut self);
    async fn read(&mut self, packet: &mut [u8; PACKET]) -> Result<usize, EndpointError>;
}

/// An endpoint that packets go to.
trait Sink {
    async fn open(&mut self);
    async fn write(&mut self, packet: &[u8]) -> Result<(), EndpointError>;
}

impl Source for Receiver<'static, Driver> {
    async fn open(&mut self) {
        self.wait_connection().await;
    }
    async fn read(&mut self, packet: &mut [u8; PACKET]) -> Result<usize, EndpointError> {
        self.read_packet(packet).await
    }
}

impl Sink for Sender<'static, Driver> {
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

/// Moves packets to the shell, in order. It waits while the shell's queue is full.
async fn inbound(pipe: usize, mut source: impl Source, mut shell: Producer<'static, Packet>) {
    loop {
        source.open().await;
        let mut bytes = [0; PACKET];
        let mut yielded = Instant::now();
        while let Ok(len) = source.read(&mut bytes).await {
            let mut packet = Packet { bytes, len };
            while let Err(unsent) = shell.enqueue(packet) {
                packet = unsent;
                yield_now().await;
            }
            wake::shell();
            // Packets that follow each other closely keep the task of the heartbeat waiting, which feeds the watchdog too.
            beat::executor_beats();
            if yielded.elapsed() >= beat::EVERY {
                yield_now().await;
                yielded = Instant::now();
            }
        }
        lose(pipe);
    }
}

/// Moves bytes from the shell to the host, in packets. Bytes that wait when a host disconnects may reach the next one,
/// because embassy's endpoints wait for a host instead of failing; the next host ignores them by their session.
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
            // The host sees the end of a transfer of full packets only by an empty packet.
            if sink.write(&packet[..len]).await.is_err()
                || (len == PACKET && shell.is_empty() && sink.write(&[]).await.is_err())
            {
                break;
            }
            // There may be room now for the controller's next frame.
            wake::shell();
        }
    }
}

/// Reports to the shell that a program has closed the serial port.
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
