//! Lockstep: time advances only when all tasks wait, by an amount that the bridge determines.
//!
//! When no task is ready, the board asks the bridge to advance the time to the next deadline, or until the
//! sensor has data. Nothing else takes time: bytes are sent immediately, and no other task runs during a bus
//! transfer. So the board's results depend only on its inputs and their times on its own clock, not on the
//! speed of the host. A byte received on a link ends the wait.
//!
//! The real chip has no such command. All numbers are little-endian.
//!
//! | offset | size | field of the request |
//! |---|---|---|
//! | 0 | 1 | `T` in ASCII |
//! | 1 | 1 | flags: bit 0, the wait also ends when the sensor has data; the others 0 |
//! | 2 | 4 | longest wait from the previous answer, µs; 0xFFFFFFFF without a deadline |
//! | 6 | 2 | bytes received on the cable, modulo 2¹⁶ |
//! | 8 | 2 | bytes received on the wireless link, modulo 2¹⁶ |
//! | 10 | 2 | bytes sent on the cable, modulo 2¹⁶ |
//! | 12 | 2 | bytes sent on the wireless link, modulo 2¹⁶ |
//! | 14 | 1 | `P` in ASCII |
//!
//! The counts tell the host whether both ends have received all bytes. A `P` before the answer ends the wait.
//!
//! | offset | size | field of the answer |
//! |---|---|---|
//! | 0 | 4 | time since the board's start, µs, modulo 2³² |
//! | 4 | 1 | flags: bit 0, the sensor has data |

use crate::uart::{CABLE, SENSOR_BUS, Traffic, WIRELESS};
use crate::{clock, data_ready};

const NO_DEADLINE: u32 = u32::MAX;

/// The latest time from the bridge, µs.
pub struct Lockstep {
    now_us: u64,
}

impl Lockstep {
    /// At the board's start.
    pub const fn new() -> Self {
        Self { now_us: 0 }
    }

    /// Advances the time. To be called when no task is ready.
    pub fn pass_time(&mut self) {
        let traffic = traffic();
        let wait = clock::next_deadline().map_or(NO_DEADLINE, |deadline| {
            let wait = deadline.saturating_sub(self.now_us);
            u32::try_from(wait).map_or(NO_DEADLINE - 1, |wait| wait.min(NO_DEADLINE - 1))
        });
        let mut request = [0; 15];
        request[0] = b'T';
        request[1] = data_ready::is_watched().into();
        request[2..6].copy_from_slice(&wait.to_le_bytes());
        let [cable, wireless] = traffic;
        let counts = [cable.received, wireless.received, cable.sent, wireless.sent];
        for (place, count) in request[6..14].chunks_exact_mut(2).zip(counts) {
            place.copy_from_slice(&count.to_le_bytes());
        }
        request[14] = b'P';
        SENSOR_BUS.write_now(&request);

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
