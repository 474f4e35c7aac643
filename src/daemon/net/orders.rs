//! Orders emergency stops among the requests of one connection as soon as their bytes arrive, even if other requests wait before
//! them.
//!
//! The bytes go through [`Orders::take`] before hyper gets them. It orders each emergency stop that the [`Gate`] admits, and keeps
//! its number until the server reaches that request ([`Orders::next_request`]), so that it is ordered once and answered in its
//! turn.
//!
//! Invariant: an emergency stop that is not ordered here is ordered when its turn comes. If a `reset` waits before an emergency
//! stop, it is ordered both here and in its turn, because the reset between them must not undo it. All others are ordered once.

use crate::daemon::arm::estop::{EStops, Origin};
use crate::daemon::net::first_request::{is_estop_request, is_post};
use crate::daemon::net::framing::Framer;
use crate::daemon::net::gate::Gate;
use crate::record::Peer;
use std::collections::VecDeque;
use std::sync::Arc;

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Orders {
    pub(in crate::daemon) framer: Framer,
    estops: Arc<EStops>,
    gate: Arc<Gate>,
    peer: Peer,
    /// The first request that was not examined.
    next: u64,
    /// The newest request that is a `reset`.
    reset: Option<u64>,
    /// Requests that were ordered, with the numbers of their emergency stops, unless they must be ordered again.
    ordered: VecDeque<(u64, Option<u64>)>,
    /// The number of requests that the server has reached.
    served: u64,
}

impl Orders {
    /// For a client whose first request is this emergency stop, if it was ordered.
    pub(in crate::daemon) fn new(
        estops: Arc<EStops>,
        gate: Arc<Gate>,
        peer: Peer,
        first: Option<u64>,
    ) -> Self {
        let ordered: VecDeque<_> = first.map(|number| (0, Some(number))).into_iter().collect();
        let next = ordered.len() as u64;
        Self { framer: Framer::new(), estops, gate, peer, next, reset: None, ordered, served: 0 }
    }

    /// Takes the next bytes that the client has sent.
    pub(in crate::daemon) fn take(&mut self, bytes: &[u8]) {
        let Self { framer, estops, gate, peer, next, reset, ordered, served } = self;
        let mut look = |request: u64, head: &[u8], is_complete: bool| {
            let is_estop = request >= *next && is_estop_request(head, *peer, gate) == Some(true);
            if is_estop {
                let number = estops.request(Origin::of(*peer));
                // The server may be carrying out the reset now.
                let is_last = reset.is_none_or(|reset| reset + 1 < *served);
                ordered.push_back((request, is_last.then_some(number)));
            }
            if is_complete && is_post(head, b"/v1/reset") == Some(true) {
                *reset = Some(request);
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

    /// Advances to the server's next request; returns the number of its emergency stop, if that need not be ordered again.
    pub(in crate::daemon) fn next_request(&mut self) -> Option<u64> {
        let request = self.served;
        self.served += 1;
        self.ordered.pop_front_if(|(of, _)| *of == request)?.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::core::engine::Engine;
    use meissner_stream::queues::queues;

    const ESTOP: &str = "POST /v1/estop HTTP/1.1\r\nhost: x\r\n\r\n";
    const RESET: &str = "POST /v1/reset HTTP/1.1\r\nhost: x\r\ncontent-length: 2\r\n\r\n{}";
    const WAIT: &str = "GET /v1/plays/1?wait=60 HTTP/1.1\r\nhost: x\r\n\r\n";

    fn orders() -> (Orders, Arc<EStops>) {
        let (_port, commands, _events) = queues().unwrap();
        let engine = Engine::of_paper(commands);
        let estops = Arc::clone(&engine.estops);
        (Orders::new(Arc::clone(&estops), Arc::clone(&engine.gate), Peer::local(1, 0), None), estops)
    }

    #[test]
    fn each_is_ordered_once_when_its_bytes_are_there_and_answered_in_its_turn() {
        let bytes = [WAIT, RESET, WAIT, ESTOP, ESTOP, WAIT].concat();
        for piece in [1, 2, 3, 7, 50, bytes.len()] {
            let (mut orders, estops) = orders();
            bytes.as_bytes().chunks(piece).for_each(|bytes| orders.take(bytes));
            assert_eq!(estops.switch.newest(), 2, "in pieces of {piece}");
            // The reset waits before them: each is ordered again.
            let turns: Vec<_> = (0..6).map(|_| orders.next_request()).collect();
            assert_eq!(turns, [None; 6]);
            bytes.as_bytes().chunks(piece).for_each(|bytes| orders.take(bytes));
            let turns: Vec<_> = (0..6).map(|_| orders.next_request()).collect();
            assert_eq!(turns, [None; 6], "the reset again");
            let bytes = [WAIT, ESTOP, WAIT, ESTOP].concat();
            bytes.as_bytes().chunks(piece).for_each(|bytes| orders.take(bytes));
            let turns: Vec<_> = (0..4).map(|_| orders.next_request()).collect();
            assert_eq!(turns, [None, Some(5), None, Some(6)], "the resets are long over");
        }
    }

    #[test]
    fn the_bytes_of_a_body_are_no_order() {
        let (mut orders, estops) = orders();
        let put = format!("PUT /v1/patterns/x HTTP/1.1\r\ncontent-length: {}\r\n\r\n{ESTOP}", ESTOP.len());
        orders.take(put.as_bytes());
        assert_eq!(estops.switch.newest(), 0);
        orders.take(ESTOP.as_bytes());
        assert_eq!(
            (estops.switch.newest(), orders.next_request(), orders.next_request()),
            (1, None, Some(1))
        );
    }
}
