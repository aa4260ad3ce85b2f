//! The radio: Espressif's controller.

use esp_hal::peripherals::BT;
use esp_radio::ble::Config;
use esp_radio::ble::controller::{BleConnector, BleConnectorError};
use trouble_host::prelude::ExternalController;

/// Commands that may be under way.
const COMMANDS: usize = 8;

pub type Controller = ExternalController<BleConnector<'static>, COMMANDS>;
pub type ControllerError = BleConnectorError;

/// Starts the controller, for one connection. The scheduler must run. Call it once.
pub fn controller(chip: BT<'static>) -> Controller {
    let config = Config::default().with_max_connections(1);
    // It fails only with a configuration that is not valid.
    ExternalController::new(BleConnector::new(chip, config).unwrap())
}
