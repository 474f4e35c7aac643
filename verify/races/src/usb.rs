//! Models of the bytes and e-stops between the streamer and the threads of a USB board.

use crate::explore::Model;
use crate::hand_over::{Near, hand_over};
use crate::newest::Newest;
use loom::thread::{current, spawn};
use std::io::ErrorKind;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// See the module.
pub(crate) const MODELS: &[Model] = &[
    Model::new(
        "usb-in",
        "bytes that wait ring the bell, and come before the news that the board is gone",
        Some(3),
        incoming,
    ),
    Model::new("usb-out", "all bytes reach the board, in order; room is reported", Some(3), outgoing),
    Model::new("usb-end", "the writer ends when it is told, also from its sleep", None, end),
    Model::new("usb-estop", "the newest e-stop is sent", None, estop),
];

/// Waits as the streamer does.
fn wait(near: &Near) {
    near.bell().wait(Duration::MAX);
}

fn incoming() {
    let (mut near, incoming, _outgoing) = hand_over().expect("a model needs no descriptors");
    let reader = spawn(move || {
        let mut transfers = [&[1][..], &[2, 3][..]].into_iter();
        incoming.run(|room| {
            let bytes = transfers.next().ok_or(rusb::Error::NoDevice)?;
            room[..bytes.len()].copy_from_slice(bytes);
            Ok(bytes.len())
        });
    });
    let mut seen = Vec::new();
    'gone: loop {
        // A round reads so often at most, as the streamer's does.
        for _ in 0..2 {
            let mut byte = [0];
            match near.read(&mut byte) {
                Ok(0) => break,
                Ok(_) => seen.push(byte[0]),
                Err(error) => {
                    assert_eq!(error.kind(), ErrorKind::BrokenPipe);
                    break 'gone;
                }
            }
        }
        wait(&near);
    }
    assert_eq!(seen, [1, 2, 3]);
    reader.join().expect("it ends");
}

fn outgoing() {
    let (mut near, _incoming, outgoing) = hand_over().expect("a model needs no descriptors");
    let sent = Arc::new(Mutex::new(Vec::new()));
    let board = Arc::clone(&sent);
    let writer = spawn(move || {
        outgoing.run(|bytes| {
            let mut board = board.lock().expect("no panic");
            board.extend_from_slice(bytes);
            // The end of the model: the board goes when it has all.
            if board.len() < 4 { Ok(bytes.len()) } else { Err(rusb::Error::NoDevice) }
        });
    });
    let (mut frames, mut unsent) = ([[1, 2], [3, 4]].into_iter(), Vec::new());
    // Rounds of the streamer: it reads, then writes until nothing is taken. It ends with the board.
    'gone: while near.read(&mut [0]).is_ok() {
        loop {
            if unsent.is_empty() {
                unsent = frames.next().map(Vec::from).unwrap_or_default();
            }
            match near.write(&unsent) {
                Ok(0) => break,
                Ok(taken) => drop(unsent.drain(..taken)),
                Err(_) => break 'gone,
            }
        }
        wait(&near);
    }
    writer.join().expect("it ends");
    assert_eq!(*sent.lock().expect("no panic"), [1, 2, 3, 4]);
}

fn end() {
    let (near, _incoming, outgoing) = hand_over().expect("a model needs no descriptors");
    let writer = spawn(move || outgoing.run(|bytes| Ok(bytes.len())));
    near.end();
    writer.join().expect("it ends");
}

fn estop() {
    let newest = Arc::new(Newest::default());
    let thread = {
        let newest = Arc::clone(&newest);
        spawn(move || {
            newest.serve(|epoch| {
                // The end of the model.
                if epoch == 2 {
                    newest.end(&current());
                }
            });
        })
    };
    newest.set(1, thread.thread());
    newest.set(2, thread.thread());
    thread.join().expect("it ends");
}
