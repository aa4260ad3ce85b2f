//! The supervisor of the node's tasks, which feeds the watchdog.

use wimu_link::message::StackStatus;
use wimu_model::DeviceTimeUs;
use wimu_node::sensor::RawSample;
use wimu_node::{Shared, Timer};

use crate::{Mutex, StartRecord};

/// Interval between two checks, µs: a quarter of the shortest time-out of a watchdog that is supported, 1 s.
const INTERVAL_US: u64 = 250_000;
/// Time of operation after which a start has succeeded, µs.
const STABLE_US: u64 = 60_000_000;
/// Checks between two measurements of the stack.
const CHECKS: u32 = 16;
/// Longest time without progress of a working task on lines that always send, µs. Three times the longest turn: four
/// sample periods of 1 s; a status every 5 s for the others, which leaves 10 s for changes of the store.
pub const LIMITS_US: [u64; 4] = [12_000_000, 15_000_000, 15_000_000, 15_000_000];

/// [`LIMITS_US`] without those of links that their hosts can stop, as USB and Bluetooth Low Energy: the cable's writer is
/// number 2, the wireless link's number 3.
pub const fn without_limit<const N: usize>(writers: [usize; N]) -> [u64; 4] {
    let mut limits = LIMITS_US;
    let mut index = 0;
    while index < N {
        limits[writers[index]] = u64::MAX;
        index += 1;
    }
    limits
}

/// Observes the progress of the node's tasks ([`Shared::progress`]): the sampler, the control task and the writers of both
/// links. [`supervise`] is a task around it.
#[derive(Clone, Debug)]
pub struct Supervisor {
    limits_us: [u64; 4],
    /// The latest progress of each task, and its time.
    seen: [(u32, DeviceTimeUs); 4],
}

impl Supervisor {
    /// A supervisor from `now` on. `limits_us` are the longest times without progress, µs, such as [`LIMITS_US`]; for
    /// the writer of a link that its host can stop, such as USB, `u64::MAX`.
    pub const fn new(limits_us: [u64; 4], now: DeviceTimeUs) -> Self {
        Self { limits_us, seen: [(0, now); 4] }
    }

    /// Whether every task has made progress within its limit.
    pub fn check(&mut self, now: DeviceTimeUs, progress: [u32; 4]) -> bool {
        let mut working = true;
        for ((seen, turns), limit) in self.seen.iter_mut().zip(progress).zip(self.limits_us) {
            if seen.0 != turns {
                *seen = (turns, now);
            }
            working &= now.0.saturating_sub(seen.1.0) < limit;
        }
        working
    }
}

/// Calls `feed`, which feeds the watchdog, four times a second while all tasks make progress. After a minute of operation
/// the start has succeeded ([`StartRecord::stable`]). Every 4 s `stack` measures the stack for the status. The body of a task at the lowest priority, so that a task that never
/// waits is noticed too.
pub async fn supervise<S: RawSample>(
    limits_us: [u64; 4],
    shared: &Shared<Mutex, S>,
    record: &StartRecord,
    timer: impl Timer,
    stack: impl Fn() -> Option<StackStatus>,
    mut feed: impl FnMut(),
) -> ! {
    let mut supervisor = Supervisor::new(limits_us, timer.now());
    let mut is_stable = false;
    for check in (0..CHECKS).cycle() {
        if check == 0
            && let Some(stack) = stack()
        {
            shared.report_stack(stack);
        }
        let now = timer.now();
        if supervisor.check(now, shared.progress()) {
            feed();
            if !is_stable && now.0 >= STABLE_US {
                record.stable();
                is_stable = true;
            }
        }
        timer.after_us(INTERVAL_US).await;
    }
    core::future::pending().await
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether the watchdog is fed at `seconds` if task `stuck` stops at 20 s and the others go on.
    fn fed(stuck: usize, limits_us: [u64; 4], seconds: u64) -> bool {
        let mut supervisor = Supervisor::new(limits_us, DeviceTimeUs(0));
        let mut progress = [u32::MAX - 10; 4];
        let mut fed = false;
        for second in 0..=seconds {
            for (task, turns) in progress.iter_mut().enumerate() {
                if task != stuck || second <= 20 {
                    *turns = turns.wrapping_add(1);
                }
            }
            fed = supervisor.check(DeviceTimeUs(second * 1_000_000), progress);
        }
        fed
    }

    #[test]
    fn one_task_without_progress_stops_the_feeding_after_its_limit() {
        for (task, limit_us) in LIMITS_US.into_iter().enumerate() {
            let limit_s = limit_us / 1_000_000;
            assert!(fed(task, LIMITS_US, 20 + limit_s - 1), "{task}");
            assert!(!fed(task, LIMITS_US, 20 + limit_s), "{task}");
        }
        assert!(fed(usize::MAX, LIMITS_US, 1000));
    }

    #[test]
    fn a_link_that_its_host_stops_does_not_stop_the_feeding() {
        let [sampler, control, cable, _] = LIMITS_US;
        assert!(fed(3, [sampler, control, cable, u64::MAX], 1000));
    }
}
