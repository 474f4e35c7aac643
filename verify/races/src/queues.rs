//! Models of the queues between the streamer and the rest: requests, events, emergency stops.
//!
//! The streamer's side loops as in `thread.rs`, and the listeners' as in the daemon's event loop and thread for e-stops.

use crate::explore::Model;
use loom::thread::{spawn, yield_now};
use meissner_stream::queues::{
    Command, CommandError, CommandQueue, ESTOP_TICKETS, Emit, EventQueue, Request, StreamEvent, ThreadQueues,
    queues,
};
use meissner_stream::time::HostInstant;

/// See the module.
pub(crate) const MODELS: &[Model] = &[
    Model::new(
        "requests",
        "a request that was sent is executed, in order, without a later ring",
        None,
        requests,
    ),
    Model::new(
        "estops",
        "e-stops of two threads are executed and answered, without a later ring",
        Some(3),
        estops,
    ),
    Model::new("reset-first", "a reset sent before an e-stop is executed before it", Some(3), reset_first),
    Model::new("flood", "an e-stop waits for no more requests than the queue holds", Some(3), flood),
    Model::new(
        "answers",
        "a confirmed e-stop is never called timed out, and no answer is taken back",
        None,
        answers,
    ),
    Model::new("no-device", "an e-stop without a device is never called timed out", None, no_device),
    Model::new("events", "an event reaches the listener, in order, without a later ring", None, events),
    Model::new("events-full", "every event that finds no room is counted", Some(3), events_full),
];

fn ends() -> (ThreadQueues, CommandQueue, EventQueue) {
    queues().expect("a model needs no descriptors")
}

fn request(ticket: u64, command: Command) -> Request {
    Request { ticket, issued_at: HostInstant::default(), command }
}

/// The number of an emergency stop.
fn number(request: &Request) -> Option<u64> {
    matches!(request.command, Command::EStop).then(|| request.ticket - ESTOP_TICKETS)
}

/// The streamer's loop, until `execute` says that it is enough.
fn streamer(mut queues: ThreadQueues, mut execute: impl FnMut(&mut ThreadQueues, Request) -> bool) {
    loop {
        let mut enough = false;
        while let Some(request) = queues.pop() {
            enough |= execute(&mut queues, request);
        }
        queues.wake_listener();
        if enough {
            return;
        }
        queues.wait();
    }
}

fn requests() {
    let (thread, mut commands, _events) = ends();
    let streamer = spawn(move || {
        let mut seen = Vec::new();
        streamer(thread, |_, request| {
            seen.push(request.ticket);
            seen.len() == 2
        });
        assert_eq!(seen, [1, 2]);
    });
    for ticket in 1..=2 {
        commands.send(request(ticket, Command::Stop)).expect("there is room");
    }
    streamer.join().expect("it ends");
}

fn estops() {
    let (thread, commands, _events) = ends();
    let streamer = spawn(move || {
        streamer(thread, |queues, request| {
            let number = number(&request).expect("nothing else is sent");
            queues.event(StreamEvent::Answer { ticket: request.ticket, result: Ok(()) });
            number == 2
        });
    });
    let other = commands.estop_switch();
    let other = spawn(move || _ = other.request());
    // The thread for e-stops: answers wake it, and nobody else looks at them.
    let listener = commands.estop_switch();
    let number = listener.request();
    let answer = loop {
        listener.wait();
        listener.clear_answers();
        if let Some(answer) = listener.answer(number) {
            break answer;
        }
    };
    assert_eq!(answer, Ok(()));
    other.join().expect("it ends");
    streamer.join().expect("it ends");
}

fn reset_first() {
    let (thread, mut commands, _events) = ends();
    let (own, other) = (commands.estop_switch(), commands.estop_switch());
    let streamer = spawn(move || {
        // The newest e-stop that was executed before the reset, and at all.
        let (mut before, mut newest) = (None, 0);
        streamer(thread, |_, request| {
            match number(&request) {
                Some(number) => newest = number,
                None => before = Some(newest),
            }
            newest == 2 && before.is_some()
        });
        before.expect("the reset has come")
    });
    let resets = spawn(move || {
        commands.send(request(1, Command::Reset { estops_seen: 0, keep: true })).expect("there is room");
        own.request()
    });
    let _ = other.request();
    let number = resets.join().expect("it ends");
    assert!(streamer.join().expect("it ends") < number, "the reset was executed after its e-stop");
}

fn flood() {
    const SENT: u64 = 4;
    let (thread, mut commands, _events) = ends();
    let streamer = spawn(move || {
        let (mut executed, mut ahead) = (0, None);
        streamer(thread, |_, request| {
            match number(&request) {
                Some(_) => ahead = Some(executed),
                None => executed += 1,
            }
            executed == SENT && ahead.is_some()
        });
        ahead.expect("the e-stop was executed")
    });
    let _ = commands.estop_switch().request();
    for ticket in 1..=SENT {
        let mut sent = commands.send(request(ticket, Command::Stop));
        while let Err(request) = sent {
            yield_now();
            sent = commands.send(request);
        }
    }
    // One may be on its way when the e-stop is ordered; the queue holds two here.
    assert!(streamer.join().expect("it ends") <= 3, "the e-stop waited for requests without end");
}

fn answer(queues: &mut ThreadQueues, number: u64, result: Result<(), CommandError>) {
    queues.event(StreamEvent::Answer { ticket: ESTOP_TICKETS + number, result });
}

fn answers() {
    let (mut thread, commands, _events) = ends();
    let streamer = spawn(move || {
        answer(&mut thread, 1, Err(CommandError::Timeout));
        answer(&mut thread, 2, Ok(()));
    });
    // This thread looks at any time, rung or not.
    let switch = commands.estop_switch();
    let second = switch.answer(2);
    assert!(second.is_none_or(|answer| answer.is_ok()), "{second:?}");
    let first = [switch.answer(1), switch.answer(1)];
    assert!(first[0] != Some(Ok(())) || first[1] == Some(Ok(())), "{first:?}");
    assert!(first[0].is_none() || first[1].is_some(), "{first:?}");
    assert!(second.is_none() || first[0] == Some(Ok(())), "{second:?} {first:?}");
    streamer.join().expect("it ends");
}

fn no_device() {
    let (mut thread, commands, _events) = ends();
    let streamer = spawn(move || answer(&mut thread, 1, Err(CommandError::NoDevice)));
    let seen = commands.estop_switch().answer(1);
    assert!(matches!(seen, None | Some(Err(CommandError::NoDevice))), "{seen:?}");
    streamer.join().expect("it ends");
}

fn event(play: u64) -> StreamEvent {
    StreamEvent::Answer { ticket: play, result: Ok(()) }
}

fn events() {
    let (mut thread, _commands, mut listener) = ends();
    let streamer = spawn(move || {
        for ticket in 1..=2 {
            thread.event(event(ticket));
            thread.wake_listener();
        }
    });
    let mut seen = Vec::new();
    while seen.len() < 2 {
        listener.wait();
        while let Some(event) = listener.pop() {
            let StreamEvent::Answer { ticket, .. } = event else { panic!("{event:?}") };
            seen.push(ticket);
        }
    }
    assert_eq!(seen, [1, 2]);
    streamer.join().expect("it ends");
}

fn events_full() {
    const SENT: u64 = 6;
    let (mut thread, _commands, mut listener) = ends();
    let streamer = spawn(move || {
        for ticket in 1..SENT {
            thread.event(event(ticket));
        }
        thread
    });
    let (mut seen, mut lost) = (0, 0);
    let mut drain = |listener: &mut EventQueue| {
        while let Some(event) = listener.pop() {
            match event {
                StreamEvent::EventsLost(count) => lost += count,
                _ => seen += 1,
            }
        }
        seen + lost
    };
    drain(&mut listener);
    let mut thread = streamer.join().expect("it ends");
    drain(&mut listener);
    // The next event that finds room reports what was lost.
    thread.event(event(SENT));
    assert_eq!(drain(&mut listener), SENT);
}
