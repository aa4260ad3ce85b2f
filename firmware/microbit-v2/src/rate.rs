//! The rate of a UART.

use embassy_nrf::uarte::Baudrate;

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
pub fn setting(baud: u32) -> (u32, Baudrate) {
    let nearest = RATES.into_iter().min_by_key(|(rate, _)| rate.abs_diff(baud));
    nearest.unwrap_or((115_200, Baudrate::Baud115200))
}

/// The supported rate nearest to `baud`, bit/s.
pub fn nearest(baud: u32) -> u32 {
    setting(baud).0
}
