//! The board: the mock in wall time, and the transfers that the host has requested.
//!
//! A transfer to the board completes at once; one from it waits until there are bytes, as on a real bus. The board answers frames on
//! the pipe they came from. A closed serial port (DTR falls) is a lost link; on the vendor pipe only the host timeout ends a session.

use crate::descriptors::{self, NOTIFICATIONS, SERIAL, VENDOR};
use firmware_protocol::message::State;
use firmware_protocol::tick::Tick;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::device::mock::Mock;
use std::collections::VecDeque;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::time::{Duration, Instant};
use usbip::usbip_protocol::{
    USBIP_RET_SUBMIT, USBIP_RET_UNLINK, UsbIpCommand, UsbIpHeaderBasic, UsbIpResponse,
};

/// Bytes for the host.
pub(crate) type Reply = Vec<u8>;

/// Intervals at which the board follows the clock: while pins may move, and while nothing can happen.
const AWAKE: Duration = Duration::from_millis(1);
const QUIET: Duration = Duration::from_secs(1);

/// Telemetry rate. Real boards send none; an emulated processor cannot read the mock's default of 1000 Hz.
const TELEMETRY_HZ: u32 = 100;

/// Results of a transfer, as Linux error numbers.
const DONE: u32 = 0;
const STALLED: u32 = (-32_i32).cast_unsigned();
const UNLINKED: u32 = (-104_i32).cast_unsigned();

/// A transfer to the host that waits for bytes.
#[derive(Debug)]
struct Waiting {
    header: UsbIpHeaderBasic,
    room: usize,
}

/// A board with power.
#[derive(Debug)]
pub(crate) struct Board {
    serial: String,
    mock: Mock,
    boot: u32,
    started: Instant,
    waiting: VecDeque<Waiting>,
    /// The endpoint that last received from the host.
    pipe: u32,
    line_coding: Vec<u8>,
    dtr: bool,
}

impl Board {
    pub(crate) fn switched_on(serial: &str) -> io::Result<Self> {
        let boot = RandomState::new().build_hasher().finish() as u32;
        Ok(Self {
            serial: serial.to_owned(),
            mock: Mock::new(
                Array::paper(),
                SimulatedMotorsConfig { telemetry_hz: TELEMETRY_HZ, ..SimulatedMotorsConfig::default() },
                boot,
            )
            .map_err(io::Error::other)?,
            boot,
            started: Instant::now(),
            waiting: VecDeque::new(),
            pipe: SERIAL,
            line_coding: vec![0, 0xC2, 1, 0, 0, 0, 8],
            dtr: false,
        })
    }

    pub(crate) fn boot(&self) -> u32 {
        self.boot
    }

    /// Time until the board must follow the clock again.
    pub(crate) fn nap(&self) -> Duration {
        match self.mock.controller().state() {
            State::Disarmed | State::Faulted => QUIET,
            _ => AWAKE,
        }
    }

    /// A command of the host.
    pub(crate) fn take(&mut self, command: UsbIpCommand, replies: &mut Vec<Reply>) {
        match command {
            UsbIpCommand::UsbIpCmdSubmit { header, setup, data, transfer_buffer_length, .. } => {
                let to_host = header.direction != 0;
                match header.ep {
                    0 => match self.control(setup, &data) {
                        Some(mut answer) => {
                            answer.truncate(transfer_buffer_length as usize);
                            let len = if to_host { answer.len() } else { data.len() };
                            replies.push(done(header, DONE, len, answer));
                        }
                        None => replies.push(done(header, STALLED, 0, vec![])),
                    },
                    NOTIFICATIONS | SERIAL | VENDOR if to_host => {
                        let room = transfer_buffer_length as usize;
                        self.waiting.push_back(Waiting { header, room });
                    }
                    SERIAL | VENDOR => {
                        self.hear(header.ep, &data);
                        replies.push(done(header, DONE, data.len(), vec![]));
                    }
                    _ => replies.push(done(header, STALLED, 0, vec![])),
                }
            }
            UsbIpCommand::UsbIpCmdUnlink { mut header, unlink_seqnum } => {
                header.command = USBIP_RET_UNLINK.into();
                let found = self.waiting.iter().position(|waiting| waiting.header.seqnum == unlink_seqnum);
                // A transfer that no longer waits has been answered.
                let status =
                    if found.and_then(|at| self.waiting.remove(at)).is_some() { UNLINKED } else { DONE };
                replies.push(UsbIpResponse::UsbIpRetUnlink { header, status }.to_bytes());
            }
            // A request for the device list has no place in this phase of the connection.
            UsbIpCommand::OpReqDevlist { .. } | UsbIpCommand::OpReqImport { .. } => {}
        }
    }

    fn hear(&mut self, pipe: u32, mut bytes: &[u8]) {
        if pipe != self.pipe {
            // Drop what the other host has not read.
            let mut unread = [0; 4096];
            while self.mock.read(&mut unread) > 0 {}
            self.pipe = pipe;
        }
        while !bytes.is_empty() {
            let taken = self.mock.write(bytes);
            bytes = &bytes[taken..];
            self.pass();
        }
    }

    fn pass(&mut self) {
        self.mock.run(Tick::BOOT + Array::paper().rate().duration_to_ticks(self.started.elapsed()));
    }

    /// Plays up to now and completes the host's waiting transfers.
    pub(crate) fn run(&mut self, replies: &mut Vec<Reply>) {
        self.pass();
        while let Some(at) =
            self.waiting.iter().position(|waiting| waiting.header.ep == self.pipe && waiting.room > 0)
        {
            let mut bytes = vec![0; self.waiting[at].room];
            let len = self.mock.read(&mut bytes);
            if len == 0 {
                break;
            }
            bytes.truncate(len);
            if let Some(Waiting { header, .. }) = self.waiting.remove(at) {
                replies.push(done(header, DONE, len, bytes));
            }
        }
    }

    /// Answers a request on endpoint 0; `None` if it is unknown.
    fn control(&mut self, setup: [u8; 8], data: &[u8]) -> Option<Vec<u8>> {
        let [kind, request, low, high, _, _, len_low, len_high] = setup;
        let mut answer = match (kind, request) {
            // GET_DESCRIPTOR, GET_CONFIGURATION, GET_INTERFACE, GET_STATUS
            (0x80, 6) => descriptors::descriptor(high, low, &self.serial)?,
            (0x80, 8) => vec![1],
            (0x81, 10) => vec![0],
            (0x80..=0x82, 0) => vec![0, 0],
            // SET_CONFIGURATION: the host has enumerated the board, perhaps again after a reset of the bus, which USB/IP does not show.
            (0x00, 9) => {
                self.mock.unplug();
                vec![]
            }
            // SET_INTERFACE, CLEAR_FEATURE
            (0x01, 11) | (0x00..=0x02, 1) => vec![],
            // CDC: SET_LINE_CODING, GET_LINE_CODING, SET_CONTROL_LINE_STATE, SEND_BREAK
            (0x21, 0x20) => {
                self.line_coding = data.to_vec();
                vec![]
            }
            (0xA1, 0x21) => self.line_coding.clone(),
            (0x21, 0x22) => {
                let dtr = low & 1 != 0;
                if std::mem::replace(&mut self.dtr, dtr) && !dtr && self.pipe == SERIAL {
                    self.mock.unplug();
                }
                vec![]
            }
            (0x21, 0x23) => vec![],
            _ => return None,
        };
        answer.truncate(u16::from_le_bytes([len_low, len_high]).into());
        Some(answer)
    }
}

fn done(mut header: UsbIpHeaderBasic, status: u32, len: usize, bytes: Vec<u8>) -> Reply {
    header.command = USBIP_RET_SUBMIT.into();
    let response = UsbIpResponse::UsbIpRetSubmit {
        header,
        status,
        actual_length: len as u32,
        start_frame: 0,
        number_of_packets: 0,
        error_count: 0,
        transfer_buffer: bytes,
        iso_packet_descriptor: vec![],
    };
    response.to_bytes()
}
