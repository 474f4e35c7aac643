//! embassy's driver, with a control pipe that loses no request.
//!
//! A host may give a request up and make another one at any time (USB 2.0, 5.5.5 and 8.5.3). embassy's driver reads a SETUP packet and
//! then clears its flag, so it loses another one that comes in between: it waits for the data of a request that the host has given up,
//! and the host waits for the answer to its next one. [`Pipe`] reads the packet again after the flag is cleared.

use embassy_rp::pac;
use embassy_rp::peripherals::USB;
use embassy_usb::driver;
use embassy_usb::driver::{ControlPipe, EndpointAddress, EndpointAllocError, EndpointError, EndpointType};

type Inner = embassy_rp::usb::Driver<'static, USB>;
type InnerPipe = <Inner as driver::Driver<'static>>::ControlPipe;

/// The last SETUP packet: the first bytes of the USB memory.
pub(crate) fn packet() -> [u8; 8] {
    let words = pac::USB_DPRAM.as_ptr().cast::<u32>();
    // SAFETY: this memory is always there.
    let [low, high] = [0, 1].map(|at| unsafe { words.wrapping_add(at).read_volatile() }.to_le_bytes());
    let [a, b, c, d] = low;
    let [e, f, g, h] = high;
    [a, b, c, d, e, f, g, h]
}

/// The last SETUP packet, whose flag is cleared. One that comes later finds the flag cleared, and sets it.
fn take() -> [u8; 8] {
    loop {
        let packet = packet();
        if !pac::USB.sie_status().read().setup_rec() {
            return packet;
        }
        // It came after embassy had cleared the flag, and its bytes may be of two packets.
        pac::USB.sie_status().write(|w| w.set_setup_rec(true));
    }
}

/// The driver of the USB device.
pub(crate) struct Driver(pub(crate) Inner);

impl driver::Driver<'static> for Driver {
    type EndpointOut = <Inner as driver::Driver<'static>>::EndpointOut;
    type EndpointIn = <Inner as driver::Driver<'static>>::EndpointIn;
    type ControlPipe = Pipe;
    type Bus = <Inner as driver::Driver<'static>>::Bus;

    fn alloc_endpoint_out(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        max_packet_size: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointOut, EndpointAllocError> {
        self.0.alloc_endpoint_out(kind, address, max_packet_size, interval_ms)
    }
    fn alloc_endpoint_in(
        &mut self,
        kind: EndpointType,
        address: Option<EndpointAddress>,
        max_packet_size: u16,
        interval_ms: u8,
    ) -> Result<Self::EndpointIn, EndpointAllocError> {
        self.0.alloc_endpoint_in(kind, address, max_packet_size, interval_ms)
    }
    fn start(self, control_max_packet_size: u16) -> (Self::Bus, Self::ControlPipe) {
        let (bus, pipe) = self.0.start(control_max_packet_size);
        (bus, Pipe(pipe))
    }
}

/// The request of the descriptor that a device has if it knows high speed as well. One that does not refuses it (USB 2.0, 9.6.2), but embassy
/// answers: it gets to see a request of a descriptor that there is not.
const GET_DESCRIPTOR: u8 = 6;
const DEVICE_QUALIFIER: u8 = 6;

/// Endpoint 0.
pub(crate) struct Pipe(InnerPipe);

impl ControlPipe for Pipe {
    fn max_packet_size(&self) -> usize {
        self.0.max_packet_size()
    }
    async fn setup(&mut self) -> [u8; 8] {
        self.0.setup().await;
        let mut packet = take();
        if let [0x80, GET_DESCRIPTOR, _, kind @ DEVICE_QUALIFIER, ..] = &mut packet {
            *kind = 0;
        }
        packet
    }
    async fn data_out(&mut self, buf: &mut [u8], first: bool, last: bool) -> Result<usize, EndpointError> {
        self.0.data_out(buf, first, last).await
    }
    async fn data_in(&mut self, data: &[u8], first: bool, last: bool) -> Result<(), EndpointError> {
        self.0.data_in(data, first, last).await
    }
    async fn accept(&mut self) {
        self.0.accept().await;
    }
    async fn reject(&mut self) {
        self.0.reject().await;
    }
    async fn accept_set_address(&mut self, addr: u8) {
        self.0.accept_set_address(addr).await;
    }
}
