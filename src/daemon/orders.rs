//! Emergency stops among the requests of one connection: ordered when their bytes are there, whatever waits before them.
//!
//! The bytes go through [`Orders::take`] before hyper gets them. It orders each emergency stop that the [`Gate`] lets through, and keeps
//! its number until the server comes to that request ([`Orders::next_request`]), so that it is ordered once and answered in its turn.
//!
//! Invariant: no request is ordered twice; one that is not ordered here is ordered when its turn comes.

use super::estop::{EStops, Origin};
use super::first_request::is_estop_request;
use super::framing::Framer;
use super::network::Gate;
use crate::session_record::Peer;
use std::collections::VecDeque;
use std::sync::Arc;

/// See the module.
#[derive(Debug)]
pub(super) struct Orders {
    pub(super) framer: Framer,
    estops: Arc<EStops>,
    gate: Arc<Gate>,
    peer: Peer,
    /// The first request that was not looked at.
    next: u64,
    /// Requests that were ordered, and the numbers of their emergency stops.
    ordered: VecDeque<(u64, u64)>,
    /// Requests that the server has come to.
    served: u64,
}

impl Orders {
    /// Of a client whose first request is this emergency stop, if it was ordered.
    pub(super) fn new(estops: Arc<EStops>, gate: Arc<Gate>, peer: Peer, first: Option<u64>) -> Self {
        let ordered: VecDeque<_> = first.map(|number| (0, number)).into_iter().collect();
        let next = ordered.len() as u64;
        Self { framer: Framer::new(), estops, gate, peer, next, ordered, served: 0 }
    }

    /// Takes the next bytes that the client has sent.
    pub(super) fn take(&mut self, bytes: &[u8]) {
        let Self { framer, estops, gate, peer, next, ordered, .. } = self;
        let mut look = |request: u64, head: &[u8], is_complete: bool| {
            let is_estop = request >= *next && is_estop_request(head, *peer, gate) == Some(true);
            if is_estop {
                ordered.push_back((request, estops.request(Origin::of(*peer))));
            }
            if is_estop || is_complete {
                *next = (request + 1).max(*next);
            }
        };
        framer.take(bytes, |request, head| look(request, head, true));
        // An emergency stop counts from its first line on, as the acceptor takes it.
        let (request, head) = framer.begun();
        look(request, head, false);
    }

    /// The server comes to the next request: the number of its emergency stop, if it was ordered.
    pub(super) fn next_request(&mut self) -> Option<u64> {
        let request = self.served;
        self.served += 1;
        let (_, number) = self.ordered.pop_front_if(|(of, _)| *of == request)?;
        Some(number)
    }
}
