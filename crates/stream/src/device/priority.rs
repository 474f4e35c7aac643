//! SCHED_FIFO for the calling thread, where the system allows it: for the streamer and for what carries its bytes.

use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
};
use thread_priority::{ThreadPriority, ThreadPriorityValue};

/// Above ordinary programs and below the kernel's own threads.
pub const FIFO_PRIORITY: u8 = 50;

/// Asks for it; whether it was granted.
#[must_use]
pub fn fifo() -> bool {
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    ThreadPriorityValue::try_from(FIFO_PRIORITY).is_ok_and(|value| {
        let priority = ThreadPriority::Crossplatform(value);
        set_thread_priority_and_policy(thread_native_id(), priority, policy).is_ok()
    })
}
