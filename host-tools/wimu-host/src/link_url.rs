//! LINK and input file arguments.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::fleet::topics::{Broker, Name};
use crate::formats::{self, Source};
use crate::{Code, Problem, Result};

/// Default baud rate.
pub const DEFAULT_BAUD: u32 = 115_200;

/// A link to a board.
///
/// | text | meaning |
/// |---|---|
/// | `serial:///dev/ttyACM0?baud=115200`, `serial://COM5` | a serial port; the baud rate is optional |
/// | `/dev/ttyACM0`, `/dev/rfcomm0`, `/dev/cu.usbmodem1`, `COM5` | the same, at 115200 baud |
/// | `tcp://127.0.0.1:7100`, `tcp://[::1]:7100` | a TCP server |
/// | `ble://wimu-1a2b`, `ble://D4:7C:12:34:56:78` | a unit with the Nordic UART Service; needs the feature `ble` |
/// | `mqtt://127.0.0.1/hall/board-1`, `mqtts://me@host:8883/hall/board-1` | a board of a fleet, through a broker |
/// | `auto` | the serial port with the USB id of a known board |
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum LinkUrl {
    /// A serial port.
    Serial {
        /// Path or name in the operating system.
        path: String,
        /// Baud rate.
        baud: u32,
    },
    /// A TCP server.
    Tcp {
        /// Host name or address, an IPv6 address without brackets.
        host: String,
        /// Port.
        port: u16,
    },
    /// A unit with the Nordic UART Service over Bluetooth Low Energy.
    Ble {
        /// Its name, or its address.
        name: String,
    },
    /// A board of a fleet, through a broker.
    Mqtt {
        /// The broker.
        broker: Broker,
        /// Name of the fleet.
        fleet: Name,
        /// Name of the board.
        board: Name,
    },
    /// The only port with the USB id of a known board.
    Auto,
}

impl FromStr for LinkUrl {
    type Err = Problem;

    fn from_str(text: &str) -> Result<Self> {
        let bad = |message: String| {
            Code::BadLink.error(message,
                "write serial:///dev/ttyACM0?baud=115200, COM5, /dev/ttyACM0, tcp://127.0.0.1:7100, mqtt://HOST/FLEET/BOARD or auto",
            )
            .at(text)
        };
        if text == "auto" {
            return Ok(Self::Auto);
        }
        if let Some(rest) = text.strip_prefix("serial://") {
            return parse_serial(rest).map_err(bad);
        }
        if let Some(rest) = text.strip_prefix("tcp://") {
            return parse_tcp(rest).map_err(bad);
        }
        if text.starts_with("mqtt://") || text.starts_with("mqtts://") {
            return parse_mqtt(text)
                .map_err(|why| Code::BadLink.error(why, "write mqtt://HOST/FLEET/BOARD").at(text));
        }
        if let Some(name) = text.strip_prefix("ble://") {
            return parse_ble(name, text).map_err(|error| error.at(text));
        }
        if let Some((scheme, _)) = text.split_once("://") {
            return Err(bad(format!("`{scheme}` is not a kind of link")));
        }
        if text.starts_with("/dev/") || is_com_port(text) {
            return Ok(Self::Serial { path: text.to_owned(), baud: DEFAULT_BAUD });
        }
        Err(bad("this is not a LINK".to_owned()))
    }
}

fn parse_serial(rest: &str) -> Result<LinkUrl, String> {
    let (path, query) = rest.split_once('?').unwrap_or((rest, ""));
    // `serial:///COM5` has the URL's slash before the name.
    let path = match path.strip_prefix('/') {
        Some(name) if is_com_port(name) => name,
        _ => path,
    };
    if path.is_empty() || path == "/" {
        return Err("the serial port is missing".to_owned());
    }
    let mut baud = DEFAULT_BAUD;
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        match pair.split_once('=') {
            Some(("baud", value)) => {
                let rate = value.parse().ok().filter(|baud| *baud > 0);
                baud = rate.ok_or_else(|| format!("`{value}` is not a baud rate"))?;
            }
            _ => return Err(format!("`{pair}` is not an option of a serial link")),
        }
    }
    Ok(LinkUrl::Serial { path: path.to_owned(), baud })
}

#[cfg(feature = "ble")]
fn parse_ble(name: &str, _: &str) -> Result<LinkUrl> {
    let missing = || {
        let message = "the name of the unit is missing";
        Code::BadLink.error(message, "`wimu device ports --probe` lists the units in range")
    };
    let name = Some(name.trim_end_matches('/')).filter(|name| !name.is_empty());
    let name = name.ok_or_else(missing)?.to_owned();
    Ok(LinkUrl::Ble { name })
}

#[cfg(not(feature = "ble"))]
fn parse_ble(_: &str, text: &str) -> Result<LinkUrl> {
    Err(crate::transport::without_ble(text))
}

fn parse_tcp(rest: &str) -> Result<LinkUrl, String> {
    let rest = rest.strip_suffix('/').unwrap_or(rest);
    let (host, port) = rest.rsplit_once(':').ok_or_else(|| "the TCP port is missing".to_owned())?;
    let host = match host.strip_prefix('[').and_then(|h| h.strip_suffix(']')) {
        Some(address) => address,
        None if host.contains(':') => {
            return Err("an IPv6 address needs brackets: tcp://[::1]:7100".to_owned());
        }
        None => host,
    };
    if host.is_empty() {
        return Err("the host is missing".to_owned());
    }
    let port = port
        .parse()
        .ok()
        .filter(|port| *port > 0)
        .ok_or_else(|| format!("`{port}` is not a TCP port"))?;
    Ok(LinkUrl::Tcp { host: host.to_owned(), port })
}

fn parse_mqtt(text: &str) -> Result<LinkUrl, String> {
    let (broker, path) = Broker::split(text)?;
    let path = path.strip_suffix('/').unwrap_or(path);
    let (fleet, board) = path.split_once('/').ok_or("the fleet or the board is missing")?;
    let name =
        |what: &str, text: &str| text.parse::<Name>().map_err(|why| format!("the {what}: {why}"));
    Ok(LinkUrl::Mqtt { broker, fleet: name("fleet", fleet)?, board: name("board", board)? })
}

fn is_com_port(text: &str) -> bool {
    text.get(..3).is_some_and(|prefix| prefix.eq_ignore_ascii_case("COM"))
        && text.len() > 3
        && text[3..].bytes().all(|b| b.is_ascii_digit())
}

impl fmt::Display for LinkUrl {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial { path, baud } => write!(out, "serial://{path}?baud={baud}"),
            Self::Tcp { host, port } if host.contains(':') => write!(out, "tcp://[{host}]:{port}"),
            Self::Tcp { host, port } => write!(out, "tcp://{host}:{port}"),
            Self::Ble { name } => write!(out, "ble://{name}"),
            Self::Mqtt { broker, fleet, board } => write!(out, "{broker}/{fleet}/{board}"),
            Self::Auto => out.write_str("auto"),
        }
    }
}

/// Input of a command: a link, a recording or a CSV file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// A live board.
    Link(LinkUrl),
    /// A recording of wimu, detected by content.
    Recording(PathBuf),
    /// Any other file or folder.
    File(PathBuf),
}

impl Input {
    /// Distinguishes a LINK from a file, and a recording of wimu from others by its first bytes.
    ///
    /// # Errors
    /// A LINK's own errors; `file_unreadable` when it is neither a LINK nor a readable file.
    pub fn parse(text: &str) -> Result<Self> {
        let path = Path::new(text);
        if text == "auto" || text.contains("://") || !path.exists() {
            return match text.parse() {
                Ok(link) => Ok(Self::Link(link)),
                Err(error) if text.contains("://") => Err(error),
                Err(_) => Err(Code::FileUnreadable.error("there is no such file, and it is not a LINK",
                    "name a recording (.mcap), a CSV file, or a LINK such as /dev/ttyACM0 or tcp://127.0.0.1:7100",
                )
                .at(text)),
            };
        }
        let is_own = formats::is_own(&Source::open(path)?);
        Ok(if is_own { Self::Recording(path.to_owned()) } else { Self::File(path.to_owned()) })
    }
}
