//! Lockstep: time passes only while everybody waits, and the bridge says how much.
//!
//! When no task has anything to do, the board asks the bridge to let time pass until the next
//! deadline, or until the sensor has data. Nothing else waits: what is sent goes out at once, and
//! the sensor's bus takes no time in which another task could go on. What the board computes then
//! depends on what it is sent and when on its own clock, and on nothing else: not on how fast the
//! host is. A byte that comes in on a link ends the wait.
//!
//! `T flags wait cable-in wireless-in cable-out wireless-out P`: bit 0 of the flags asks for
//! data-ready; the wait is in µs from the last answer, 32 bits, all ones without a deadline; how
//! many bytes have come in and gone out on each link tells the host whether each side has seen
//! everything, 16 bits each. A lone `P` ends the wait. The answer: the low 32 bits of the time
//! since the board's start, µs, and flags, bit 0 data-ready. All lowest byte first. The chip that
//! the bridge resembles has no such command.

use crate::uart::{CABLE, SENSOR_BUS, Traffic, WIRELESS};
use crate::{clock, data_ready};

const NO_DEADLINE: u32 = u32::MAX;

/// The time as the bridge said last, µs.
pub struct Lockstep {
    now_us: u64,
}

impl Lockstep {
    /// At the board's start.
    pub const fn new() -> Self {
        Self { now_us: 0 }
    }

    /// Lets time pass: to be called when no task has anything to do.
    pub fn pass_time(&mut self) {
        let traffic = traffic();
        let wait = clock::next_deadline().map_or(NO_DEADLINE, |deadline| {
            let wait = deadline.saturating_sub(self.now_us);
            u32::try_from(wait).map_or(NO_DEADLINE - 1, |wait| wait.min(NO_DEADLINE - 1))
        });
        let mut question = [0; 15];
        question[0] = b'T';
        question[1] = data_ready::is_watched().into();
        question[2..6].copy_from_slice(&wait.to_le_bytes());
        let [cable, wireless] = traffic;
        let counts = [cable.received, wireless.received, cable.sent, wireless.sent];
        for (place, count) in question[6..14].chunks_exact_mut(2).zip(counts) {
            place.copy_from_slice(&count.to_le_bytes());
        }
        question[14] = b'P';
        SENSOR_BUS.write_now(&question);

        let mut answer = [0; 5];
        let mut ended = false;
        SENSOR_BUS.read_now(&mut answer, || {
            if !ended && self::traffic() != traffic {
                SENSOR_BUS.write_now(b"P");
                ended = true;
            }
        });
        let [a, b, c, d, flags] = answer;
        let low = u32::from_le_bytes([a, b, c, d]);
        self.now_us += u64::from(low.wrapping_sub(self.now_us as u32));
        data_ready::set(flags & 1 != 0);
        clock::advance_to(self.now_us);
    }
}

fn traffic() -> [Traffic; 2] {
    [CABLE.traffic(), WIRELESS.traffic()]
}
