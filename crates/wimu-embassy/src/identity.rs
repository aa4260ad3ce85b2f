//! The identity of a board.

use wimu_link::hello::{Capabilities, Part};
use wimu_link::{Hello, LinkRole};

use crate::start::Start;

/// The identity of a device with a nominal sensitivity, for [`Board::hello`](wimu_node::Board::hello).
///
/// `firmware` is the version of the board's package, `env!("CARGO_PKG_VERSION")`: numbers separated by dots. A number
/// that cannot be read is 0.
pub fn hello(
    device_id: u64,
    firmware: &str,
    start: &Start,
    capabilities: Capabilities,
    board: Part,
    sensor: Part,
) -> Hello {
    let mut numbers = firmware.split('.').map(|text| text.parse().unwrap_or(0));
    Hello {
        device_id,
        firmware: core::array::from_fn(|_| numbers.next().unwrap_or(0)),
        reset_reason: start.reason,
        fault: start.fault,
        capabilities,
        sensitivity_known: true,
        safe_mode: start.is_safe_mode(),
        board,
        sensor,
        ..Hello::new(LinkRole::Cable)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_version_of_the_package_is_that_of_the_firmware() {
        let firmware = |text| {
            let part = Part::default();
            let start = Start::default();
            hello(1, text, &start, Capabilities::STORE, part, part).firmware
        };
        assert_eq!(firmware("1.20.3"), [1, 20, 3]);
        assert_eq!(firmware("2.x"), [2, 0, 0]);
    }
}
