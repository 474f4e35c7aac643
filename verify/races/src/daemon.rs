//! Models of what threads of the program hand over beside the streamer's queues.

use crate::estop::{EStops, Origin};
use crate::explore::Model;
use crate::gate::Gate;
use crate::record::Peer;
use loom::thread::{spawn, yield_now};
use meissner_stream::queues::{Command, queues};
use std::sync::{Arc, Mutex};

/// See the module.
pub(crate) const MODELS: &[Model] = &[
    Model::new("guard-reset", "a reset forgets no e-stop that came after its check", None, guard_reset),
    Model::new("guard-first", "who sees the e-stop finds whose it was", None, guard_first),
    Model::new("last-stop", "every order has a stop after it, and none follows", None, last_stop),
];

/// A client of which the kernel tells nothing: another one than all others.
const STRANGER: Peer = Peer { pid: -1 };

fn guard_reset() {
    let (_thread, commands, _events) = queues().expect("a model needs no descriptors");
    let estops = Arc::new(EStops::new(commands.estop_switch()));
    let stranger = Origin::of(STRANGER);
    estops.request(stranger);
    let before = estops.guard();
    let of_other = Arc::clone(&estops);
    let other = spawn(move || of_other.request(Origin::of(STRANGER)));
    let found = estops.guard();
    estops.reset(found);
    other.join().expect("it ends");
    assert_eq!(estops.guard().has_another(stranger), found == before, "of the later e-stop");
}

fn guard_first() {
    let (mut thread, commands, _events) = queues().expect("a model needs no descriptors");
    let estops = Arc::new(EStops::new(commands.estop_switch()));
    let of_listener = Arc::clone(&estops);
    let listener = spawn(move || of_listener.request(Origin::of(STRANGER)));
    if let Some(request) = thread.pop() {
        assert!(matches!(request.command, Command::EStop));
        assert!(estops.guard().has_another(Origin::of(STRANGER)), "the guard came later");
    }
    listener.join().expect("it ends");
}

fn last_stop() {
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    enum Sent {
        Order,
        Stop,
    }
    let (gate, sent) = (Arc::new(Gate::default()), Arc::new(Mutex::new(Vec::new())));
    let orders = {
        let (gate, sent) = (Arc::clone(&gate), Arc::clone(&sent));
        spawn(move || {
            for _ in 0..2 {
                gate.order(|| {
                    // It is on its way for a while.
                    yield_now();
                    sent.lock().expect("no panic").push(Sent::Order);
                });
            }
        })
    };
    gate.stop(|| sent.lock().expect("no panic").push(Sent::Stop));
    let stopped = sent.lock().expect("no panic").clone();
    assert_eq!(stopped.last(), Some(&Sent::Stop), "{stopped:?}");
    orders.join().expect("it ends");
    assert_eq!(*sent.lock().expect("no panic"), stopped, "an order followed");
}
