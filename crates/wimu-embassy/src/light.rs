//! A light and a button: what a board without a display has.

use wimu_node::sensor::RawSample;
use wimu_node::{Health, Shared, Timer};

use crate::Mutex;

/// Duration of a step, µs.
const STEP_US: u64 = 125_000;
/// Steps for which the button must be held to erase the key: 5 s.
const KEY_LOST_STEPS: u32 = 40;

/// Shows the device's state with a light, and erases the key and the settings when a button is held for five seconds. The
/// body of a task.
///
/// Blinking fast: no sensor; three flashes: safe mode; 0.5 s on, 0.5 s off: uncalibrated; on with a gap: calibrated.
pub async fn attend<S: RawSample>(
    shared: &Shared<Mutex, S>,
    is_safe_mode: bool,
    timer: impl Timer,
    mut light: impl FnMut(bool),
    is_pressed: impl Fn() -> bool,
) -> ! {
    let mut held = Held::default();
    for step in (0..8).cycle() {
        if held.is_long(is_pressed()) {
            shared.forget_key();
        }
        light(pattern(&shared.health(), is_safe_mode) >> step & 1 != 0);
        timer.after_us(STEP_US).await;
    }
    core::future::pending().await
}

/// One bit for each step, lowest first: light on.
fn pattern(health: &Health, is_safe_mode: bool) -> u8 {
    match (health.sensor_lost, is_safe_mode, health.calibrated) {
        (true, ..) => 0b0101_0101,
        (_, true, _) => 0b0001_0101,
        (_, _, true) => 0b1111_1110,
        _ => 0b0000_1111,
    }
}

/// How long a button has been held.
#[derive(Default)]
struct Held {
    /// It was seen up: a button that has been down since the start is ignored.
    released: bool,
    steps: u32,
}

impl Held {
    /// Whether the button has just been held for [`KEY_LOST_STEPS`].
    fn is_long(&mut self, is_pressed: bool) -> bool {
        self.released |= !is_pressed;
        let is_held = self.released && is_pressed;
        self.steps = if is_held { self.steps.saturating_add(1) } else { 0 };
        self.steps == KEY_LOST_STEPS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The steps, of `pressed`, at which the key is erased.
    fn erased(pressed: impl IntoIterator<Item = bool>) -> std::vec::Vec<usize> {
        let mut held = Held::default();
        let steps = pressed.into_iter().enumerate();
        steps.filter(|(_, is_pressed)| held.is_long(*is_pressed)).map(|(step, _)| step).collect()
    }

    #[test]
    fn a_button_erases_the_key_once_after_five_seconds_and_not_if_it_was_down_from_the_start() {
        let hold = |steps| std::iter::repeat_n(true, steps);
        let press = |steps| [false].into_iter().chain(hold(steps));
        assert_eq!(erased(press(39)), []);
        assert_eq!(erased(press(400)), [40]);
        assert_eq!(erased(press(39).chain(press(39))), []);
        assert_eq!(erased(press(40).chain(press(40))), [40, 81]);
        assert_eq!(erased(hold(400)), []);
    }

    #[test]
    fn each_state_has_its_own_pattern() {
        let pattern = |sensor_lost, is_safe_mode, calibrated| {
            let health = Health { samples: 1, sensor_lost, calibrated, shed: 0 };
            pattern(&health, is_safe_mode)
        };
        let mut patterns = [
            pattern(true, false, true),
            pattern(false, true, true),
            pattern(false, false, true),
            pattern(false, false, false),
        ];
        assert_eq!(pattern(true, true, true), patterns[0]);
        patterns.sort();
        assert!(patterns.is_sorted_by(|a, b| a < b));
    }
}
