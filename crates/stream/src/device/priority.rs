//! Real-time priority (SCHED_FIFO) for the calling thread, where the system allows it.
//!
//! The streamer's thread asks for it, and so do the threads that carry its bytes.

use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

/// The priority: above ordinary programs, below the kernel's own threads.
pub const FIFO_PRIORITY: u8 = 50;
/// For threads that must be as prompt, but must not hold up the streamer.
pub const BELOW_STREAMER: u8 = FIFO_PRIORITY - 1;

/// Requests SCHED_FIFO at this priority; returns whether the system granted it.
pub fn fifo(priority: u8) -> bool {
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    ThreadPriorityValue::try_from(priority).is_ok_and(|value| {
        let priority = ThreadPriority::Crossplatform(value);
        set_thread_priority_and_policy(thread_native_id(), priority, policy).is_ok()
    })
}
