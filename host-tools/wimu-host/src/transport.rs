//! Byte streams to and from a board, blocking with time-outs: serial ports, TCP, gateways behind a
//! broker, and with the feature `ble` Bluetooth Low Energy.

#[cfg(feature = "ble")]
pub mod ble;
pub mod nus;

use std::fmt;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use serialport::{SerialPort, SerialPortType};

use crate::fleet;
use crate::link_url::{DEFAULT_BAUD, LinkUrl};
use crate::{Code, Problem, Result};

/// Longest wait for a connection, and for a link to accept data.
const PATIENCE: Duration = Duration::from_secs(3);

/// The monotonic clock of real links: time since its first use.
pub fn now() -> Duration {
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed()
}

/// A byte stream to and from a board.
pub trait Transport {
    /// Reads available data, at least one byte; `Ok(0)` without any within `timeout`.
    ///
    /// # Errors
    /// `link_lost` when the other end is gone.
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize>;

    /// Writes all of `bytes`.
    ///
    /// # Errors
    /// `link_lost` when the other end is gone or accepts nothing for 3 s.
    fn write_all(&mut self, bytes: &[u8]) -> Result<()>;

    /// The monotonic clock of this link: all times of data and answers on it are from this clock,
    /// so that a simulated link can run in virtual time.
    fn now(&self) -> Duration {
        now()
    }

    /// Time on this clock at which the latest data read had arrived at this computer or, over a broker, at the
    /// gateway.
    fn received_at(&self) -> Duration {
        self.now()
    }

    /// Baud rate at this end; `None` for a link without one.
    fn baud(&self) -> Option<u32> {
        None
    }
}

impl<T: Transport + ?Sized> Transport for Box<T> {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        (**self).read(buffer, timeout)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        (**self).write_all(bytes)
    }

    fn now(&self) -> Duration {
        (**self).now()
    }

    fn received_at(&self) -> Duration {
        (**self).received_at()
    }

    fn baud(&self) -> Option<u32> {
        (**self).baud()
    }
}

/// Opens a link. [`LinkUrl::Auto`] opens the only port with the USB id of a known board.
///
/// # Errors
/// `link_absent`, `link_busy`, `link_permission`, `link_refused`; `bad_link` when several ports
/// match `auto`: [`candidates`] lists them.
pub fn open(link: &LinkUrl) -> Result<Box<dyn Transport + Send>> {
    match link {
        LinkUrl::Serial { path, baud } => Ok(Box::new(SerialLink::open(path, *baud)?)),
        LinkUrl::Tcp { host, port } => Ok(Box::new(TcpLink::open(link, host, *port)?)),
        #[cfg(feature = "ble")]
        LinkUrl::Ble { name } => Ok(Box::new(ble::open(name)?)),
        #[cfg(not(feature = "ble"))]
        LinkUrl::Ble { .. } => Err(without_ble(&link.to_string())),
        LinkUrl::Mqtt { broker, fleet, board } => {
            Ok(Box::new(fleet::open(&link.to_string(), broker, fleet, board)?))
        }
        LinkUrl::Auto => match candidates()?.as_slice() {
            [only] => open(only),
            several => {
                let names: Vec<_> = several.iter().map(LinkUrl::to_string).collect();
                Err(Code::BadLink
                    .error(
                        format!("several ports may be a board: {}", names.join(", ")),
                        "name one of them instead of `auto`",
                    )
                    .at("auto"))
            }
        },
    }
}

/// The ports that `auto` tries, in order: serial ports with the USB id of a known board. None is
/// opened.
///
/// # Errors
/// `link_absent` when there is none.
pub fn candidates() -> Result<Vec<LinkUrl>> {
    let found: Vec<_> = ports()?
        .into_iter()
        .filter(|port| port.board.is_some())
        .map(|port| LinkUrl::Serial { path: port.path, baud: DEFAULT_BAUD })
        .collect();
    if found.is_empty() {
        Err(Code::LinkAbsent.error("no serial port has the USB id of a known board",
            "plug the board in, or name its port: `wimu device ports` lists them; `wimu simulate` needs none",
        )
        .at("auto"))
    } else {
        Ok(found)
    }
}

/// The error of a LINK that needs the feature `ble`.
#[cfg(not(feature = "ble"))]
pub(crate) fn without_ble(link: &str) -> Problem {
    Code::LinkKindMissing
        .error(
            "Bluetooth Low Energy is not built into this wimu",
            "install it with `cargo install --path host-tools/wimu --features ble` (Debian: package libdbus-1-dev), \
             or use a Bluetooth serial (SPP) adapter or a cable",
        )
        .at(link)
}

/// The units with the Nordic UART Service in range, as ports; takes 4 s. None without the feature `ble`.
///
/// # Errors
/// `link_absent` without a Bluetooth adapter.
pub fn nearby() -> Result<Vec<Port>> {
    #[cfg(feature = "ble")]
    return ble::nearby();
    #[cfg(not(feature = "ble"))]
    Ok(Vec::new())
}

/// A serial port of this computer, or a unit in range.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Port {
    /// Path or name, as a LINK.
    pub path: String,
    /// USB vendor and product id, for a port on USB.
    pub usb: Option<UsbId>,
    /// Product name that the device reports.
    pub product: Option<String>,
    /// Serial number that the device reports.
    pub serial_number: Option<String>,
    /// Boards and adapters with this USB id.
    pub board: Option<&'static str>,
}

/// USB vendor and product id.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct UsbId {
    /// Vendor.
    pub vendor: u16,
    /// Product.
    pub product: u16,
}

impl UsbId {
    /// The board or serial adapter with this id, if wimu supports it.
    pub fn board(self) -> Option<&'static str> {
        KNOWN_BOARDS
            .iter()
            .find(|(vendor, product, _)| {
                *vendor == self.vendor && product.is_none_or(|product| product == self.product)
            })
            .map(|(_, _, name)| *name)
    }
}

impl fmt::Display for UsbId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{:04x}:{:04x}", self.vendor, self.product)
    }
}

/// Vendor, product (any if `None`), name.
const KNOWN_BOARDS: [(u16, Option<u16>, &str); 9] = [
    (0x0d28, Some(0x0204), "micro:bit"),
    (0x1366, None, "SEGGER probe"),
    (0x2886, Some(0x8045), "XIAO nRF52840 Sense"),
    (0x2e8a, None, "Raspberry Pi Pico or its debug probe"),
    (0x303a, Some(0x1001), "ESP32-C3 or a relative"),
    (0x0403, None, "FTDI serial adapter"),
    (0x10c4, Some(0xea60), "CP210x serial adapter"),
    (0x10c4, Some(0xea70), "CP2105 serial adapter"),
    (0x1a86, Some(0x7523), "CH340 serial adapter"),
];

/// The serial ports, by name; none is opened.
///
/// # Errors
/// `link_absent` when the operating system does not list them.
pub fn ports() -> Result<Vec<Port>> {
    let found = serialport::available_ports().map_err(|error| {
        Code::LinkAbsent.error(
            format!("the operating system does not list its serial ports: {error}"),
            "name the port",
        )
    })?;
    let mut ports: Vec<_> = found
        .into_iter()
        .map(|port| match port.port_type {
            SerialPortType::UsbPort(usb) => {
                let id = UsbId { vendor: usb.vid, product: usb.pid };
                Port {
                    path: port.port_name,
                    usb: Some(id),
                    product: usb.product,
                    serial_number: usb.serial_number,
                    board: id.board(),
                }
            }
            _ => Port {
                path: port.port_name,
                usb: None,
                product: None,
                serial_number: None,
                board: None,
            },
        })
        .collect();
    ports.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(ports)
}

struct SerialLink {
    path: String,
    port: Box<dyn SerialPort>,
}

impl SerialLink {
    fn open(path: &str, baud: u32) -> Result<Self> {
        let port = serialport::new(path, baud)
            .timeout(PATIENCE)
            .open()
            .map_err(|error| serial_error(path, baud, &error))?;
        Ok(Self { path: path.to_owned(), port })
    }
}

impl Transport for SerialLink {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        self.port.set_timeout(timeout).map_err(|error| lost(&self.path, &error.into()))?;
        read_some(&mut self.port, buffer, &self.path)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        self.port.set_timeout(PATIENCE).map_err(|error| lost(&self.path, &error.into()))?;
        self.port.write_all(bytes).map_err(|error| lost(&self.path, &error))
    }

    fn baud(&self) -> Option<u32> {
        self.port.baud_rate().ok()
    }
}

fn serial_error(path: &str, baud: u32, error: &serialport::Error) -> Problem {
    use serialport::ErrorKind as Kind;
    let exists = if cfg!(unix) {
        std::path::Path::new(path).exists()
    } else {
        ports().is_ok_and(|ports| ports.iter().any(|port| port.path.eq_ignore_ascii_case(path)))
    };
    let failure = match error.kind() {
        _ if !exists => Code::LinkAbsent.error("there is no such serial port",
            "plug in the board or adapter (bind a paired Bluetooth adapter: `sudo rfcomm bind 0 ADDRESS`); `wimu device ports` lists the ports",
        ),
        Kind::Io(ErrorKind::PermissionDenied) if cfg!(unix) => Code::LinkPermission.error("no permission to open the port",
            "join the port's group (`sudo usermod -aG dialout $USER`, on Arch `uucp`) and log in again, or put \
             `SUBSYSTEM==\"tty\", ATTRS{idVendor}==\"0d28\", TAG+=\"uaccess\"` with the adapter's own id into \
             /etc/udev/rules.d/70-wimu.rules and plug it in again",
        ),
        // Windows calls a port that is open elsewhere a denied access.
        Kind::NoDevice | Kind::Io(ErrorKind::PermissionDenied | ErrorKind::WouldBlock) => {
            Code::LinkBusy.error("another program has the port open",
                "close the other terminal, monitor or modem manager",
            )
        }
        _ => Code::LinkAbsent.error(format!("the port does not open at {baud} baud: {error}"),
            "check that it is a serial port and that it supports this baud rate",
        ),
    };
    failure.at(path)
}

struct TcpLink {
    name: String,
    stream: TcpStream,
    timeout: Option<Duration>,
}

impl TcpLink {
    fn open(link: &LinkUrl, host: &str, port: u16) -> Result<Self> {
        let name = link.to_string();
        let addresses = (host, port).to_socket_addrs().map_err(|error| {
            Code::LinkAbsent
                .error(format!("unknown host `{host}`: {error}"), "check the name and the network")
                .at(&name)
        })?;
        let mut last = io::Error::from(ErrorKind::AddrNotAvailable);
        for address in addresses {
            match TcpStream::connect_timeout(&address, PATIENCE) {
                Ok(stream) => {
                    // Requests are small and wait for their replies.
                    let ready = stream
                        .set_nodelay(true)
                        .and_then(|()| stream.set_write_timeout(Some(PATIENCE)));
                    ready.map_err(|error| lost(&name, &error))?;
                    return Ok(Self { name, stream, timeout: None });
                }
                Err(error) => last = error,
            }
        }
        Err(match last.kind() {
            ErrorKind::ConnectionRefused => Code::LinkRefused.error(
                "nothing listens at this address",
                "start `wimu simulate` first, or check the port",
            ),
            _ => Code::LinkAbsent.error(
                format!("the host does not answer: {last}"),
                "check the address and the network",
            ),
        }
        .at(name))
    }
}

impl Transport for TcpLink {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        // Whole ms, so that equal waits need no system call to set it; zero would mean without limit.
        let timeout = Some(Duration::from_millis(timeout.as_millis() as u64 + 1));
        if self.timeout != timeout {
            self.stream.set_read_timeout(timeout).map_err(|error| lost(&self.name, &error))?;
            self.timeout = timeout;
        }
        read_some(&mut self.stream, buffer, &self.name)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        self.stream.write_all(bytes).map_err(|error| lost(&self.name, &error))
    }
}

fn read_some(source: &mut dyn Read, buffer: &mut [u8], name: &str) -> Result<usize> {
    if buffer.is_empty() {
        return Ok(0);
    }
    match source.read(buffer) {
        Ok(0) => Err(lost(name, &io::Error::from(ErrorKind::UnexpectedEof))),
        Ok(count) => Ok(count),
        Err(error) => match error.kind() {
            ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted => Ok(0),
            _ => Err(lost(name, &error)),
        },
    }
}

fn lost(name: &str, error: &io::Error) -> Problem {
    let message = match error.kind() {
        ErrorKind::UnexpectedEof => "the other end closed the link".to_owned(),
        ErrorKind::TimedOut | ErrorKind::WouldBlock => {
            format!("the other end has accepted no data for {} s", PATIENCE.as_secs())
        }
        _ => format!("the link failed: {error}"),
    };
    Code::LinkLost
        .error(message, "check the cable, the adapter's power and its range, then connect again")
        .at(name)
}
