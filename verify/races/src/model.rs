//! The twins of doorbell, ring and sleep in the model checker.
//!
//! The doorbell promises what the kernel's does: a ring happens before the clear or the end of the wait that saw it (an event
//! descriptor has a lock). It has no timeout, so a lost wake-up is a deadlock, which loom reports. The ring has the contract of
//! rtrb: a push releases the producer's count and the consumer acquires it, and the other way round. What rtrb does inside is not
//! explored.

use loom::sync::{Condvar, Mutex};
use rustix::fd::{AsFd, BorrowedFd};
use std::io;
use std::sync::PoisonError;
use std::time::Duration;

/// See the module.
#[derive(Debug)]
pub struct Doorbell {
    rung: Mutex<bool>,
    rings: Condvar,
}

impl Doorbell {
    /// A silent doorbell.
    ///
    /// # Errors
    /// Never.
    pub fn new() -> io::Result<Self> {
        Ok(Self { rung: Mutex::new(false), rings: Condvar::new() })
    }

    /// Wakes the thread that waits.
    pub fn ring(&self) {
        *self.rung.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.rings.notify_one();
    }

    /// Makes the next wait wait.
    pub fn clear(&self) {
        *self.rung.lock().unwrap_or_else(PoisonError::into_inner) = false;
    }

    /// Waits until it is rung, however long that takes.
    pub fn wait(&self, _most: Duration) {
        let mut rung = self.rung.lock().unwrap_or_else(PoisonError::into_inner);
        while !*rung {
            rung = self.rings.wait(rung).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl AsFd for Doorbell {
    fn as_fd(&self) -> BorrowedFd<'_> {
        unreachable!("a doorbell of the model checker has no descriptor")
    }
}

/// Lets other threads go first.
pub fn sleep(_: Duration) {
    loom::thread::yield_now();
}

/// A ring for one producer and one consumer.
pub mod ring {
    use loom::sync::atomic::{AtomicUsize, Ordering};
    use std::collections::VecDeque;
    use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

    /// What both ends share.
    #[derive(Debug)]
    pub struct RingBuffer<T> {
        capacity: usize,
        pushed: AtomicUsize,
        popped: AtomicUsize,
        /// Loom runs one thread at a time: this lock is free whenever it is taken, and orders nothing in the model.
        items: Mutex<VecDeque<T>>,
    }

    impl<T> RingBuffer<T> {
        /// A ring with room for so many.
        #[expect(clippy::new_ret_no_self, reason = "as in rtrb")]
        pub fn new(capacity: usize) -> (Producer<T>, Consumer<T>) {
            let (pushed, popped, items) = (AtomicUsize::new(0), AtomicUsize::new(0), Mutex::default());
            let ring = Arc::new(Self { capacity, pushed, popped, items });
            (Producer { ring: Arc::clone(&ring), pushed: 0 }, Consumer { ring, popped: 0 })
        }

        fn items(&self) -> MutexGuard<'_, VecDeque<T>> {
            self.items.lock().unwrap_or_else(PoisonError::into_inner)
        }
    }

    /// Why nothing was pushed.
    #[derive(Debug)]
    pub enum PushError<T> {
        /// There is no room.
        Full(T),
    }

    /// Nothing is there.
    #[derive(Debug)]
    pub struct PopError;

    /// The end that pushes.
    #[derive(Debug)]
    pub struct Producer<T> {
        ring: Arc<RingBuffer<T>>,
        /// What it has stored last. Loom remembers the last access alone: a load by the same thread would hide the other's.
        pushed: usize,
    }

    impl<T> Producer<T> {
        /// How many there is room for.
        pub fn slots(&self) -> usize {
            self.ring.capacity + self.ring.popped.load(Ordering::Acquire) - self.pushed
        }

        /// Pushes one.
        ///
        /// # Errors
        /// Hands it back if there is no room.
        pub fn push(&mut self, item: T) -> Result<(), PushError<T>> {
            if self.slots() == 0 {
                return Err(PushError::Full(item));
            }
            self.ring.items().push_back(item);
            self.count(1);
            Ok(())
        }

        /// Pushes all or none.
        ///
        /// # Errors
        /// If there is no room for all.
        pub fn push_entire_slice(&mut self, items: &[T]) -> Result<(), PopError>
        where
            T: Copy,
        {
            if self.slots() < items.len() {
                return Err(PopError);
            }
            self.ring.items().extend(items);
            self.count(items.len());
            Ok(())
        }

        fn count(&mut self, pushed: usize) {
            self.pushed += pushed;
            self.ring.pushed.store(self.pushed, Ordering::Release);
        }
    }

    /// The end that pops.
    #[derive(Debug)]
    pub struct Consumer<T> {
        ring: Arc<RingBuffer<T>>,
        /// As in the producer.
        popped: usize,
    }

    impl<T> Consumer<T> {
        /// How many there are.
        pub fn slots(&self) -> usize {
            self.ring.pushed.load(Ordering::Acquire) - self.popped
        }

        /// Whether there are none.
        pub fn is_empty(&self) -> bool {
            self.slots() == 0
        }

        /// Takes the oldest.
        ///
        /// # Errors
        /// If there is none.
        pub fn pop(&mut self) -> Result<T, PopError> {
            if self.is_empty() {
                return Err(PopError);
            }
            let item = self.ring.items().pop_front().ok_or(PopError)?;
            self.count(1);
            Ok(item)
        }

        /// Takes as many as there are and find room; returns them, and the room that is left.
        pub fn pop_partial_slice<'a>(&mut self, room: &'a mut [T]) -> (&'a mut [T], &'a mut [T]) {
            let taken = self.slots().min(room.len());
            for (place, item) in room.iter_mut().zip(self.ring.items().drain(..taken)) {
                *place = item;
            }
            if taken > 0 {
                self.count(taken);
            }
            room.split_at_mut(taken)
        }

        fn count(&mut self, popped: usize) {
            self.popped += popped;
            self.ring.popped.store(self.popped, Ordering::Release);
        }
    }
}
