//! The wireless link: a Bluetooth adapter on a UART.

use embassy_nrf::buffered_uarte::{BufferedUarteRx, BufferedUarteTx};
use embassy_nrf::uarte::{Baudrate, Config};
use wimu_node::Store;

pub type Receiver = BufferedUarteRx<'static>;
pub type Sender = BufferedUarteTx<'static>;
pub const NEAREST_RATE: Option<fn(u32) -> u32> = Some(|baud| setting(baud).0);

/// The rates of the datasheet, bit/s.
const RATES: [(u32, Baudrate); 17] = [
    (1200, Baudrate::Baud1200),
    (2400, Baudrate::Baud2400),
    (4800, Baudrate::Baud4800),
    (9600, Baudrate::Baud9600),
    (14_400, Baudrate::Baud14400),
    (19_200, Baudrate::Baud19200),
    (28_800, Baudrate::Baud28800),
    (31_250, Baudrate::Baud31250),
    (38_400, Baudrate::Baud38400),
    (56_000, Baudrate::Baud56000),
    (57_600, Baudrate::Baud57600),
    (76_800, Baudrate::Baud76800),
    (115_200, Baudrate::Baud115200),
    (230_400, Baudrate::Baud230400),
    (250_000, Baudrate::Baud250000),
    (460_800, Baudrate::Baud460800),
    (921_600, Baudrate::Baud921600),
];

/// The setting nearest to `baud`, with its rate, bit/s.
fn setting(baud: u32) -> (u32, Baudrate) {
    let nearest = RATES.into_iter().min_by_key(|(rate, _)| rate.abs_diff(baud));
    nearest.unwrap_or((115_200, Baudrate::Baud115200))
}

/// 115,200 bits/s, 8N1, unless another rate is stored.
pub fn config(store: &mut impl Store) -> Config {
    let mut config = Config::default();
    if let Some(baud) = wimu_node::line_rate(store) {
        config.baudrate = setting(baud).1;
    }
    config
}
