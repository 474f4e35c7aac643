//! Frames: whatever the chunks, a decoder finds the same bodies, and it is synchronised after a zero.

use crate::input::{Raw, chunk};
use arbitrary::Unstructured;
use firmware_protocol::frame::{self, Decoder, FRAME_OVERHEAD, FrameError, MAX_FRAME};
use firmware_protocol::message::{DeviceMessage, HostMessage};
use firmware_protocol::urgent::{Urgent, Watch};

/// Half of the inputs are bytes on the line, the others bodies that are encoded first.
pub fn run(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let (Ok(encoded), Ok(cut)) = (input.arbitrary::<bool>(), input.arbitrary::<u8>()) else { return };
    if encoded {
        round_trip(&mut input, cut);
    } else {
        in_any_chunks(input.take_rest(), cut);
    }
}

/// The bodies of a stream are the same, however it is cut.
fn in_any_chunks(bytes: &[u8], cut: u8) {
    let (mut whole, mut pieces) = (Decoder::new(), Decoder::new());
    let (mut watch, mut watched) = (Watch::new(), 0_u32);
    let mut rest = bytes;
    let mut chunks = bytes.chunks(usize::from(cut).max(1));
    let mut piece: &[u8] = &[];
    while let Some(body) = whole.next(&mut rest) {
        // The other decoder comes to the same body.
        let same = loop {
            if let Some(found) = pieces.next(&mut piece) {
                break found;
            }
            piece = chunks.next().expect("the bytes of a body that the whole stream has");
            watched += u32::from(matches!(watch.look(piece), Some(Urgent::EStop(_))));
        };
        assert_eq!(body, same);
        see(body);
    }
    // After a zero a decoder reads a good frame, whatever came before.
    let mut good = [0; MAX_FRAME];
    let len = frame::encode(&HostMessage::Hello { session: watched }, &mut good).expect("a short message");
    let mut rest: &[u8] = &[0];
    while whole.next(&mut rest).is_some() {}
    let mut rest = &good[..len];
    let body = whole.next(&mut rest).expect("a frame");
    assert_eq!(frame::read(body), Ok(HostMessage::Hello { session: watched }));
}

/// What a body is read as is written as a body that reads the same.
fn see(body: Result<&[u8], FrameError>) {
    let Ok(body) = body else { return };
    assert!(body.len() + FRAME_OVERHEAD <= MAX_FRAME);
    if let Ok(message) = frame::read::<HostMessage<'_>>(Ok(body)) {
        again(&message, |body| assert_eq!(frame::read(body), Ok(message)));
    }
    if let Ok(message) = frame::read::<DeviceMessage>(Ok(body)) {
        again(&message, |body| assert_eq!(frame::read(body), Ok(message)));
    }
}

fn again(message: &impl serde::Serialize, check: impl FnOnce(Result<&[u8], FrameError>)) {
    let mut out = [0; MAX_FRAME];
    // A text that is read may be longer than the shortest that says the same, and never shorter.
    let len = frame::encode(message, &mut out).expect("a message that was read fits a frame");
    let mut decoder = Decoder::new();
    check(decoder.next(&mut &out[..len]).expect("a frame"));
}

/// Bodies that are encoded one after the other come out as they went in.
fn round_trip(input: &mut Unstructured<'_>, cut: u8) {
    let mut decoder = Decoder::new();
    let mut watch = Watch::new();
    let mut out = [0; MAX_FRAME];
    while !input.is_empty() {
        let body = chunk(input);
        let Ok(len) = frame::encode(&Raw(body), &mut out) else {
            assert!(body.len() + FRAME_OVERHEAD > MAX_FRAME, "{} bytes have room", body.len());
            continue;
        };
        assert_eq!(len, body.len() + FRAME_OVERHEAD);
        assert_eq!(out[..len].iter().position(|&byte| byte == 0), Some(len - 1), "the only zero ends it");
        let (first, second) = out[..len].split_at(usize::from(cut) % len);
        let urgent = watch.look(first).or(watch.look(second));
        assert!(decoder.next(&mut &*first).is_none(), "the frame has not ended");
        let found = decoder.next(&mut &*second).expect("a frame");
        assert_eq!(found, Ok(body));
        // An e-stop is found early exactly if it is one.
        let message = frame::read::<HostMessage<'_>>(found);
        let is_urgent = match message {
            Ok(HostMessage::Hello { session }) => Some(Urgent::Hello(session)),
            Ok(HostMessage::Control { epoch, op: firmware_protocol::message::Op::EStop, .. }) => {
                Some(Urgent::EStop(epoch))
            }
            _ => None,
        };
        // A number in a longer form than this program's may hide it there; it is read in order all the same.
        let mut shortest = [0; MAX_FRAME];
        let is_shortest = message.is_ok_and(|message| {
            frame::encode(&message, &mut shortest).is_ok_and(|own| shortest[..own] == out[..len])
        });
        assert!(urgent == is_urgent || (urgent.is_none() && !is_shortest), "{urgent:?}, not {is_urgent:?}");
        see(Ok(body));
    }
}
