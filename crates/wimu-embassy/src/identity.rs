//! The identity of a board.

use wimu_link::hello::{Capabilities, Part};
use wimu_link::{Hello, LinkRole};
use wimu_node::InertialSensor;

use crate::start::Start;

/// The identity of a device with a nominal sensitivity, for [`Board::hello`](wimu_node::Board::hello): name and measured
/// quantities of the sensor `A`, and the `capabilities` of the board.
///
/// `firmware` is the version of the board's package, `env!("CARGO_PKG_VERSION")`: numbers separated by dots. A number
/// that cannot be read is 0.
pub fn hello<A: InertialSensor>(
    device_id: u64,
    firmware: &str,
    start: &Start,
    capabilities: Capabilities,
    board: Part,
) -> Hello {
    let mut numbers = firmware.split('.').map(|text| text.parse().unwrap_or(0));
    Hello {
        device_id,
        firmware: core::array::from_fn(|_| numbers.next().unwrap_or(0)),
        reset_reason: start.reason,
        fault: start.fault,
        capabilities: capabilities.with(A::CAPABILITIES),
        sensitivity_known: true,
        safe_mode: start.is_safe_mode(),
        board,
        sensor: A::PART,
        ..Hello::new(LinkRole::Cable)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn version_and_sensor_are_those_of_the_package_and_the_driver() {
        let found = |text| {
            let start = Start::default();
            hello::<crate::packets::with_node::NoSensor>(
                1,
                text,
                &start,
                Capabilities::STORE,
                Part::default(),
            )
        };
        assert_eq!(found("1.20.3").firmware, [1, 20, 3]);
        assert_eq!(found("2.x").firmware, [2, 0, 0]);
        assert_eq!(found("1").sensor.name.as_str(), "none");
        let all = Capabilities::ACCELEROMETER.with(Capabilities::STORE);
        assert!(found("1").capabilities.contains(all));
    }
}
