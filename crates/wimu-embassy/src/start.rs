//! What is remembered over a reset: the fault before it, and the number of starts that failed.

use core::sync::atomic::{AtomicU32, Ordering};

use wimu_link::hello::{Fault, Name, ResetReason};

/// Seed of the check sum, "WIMU": erased memory is not a valid record.
const SEED: u32 = 0x5749_4d55;
/// Words of a fault's place: its address, and its kind of up to 15 bytes with the length in the last byte.
const PLACE: usize = 5;
/// Length in a record without a fault.
const NO_FAULT: u8 = 0xFF;
/// Failed starts in a row after which the device starts in safe mode.
const FAILURES: u32 = 3;
/// Delay of the second start in a row after a failed one, ms. It doubles with each further failure.
const DELAY_MS: u32 = 250;
/// Longest delay, ms.
const LONGEST_DELAY_MS: u32 = 8_000;

/// Memory that survives a reset. Put it in a `static` in memory that is not cleared at a start.
///
/// It is made of atomic words because a handler of panics writes it while any task may be interrupted. A check sum
/// distinguishes a record from the arbitrary content after power-on.
#[derive(Debug)]
pub struct StartRecord {
    check: AtomicU32,
    /// Failed starts in a row, including the present one until it is [`stable`](Self::stable).
    failures: AtomicU32,
    place: [AtomicU32; PLACE],
}

/// Why and how a device starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Start {
    /// The reset reason; [`ResetReason::Fault`] if a fault was recorded.
    pub reason: ResetReason,
    /// The recorded fault.
    pub fault: Option<Fault>,
    /// Starts in a row that ended within a minute by a panic, a fault or the watchdog.
    pub failures: u32,
}

impl Default for Start {
    /// A start for an unknown reason after a normal end.
    fn default() -> Self {
        Self { reason: ResetReason::Unknown, fault: None, failures: 0 }
    }
}

impl Start {
    /// Whether to start without stored parameters and settings: three starts in a row have failed.
    pub fn is_safe_mode(&self) -> bool {
        self.failures >= FAILURES
    }

    /// The same start in safe mode, because of `fault`.
    #[must_use]
    pub fn in_safe_mode(self, fault: Fault) -> Self {
        Self {
            reason: ResetReason::Fault,
            fault: Some(fault),
            failures: self.failures.max(FAILURES),
        }
    }

    /// How long to wait before the start, ms: 0, 0, 250, 500, … up to 8000 after 0, 1, 2, 3, … failures. It limits the
    /// wear of the flash, in which every start is counted.
    pub fn delay_ms(&self) -> u32 {
        match self.failures {
            0 | 1 => 0,
            failures => LONGEST_DELAY_MS.min(DELAY_MS << (failures - 2).min(16)),
        }
    }
}

impl StartRecord {
    /// The record in memory of zeros: none.
    #[allow(clippy::new_without_default, reason = "made in a static")]
    pub const fn new() -> Self {
        Self {
            check: AtomicU32::new(0),
            failures: AtomicU32::new(0),
            place: [const { AtomicU32::new(0) }; PLACE],
        }
    }

    /// Begins a start that the hardware explains with `reason`. Returns what the record says of the time before,
    /// and clears the fault. Call it once, before the tasks.
    pub fn begin(&self, reason: ResetReason) -> Start {
        let valid = self.check.load(Ordering::Relaxed) == self.sum();
        let before = if valid { self.failures() } else { 0 };
        let fault = if valid { self.fault() } else { None };
        let reason = match fault {
            Some(_) => ResetReason::Fault,
            None => reason,
        };
        let failures = match reason {
            ResetReason::Fault | ResetReason::Watchdog => before.saturating_add(1),
            _ => 0,
        };
        self.write(failures, None);
        Start { reason, fault, failures }
    }

    /// Ends the series of failed starts: the device has worked for a minute.
    pub fn stable(&self) {
        // A failure from now on is the first one again.
        self.write(0, self.fault().as_ref());
    }

    /// Records a fault. Call it from the handlers of panics and faults with interrupts disabled, then reset.
    pub fn record(&self, fault: &Fault) {
        self.write(self.failures(), Some(fault));
    }

    fn failures(&self) -> u32 {
        self.failures.load(Ordering::Relaxed)
    }

    fn fault(&self) -> Option<Fault> {
        let [address, kind @ ..] = self.place.each_ref().map(|w| w.load(Ordering::Relaxed));
        let mut bytes = [0; 16];
        for (place, word) in bytes.chunks_exact_mut(4).zip(kind) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        let (length, bytes) = bytes.split_last()?;
        let kind = bytes.get(..usize::from(*length))?;
        Some(Fault { address, kind: Name::from_bytes(kind) })
    }

    fn write(&self, failures: u32, fault: Option<&Fault>) {
        let mut bytes = [0; 16];
        let kind = fault.map_or(&[][..], |fault| fault.kind.as_bytes());
        for (place, byte) in bytes.iter_mut().zip(kind) {
            *place = *byte;
        }
        if let Some(length) = bytes.last_mut() {
            *length = fault.map_or(NO_FAULT, |_| kind.len() as u8);
        }
        self.failures.store(failures, Ordering::Relaxed);
        let address = fault.map_or(0, |fault| fault.address);
        let kind = bytes.as_chunks().0.iter().map(|&b| u32::from_le_bytes(b));
        for (word, value) in self.place.iter().zip([address].into_iter().chain(kind)) {
            word.store(value, Ordering::Relaxed);
        }
        self.check.store(self.sum(), Ordering::Relaxed);
    }

    /// Check sum of all other words.
    fn sum(&self) -> u32 {
        let words = [&self.failures].into_iter().chain(&self.place);
        words.fold(SEED, |sum, word| {
            (sum.rotate_left(5) ^ word.load(Ordering::Relaxed)).wrapping_mul(0x9E37_79B1)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault() -> Fault {
        Fault::panic([0x0001_1128, 0x0002_5678])
    }

    #[test]
    fn memory_after_power_on_is_no_record() {
        for fill in [0, u32::MAX, 0xCCCC_CCCC] {
            let record = StartRecord::new();
            let words = [&record.check, &record.failures];
            for word in words.into_iter().chain(&record.place) {
                word.store(fill, Ordering::Relaxed);
            }
            let start = record.begin(ResetReason::PowerOn);
            assert_eq!((start.fault, start.failures), (None, 0), "{fill:#x}");
        }
    }

    #[test]
    fn a_fault_is_reported_once_with_its_place() {
        let record = StartRecord::new();
        record.begin(ResetReason::PowerOn);
        record.record(&fault());
        let start = record.begin(ResetReason::Software);
        assert_eq!((start.reason, start.fault), (ResetReason::Fault, Some(fault())));
        let start = record.begin(ResetReason::Pin);
        assert_eq!((start.reason, start.fault), (ResetReason::Pin, None));
        // Names of every length that fits, and none.
        for length in 0..=15 {
            let fault = Fault::processor(&"123456789012345"[..length], u32::MAX);
            record.record(&fault);
            assert_eq!(record.begin(ResetReason::Unknown).fault, Some(fault));
        }
    }

    #[test]
    fn a_damaged_record_is_none() {
        for word in 0..PLACE + 1 {
            for bit in 0..32 {
                let record = StartRecord::new();
                record.begin(ResetReason::PowerOn);
                record.record(&fault());
                let words = [&record.failures].into_iter().chain(&record.place);
                let word = words.into_iter().nth(word).unwrap();
                word.fetch_xor(1 << bit, Ordering::Relaxed);
                assert_eq!(record.begin(ResetReason::Unknown).fault, None);
            }
        }
    }

    #[test]
    fn three_failed_starts_in_a_row_lead_to_safe_mode_whatever_ended_them() {
        let record = StartRecord::new();
        let mut start = record.begin(ResetReason::PowerOn);
        for (failures, by_watchdog) in [(1, false), (2, true), (3, false), (4, true)] {
            assert_eq!(start.is_safe_mode(), start.failures >= 3);
            if !by_watchdog {
                record.record(&fault());
            }
            start = record.begin(ResetReason::Watchdog);
            assert_eq!(start.failures, failures);
        }
        assert!(start.is_safe_mode());
    }

    #[test]
    fn a_minute_of_operation_or_a_reset_by_the_owner_ends_the_series() {
        for stable in [true, false] {
            let record = StartRecord::new();
            for _ in 0..5 {
                record.begin(ResetReason::Watchdog);
            }
            let start = if stable {
                record.stable();
                record.begin(ResetReason::Watchdog)
            } else {
                record.begin(ResetReason::Pin)
            };
            assert_eq!(start.failures, u32::from(stable));
            assert!(!start.is_safe_mode());
        }
    }

    #[test]
    fn the_delay_doubles_up_to_eight_seconds() {
        let delays = [0, 1, 2, 3, 4, 5, 6, 7, 8, u32::MAX].map(|failures| {
            let start = Start::default();
            Start { failures, ..start }.delay_ms()
        });
        let expected = [0, 0, 250, 500, 1000, 2000, 4000, 8000, 8000, 8000];
        assert_eq!(delays, expected);
    }
}
