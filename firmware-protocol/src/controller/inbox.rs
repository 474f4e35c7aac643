//! Decodes the bytes of the host into the body of a frame, and keeps it until it is read.
//!
//! Reading a frame takes a piece of time of its own. There is a place for one: the controller decodes the next one when it
//! has taken this one.

use crate::frame::{Decoder, FrameError, MAX_FRAME};

#[derive(Clone, Debug)]
pub(super) struct Inbox {
    decoder: Decoder,
    body: [u8; MAX_FRAME],
    /// Length of the body that is not read yet.
    len: usize,
}

impl Inbox {
    pub(super) const EMPTY: Self = Self { decoder: Decoder::new(), body: [0; MAX_FRAME], len: 0 };

    /// Decodes bytes up to the end of the next frame, and removes them from `bytes`. `None` if no frame ends there.
    pub(super) fn decode(&mut self, bytes: &mut &[u8]) -> Option<Result<(), FrameError>> {
        let decoded = self.decoder.next(bytes)?;
        Some(decoded.map(|body| {
            if let Some(place) = self.body.get_mut(..body.len()) {
                place.copy_from_slice(body);
                self.len = body.len();
            }
        }))
    }

    /// The body that is not read yet, and its length; once.
    pub(super) fn take(&mut self) -> Option<([u8; MAX_FRAME], usize)> {
        let len = core::mem::take(&mut self.len);
        if len == 0 {
            return None;
        }
        Some((self.body, len))
    }

    /// Forgets a frame that has begun.
    pub(super) fn reset(&mut self) {
        self.decoder.reset();
    }
}
