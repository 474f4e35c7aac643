//! Models of what threads of the program hand over beside the streamer's queues.

use crate::daemon::state::render_job::Job;
use crate::estop::{EStops, Origin};
use crate::explore::Model;
use crate::gate::Gate;
use crate::poses::Poses;
use crate::session_record::Peer;
use loom::thread::{spawn, yield_now};
use meissner_stream::queues::{Command, queues};
use std::sync::{Arc, Mutex};

/// What `poses` needs of the program's state.
pub(crate) mod state {
    pub(crate) mod render_job {
        /// A pose that waits, without the pose.
        #[derive(Debug)]
        pub(crate) struct Job {
            pub(crate) seq: u64,
            pub(crate) scale: Option<(u64, f64)>,
        }
    }
}

/// See the module.
pub(crate) const MODELS: &[Model] = &[
    Model::new("guard-reset", "a reset forgets no e-stop that came after its check", None, guard_reset),
    Model::new("guard-first", "who sees the e-stop finds whose it was", None, guard_first),
    Model::new("poses", "the newest pose is rendered, and no scale is forgotten", None, poses),
    Model::new("poses-end", "the renderer ends when the play is over", None, poses_end),
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
    let of_acceptor = Arc::clone(&estops);
    let acceptor = spawn(move || of_acceptor.request(Origin::of(STRANGER)));
    if let Some(request) = thread.pop() {
        assert!(matches!(request.command, Command::EStop));
        assert!(estops.guard().has_another(Origin::of(STRANGER)), "the guard came later");
    }
    acceptor.join().expect("it ends");
}

fn job(seq: u64) -> Job {
    Job { seq, scale: (seq == 1).then_some((1, 0.5)) }
}

fn poses() {
    let poses = Arc::new(Poses::default());
    let waiting = Arc::clone(&poses);
    let renderer = spawn(move || {
        let mut scaled = false;
        loop {
            let job = waiting.take().expect("the play goes on");
            scaled |= job.scale.is_some();
            if job.seq == 2 {
                return scaled;
            }
        }
    });
    poses.put(job(1));
    poses.put(job(2));
    assert!(renderer.join().expect("it ends"), "the scale was forgotten");
}

fn poses_end() {
    let poses = Arc::new(Poses::default());
    let waiting = Arc::clone(&poses);
    let renderer = spawn(move || while waiting.take().is_some() {});
    poses.put(job(1));
    poses.close();
    renderer.join().expect("it ends");
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
